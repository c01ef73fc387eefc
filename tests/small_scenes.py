"""Small scenes for tests, and simulations of them with a clean backend."""

from __future__ import annotations

from typing import Any

import tparticles as tp
from tparticles import backend

WHITE = tp.Ramp(colors=((1.0, 1.0, 1.0),), span=1.0)
STILL = tp.Advected(flow=tp.Uniform())
CAMERA = tp.Camera(position=(0.0, -5.0, 0.0), target=(0.0, 0.0, 0.0))


def group(name: str = "dots", *, system: Any = STILL, appearance: Any = WHITE, **options: Any) -> tp.Group:
    """Return a group; what `tp.Group` does not take goes to its only emitter."""
    own = {k: options.pop(k) for k in ("cooling", "region", "too_cold", "capacity", "emitters") if k in options}
    own.setdefault("emitters", None)
    if own["emitters"] is None:
        own["emitters"] = tp.Emitter(**{"births": tp.Burst(count=10), **options})
    return tp.Group(name=name, system=system, appearance=appearance, **own)


def scene(*groups: tp.Group, **options: Any) -> tp.Scene:
    """Return a film of one second in 64 x 36 pixels."""
    return tp.Scene(groups=groups, **{"camera": CAMERA, "duration": 1.0, "size": (64, 36), "shutter": 0.0, **options})


def simulate(film: tp.Scene, **options: Any) -> tp.Simulation:
    """Return a simulation on a backend that was stopped before: fields of old ones are gone, cached kernels fit again."""
    backend.stop()
    return tp.Simulation(film, **{"arch": "cpu", "threads": 2, **options})
