"""A rope bridge of steel cables swings after a gust: springs 100 000 times as stiff as its weight asks for, by implicit steps."""

import numpy as np

import tparticles as tp


def scene(quality: str, *, planks: int = 48, ratio: float = 1e5, gust: float = 3.0, scheme: str = "sdirk2") -> tp.Scene:
    """Describe the film.

    planks of the bridge; ratio of a cable's stiffness k l to the weight of its vertex m g; gust [m/s] that it starts with.
    """
    span, width, sag, rail, mass = 8.0, 1.0, 0.9, 0.8, 2.0
    s = np.linspace(-1.0, 1.0, planks + 1)
    low = np.stack([0.5 * span * s, np.zeros_like(s), sag * (s * s - 1.0)], axis=1)
    lines = [low + np.array([0.0, side * 0.5 * width, up * rail]) for up in (0, 1) for side in (-1, 1)]
    n = len(s)
    i, j = np.arange(n), np.arange(n - 1)
    along = [np.stack([k * n + j, k * n + j + 1], axis=1) for k in range(4)]
    across = [np.stack([i, n + i], axis=1), np.stack([i, 2 * n + i], axis=1), np.stack([n + i, 3 * n + i], axis=1)]
    braces = [np.stack([j, n + j + 1], axis=1), np.stack([j, 2 * n + j + 1], axis=1)]
    springs = np.concatenate([*along, *across, *braces])
    ends = [k * n + end for k in range(4) for end in (0, n - 1)]
    swing = gust * np.sin(np.pi * i / (n - 1))
    bridge = tp.Mesh(
        x=np.concatenate(lines),
        v=np.tile(swing, 4)[:, None] * (0.0, 1.0, 0.35),
        mass=mass,
        springs=springs,
        stiffness=ratio * mass * 9.81 / (span / planks),
        damping=4.0,
    ).pin(ends)
    group = tp.MeshGroup(
        name="bridge",
        mesh=bridge,
        appearance=tp.Wires(
            by="speed", colors=((0.42, 0.27, 0.13), (0.85, 0.62, 0.30), (1.0, 0.95, 0.8)), high=3.0, width=0.02
        ),
        scheme=scheme,
        steps=tp.Fixed(dt=1 / 96),
    )
    return tp.Scene(
        groups=(group,),
        camera=tp.Camera(position=(2.6, -9.0, 1.7), target=(0.1, 0.0, -0.25), fov=34.0),
        background=tp.Gradient(top=(0.03, 0.05, 0.09), bottom=(0.09, 0.08, 0.08)),
        duration=6.0,
    )
