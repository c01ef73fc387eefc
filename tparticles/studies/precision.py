"""The work-precision study: what an error costs, in wall time and in evaluations, for every scheme and for scipy's solvers.

Each scheme is swept over equal steps and over tolerances; a point of the diagram is one run: its cost, and the largest and the
median error over the particles. Times are the best of a few after a warm-up, so that nothing is compiled within them.
Source: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, section II.10 (work-precision diagrams).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, RunError
from ..schemes import Scheme, doubled
from ..stepping.control import ErrorControl, check_precision
from ..stepping.report import StepReport
from . import peers
from .cloth import Cloth, MeshEnsemble
from .ensemble import Ensemble, applicable, start_engine
from .work_problems import Work

COUNT = 10_000
STEPS = tuple(sorted([2**k for k in range(2, 15)] + [3 * 2**k for k in range(1, 13)]))  # over the whole span
TOLERANCES = tuple(10.0**-k for k in range(2, 11))
PEER_TOLERANCES = tuple(10.0**-k for k in range(3, 10))
TARGETS = (1e-3, 1e-6)
FLOOR = {"f32": 1e-6, "f64": 1e-9}  # of the error: finer steps gain nothing, or nobody asks for it
_BLOWN = 1e3  # an error above this is no result
_LONGEST = 0.5  # [s]; a sweep ends with the first run that takes longer
_LONGEST_PEER = 6.0
_LONGEST_MESH, _LONGEST_MESH_PEER = 2.0, 30.0  # implicit solvers take long over a step
_REPEATED, _REPEATS = 0.15, 4  # a run is timed again until this long [s], at most so often


@dataclass(frozen=True)
class Point:
    """One run. `solver`: a scheme, or scipy's; `control`: "fixed" (`setting` is dt [s]), "error" (rtol = atol), "pixels" (px).

    `seconds`: wall time for the whole ensemble. `evaluations` of the right-hand side per particle; of implicit schemes, stages
    solved, each of several evaluations. `largest`, `median`: error over the particles in `unit`, the largest of any component.
    """

    solver: str
    control: str
    precision: str
    setting: float
    seconds: float
    evaluations: float
    steps: float
    largest: float
    median: float
    peer: bool = False

    @property
    def label(self) -> str:
        """What to name it: solver, and how its steps were chosen."""
        return f"{self.solver}, {self.control}"


@dataclass(frozen=True)
class Choice:
    """The cheapest point whose largest error is at most `target`; `peer`: of scipy's; `ratio` of their times (NaN: none)."""

    target: float
    precision: str
    best: Point | None
    fewest: Point | None  # the fewest evaluations, of explicit schemes
    peer: Point | None
    ratio: float


@dataclass(frozen=True)
class Precision:
    """The result. `notes`: what was left out, and why."""

    subject: str
    what: str
    unit: str
    particles: int
    points: tuple[Point, ...]
    choices: tuple[Choice, ...]
    notes: tuple[str, ...]

    def rows(self) -> list[dict[str, object]]:
        """Return a row for each point."""
        return [
            {
                "subject": self.subject,
                "solver": p.solver,
                "control": p.control,
                "precision": p.precision,
                "setting": p.setting,
                "seconds": p.seconds,
                "evaluations": p.evaluations,
                "steps": p.steps,
                "largest_error": p.largest,
                "median_error": p.median,
                "unit": self.unit,
                "peer": p.peer,
            }
            for p in self.points
        ]


