"""The staged executor: a spring mesh advanced stage by stage, with the whole mesh as the barrier between them.

`for sub-step: for pass: for block of vertices`, where a pass is an evaluation and all ops up to the next. A small mesh runs all
sub-steps of a frame in one serial launch: to wake threads for a pass takes longer than what they save. A large one takes a launch
for every pass. Both give the same bits. A scheme with an implicit stage is walked on the host, which hands the stage to a linear
solver.

A mesh is one system: a contact, or a step of another size, makes the past worthless for all of it, and the starter runs again.
"""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from .. import backend
from ..errors import RunError
from ..schemes import Scheme
from ..systems.spring_mesh import SpringMesh
from .contact import Contact
from .control import CLAMPS
from .mesh_solver import MeshSolver, SolveResult
from .passes import Passes
from .recorder import UNRECORDED, Recorder
from .report import Solves, StepReport
from .stages import SOLVE, Stages
from .table import Table
from .walls import ROUNDS, Walls

_WAKE = 35_000  # vertices that a thread does a pass over while others are woken for it
_LAUNCH = 20_000_000  # vertex-steps in a serial launch, about a second: Ctrl-C waits for it
_PICTURE = 0.1  # tolerance of an implicit stage in f32, as a part of a spring: below a pixel, where a spring is some pixels long
_HALVINGS = 10  # of a step that has no solution


class _NoSolutionError(Exception):
    """An implicit stage has none, or Newton's method does not find it."""


class _TouchError(Exception):
    """A step of another scheme than backward Euler leads into a collider."""


Drive = Callable[[float], np.ndarray]


