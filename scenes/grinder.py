"""Sparks of an angle grinder: hot, fast, with inertia, under gravity and drag."""

import tparticles as tp


def scene(
    quality: str,
    *,
    rate: float = 2600.0,
    speed: float = 12.0,
    spread: float = 13.0,
    response: float = 0.25,
    seed: int = 1,
) -> tp.Scene:
    """Describe the film.

    rate [1/s] of sparks; speed [m/s] at the wheel; spread [degrees] of the fan; response [s] to the air, the drag's time.
    """
    air = tp.CurlNoise(speed=0.8, length=0.5, octaves=2, period=0.8, seed=seed) + tp.Uniform(wind=(0.4, 0.0, 0.1))
    sparks = tp.Group(
        name="sparks",
        system=tp.Newtonian(forces=(tp.Gravity(), tp.Drag(time=response, flow=air))),
        emitters=tp.Emitter(
            births=tp.Rate(rate=((0.0, 0.0), (0.15, rate), (2.6, rate), (2.8, 0.2 * rate), (3.1, rate))),
            shape=tp.Line(start=(-1.32, -0.02, 1.04), end=(-1.28, 0.02, 1.08)),
            velocity=tp.Cone(axis=(1.0, 0.0, 0.22), angle=spread, speed=tp.Spread(mean=speed, variance=0.45 * speed)),
            temperature=tp.Spread(mean=1800.0, variance=200.0),
            size=tp.Spread(mean=0.0014, variance=0.0007),
        ),
        cooling=tp.Exponential(time=0.8, ambient=293.0),
        region=tp.Box(low=(-4.0, -4.0, 0.0), high=(6.0, 4.0, 4.0)),
    )
    return tp.Scene(
        groups=(sparks,),
        camera=tp.Camera(position=(0.3, -3.6, 1.0), target=(0.3, 0.0, 0.98), fov=34.0),
        look=tp.Look(ev=7.0),
        background=tp.Gradient(top=(0.020, 0.022, 0.028), bottom=(0.055, 0.055, 0.060)),
        duration=4.0,
        scheme="abm5-pec",
        steps=tp.PixelTolerance(px=0.5),
        shutter=0.6,
        seed=seed,
    )
