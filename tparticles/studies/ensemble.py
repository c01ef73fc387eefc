"""Ensembles: independent initial states of a test problem, run by the engine's fused stepper without a scene around it.

Schemes run one after another on the same columns. A kernel is compiled once for all schemes of equal structure; with `share`
schemes get spare slope registers, so that more of them are equal (for errors, not for timing: spare registers cost time).
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .. import backend, schemes
from ..errors import BackendError
from ..schemes import Scheme
from ..stepping.control import Tolerance
from ..stepping.fused import FusedStepper
from ..stepping.pace import memory
from ..stepping.report import StepReport
from ..systems.attributes import Attribute, Columns
from .problems import Problem, system

_SPARE = {False: 7, True: 3}  # slope registers of shared kernels: explicit one-step schemes, implicit ones


@dataclass(frozen=True)
class Run:
    """What an ensemble did: states, shape (times, components, particles), steps over all particles, and wall time [s]."""

    t: np.ndarray
    states: np.ndarray
    report: StepReport
    seconds: float


def start_engine(precision: str = "f64", *, threads: int | None = None) -> None:
    """Start Taichi on the CPU, or keep what runs there in this precision."""
    try:
        running = backend.current()
    except BackendError:
        running = None
    fits = running is not None and running.is_cpu and running.precision == precision
    if not fits or (running is not None and threads not in (None, running.threads)):
        backend.start(arch="cpu", threads=threads, precision=precision)


def applicable(problem: Problem, scheme: Scheme) -> bool:
    """Whether a scheme runs this problem at its declared order."""
    if problem.order not in scheme.system_orders:
        return False
    return problem.velocity_free or "velocity-free forces" not in scheme.needs


class Ensemble:
    """The particles of one problem, ready to be advanced by one scheme after another.

    Arguments:
        problem: the law.
        start: initial states, shape (3, n) or (6, n).
        share: whether schemes get spare registers, to compile less.
        lanes: particles per block; the backend's choice by default.
    """

    def __init__(self, problem: Problem, start: np.ndarray, *, share: bool = True, lanes: int | None = None):
        self.problem, self.system, self.share, self.lanes = problem, system(problem), share, lanes
        self.start = np.array(start, float)
        components, self.count = self.start.shape
        # One set of columns for all schemes: the widest history.
        every = [memory(scheme, components, adaptive=True) for scheme in schemes.CATALOGUE.values()]
        widest = max(sum(a.components for a in attributes) - 1 for attributes in every)
        more = (Attribute("history", widest, "real", "", ""), Attribute("dt", 1, "real", "s", ""))
        self.columns = Columns(("x", "id", "birth", *self.system.state), self.count, more=more)
        self._state = [field for name in self.system.state for field in self.columns[name]]
        self._steppers: dict[object, FusedStepper] = {}
        self._fill(self.columns["id"][0], np.arange(self.count))

    def run(
        self,
        scheme: Scheme,
        times: Sequence[float] | np.ndarray,
        dt: float,
        *,
        t0: float = 0.0,
        clamp: str = "equal",
        tolerance: Tolerance | None = None,
    ) -> Run:
        """Advance from the initial states at `t0` to each of `times`, in steps of at most `dt`, and return all states there.

        `tolerance`: particles choose their own steps. Compilation is not part of `seconds`.
        Raises RunError where a particle finds no step.
        """
        states, reports, seconds = [], [], 0.0
        for _, z, report, spent in self.frames(scheme, times, dt, t0=t0, clamp=clamp, tolerance=tolerance):
            states.append(z)
            reports.append(report)
            seconds += spent
        return Run(np.array(times, float), np.array(states), _total(reports), seconds)

    def frames(
        self,
        scheme: Scheme,
        times: Sequence[float] | np.ndarray,
        dt: float,
        *,
        t0: float = 0.0,
        clamp: str = "equal",
        tolerance: Tolerance | None = None,
    ) -> Iterator[tuple[float, np.ndarray, StepReport, float]]:
        """Yield (time, states, report, seconds) of each output time as it is reached; arguments as for `run`."""
        stepper = self._stepper(scheme, clamp, tolerance)
        stepper.advance(self.count, t0, t0, dt)  # no time passes: this compiles
        for field, values in zip(self._state, self.start, strict=True):
            self._fill(field, values)
        self._fill(self.columns["birth"][0], np.full(self.count, t0))
        before = t0
        for t in times:
            begin = time.perf_counter()
            report = stepper.advance(self.count, before, float(t), dt)
            seconds = time.perf_counter() - begin
            yield float(t), self._states(), report, seconds
            before = float(t)

    def _stepper(self, scheme: Scheme, clamp: str, tolerance: Tolerance | None) -> FusedStepper:
        key = scheme, clamp, tolerance
        if key not in self._steppers:
            self._steppers[key] = FusedStepper(
                self.system,
                cooling=None,
                scheme=_with_spare_registers(scheme) if self.share and tolerance is None else scheme,
                clamp=clamp,
                columns=self.columns,
                size=1e-3,
                tolerance=tolerance,
                lanes=self.lanes,
            )
        return self._steppers[key]

    def _fill(self, field: object, values: np.ndarray) -> None:
        padded = np.zeros(self.columns.padded)
        padded[: self.count] = values
        field.from_numpy(padded.astype(field.to_numpy().dtype))  # type: ignore[attr-defined]

    def _states(self) -> np.ndarray:
        return np.stack([field.to_numpy()[: self.count] for field in self._state])


def interpreted(problem: Problem, start: np.ndarray, scheme: Scheme, times: Sequence[float], dt: float) -> np.ndarray:
    """Return the states at `times`, as `Ensemble.run` does, by the schemes' plain interpreter: slow, and without Taichi.

    `times` are multiples of `dt`, from 0.
    """
    count = start.shape[1]
    shape = (2, 3, count) if problem.order == 2 else start.shape  # splittings see (x, v) on a leading axis

    def f(t: float, z: np.ndarray) -> np.ndarray:
        return problem.rate(t, z.reshape(-1, count)).reshape(shape)

    steps = [round(t / dt) for t in times]
    free = problem.order == 2 and problem.velocity_free
    states = schemes.integrate(scheme, f, 0.0, start.reshape(shape), dt, max(steps), velocity_free=free)
    return np.array([states[n].reshape(-1, count) for n in steps])


def _with_spare_registers(scheme: Scheme) -> Scheme:
    if not scheme.one_step:
        return scheme
    slopes = max(scheme.slopes, _SPARE[scheme.implicit])
    return dataclasses.replace(scheme, slopes=slopes, error_weights=(), error_order=0)


def _total(reports: Sequence[StepReport]) -> StepReport:
    moved = [report for report in reports if report.steps]
    return StepReport(
        steps=sum(report.steps for report in reports),
        rejected=sum(report.rejected for report in reports),
        starting=sum(report.starting for report in reports),
        dt_min=min((report.dt_min for report in moved), default=0.0),
        dt_max=max((report.dt_max for report in moved), default=0.0),
    )
