"""A scene that compiles quickly, for tests that change something about it, and pictures that need no scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np

SCENE = '''"""A tiny film."""
import tparticles as tp


def scene(quality, *, turn: float = 20.0, ev: float = 7.0) -> tp.Scene:
    dots = tp.Group(
        name="dots",
        system=tp.Advected(flow=tp.Vortex(axis=(0.0, 1.0, 0.0), circulation=turn, core=0.4)),
        emitters=tp.Emitter(births=tp.Burst(count=40), shape=tp.Sphere(radius=1.0), size=0.2, temperature=(1500.0, 200.0)),
    )
    camera = tp.Camera(position=(0.0, -5.0, 0.0), target=(0.0, 0.0, 0.0))
    return tp.Scene(groups=dots, camera=camera, look=tp.Look(ev=ev), duration=0.5, size=(64, 36), shutter=0.0)
'''
PLAN = """
[tiny]
size = [64, 36]
frames = [1, 4]
"""


def write_scene(folder: Path, name: str = "tiny", **changes: str) -> Path:
    """Write a scene, with other defaults of its parameters."""
    text = SCENE
    for parameter, value in changes.items():
        old = {"turn": "turn: float = 20.0", "ev": "ev: float = 7.0"}[parameter]
        text = text.replace(old, f"{parameter}: float = {value}")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.py").write_text(text)
    return folder / f"{name}.py"


def picture(seed: int = 0, size: tuple[int, int] = (64, 36)) -> np.ndarray:
    """Return a picture of noise."""
    return np.random.default_rng(seed).integers(20, 200, (size[1], size[0], 3)).astype(np.uint8)
