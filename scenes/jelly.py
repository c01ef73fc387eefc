"""A cube of jelly, a lattice of 20 x 20 x 20 masses, drops onto a bar and wobbles."""

import tparticles as tp


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
            tp.Capsule(start=(0.0, -1.5, 0.05), end=(0.0, 1.5, 0.05), radius=0.2, restitution=0.0, friction=0.8),
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
    return tp.Scene(
        groups=(jelly,),
        camera=tp.Camera(position=(1.9, -5.6, 2.0), target=(0.0, 0.0, 0.85), fov=33.0),
        background=tp.Gradient(top=(0.02, 0.02, 0.035), bottom=(0.05, 0.05, 0.06)),
        duration=4.0,
    )
