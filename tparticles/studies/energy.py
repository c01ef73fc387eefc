"""The energy study: what 10^4 undamped periods do to energy and phase, for every scheme, on the engine in f64.

An oscillator and two pendula of period 1, started at 16 phases of their swing. Steps are an equal fraction of the period.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import RunError
from ..schemes import Scheme
from .ensemble import Ensemble, start_engine
from .periodic import Swings

PERIODS = 10_000
STEPS = 40  # per period: omega dt = 0.157 for the oscillator
SAMPLES = 500
KEPT = 150  # samples in the result: the phase is counted over all of them
PHASES = 16
AMPLITUDES = (1.0, 1.0, 2.0)  # the oscillator's has no meaning; pendula [rad]
PROBLEMS = ("oscillator", "pendulum 1 rad", "pendulum 2 rad")
_BLOWN_UP = 1e6  # energy, in units of the first
_NOTHING = 1e-30  # energy, where nothing is left to look at
_EXACT = 1e-9  # trends below this are rounding
_LOST = 1e-3  # energy left where a phase has no meaning


@dataclass(frozen=True)
class Drift:
    """What became of one problem under one scheme; energies in units of the exact one, means over the phases.

    `periods`: when samples were taken. `energy`: mean energy; `spread`: largest deviation of any phase from 1. `phase`: mean
    lead over the exact motion [turns]; NaN from where it has none, at rest or over the top. `largest`: of all spreads.
    `verdict`: "bounded", "decays", "grows", "blows up". `factor`: of the energy, per step, in the later half; `theory`: what the
    scheme's coefficients say of the oscillator.
    """

    scheme: str
    problem: str
    verdict: str
    periods: tuple[float, ...]
    energy: tuple[float, ...]
    spread: tuple[float, ...]
    phase: tuple[float, ...]
    largest: float
    factor: float
    theory: float


@dataclass(frozen=True)
class Energy:
    """The result: one drift for each scheme and problem; `seconds`: of wall time, by scheme."""

    periods: int
    steps_per_period: int
    omega_dt: float
    phases: int
    amplitudes: tuple[float, ...]
    drifts: tuple[Drift, ...]
    seconds: dict[str, float]

    def rows(self) -> list[dict[str, object]]:
        """Return a row for each sample."""
        return [
            {
                "problem": d.problem,
                "scheme": d.scheme,
                "verdict": d.verdict,
                "period": t,
                "energy": e,
                "spread": s,
                "phase": p,
            }
            for d in self.drifts
            for t, e, s, p in zip(d.periods, d.energy, d.spread, d.phase, strict=True)
        ]


def study(
    chosen: Sequence[Scheme],
    *,
    periods: int = PERIODS,
    steps: int = STEPS,
    samples: int = SAMPLES,
    tell: Callable[[str], None] = lambda _: None,
) -> Energy:
    """Run each scheme for `periods` periods of `steps` equal steps, looking at the state `samples` times.

    A run ends early where the energy of all that swings has grown a million times, or where nothing is left of it.
    """
    start_engine()
    problem = Swings.of_period_1(*AMPLITUDES[1:])
    ensemble = Ensemble(problem, problem.at_phases(AMPLITUDES, PHASES))
    drifts: list[Drift] = []
    seconds: dict[str, float] = {}
    for scheme in chosen:
        tell(f"energy: {scheme.name}")
        found, seconds[scheme.name] = _drifts(scheme, problem, ensemble, _sample_times(periods, samples), steps)
        drifts += found
    return Energy(
        periods=periods,
        steps_per_period=steps,
        omega_dt=2 * math.pi / steps,
        phases=PHASES,
        amplitudes=AMPLITUDES,
        drifts=tuple(drifts),
        seconds=seconds,
    )


def _sample_times(periods: int, samples: int) -> np.ndarray:
    """Return whole periods, evenly spaced, with the first ones in ever longer spaces: what grows does so early."""
    even = np.linspace(0, periods, samples + 1)[1:]
    early = np.geomspace(1, max(even[0], 1), 12)
    return np.unique(np.round(np.concatenate([early, even])))


def _drifts(
    scheme: Scheme, problem: Swings, ensemble: Ensemble, times: np.ndarray, steps: int
) -> tuple[list[Drift], float]:
    exact, states, seconds = problem.energy(ensemble.start), [ensemble.start], 0.0
    with np.errstate(all="ignore"):
        try:
            for _, z, _, spent in ensemble.frames(scheme, times, 1 / steps):
                states.append(z)
                seconds += spent
                size = (problem.energy(z) / exact).max(axis=1)
                if not (size < _BLOWN_UP).any() or (size < _NOTHING).all():  # a NaN is not below either
                    break
        except RunError:
            states.append(np.full_like(ensemble.start, np.inf))  # Newton's method finds no step any more
        energy = np.array([problem.energy(z) / exact for z in states])
        swings = [problem.swing(z) for z in states]
        phase, frequency = (np.array(part) for part in zip(*swings, strict=True))
        t = np.concatenate([[0.0], times[: len(states) - 1]])
        parts = [(energy[:, i], _lead(t, phase[:, i], frequency[:, i])) for i in range(len(PROBLEMS))]
        return [_drift(scheme, name, t, *part, steps) for name, part in zip(PROBLEMS, parts, strict=True)], seconds


def _drift(scheme: Scheme, name: str, t: np.ndarray, energy: np.ndarray, lead: np.ndarray, steps: int) -> Drift:
    """Judge one problem by its energies, shape (samples, phases), and its mean lead [turns], from t = 0."""
    gone = ~(energy.max(axis=1) < _BLOWN_UP)  # a NaN too
    end = int(np.argmax(gone)) + 1 if gone.any() else len(energy)
    mean, spread = energy[:end].mean(axis=1), np.abs(energy[:end] - 1).max(axis=1)
    lost = np.maximum.accumulate(~(mean > _LOST) | ~np.isfinite(lead[:end]))
    lead = np.where(lost, np.nan, lead[:end])
    kept = _kept(end)
    return Drift(
        scheme=scheme.name,
        problem=name,
        verdict="blows up" if gone.any() else _verdict(mean, spread),
        periods=tuple(t[kept].tolist()),
        energy=tuple(mean[kept].tolist()),
        spread=tuple(spread[kept].tolist()),
        phase=tuple(lead[kept].tolist()),
        largest=float(spread.max()),
        factor=_factor(mean, t[:end] * steps),
        theory=scheme.stability.amplification(2j * math.pi / steps) ** 2 if name == PROBLEMS[0] else math.nan,
    )


def _kept(count: int) -> np.ndarray:
    """Return which of `count` samples to keep but the first: all early ones, an even choice of the others, the last."""
    early, even = np.arange(1, min(20, count)), np.linspace(1, count - 1, KEPT)
    return np.unique(np.concatenate([early, np.round(even)]).astype(int))


def _factor(mean: np.ndarray, steps: np.ndarray) -> float:
    """Return the factor per step over the later half of what are numbers: a parasite takes its time to rule."""
    good = np.flatnonzero(np.isfinite(mean) & (mean > 0))
    first = next((k for k in good if steps[k] >= steps[good[-1]] / 2), good[0])
    last = good[-1]
    if first == last:
        return math.nan
    return float(np.exp(np.log(mean[last] / mean[first]) / (steps[last] - steps[first])))


def _lead(t: np.ndarray, phase: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """Return by how many turns the motion is ahead of the exact one, mean over the phases, at each sample.

    Between two samples it makes about as many turns as its frequencies at their energies say: that tells whole turns apart.
    """
    expected = np.diff(t)[:, None] * (frequency[1:] + frequency[:-1]) / 2
    change = np.diff(phase, axis=0) - expected
    turns = change - np.round(change) + expected
    lead = np.cumsum(turns - np.diff(t)[:, None], axis=0).mean(axis=1)
    return np.concatenate([[0.0], lead])


def _verdict(mean: np.ndarray, spread: np.ndarray) -> str:
    """Say whether the energy drifts: all phases go the same way in the end, where else their errors differ in sign."""
    late = max(2, len(mean) // 10)
    end = mean[-late:].mean()
    if abs(end - 1) <= max(_EXACT, 0.5 * min(spread[-late:].max(), 1.0)):
        return "bounded"
    return "grows" if end > 1 else "decays"