class StagedStepper:
    """Advances a mesh by a scheme.

    Arguments:
        system: the mesh.
        scheme: any scheme for second-order systems.
        clamp: how steps are fitted to the frame, a key of `CLAMPS`.
        contact: its colliders.
        driven: vertices that follow a path, int (d,); `drive(t)` gives their positions, (d, 3) [m].
        velocity_free: whether no force depends on v.
        recorder: records the steps, once it has a sink.
    """

    def __init__(
        self,
        system: SpringMesh,
        *,
        scheme: Scheme,
        clamp: str,
        contact: Contact,
        driven: np.ndarray,
        drive: Drive,
        velocity_free: bool,
        recorder: Recorder | None = None,
    ):
        self.system, self.contact = system, contact
        self.clamp = CLAMPS[clamp]
        self.driven, self.drive = np.asarray(driven, np.int32), drive
        self.drives = len(driven) > 0
        self.table = Table.of(scheme)
        self.steps_back = scheme.steps_back
        self.reuses = int(self.table.reuses(velocity_free=velocity_free and not system.damped))
        self.recorder = recorder
        self.stages = Stages(system, self.table, contact, reuses=self.reuses, drives=self.drives, record=recorder)
        self.passes = Passes(self.table, reuses=self.reuses)
        self.programs = self.passes.programs()
        self.ends = contact.any or system.tears  # whether more ends a step than what the scheme says
        self.plain = not (self.ends or self.drives or recorder or self.table.implicit)
        saved = system.count * (1.0 - 1.0 / backend.current().threads)  # vertices that other threads would do
        self.serial = backend.current().is_cpu and saved <= _WAKE and not self.table.implicit
        self.held, self.fresh, self.last_h, self.began = 0, 0, 0.0, 0.0
        self.contacts, self.rejected = 0, 0  # bounces and halved steps so far
        self.iterations = np.zeros(2, np.int64)  # of Newton's method and of its linear systems, so far
        self.residual, self.method = 0.0, ""  # largest misfit in this advance, what the last stage was solved by
        self.solver = self._make_solver() if self.table.implicit else None
        # A stop leaves stiff springs swinging, and a slope that is looked at then kicks them: it is Euler's that a scheme goes on
        # from which begins with a slope.
        self.wary = bool(contact.any and self.table.implicit and self.reuses)

    def _make_solver(self) -> MeshSolver:
        mesh, whole = self.system.mesh, self.system.whole()
        self._whole = whole
        return MeshSolver(
            mesh.springs[whole],
            mesh.stiffness[whole],
            mesh.damping[whole],
            mesh.rest[whole],
            mesh.mass,
            mesh.pinned,
            tolerance=_PICTURE if self.stages.kind is np.float32 else None,
        )

    def forget(self) -> None:
        """Throw away the past: something else than a step changed the state."""
        self.held = self.fresh = 0

    def past(self) -> dict[str, Any]:
        """Return what the next step depends on beside the state."""
        past = {"held": self.held, "fresh": self.fresh, "last_h": self.last_h, "contacts": self.contacts}
        if self.solver and self.solver.tension is not None:
            past["tension"] = self.solver.tension
        return past

    def set_past(self, past: Mapping[str, Any]) -> None:
        """Go on from what `past` returned."""
        self.held, self.fresh, self.contacts = (int(past[name]) for name in ("held", "fresh", "contacts"))
        self.last_h = float(past["last_h"])
        if self.table.implicit:
            self.solver = self._make_solver()
            self.solver.tension = np.array(past["tension"]) if "tension" in past else None

    def advance(self, t0: float, t1: float, dt: float) -> StepReport:
        """Advance from `t0` to `t1` [s] in steps <= `dt`.

        Raises:
            RunError: an implicit stage has no solution, not even with the smallest step.
        """
        report, rejected, before = StepReport(), self.rejected, self.iterations
        self.residual = 0.0
        t = t0
        for h, count in self._runs(t1 - t0, dt):
            if abs(h - self.last_h) > 1e-4 * h:
                self.held = 0
            self.last_h = h
            batch = max(1, _LAUNCH // max(1, self.system.count * len(self.table.ops)))
            first = 0
            while first < count:
                n = min(batch, count - first, self.recorder.room if self.recorder else count)
                self._steps(t + first * h, h, n)
                first += n
            t += h * count
            low = min(report.dt_min, h) if report.steps else h
            report = StepReport(report.steps + count, 0, low, max(report.dt_max, h))
        return dataclasses.replace(report, rejected=self.rejected - rejected, solves=self._solves(before))

    def _solves(self, before: np.ndarray) -> Solves | None:
        if not self.solver:
            return None
        newton, linear = (int(n) for n in self.iterations - before)
        return Solves(self.method, self.solver.reason, newton, linear, self.residual)

    def _runs(self, span: float, dt: float) -> Iterator[tuple[float, int]]:
        """Yield (step, how many of it) until the span is over."""
        left = span
        while left > 1e-9 * span:
            h = min(float(self.clamp(left, dt, span)), left)
            n = max(1, math.floor(left / h + 1e-6)) if self.clamp is CLAMPS["equal"] else 1
            yield h, n
            left = left - n * h

    def _steps(self, t: float, h: float, count: int) -> None:
        if self.plain:
            self._plain_steps(t, h, count)
        elif self.serial:
            self._serial_steps(t, h, count)
        else:
            self._single_steps(t, h, count)

    def _plain_steps(self, t: float, h: float, count: int) -> None:
        """Take steps that nothing comes between."""
        groups = list(self.passes.run(count, self.held, self.fresh))
        values = self.system.parameters.array
        if self.serial:
            edges = np.cumsum([0, *(len(passes) for _, passes in groups)])
            steps = np.stack([[times for times, _ in groups], edges[:-1], edges[1:]], axis=1).astype(np.int32)
            self.stages.walk(t, h, np.concatenate([passes for _, passes in groups]), steps, values)
        else:
            page, done = 0, 0
            for times, passes in groups:
                for _ in range(times):
                    page = self._pass_over(passes, page, t + done * h, h)
                    done += 1
            self._turn(page)
        self.held, self.fresh = min(self.held + count, self.steps_back), self.reuses

    def _pass_over(self, passes: np.ndarray, page: int, t: float, h: float) -> int:
        """Do the passes of a step, from `page` of the state; return the page that it is on then."""
        for n, turns in enumerate(passes[:, 1]):
            self.stages.pass_over(passes, n, page, t, h, self.system.parameters.array)
            page ^= int(turns)
        return page

    def _turn(self, page: int) -> None:
        """Bring the state to the page that everybody reads."""
        if page:
            self.stages.turn()

    def _serial_steps(self, t: float, h: float, count: int, *, ends: bool = False) -> None:
        """Take steps in one launch, with what comes between them; record what they lead to if the record `ends` there."""
        claimed = self.recorder.claim() if self.recorder else UNRECORDED
        result = self.stages.run(
            t,
            h,
            count,
            self.held,
            self.fresh,
            *self.programs,
            self.driven,
            self._paths(t, h, count + ends),
            self.system.parameters.array,
            int(ends),
            *claimed,
        )
        self.held, self.fresh, bounces = (int(v) for v in result)
        self.contacts += bounces
        if self.recorder:
            self.recorder.took(t, h, count)

    def _single_steps(self, t: float, h: float, count: int) -> None:
        """Take steps one by one, with what comes between them."""
        paths = self._paths(t, h, 1 if self.table.implicit else count)
        for n in range(count):
            self.began = t + n * h
            if self.recorder and not self.recorder.due:
                self._record(self.began, h, paths[n : n + 2])
            if self.table.implicit:
                self._halved(self.began, h, _HALVINGS)
            else:
                self._one_step(self.began, h, paths[n : n + 2])
            if self.recorder:
                self.recorder.took(self.began, h, 1)

    def _record(self, t: float, h: float, paths: np.ndarray) -> None:
        """Record the state at the beginning of a step of `h` from `t` [s], with its slope."""
        assert self.recorder
        if self.drives:
            self.stages.aim(h, self.driven, paths)
        slot = self.table.probe
        if slot < 0:
            slot = int(self.table.ops[self.table.edges[int(self.held < self.steps_back)], 1])
        if self.table.probe >= 0 or not self.fresh:
            self.stages.evaluate(slot, t, h, self.system.parameters.array)
            self.fresh = int(self.table.probe < 0)
        self.recorder.record(slot)

    def end_record(self, t: float) -> None:
        """Record the state that the last step has led to, at `t` [s], and give the record away."""
        assert self.recorder
        if self.recorder.step:
            self.recorder.due = 0  # whatever the interval of the rows is
            if self.serial:
                self._serial_steps(t, self.last_h, 0, ends=True)
            else:
                self._record(t, self.last_h, self._paths(t, self.last_h, 1))
            self.recorder.end(t)
        self.recorder.hand_over()

    def _halved(self, t: float, h: float, halvings: int) -> None:
        """Take a step with an implicit stage, in two where it has no solution, and so on."""
        try:
            self._one_step(t, h, self._paths(t, h, 1))
        except _NoSolutionError:
            if halvings == 0:
                raise RunError(
                    f"no solution of an implicit stage of '{self.table.scheme.name}', not even with steps of {h:.3g} s"
                ) from None
            self.rejected += 1
            self.stages.back()
            for half in (t, t + h / 2):
                self.forget()
                self._halved(half, h / 2, halvings - 1)
            self.forget()

    def _paths(self, t: float, h: float, count: int) -> np.ndarray:
        """Return where driven vertices are at the ends of the steps, (count + 1, d, 3)."""
        kind = self.stages.kind
        if not self.drives:
            return np.zeros((2, 1, 3), kind)
        return np.stack([self.drive(t + n * h) for n in range(count + 1)]).astype(kind)

    def _one_step(self, t: float, h: float, paths: np.ndarray) -> None:
        starting = int(self.held < self.steps_back)
        if self.drives:
            self.stages.aim(h, self.driven, paths)
        passes = self.passes.step(starting, self.fresh, ends=False)
        met, page, smooth = 0, 0, True
        try:
            if self.wary and not self.fresh:
                self._pass_over(passes[:1], 0, t, h)  # which keeps where the step begins
                self.stages.back()
                self._euler(t, h)
            elif self.table.implicit:
                page = self._solved(passes, t, h)
            else:
                page = self._pass_over(passes, 0, t, h)
        except _TouchError:
            smooth = False
            self.stages.back()
            self._euler(t, h)
        if self.ends:
            met_at = self.recorder.met_at if self.recorder else UNRECORDED[4]
            met = self.stages.finish(page, t, h, self.system.parameters.array, t + h - self.began, met_at)
        else:
            self._turn(page)
        if self.table.shifts:
            self.stages.end(starting, h)
        self.held, self.fresh = min(self.held + 1, self.steps_back), self.reuses
        self.contacts += met
        if met or not smooth or (self.wary and self.contact.touches()):
            self.forget()
        if self.solver and self.system.tears and not np.array_equal(self.system.whole(), self._whole):
            self.solver = self._make_solver()
        if self.drives:
            self.stages.place(self.driven, paths)

    def _solved(self, passes: np.ndarray, t: float, h: float) -> int:
        """Do as `_pass_over` for a step with implicit stages, from the first page."""
        page = 0
        for n, stage in enumerate(passes[:, 0]):
            if stage >= 0 and self.table.ops[stage, 0] == SOLVE:
                self._turn(page)
                page = 0
                self._solve(int(stage), t, h)
            else:
                page = self._pass_over(passes[n : n + 1], page, t, h)
        return page

    def _solve(self, op: int, t: float, h: float) -> None:
        """Solve an implicit stage on the host: z = zbar + w h f(z), k = f(z)."""
        row = self.table.ops[op]
        w = float(self.table.coefficients[op, 1]) * h
        x, v = (np.asarray(a, float) for a in self.system.read())
        at = t + float(self.table.coefficients[op, 0]) * h
        linear = bool(row[3])
        found = self._solution(x, v, w, at, linear=linear)
        if self.contact.any and w == h and not linear:  # backward Euler
            found = self._stopped(found, x, v, at, h)
        elif self.contact.any:
            goes_on = self._goes_on(op)
            ends = x + (found.x - x) * (h / w) if goes_on else found.x
            if self._walls(x, v, t + h if goes_on else at, w).enters(ends):
                raise _TouchError
        self._put(int(row[1]), found, (found.v - v) / w)

    def _goes_on(self, op: int) -> bool:
        """Whether the step goes on from this stage along its slope, as the implicit midpoint rule does."""
        after = self.table.ops[op + 1 : self.table.edges[1] if op < self.table.edges[1] else self.table.edges[2], 0]
        return bool(self.table.coefficients[op, 0] < 1.0 and SOLVE not in after)

    def _euler(self, t: float, h: float) -> None:
        """Take a step of backward Euler, which contact cannot make gain energy.

        Its slope goes into all registers: one of them is k_0 of the next step.
        """
        x, v = (np.asarray(a, float) for a in self.system.read())
        found = self._stopped(self._solution(x, v, h, t + h, linear=False), x, v, t + h, h)
        for slot in range(self.table.scheme.registers):
            self._put(slot, found, (found.v - v) / h)

    def _put(self, slot: int, found: SolveResult, a: np.ndarray) -> None:
        self.stages.put(slot, *(np.ascontiguousarray(array, self.stages.kind) for array in (found.x, found.v, a)))

    def _walls(self, x: np.ndarray, v: np.ndarray, t: float, w: float) -> Walls:
        assert self.solver
        return Walls(self.contact, x, v, t=t, w=w, length=self.solver.length)

    def _stopped(self, found: SolveResult, x: np.ndarray, v: np.ndarray, t: float, w: float) -> SolveResult:
        """Return a solution of a stage that enters no collider, from one that may, which is returned if it does not."""
        walls = self._walls(x, v, t, w)
        for _ in range(ROUNDS):
            if not walls.take(found):
                break
            found = self._solution(x, walls.vbar, w, t, linear=False, walls=walls.normals, speeds=walls.speeds)
        return found

    def _solution(self, x: np.ndarray, v: np.ndarray, w: float, t: float, *, linear: bool, **walls: Any) -> SolveResult:
        assert self.solver
        found = self.solver.solve(
            x, v, w, extra_acceleration=lambda x, v: self.stages.outside(x, v, t), linear=linear, **walls
        )
        self.iterations = self.iterations + np.array([found.iterations, found.linear_iterations])
        if not found.converged:
            raise _NoSolutionError
        self.residual, self.method = max(self.residual, found.residual), found.method
        return found
