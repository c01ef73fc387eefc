"""The peers of the work-precision study: scipy's solvers on the same ensemble.

Two ways, as somebody who knows scipy would do it. `stacked`: one `solve_ivp` over all particles at once, whose right-hand side is
NumPy on whole arrays; solvers with a Jacobian are told its blocks (Radau, BDF: sparsity; LSODA: bands), and difference it in
about as many evaluations as a particle has components. `each`: a `solve_ivp` for every particle of a subset, with steps of its
own; the time is scaled up to the whole ensemble.
"""

# pyright: reportMissingImports=false, reportMissingModuleSource=false, reportMissingTypeStubs=false
# scipy is an extra.

from __future__ import annotations

import importlib.util
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from .cloth import Cloth
from .work_problems import Work

INSTALL = "no peers: scipy is missing; install it with: pip install 'tparticles[studies]'"
METHODS = ("DOP853", "LSODA", "BDF", "Radau")
MESH_METHODS = ("DOP853", "BDF", "Radau")  # LSODA has no sparse Jacobian
SUBSET = 8


class _TooLongError(Exception):
    """A solver ran past its time."""


@dataclass(frozen=True)
class Solved:
    """What a solver gave: states (components, particles) of `particles`, seconds and evaluations for one particle's share."""

    states: np.ndarray
    particles: np.ndarray
    seconds: float
    evaluations: float


def has_scipy() -> bool:
    """Whether scipy is there."""
    try:
        return importlib.util.find_spec("scipy") is not None
    except ValueError:  # it was kept out on purpose
        return False


def stacked(work: Work, start: np.ndarray, method: str, tolerance: float, *, limit: float) -> Solved | None:
    """Solve for all particles at once to `tolerance`, relative and absolute; None if that takes more than `limit` [s]."""
    moving = list(work.moving or range(len(start)))
    width, count = len(moving), start.shape[1]
    by_particle = method != "DOP853"  # particles as blocks: what bands and sparsity need
    full = start.copy()

    def f(t: float, y: np.ndarray) -> np.ndarray:
        full[moving] = y.reshape(count, width).T if by_particle else y.reshape(width, count)
        rate = work.problem.rate(t, full)[moving]
        return rate.T.ravel() if by_particle else rate.ravel()

    more: dict[str, Any] = {}
    if method == "LSODA":
        more = {"lband": width - 1, "uband": width - 1}
    elif by_particle:
        from scipy.sparse import block_diag

        more = {"jac_sparsity": block_diag([np.ones((width, width))] * count, format="csc")}
    y0 = start[moving].T.ravel() if by_particle else start[moving].ravel()
    found = _solve(f, work.span, y0, method, tolerance, limit=limit, more=more)
    if found is None:
        return None
    y, seconds, evaluations = found
    states = start.copy()
    states[moving] = y.reshape(count, width).T if by_particle else y.reshape(width, count)
    return Solved(states, np.arange(count), seconds, evaluations)


def each(work: Work, start: np.ndarray, method: str, tolerance: float, *, limit: float) -> Solved | None:
    """Solve for each of a subset alone; seconds are those of all, in proportion. None if the subset takes more than `limit` [s]."""
    count = start.shape[1]
    chosen = np.unique(np.linspace(0, count - 1, min(SUBSET, count)).astype(int))
    moving = list(work.moving or range(len(start)))
    states, seconds, evaluations = start[:, chosen].copy(), 0.0, 0.0
    for k, i in enumerate(chosen):
        full = start[:, i : i + 1].copy()

        def f(t: float, y: np.ndarray, full: np.ndarray = full) -> np.ndarray:
            full[moving, 0] = y
            return work.problem.rate(t, full)[moving, 0]

        found = _solve(f, work.span, start[moving, i], method, tolerance, limit=limit - seconds, more={})
        if found is None:
            return None
        states[moving, k] = found[0]
        seconds, evaluations = seconds + found[1], evaluations + found[2]
    return Solved(states, chosen, seconds * count / len(chosen), evaluations / len(chosen))


def whole(work: Work, start: np.ndarray, method: str, tolerance: float, *, limit: float) -> Solved | None:
    """Solve for a mesh, with its sparse Jacobian where the method takes one; None if that takes more than `limit` [s]."""
    problem, shape = work.problem, start.shape
    assert isinstance(problem, Cloth)

    def f(t: float, y: np.ndarray) -> np.ndarray:
        return problem.rate(t, y.reshape(shape)).ravel()

    more = {} if method == "DOP853" else {"jac": lambda t, y: problem.jacobian(t, y.reshape(shape))}
    found = _solve(f, work.span, start.ravel(), method, tolerance, limit=limit, more=more)
    if found is None:
        return None
    y, seconds, evaluations = found
    return Solved(y.reshape(shape), np.arange(shape[1]), seconds, evaluations)


def _solve(
    f: Callable[..., np.ndarray],
    span: float,
    y0: np.ndarray,
    method: str,
    tolerance: float,
    *,
    limit: float,
    more: dict[str, Any],
) -> tuple[np.ndarray, float, float] | None:
    from scipy.integrate import solve_ivp

    begin, calls = time.perf_counter(), 0

    def watched(t: float, y: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        if time.perf_counter() - begin > limit:
            raise _TooLongError
        return f(t, y)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = solve_ivp(
                watched, (0.0, span), y0, method=method, rtol=tolerance, atol=tolerance, t_eval=[span], **more
            )
    except (_TooLongError, RuntimeError, ValueError):
        return None
    return (found.y[:, -1], time.perf_counter() - begin, calls) if found.success else None


def sweep(
    work: Work, start: np.ndarray, *, tolerances: tuple[float, ...], limit: float
) -> Iterator[tuple[str, str, float, Solved]]:
    """Yield (method, way, tolerance, what it gave), from loose to tight; a solver that runs past `limit` [s] is left there."""
    ways: dict[str, Callable[..., Solved | None]] = {"stacked": stacked, "each": each}
    if work.coupled:
        ways = {"whole": whole}
    for method in MESH_METHODS if work.coupled else METHODS:
        for way, solve in ways.items():
            for tolerance in tolerances[::3] if way == "each" else tolerances:
                found = solve(work, start, method, tolerance, limit=limit)
                if found is None:
                    break
                yield method, way, tolerance, found


def reference(work: Work, start: np.ndarray) -> np.ndarray:
    """Return DOP853's solution to 1e-13 (of a mesh to 1e-12), of all particles at once."""
    found = (whole if work.coupled else stacked)(work, start, "DOP853", 1e-12 if work.coupled else 1e-13, limit=600.0)
    assert found is not None
    return found.states
