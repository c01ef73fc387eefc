"""The flows that the package offers, each with some sets of parameters and a box of points [m] to look at."""

from dataclasses import dataclass
from typing import Any

import numpy as np

import tparticles as tp


@dataclass(frozen=True)
class Case:
    """A flow, where to look, the time [s], and a step [m] for differences."""

    flow: Any
    low: tuple[float, float, float] = (-2.0, -2.0, -2.0)
    high: tuple[float, float, float] = (2.0, 2.0, 2.0)
    t: float = 0.0
    h: float = 1e-3

    def points(self, count: int, *, seed: int = 0, margin: float = 4.0) -> np.ndarray:
        """Return random points that keep `margin` steps away from the faces of every lattice: there u'' jumps."""
        x = np.random.default_rng(seed).uniform(self.low, self.high, (count, 3))
        keep = np.ones(count, bool)
        for term in getattr(self.flow, "flows", (self.flow,)):
            if isinstance(term, tp.CurlNoise):
                for f in term.tables()["frequency"]:
                    p = (x - self.t * np.array(term.drift)) * f
                    keep &= (np.abs(p - np.round(p)) > margin * self.h * f).all(axis=1)
                for edge in (term.ground, term.ground + term.ramp):
                    keep &= np.abs(x[:, 2] - edge) > margin * self.h
        return x[keep]


ABOVE = {"low": (-1.5, -1.5, 0.02), "high": (1.5, 1.5, 4.0)}
RAMP = {"low": (-2.0, -2.0, 0.3), "high": (2.0, 2.0, 0.9)}

CASES = {
    tp.Uniform: {"wind": Case(tp.Uniform(wind=(1.0, -2.0, 0.5)))},
    tp.Vortex: {
        "plain": Case(tp.Vortex()),
        "tilted": Case(tp.Vortex(center=(0.3, -0.2, 0.1), axis=(1.0, 2.0, 2.0), circulation=-3.0, core=0.4)),
        "wide": Case(tp.Vortex(axis=(1e-30, 0.0, 0.0), circulation=2.0, core=20.0)),
    },
    tp.ABC: {
        "plain": Case(tp.ABC()),
        "short": Case(tp.ABC(A=1.0, B=-0.5, C=2.0, length=1.5)),
    },
    tp.Plume: {
        "campfire": Case(tp.Plume(), **ABOVE, h=1e-4),
        "bonfire": Case(tp.Plume(power=2000.0, center=(0.5, 0.0, 0.0), radius=0.9, spread=0.2), **ABOVE, h=1e-4),
        "jet": Case(tp.Plume(power=5.0, radius=0.1, spread=0.0), **ABOVE, h=1e-4),
    },
    tp.CurlNoise: {
        "one octave": Case(tp.CurlNoise(length=0.7)),
        "four octaves": Case(tp.CurlNoise(speed=2.0, octaves=4, gain=0.6, seed=3)),
        "drifting": Case(tp.CurlNoise(octaves=2, drift=(0.5, 0.0, 1.6)), t=2.0),
        "turning": Case(tp.CurlNoise(octaves=3, period=1.6, lacunarity=1.7, gain=0.6), t=0.37),
        "ramp": Case(tp.CurlNoise(octaves=2, ramp=0.5, ground=0.35), **RAMP),
        "all": Case(
            tp.CurlNoise(length=0.9, octaves=3, gain=0.6, drift=(0.2, 0, 1), period=2.0, ramp=0.5, ground=0.4),
            **RAMP,
            t=5.3,
        ),
    },
}

SUMS = {
    "fire": Case(
        tp.Plume() + tp.CurlNoise(octaves=2, ramp=0.5, period=1.6) + tp.Uniform(wind=(0.3, 0.0, 0.0)),
        **ABOVE,
        h=1e-4,
        t=1.1,
    ),
    "swirl": Case(tp.ABC() + tp.Vortex(core=0.5) + tp.Uniform(wind=(0.0, 1.0, 0.0))),
}


def every_case() -> dict[str, Case]:
    """Return all cases by a readable name, sums included."""
    named = {f"{cls.__name__}, {name}": case for cls, cases in CASES.items() for name, case in cases.items()}
    return named | {f"sum, {name}": case for name, case in SUMS.items()}
