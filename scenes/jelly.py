"""A cube of jelly, a lattice of 20 x 20 x 20 masses, drops onto a bar and wobbles."""

import numpy as np

import tparticles as tp

RADIUS, HALF, HEIGHT = 0.2, 1.5, 0.05  # of the bar, which lies along y, sunk into the floor [m]


def bar_wires() -> tp.Mesh:
    """Return hoops around the bar and lines along it, as much of them as the floor leaves to see."""
    y = np.linspace(-1.0, 1.0, 35)[:, None] * (HALF + 0.995 * RADIUS)
    r = np.sqrt(RADIUS**2 - np.maximum(abs(y) - HALF, 0.0) ** 2)  # round at both ends
    sunk = np.arcsin(HEIGHT / RADIUS)
    turn = np.linspace(-sunk, np.pi + sunk, 13)
    x = np.stack(np.broadcast_arrays(r * np.cos(turn), y, HEIGHT + r * np.sin(turn)), axis=-1)
    i = np.arange(y.size * turn.size).reshape(y.size, turn.size)
    springs = [np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ((i[1:], i[:-1]), (i[:, 1:], i[:, :-1]))]
    return tp.Mesh(x=x.reshape(-1, 3), springs=np.concatenate(springs), pinned=True)


def scenery(name: str, mesh: tp.Mesh, color: tuple[float, float, float]) -> tp.MeshGroup:
    """Return a mesh that stands still: it shows what the jelly meets, and takes one step a frame."""
    wires = tp.Wires(colors=(color,), width=0.006)
    return tp.MeshGroup(name=name, mesh=mesh, forces=(), appearance=wires, scheme="rk4", steps=tp.Fixed(dt=1.0))


def scene(
    quality: str, *, count: int = 20, stiffness: float = 130.0, damping: float = 0.05, spin: float = 0.3
) -> tp.Scene:
    """Describe the film.

    count of masses along an edge; stiffness [N/m] and damping [N s/m] of a spring; spin [rad/s] of the drop.
    """
    cube = tp.lattice(counts=(count, count, count), size=1.2, mass=35.0, stiffness=stiffness, damping=damping)
    jelly = tp.MeshGroup(
        name="jelly",
        mesh=cube.turned((1.0, 0.4, 0.2), 12.0).moved((0.0, 0.0, 1.75)).launched(spin=(0.4 * spin, spin, 0.0)),
        colliders=(
            tp.Plane(restitution=0.0, friction=0.8),
            tp.Capsule(
                start=(0.0, -HALF, HEIGHT), end=(0.0, HALF, HEIGHT), radius=RADIUS, restitution=0.0, friction=0.8
            ),
        ),
        appearance=tp.Wires(
            by="strain",
            colors=((0.05, 0.75, 0.75), (0.22, 0.45, 0.30), (0.95, 0.85, 0.10)),
            low=-0.16,
            high=0.16,
            width=0.0013,
        ),
        scheme="velocity-verlet",
        steps=tp.StabilityLimit(safety=0.9),
    )
    bar = scenery("bar", bar_wires(), (0.72, 0.42, 0.24))
    tiles = tp.cloth(counts=(21, 21), size=8.0, shear=0.0, bend=0.0).pin(where=tp.Sphere(radius=6.0))
    return tp.Scene(
        groups=(jelly, bar, scenery("floor", tiles, (0.19, 0.21, 0.27))),
        camera=tp.Camera(position=(1.9, -5.6, 2.0), target=(0.0, 0.0, 0.85), fov=33.0),
        background=tp.Gradient(top=(0.02, 0.02, 0.035), bottom=(0.05, 0.05, 0.06)),
        duration=4.0,
    )