def study(
    name: str,
    work: Work,
    chosen: Sequence[Scheme],
    *,
    precisions: Sequence[str] = ("f32", "f64"),
    count: int = COUNT,
    steps: Sequence[int] = STEPS,
    tolerances: Sequence[float] = TOLERANCES,
    targets: Sequence[float] = TARGETS,
    with_peers: bool = True,
    peer_tolerances: Sequence[float] = PEER_TOLERANCES,
    peer_limit: float | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Precision:
    """Measure each of the schemes that run the problem `work`, in each precision, over `steps` and over `tolerances`.

    `count` particles. `targets`: errors for which the cheapest is named. `peer_limit` [s] ends the sweep of a peer, by default at
    6 s, with meshes at 30 s.

    Raises:
        InputError: none of the schemes runs the problem.
    """
    fitting = [scheme for scheme in chosen if applicable(work.problem, scheme)]
    if not fitting:
        names = ", ".join(scheme.name for scheme in chosen)
        raise InputError(f"problem '{name}' is of order {work.problem.order} and {_free(work)}: {names} cannot run it")
    notes = []
    if len(fitting) < len(chosen):
        left = ", ".join(scheme.name for scheme in chosen if scheme not in fitting)
        notes.append(f"do not apply to this problem: {left}")
    start = work.problem.start(count)
    particles = start.shape[1]  # a mesh has as many as it has
    with_peers = with_peers and peers.has_scipy()
    peer_limit = peer_limit or (_LONGEST_MESH_PEER if work.coupled else _LONGEST_PEER)
    tell(f"precision: reference of {name}")
    exact = _exact(work, start)
    points: list[Point] = []
    for precision in precisions:
        start_engine(precision)
        if isinstance(work.problem, Cloth):
            ensemble = MeshEnsemble(work.problem)
        else:
            ensemble = Ensemble(work.problem, start, share=False)
        for scheme in fitting:
            tell(f"precision: {scheme.name}, {name}, {precision}")
            points += _fixed(ensemble, work, scheme, exact, precision, steps)
            if isinstance(ensemble, Ensemble):  # a mesh steps as a whole
                points += _adaptive(ensemble, work, scheme, exact, precision, tolerances)
    if with_peers:
        tell(f"precision: scipy, {name}")
        points += peer_points(work, start, exact, peer_tolerances, peer_limit)
        notes.append(
            f"scipy: one solve_ivp with the sparse Jacobian of the mesh; left out: runs above {peer_limit:g} s"
            if work.coupled
            else "scipy stacked: one solve_ivp over all particles (Jacobian by blocks); each: one for each particle of a subset of "
            f"{min(peers.SUBSET, count)}, its time scaled to all of them; left out: runs above {peer_limit:g} s"
        )
    else:
        notes.append(peers.INSTALL)
    return Precision(
        subject=name,
        what=work.what,
        unit="largest component, SI",
        particles=particles,
        points=tuple(points),
        choices=choices(points, targets, precisions),
        notes=tuple(notes),
    )


def _free(work: Work) -> str:
    return "its force does without velocity" if work.problem.velocity_free else "its force depends on the velocity"


def _exact(work: Work, start: np.ndarray) -> np.ndarray:
    """Return the closed form, or for tracers and meshes an independent solver's result, if it is there."""
    if (work.problem.name == "abc" or work.coupled) and peers.has_scipy():
        return peers.reference(work, start)
    return work.problem.solution(work.span, start)


def _fixed(
    ensemble: Ensemble | MeshEnsemble,
    work: Work,
    scheme: Scheme,
    exact: np.ndarray,
    precision: str,
    steps: Sequence[int],
) -> Iterator[Point]:
    def run(n: int) -> Point | None:
        return _timed(ensemble, work, scheme, exact, precision, setting=work.span / n)

    longest = _LONGEST_MESH if work.coupled else _LONGEST
    yield from until_useless(map(run, steps), FLOOR[precision], longest=longest)


def _adaptive(
    ensemble: Ensemble, work: Work, scheme: Scheme, exact: np.ndarray, precision: str, tolerances: Sequence[float]
) -> Iterator[Point]:
    try:
        running = doubled(scheme)
    except InputError:
        return

    def run(tolerance: float) -> Point | None:
        control = ErrorControl(rtol=tolerance, atol=tolerance)
        try:
            check_precision(control, precision)
        except InputError:
            return None
        return _timed(ensemble, work, running, exact, precision, setting=tolerance, control=control, name=scheme.name)

    yield from until_useless(map(run, tolerances), FLOOR[precision])


def until_useless(points: Iterable[Point | None], floor: float, *, longest: float = _LONGEST) -> Iterator[Point]:
    """Yield the points of a sweep, from coarse to fine, until rounding rules or a run takes longer than `longest` [s].

    Runs that blew up have no finite error and are left out, as are those that cannot be (None); their time counts.
    """
    best, worse = math.inf, 0
    for point in points:
        if point is None:
            continue
        if not point.largest < _BLOWN:
            if point.seconds > longest:
                return
            continue
        yield point
        worse = 0 if point.largest < 0.9 * best else worse + 1
        best = min(best, point.largest)
        if point.largest < floor or point.seconds > longest or (worse >= 3 and best < 1e-3):
            return


def _timed(
    ensemble: Ensemble | MeshEnsemble,
    work: Work,
    scheme: Scheme,
    exact: np.ndarray,
    precision: str,
    *,
    setting: float,
    control: ErrorControl | None = None,
    name: str = "",
) -> Point:
    dt = setting if control is None else work.span
    begin = time.perf_counter()
    try:
        run = ensemble.run(scheme, [work.span], dt, tolerance=control)
        seconds = [run.seconds]
        while np.isfinite(run.states).all() and len(seconds) < _REPEATS and sum(seconds) < _REPEATED:
            seconds.append(ensemble.run(scheme, [work.span], dt, tolerance=control).seconds)
        states, report = run.states[0], run.report
    except (RunError, OverflowError):
        seconds, states, report = [time.perf_counter() - begin], np.full_like(exact, np.nan), StepReport()
    largest, median = errors(states, exact)
    return Point(
        solver=name or scheme.name,
        control="fixed" if control is None else "error",
        precision=precision,
        setting=setting,
        seconds=min(seconds),
        evaluations=report.evaluations(scheme) / ensemble.count,
        steps=report.steps / ensemble.count,
        largest=largest,
        median=median,
    )


def errors(states: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """Return the largest and the median over the particles of the largest error of any component."""
    with np.errstate(all="ignore"):
        off = np.abs(states - exact).max(axis=0)
    return float(off.max()), float(np.median(off))


def peer_points(
    work: Work, start: np.ndarray, exact: np.ndarray, tolerances: Sequence[float], limit: float
) -> Iterator[Point]:
    """Yield scipy's points."""
    for method, way, tolerance, found in peers.sweep(work, start, tolerances=tuple(tolerances), limit=limit):
        largest, median = errors(found.states, exact[:, found.particles])
        yield Point(
            solver=f"scipy {method} {way}",
            control="error",
            precision="f64",
            setting=tolerance,
            seconds=found.seconds,
            evaluations=found.evaluations,
            steps=math.nan,
            largest=largest,
            median=median,
            peer=True,
        )


def choices(points: Sequence[Point], targets: Sequence[float], precisions: Sequence[str]) -> tuple[Choice, ...]:
    """Return for each error and precision the cheapest point that meets it."""
    found = []
    for target in targets:
        good = [p for p in points if p.largest <= target]
        peer = min((p for p in good if p.peer), key=lambda p: p.seconds, default=None)
        for precision in precisions:
            ours = [p for p in good if not p.peer and p.precision == precision]
            best = min(ours, key=lambda p: p.seconds, default=None)
            fewest = min((p for p in ours if not _implicit(p)), key=lambda p: p.evaluations, default=None)
            ratio = peer.seconds / best.seconds if peer and best else math.nan
            found.append(Choice(target, precision, best, fewest, peer, ratio))
    return tuple(found)


def _implicit(point: Point) -> bool:
    from ..schemes import CATALOGUE

    return point.solver in CATALOGUE and CATALOGUE[point.solver].implicit
