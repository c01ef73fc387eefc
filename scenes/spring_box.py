"""Lander's spring box: eight masses, thrown into a room, tumble and come to rest. Springs are coloured by their strain."""

import tparticles as tp

STRAIN = ((0.15, 0.45, 1.0), (0.75, 0.85, 1.0), (1.0, 0.35, 0.1))


def scene(
    quality: str,
    *,
    stiffness: float = 1500.0,
    damping: float = 1.0,
    spin: float = 4.0,
    restitution: float = 0.6,
    friction: float = 0.25,
) -> tp.Scene:
    """Describe the film.

    stiffness [N/m] and damping [N s/m] of the springs; spin [rad/s] of the throw; restitution and friction of the walls.
    """
    box = tp.spring_box(stiffness=stiffness, damping=damping).turned((1.0, 0.3, 0.2), 40.0).moved((-1.6, 0.0, 2.6))
    room = tp.Room(low=(-2.6, -1.6, 0.0), high=(2.6, 1.6, 4.2), restitution=restitution, friction=friction)
    thrown = tp.MeshGroup(
        name="box",
        mesh=box.launched((3.2, 0.6, 1.5), spin=(spin, 0.5 * spin, 0.3 * spin)),
        colliders=room,
        appearance=tp.Wires(by="strain", colors=STRAIN, low=-0.05, high=0.05, width=0.028, dot=0.15),
        scheme="rk4",
        steps=tp.StabilityLimit(safety=0.5),
    )
    corners = tp.lattice(counts=(2, 2, 2), size=(5.2, 3.2, 4.2), face_diagonal=0.0, body_diagonal=0.0)
    edges = tp.MeshGroup(
        name="room",
        mesh=corners.moved((0.0, 0.0, 2.1)).pin(tuple(range(8))),
        forces=(),
        appearance=tp.Wires(colors=((0.30, 0.33, 0.40),), width=0.014),
        scheme="rk4",
        steps=tp.Fixed(dt=1.0),
    )
    return tp.Scene(
        groups=(thrown, edges),
        camera=tp.Camera(position=(1.2, -9.0, 2.9), target=(0.0, 0.0, 1.95), fov=32.0),
        background=tp.Gradient(top=(0.02, 0.025, 0.04), bottom=(0.06, 0.06, 0.07)),
        duration=6.0,
    )
