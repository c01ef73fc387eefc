"""The order study: how the error falls with the step, for every scheme on every smooth problem that it can run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import RunError
from ..schemes import Scheme
from .ensemble import Ensemble, applicable, interpreted, start_engine
from .problems import Problem, Rubbing, Shaken, Spiral

# One first-order problem, and second-order ones without and with velocity in the force.
PROBLEMS: tuple[Problem, ...] = (Spiral(), Shaken(), Rubbing())
SPAN = 2.0
FRAMES = 8  # output times; the error is taken over the second half of them
_HIGH = 6  # an order from which on steps of such a frame are too short for the leading term to stand above rounding
_FRAMES_HIGH = 2
STEPS = tuple(2**k for k in range(12))  # per frame
COUNT = 16  # particles
_FITTED = 3  # points of the fit
_COARSEST = 0.03  # errors above this, in units of the solution, are far from their leading term
# Rounding: of explicit steps, of few of them, and of what Newton's method leaves.
_FLOOR, _FLOOR_HIGH, _FLOOR_IMPLICIT = 3e-12, 1e-13, 1e-10

Runner = Callable[[Scheme, Sequence[float], float], np.ndarray]


@dataclass(frozen=True)
class Curve:
    """Error against step of one scheme on one problem; `slope` is fitted over the points `fitted` (first, last).

    `error`: root of the mean square over particles and the last frames, relative to the solution's; NaN where it blew up.
    """

    scheme: str
    problem: str
    declared: int
    slope: float
    fitted: tuple[int, int]
    dt: tuple[float, ...]
    error: tuple[float, ...]
    evaluations: tuple[int, ...]


@dataclass(frozen=True)
class Order:
    """The result: one curve for each scheme and problem."""

    span: float
    particles: int
    curves: tuple[Curve, ...]

    def rows(self) -> list[dict[str, object]]:
        """Return a row for each point."""
        return [
            {
                "problem": c.problem,
                "scheme": c.scheme,
                "declared": c.declared,
                "slope": c.slope,
                "dt": dt,
                "error": error,
                "evaluations": evaluations,
            }
            for c in self.curves
            for dt, error, evaluations in zip(c.dt, c.error, c.evaluations, strict=True)
        ]


def study(
    chosen: Sequence[Scheme],
    *,
    problems: Sequence[Problem] = PROBLEMS,
    steps: Sequence[int] = STEPS,
    count: int = COUNT,
    engine: bool = True,
    tell: Callable[[str], None] = lambda _: None,
) -> Order:
    """Measure the order of each of the schemes on each of the problems that it can run.

    `steps`: how many a frame, ascending. `engine`: on the fused stepper in f64; False: by the plain interpreter.
    `tell` is called with a line on what is being done.
    """
    curves = []
    for problem in problems:
        start = problem.start(count)
        runner = _engine(problem, start) if engine else _interpreter(problem, start)
        for scheme in chosen:
            if applicable(problem, scheme):
                tell(f"order: {scheme.name}, {problem.name}")
                curves.append(_curve(scheme, problem, start, runner, steps))
    return Order(span=SPAN, particles=count, curves=tuple(curves))


def _engine(problem: Problem, start: np.ndarray) -> Runner:
    start_engine()
    ensemble = Ensemble(problem, start)
    return lambda scheme, times, dt: ensemble.run(scheme, times, dt).states


def _interpreter(problem: Problem, start: np.ndarray) -> Runner:
    return lambda scheme, times, dt: interpreted(problem, start, scheme, times, dt)


def _curve(scheme: Scheme, problem: Problem, start: np.ndarray, run: Runner, steps: Sequence[int]) -> Curve:
    frames = _FRAMES_HIGH if scheme.order >= _HIGH else FRAMES
    times = [SPAN * (k + 1) / frames for k in range(frames)]
    exact = np.array([problem.solution(t, start) for t in times])
    half, size = len(times) // 2, math.sqrt(np.mean(exact**2))
    dt = [SPAN / frames / n for n in steps]
    errors = []
    for h in dt:
        try:
            with np.errstate(all="ignore"):
                off = run(scheme, times, h)[half:] - exact[half:]
                errors.append(math.sqrt(np.mean(off**2)) / size)
        except (RunError, OverflowError):
            errors.append(math.nan)
    floor = _FLOOR_IMPLICIT if scheme.implicit else _FLOOR_HIGH if scheme.order >= _HIGH else _FLOOR
    slope, fitted = fit(dt, errors, floor)
    return Curve(
        scheme=scheme.name,
        problem=problem.name,
        declared=scheme.order,
        slope=slope,
        fitted=fitted,
        dt=tuple(dt),
        error=tuple(errors),
        evaluations=tuple(frames * n * scheme.evaluations for n in steps),
    )


def fit(dt: Sequence[float], errors: Sequence[float], floor: float) -> tuple[float, tuple[int, int]]:
    """Return the slope of log error over log dt through the finest points above `floor`, and which those are.

    Not a number, and (-1, -1), where fewer than two points can be used.
    """
    good = [k for k, e in enumerate(errors) if floor < e < _COARSEST]
    below = next((k for k, e in enumerate(errors) if e <= floor), len(errors))
    used = [k for k in good if k < below][-_FITTED:]
    if len(used) < 2:
        return math.nan, (-1, -1)
    slope = np.polyfit(np.log([dt[k] for k in used]), np.log([errors[k] for k in used]), 1)[0]
    return float(slope), (used[0], used[-1])
