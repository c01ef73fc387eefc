"""Wright's effect: steps that alternate in size, each stable if taken for ever, that blow up together.

On an oscillator, by products of one-step matrices (J. P. Wright, Numerical instability due to varying time steps in explicit wave
propagation and mechanics calculations, J. Comput. Phys. 140, 1998; slide 17), with spot checks on the engine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..schemes import Scheme, oscillator_limit
from .ensemble import Ensemble, start_engine
from .linear_maps import pair_growth, restarts
from .periodic import Oscillator

WIDTH, HEIGHT = 50, 32  # of a map
REACH = 10.0  # largest omega dt of schemes without a limit
SPLIT = 0.6  # of the frame: the lecture's rule (slide 32) with dt = 0.6 frame takes 0.6 and 0.4
_GROWS = 1e-6  # growth above 1 by more than rounding: eigenvalues of a double root are good to its square root
_PAIRS = 60
_SHORTEST = 0.025


@dataclass(frozen=True)
class Map:
    """Growth per pair of steps of one scheme.

    `growth[j][i]`: where the larger step is `omega_dt[i]` and the smaller one `ratio[j]` of it. `limit`: of constant steps,
    infinite where there is none; every step of the map is below it. `restarts`: the scheme answers each change of the step by its
    `starter`, so that this is what runs. `worst`, `at`: the largest growth, and the two steps that have it.
    """

    scheme: str
    limit: float
    restarts: bool
    starter: str
    omega_dt: tuple[float, ...]
    ratio: tuple[float, ...]
    growth: tuple[tuple[float, ...], ...]
    worst: float
    at: tuple[float, float]

    @property
    def affected(self) -> bool:
        """Whether some pair of stable steps grows."""
        return self.worst > 1 + _GROWS


@dataclass(frozen=True)
class Clamp:
    """Growth per frame of one scheme with a frame split 0.6 : 0.4, and halved, against omega times the frame."""

    scheme: str
    limit: float
    omega_frame: tuple[float, ...]
    split: tuple[float, ...]
    halved: tuple[float, ...]


@dataclass(frozen=True)
class Check:
    """A growth per pair that the engine was seen to have, next to the computed one."""

    scheme: str
    first: float
    second: float
    how: str
    computed: float
    measured: float


@dataclass(frozen=True)
class VariableSteps:
    """The result. `without`: schemes that have no stable step on this oscillator."""

    zeta: float
    maps: tuple[Map, ...]
    clamps: tuple[Clamp, ...]
    checks: tuple[Check, ...]
    without: tuple[str, ...]

    def rows(self) -> list[dict[str, object]]:
        """Return a row for each pair of steps."""
        return [
            {"scheme": m.scheme, "limit": m.limit, "larger": h, "smaller": h * r, "ratio": r, "growth": growth}
            for m in self.maps
            for r, line in zip(m.ratio, m.growth, strict=True)
            for h, growth in zip(m.omega_dt, line, strict=True)
        ]


def study(
    chosen: Sequence[Scheme],
    *,
    zeta: float = 0.0,
    width: int = WIDTH,
    height: int = HEIGHT,
    engine: bool = True,
    tell: Callable[[str], None] = lambda _: None,
) -> VariableSteps:
    """Map the growth of alternating steps for each of the schemes, on an oscillator of damping ratio `zeta`.

    `width`, `height`: points of a map along the larger step and along the ratio. `engine`: spot checks on the fused stepper.
    """
    maps, clamps, without = [], [], []
    for scheme in chosen:
        limit = oscillator_limit(scheme, zeta)
        if limit == 0:
            without.append(scheme.name)
            continue
        tell(f"variable-steps: {scheme.name}")
        maps.append(_map(scheme, limit, zeta, width, height))
        clamps.append(_clamp(scheme, limit, zeta))
    names = {scheme.name for scheme in chosen}
    cases = [case for case in CHECKS if engine and case[0].name in names]
    ensemble = swinging() if cases else None
    checks = [check(ensemble, *case) for case in cases if ensemble]
    return VariableSteps(
        zeta=zeta, maps=tuple(maps), clamps=tuple(clamps), checks=tuple(checks), without=tuple(without)
    )


def _map(scheme: Scheme, limit: float, zeta: float, width: int, height: int) -> Map:
    reach = min(limit, REACH)
    # Below the limit: on it, constant steps are at the edge.
    larger = reach * (np.arange(width) + 0.5) / width
    ratio = np.linspace(_SHORTEST, 1, height)
    H, R = np.meshgrid(larger, ratio)
    growth = pair_growth(scheme, H.ravel(), (H * R).ravel(), zeta=zeta).reshape(H.shape)
    j, i = np.unravel_index(int(growth.argmax()), growth.shape)
    return Map(
        scheme=scheme.name,
        limit=limit,
        restarts=restarts(scheme),
        starter=scheme.starter.name if scheme.starter else "",
        omega_dt=tuple(larger.tolist()),
        ratio=tuple(ratio.tolist()),
        growth=tuple(tuple(float(f"{g:.6g}") for g in line) for line in growth),
        worst=float(growth[j, i]),
        at=(float(H[j, i]), float(H[j, i] * R[j, i])),
    )


def _clamp(scheme: Scheme, limit: float, zeta: float) -> Clamp:
    # Up to where the longer of the two steps meets the limit of constant ones.
    frame = np.linspace(0, min(limit, REACH) / SPLIT, 401)[1:]
    return Clamp(
        scheme=scheme.name,
        limit=limit,
        omega_frame=tuple(frame.tolist()),
        split=tuple(pair_growth(scheme, SPLIT * frame, (1 - SPLIT) * frame, zeta=zeta).tolist()),
        halved=tuple(pair_growth(scheme, frame / 2, frame / 2, zeta=zeta).tolist()),
    )


def swinging() -> Ensemble:
    """Return oscillators on the engine, omega = 1."""
    start_engine()
    problem = Oscillator()
    return Ensemble(problem, problem.start(16))


def check(ensemble: Ensemble, scheme: Scheme, first: float, second: float, clamp: str) -> Check:
    """Run pairs of steps on the engine, and compare how they grow with what is computed.

    `clamp`: "slide32" takes a pair as one frame under the lecture's rule; "equal" takes each step as a frame of its own.
    """
    frame = first + second
    if clamp == "slide32":
        times, dt, each = frame * np.arange(1, _PAIRS + 1), first, 1
    else:
        times, dt, each = np.cumsum([first, second] * _PAIRS), 10 * frame, 2
    states = ensemble.run(scheme, times, dt, clamp=clamp).states[each - 1 :: each]
    sizes = np.sqrt((states**2).sum(axis=(1, 2)))
    half = _PAIRS // 2
    measured = math.exp(math.log(sizes[-1] / sizes[half - 1]) / (_PAIRS - half))
    computed = float(pair_growth(scheme, np.array([first]), np.array([second]))[0])
    return Check(
        scheme.name, first, second, "one frame, slide32" if clamp == "slide32" else "two frames", computed, measured
    )


def _checks() -> tuple[tuple[Scheme, float, float, str], ...]:
    from ..schemes import get

    verlet, rk4 = get("velocity-verlet"), get("rk4")
    return (
        (verlet, 1.35, 1.47, "equal"),
        (verlet, 0.6 * 2.9, 0.4 * 2.9, "slide32"),
        (rk4, 1.35, 1.47, "equal"),
        (rk4, 0.6 * 2.9, 0.4 * 2.9, "slide32"),
    )


CHECKS = _checks()
