"""A flag over a fire: the plume lifts it, its eddies make it flap, sparks fly through."""

import tparticles as tp


def scene(quality: str, *, count: int = 48, wind: float = 2.4, power: float = 60.0, seed: int = 1) -> tp.Scene:
    """Describe the film.

    count of vertices along the hoist; wind [m/s]; power [kW] of the fire.
    """
    plume = tp.Plume(power=power, radius=0.35, center=(0.0, 0.0, -0.6))
    eddies = tp.CurlNoise(speed=2.6, length=1.1, octaves=2, gain=0.7, drift=(wind, 0.0, 1.2), period=1.0, seed=seed)
    air = plume + eddies + tp.Uniform(wind=(wind, 0.0, 0.0))
    sheet = tp.cloth(counts=(3 * count // 2, count), size=(1.8, 1.2), mass=0.25, stiffness=90.0, damping=0.004)
    # upright, its hoist at x = -0.9
    flag = tp.MeshGroup(
        name="flag",
        mesh=sheet.turned((1.0, 0.0, 0.0), 90.0).moved((0.25, 0.0, 1.7)).pin(where=lambda x: x[:, 0] < -0.649),
        forces=(tp.Gravity(), tp.Drag(time=0.09, flow=air)),
        appearance=tp.Wires(
            by="speed", colors=((0.30, 0.03, 0.03), (0.80, 0.16, 0.05), (1.0, 0.75, 0.30)), high=4.5, width=0.006
        ),
        scheme="velocity-verlet",
        steps=tp.StabilityLimit(safety=0.9),
    )
    sparks = tp.Group(
        name="sparks",
        system=tp.Advected(flow=air),
        emitters=tp.Emitter(
            births=tp.Rate(rate=130.0),
            shape=tp.Disc(center=(0.0, 0.0, 0.0), radius=0.3),
            temperature=tp.Spread(mean=1400.0, variance=150.0),
            size=tp.Spread(mean=0.0032, variance=0.0012),
            preroll=2.0,
        ),
        cooling=tp.Exponential(time=2.6, ambient=293.0),
        region=tp.Box(low=(-4.0, -4.0, -0.5), high=(6.0, 4.0, 5.0)),
    )
    return tp.Scene(
        groups=(sparks, flag),
        camera=tp.Camera(position=(0.35, -5.2, 1.25), target=(0.35, 0.0, 1.4), fov=33.0),
        look=tp.Look(ev=4.2, tone="filmic"),
        background=tp.Gradient(top=(0.012, 0.016, 0.032), bottom=(0.048, 0.036, 0.036)),
        duration=6.0,
        steps=tp.Fixed(dt=1 / 96),
        seed=seed,
    )
