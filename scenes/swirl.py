"""Tracers in an ABC flow, coloured by age: the throughput scene."""

import tparticles as tp


def scene(quality: str, *, count: int = 200_000, spin_up: float = 6.0, speed: float = 0.4, seed: int = 1) -> tp.Scene:
    """Describe the film: `count` tracers, released over `spin_up` [s]; speed [m/s] scales the flow."""
    flow = tp.ABC(A=1.732 * speed, B=1.414 * speed, C=speed, length=2.4)
    # Four springs of tracers; all are released before the film begins, so it opens on every age up to `spin_up`.
    places = ((0.9, 0.0, 0.0), (-0.9, 0.2, 0.1), (0.0, 0.9, -0.4), (0.1, -0.9, 0.5))
    tracers = tp.Group(
        name="tracers",
        system=tp.Advected(flow=flow),
        emitters=tuple(
            tp.Emitter(
                name=f"spring {i}",
                births=tp.Rate(rate=count / len(places) / spin_up),
                start=-spin_up,
                stop=0.0,
                shape=tp.Sphere(center=place, radius=0.16),
                size=0.006,
            )
            for i, place in enumerate(places)
        ),
        appearance=tp.Ramp(
            colors=((0.25, 0.55, 1.0), (0.55, 0.35, 1.0), (1.0, 0.35, 0.55), (1.0, 0.75, 0.35)),
            span=spin_up + 4.0,
            brightness=0.7 * (200_000 / count),
        ),
    )
    return tp.Scene(
        groups=(tracers,),
        camera=tp.Camera(
            position=tp.Track(keys=((0.0, (1.0, -8.2, 1.8)), (4.0, (5.0, -6.6, 2.8))), smooth=True),
            target=(0.2, 0.0, 0.6),
            fov=42.0,
        ),
        look=tp.Look(tone="reinhard", white=6.0),
        background=tp.Gradient(top=(0.01, 0.012, 0.03), bottom=(0.02, 0.015, 0.03)),
        duration=4.0,
        steps=tp.Fixed(dt=1 / 48),
        shutter=0.0,
        seed=seed,
    )
