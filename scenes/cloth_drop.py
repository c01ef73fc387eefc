"""A cloth drops onto a ball and drapes itself over it, under a shower of sparks."""

import tparticles as tp


def scenery(name: str, mesh: tp.Mesh, color: tuple[float, float, float]) -> tp.MeshGroup:
    """Return a mesh that stands still: it shows what the cloth meets, and takes one step a frame."""
    wires = tp.Wires(colors=(color,), width=0.006)
    return tp.MeshGroup(
        name=name,
        mesh=mesh.pin(where=tp.Sphere(radius=6.0)),
        forces=(),
        appearance=wires,
        scheme="rk4",
        steps=tp.Fixed(dt=1.0),
    )


def scene(
    quality: str,
    *,
    count: int = 72,
    stiffness: float = 60.0,
    friction: float = 0.35,
    rate: float = 260.0,
    seed: int = 1,
) -> tp.Scene:
    """Describe the film.

    count of vertices along a side; stiffness [N/m]; friction of the ball; rate [1/s] of the sparks.
    """
    sheet = tp.cloth(counts=(count, count), size=(2.4, 2.4), mass=0.5, stiffness=stiffness, damping=0.002)
    ball = tp.Ball(center=(0.0, 0.0, 0.75), radius=0.6, restitution=0.0, friction=friction)
    cloth = tp.MeshGroup(
        name="cloth",
        mesh=sheet.turned((0.2, 0.1, 1.0), 24.0).moved((0.1, 0.05, 1.75)),
        forces=(tp.Gravity(), tp.Drag(time=1.6)),
        colliders=(ball, tp.Plane(restitution=0.0, friction=0.6)),
        radius=0.012,
        appearance=tp.Wires(
            by="strain",
            colors=((0.10, 0.16, 0.34), (0.32, 0.42, 0.66), (0.95, 0.65, 0.40)),
            low=-0.04,
            high=0.10,
            width=0.0045,
        ),
        scheme="velocity-verlet",
        steps=tp.StabilityLimit(safety=0.9),
    )
    shell = tp.sphere_shell(radius=ball.radius, subdivisions=2, bend=0.0, bracing=0.0)
    tiles = tp.cloth(counts=(21, 21), size=8.0, shear=0.0, bend=0.0)
    top = ball.center[2] + ball.radius
    air = tp.CurlNoise(speed=0.35, length=0.6, octaves=2, period=1.0, seed=seed)
    sparks = tp.Group(
        name="sparks",
        system=tp.Newtonian(forces=(tp.Gravity(), tp.Drag(time=0.45, flow=air))),
        emitters=(
            tp.Emitter(
                name="shower",
                births=tp.Rate(rate=rate),
                shape=tp.Disc(center=(0.0, 0.0, 3.3), radius=0.35),
                velocity=tp.Cone(axis=(0.0, 0.0, -1.0), angle=10.0, speed=tp.Spread(mean=1.0, variance=0.6)),
                temperature=tp.Spread(mean=1750.0, variance=180.0),
                size=tp.Spread(mean=0.0022, variance=0.001),
                preroll=0.25,
            ),
            # Particles meet no mesh: what falls ends at the top of the draped ball, and as much is thrown up from there.
            tp.Emitter(
                name="splash",
                births=tp.Rate(rate=rate),
                shape=tp.Disc(center=(0.0, 0.0, top), radius=0.25),
                velocity=tp.Cone(angle=50.0, speed=tp.Spread(mean=1.8, variance=1.0)),
                temperature=tp.Spread(mean=1500.0, variance=180.0),
                size=tp.Spread(mean=0.0018, variance=0.0008),
                start=0.45,
            ),
        ),
        cooling=tp.Exponential(time=2.0, ambient=293.0),
        region=tp.Box(low=(-4.0, -4.0, top), high=(4.0, 4.0, 4.0)),
    )
    return tp.Scene(
        groups=(
            sparks,
            cloth,
            scenery("ball", shell.moved(ball.center), (0.80, 0.48, 0.24)),
            scenery("floor", tiles, (0.19, 0.21, 0.27)),
        ),
        camera=tp.Camera(position=(1.3, -5.4, 2.5), target=(0.0, 0.0, 0.85), fov=31.0),
        look=tp.Look(ev=7.0),
        background=tp.Gradient(top=(0.015, 0.018, 0.030), bottom=(0.050, 0.046, 0.050)),
        duration=5.0,
        steps=tp.StabilityLimit(safety=0.9),
        seed=seed,
    )
