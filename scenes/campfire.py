"""Sparks from a campfire (Bridson's slide 9), over a bed of embers and a body of flame."""

import tparticles as tp


def scene(
    quality: str,
    *,
    wind: float = 0.25,
    power: float = 45.0,
    rate: float = 2.5,
    turbulence: float = 0.9,
    seed: int = 1,
) -> tp.Scene:
    """Describe the film.

    wind [m/s] blows to the right; power [kW] of the fire drives the plume; rate is the mean number of sparks born in 1/24 s;
    turbulence [m/s] is the speed of the largest eddies.
    """
    plume = tp.Plume(power=power, radius=0.32)
    # Eddies are carried up by the mean flow; they die out at the ground.
    eddies = tp.CurlNoise(
        speed=turbulence, length=0.9, octaves=3, gain=0.6, drift=(wind, 0.0, 1.6), period=1.6, ramp=0.5, seed=seed
    )
    smoke = plume + eddies + tp.Uniform(wind=(wind, 0.0, 0.0))

    sparks = tp.Group(
        name="sparks",
        system=tp.Advected(flow=smoke),
        emitters=tp.Emitter(
            births=tp.PerFrame(mean=rate, variance=0.5),
            shape=tp.Disc(center=(0.0, 0.0, 0.12), radius=0.3),
            temperature=tp.Spread(mean=1380.0, variance=150.0),
            size=tp.Spread(mean=0.003, variance=0.0012),
            preroll=2.6,
        ),
        cooling=tp.Exponential(time=3.0, ambient=293.0),
        region=tp.Box(low=(-6.0, -4.0, -0.5), high=(6.0, 6.0, 8.0)),
    )
    # Tongues of flame: the same smoke with smaller eddies on top, drawn as soft, short-lived, optically thin blobs.
    tongues = tp.CurlNoise(
        speed=0.75, length=0.34, octaves=2, drift=(wind, 0.0, 2.2), period=0.7, ramp=0.2, seed=seed + 1
    )
    flames = tp.Group(
        name="flames",
        system=tp.Advected(flow=smoke + tongues),
        emitters=tp.Emitter(
            births=tp.Rate(rate=2200.0),
            shape=tp.Disc(center=(0.0, 0.0, 0.04), radius=0.27),
            temperature=tp.Spread(mean=1560.0, variance=120.0),
            size=tp.Spread(mean=0.062, variance=0.03),
            lifetime=tp.Spread(mean=0.42, variance=0.3),
            preroll=0.75,
        ),
        cooling=tp.Exponential(time=0.95, ambient=293.0),
        appearance=tp.Glow(emissivity=0.0019, fade_in=0.15, fade_out=0.6),
    )
    embers = tp.Group(
        name="embers",
        system=tp.Still(),
        emitters=tp.Emitter(
            births=tp.Rate(rate=120.0),
            shape=tp.Disc(center=(0.0, 0.0, 0.02), radius=0.38),
            temperature=tp.Spread(mean=1010.0, variance=90.0),
            size=tp.Spread(mean=0.026, variance=0.012),
            lifetime=tp.Spread(mean=3.0, variance=1.5),
            preroll=2.6,
        ),
        appearance=tp.Glow(emissivity=0.8, fade_in=0.4, fade_out=0.5),
    )
    return tp.Scene(
        groups=(embers, flames, sparks),
        camera=tp.Camera(position=(0.0, -5.6, 1.25), target=(0.12, 0.0, 1.24), fov=28.5),
        look=tp.Look(ev=4.0, tone="filmic"),
        background=tp.Gradient(top=(0.012, 0.016, 0.030), bottom=(0.045, 0.034, 0.034)),
        duration=10.0,
        # To half a pixel in any size, so that a preview shows the sparks where the film will have them.
        scheme="abm5-pec",
        steps=tp.PixelTolerance(px=0.5),
        seed=seed,
    )
