"""The staged executor: a spring mesh advanced stage by stage, with the whole mesh as the barrier between them.

`for sub-step: for op: for block of vertices`. A small mesh runs all sub-steps of a frame in one serial launch: a launch costs more
than a sweep over some thousand vertices. A large one takes a launch for every evaluation and one for all ops up to the next. A
scheme with an implicit stage is walked on the host, which hands the stage to a linear solver.

A mesh is one system: a contact, or a step of another size, makes the past worthless for all of it, and the starter runs again.
"""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import taichi as ti

from .. import backend
from ..errors import RunError
from ..schemes import OpKind, Scheme
from ..systems.spring_mesh import SpringMesh
from .block import Block
from .contact import Contact
from .control import CLAMPS
from .fused import StepReport
from .table import Table

# Ops by number: inside a kernel an enum member is no number.
_COMBINE, _EVALUATE, _KICK, _DRIFT = (int(k) for k in (OpKind.COMBINE, OpKind.EVALUATE, OpKind.KICK, OpKind.DRIFT))
_ROTATE, _DIFFERENCE, _SOLVE = int(OpKind.ROTATE), int(OpKind.DIFFERENCE), int(OpKind.SOLVE)

_SERIAL = 20_000  # vertices: below it one thread is faster than a launch for every op
_EXACT = 512  # vertices: up to here the whole mesh goes back to the moment of a contact
_LAUNCH = 20_000_000  # vertex-steps in a serial launch, about a second: Ctrl-C waits for it
_EVENTS = 32  # contacts in a step before they are resolved vertex by vertex

Drive = Callable[[float], np.ndarray]


@ti.data_oriented
class StagedStepper:
    """Advances a mesh by a scheme.

    Arguments:
        system: the mesh.
        scheme: any scheme for second-order systems.
        clamp: how steps are fitted to the frame, a key of `CLAMPS`.
        contact: its colliders.
        driven: vertices that follow a path, int (d,); `drive(t)` gives their positions, (d, 3) [m].
        velocity_free: whether no force depends on v.
        solver: solves implicit stages: `solve(x, v, h, linear=..., t=...)`, see `mesh_solver`.
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
        solver: Any = None,
    ):
        self.system, self.contact, self.solver = system, contact, solver
        self.clamp = CLAMPS[clamp]
        self.driven, self.drive = np.asarray(driven, np.int32), drive
        self.drives = len(driven) > 0
        self.table = Table.of(scheme)
        self.registers = scheme.registers
        self.steps_back = scheme.steps_back
        self.reuses = int(self.table.reuses(velocity_free=velocity_free and not system.damped))
        self.serial = backend.current().is_cpu and system.count <= _SERIAL and not self.table.implicit
        self.exact = contact.any and system.count <= _EXACT and not self.table.implicit
        kind = np.float64 if backend.current().precision == "f64" else np.float32
        self.coefficients = self.table.coefficients.astype(kind)
        self.layout = {"z": 6, "a": 3, "u": 3}
        self.held, self.fresh, self.last_h = 0, 0, 0.0
        self.contacts = 0  # bounces so far

    def forget(self) -> None:
        """Throw away the past: something else than a step changed the state."""
        self.held = self.fresh = 0

    def past(self) -> dict[str, Any]:
        """Return what the next step depends on beside the state."""
        return {"held": self.held, "fresh": self.fresh, "last_h": self.last_h, "contacts": self.contacts}

    def set_past(self, past: dict[str, Any]) -> None:
        """Go on from what `past` returned."""
        self.held, self.fresh, self.contacts = (int(past[name]) for name in ("held", "fresh", "contacts"))
        self.last_h = float(past["last_h"])

    def advance(self, t0: float, t1: float, dt: float, *, on_step: Callable[[float], None] | None = None) -> StepReport:
        """Advance from `t0` to `t1` [s] in steps <= `dt`; `on_step(t)` is called after each one.

        Raises:
            RunError: an implicit stage has no solution, not even with the smallest step.
        """
        report = StepReport()
        t = t0
        for h, count in self._runs(t1 - t0, dt):
            if abs(h - self.last_h) > 1e-4 * h:
                self.held = 0
            self.last_h = h
            batch = 1 if on_step else max(1, _LAUNCH // max(1, self.system.count * len(self.table.ops)))
            for first in range(0, count, batch):
                n = min(batch, count - first)
                self._steps(t + first * h, h, n)
                if on_step:
                    on_step(t + (first + n) * h)
            t += h * count
            low = min(report.dt_min, h) if report.steps else h
            report = StepReport(report.steps + count, 0, low, max(report.dt_max, h))
        return report

    def _runs(self, span: float, dt: float) -> Iterator[tuple[float, int]]:
        """Yield (step, how many of it) until the span is over."""
        left = span
        while left > 1e-9 * span:
            h = min(float(self.clamp(left, dt, span)), left)
            n = max(1, math.floor(left / h + 1e-6)) if self.clamp is CLAMPS["equal"] else 1
            yield h, n
            left = left - n * h

    def _steps(self, t: float, h: float, count: int) -> None:
        values, paths = self.system.parameters.array, self._paths(t, h, count)
        if self.serial:
            result = self._run(
                t, h, count, self.held, self.fresh, self.table.ops, self.table.edges, self.coefficients, self.driven, paths, values
            )
            self.held, self.fresh, bounces = (int(v) for v in result)
            self.contacts += bounces
            return
        for n in range(count):
            self._one_step(t + n * h, h, paths[n : n + 2])

    def _paths(self, t: float, h: float, count: int) -> np.ndarray:
        """Return where driven vertices are at the ends of the steps, (count + 1, d, 3)."""
        kind = self.coefficients.dtype
        if not self.drives:
            return np.zeros((2, 1, 3), kind)
        return np.stack([self.drive(t + n * h) for n in range(count + 1)]).astype(kind)

    # One launch for many steps.

    @ti.kernel
    def _run(
        self,
        t0: ti.f64,
        dt: float,
        count: ti.i32,
        held0: ti.i32,
        fresh0: ti.i32,
        ops: ti.types.ndarray(dtype=ti.i32, ndim=2),
        edges: ti.types.ndarray(dtype=ti.i32, ndim=1),
        coefficients: ti.types.ndarray(ndim=2),
        driven: ti.types.ndarray(dtype=ti.i32, ndim=1),
        paths: ti.types.ndarray(ndim=3),
        values: ti.types.ndarray(ndim=1),
    ) -> ti.types.vector(3, ti.i32):
        ti.static(self.system.parameters.read_from(values))
        held, fresh, bounces = held0, fresh0, 0
        ti.loop_config(serialize=True)
        for _ in range(1):
            for step in range(count):
                left, events = dt, 0
                if ti.static(self.drives):
                    self._aim(step, dt, driven, paths)
                while left > 0.0:
                    t = ti.cast(t0 + step * ti.cast(dt, ti.f64), float) + (dt - left)
                    starting = ti.select(held < self.steps_back, 1, 0)
                    self._program(starting, fresh, t, left, dt, ops, edges, coefficients)
                    reached, hit = left, ti.cast(2.0, float)
                    if ti.static(self.exact):
                        if events < _EVENTS:
                            for i in range(self.system.count):
                                hit = ti.min(hit, self.contact.entry(i, t, left))
                        if hit < 1.0:
                            # Go back, and step to the moment of the first contact.
                            reached = hit * left
                            for i in range(self.system.padded):
                                for d in ti.static(range(6)):
                                    self.system.z[d][i] = self.system.z0[d][i]
                            if reached > 0.0:
                                self._program(ti.select(ti.static(self.steps_back > 0), 1, 0), 0, t, reached, dt, ops, edges, coefficients)
                            left -= reached
                            events += 1
                    met = self._finish_all(t, reached, dt, hit < 1.0)
                    bounces += met
                    if ti.static(self.table.shifts):
                        self._shift_all(starting, ops, edges, reached)
                    kept = (met == 0) & (hit >= 1.0)
                    held = ti.select(kept, ti.min(held + 1, self.steps_back), 0)
                    fresh = ti.select(kept, self.reuses, 0)
                    if hit >= 1.0:
                        left = 0.0
                if ti.static(self.drives):
                    self._place(step + 1, driven, paths)
        return ti.Vector([held, fresh, bounces])

    @ti.func
    def _program(self, starting, fresh, t, h, dt, ops: ti.template(), edges: ti.template(), coefficients: ti.template()):
        """Run the scheme's program, or its starter's, on all blocks, and remember the state it began with."""
        for block in range(self.system.blocks):
            self._begin(block)
        first, last = edges[0] + fresh, edges[1]
        if starting > 0:
            first, last = edges[1] + fresh, edges[2]
        for op in range(first, last):
            if ops[op, 0] == _EVALUATE:
                for block in range(self.system.blocks):
                    self._evaluate(block, ops[op, 1], t + coefficients[op, 0] * h, h)
            else:
                for block in range(self.system.blocks):
                    self._move(block, op, h, ops, coefficients)

    @ti.func
    def _finish_all(self, t, h, dt, at_contact):
        """What ends a step: contacts and tears. Return how many vertices bounced."""
        met = 0
        if ti.static(self.contact.any):
            for i in range(self.system.count):
                met += self._touch(i, t, h, dt, at_contact)
        if ti.static(self.system.tears):
            for block in range(self.system.blocks):
                self.system.tear(block)
        return met

    @ti.func
    def _touch(self, i, t, h, dt, at_contact):
        met = 0
        if ti.static(self.exact):
            if at_contact:
                self.contact.settle(i, t + h)
                # a bounce that ends within a step is none
                met = self.contact.impulse(i, t + h, self._slow(i, dt))
            else:
                met = self.contact.resolve(i, t, h)
        else:
            met = self.contact.resolve(i, t, h)
        return met

    @ti.func
    def _slow(self, i, dt):
        """Return the speed [m/s] that the present acceleration takes away in half a step."""
        first = ti.Vector([self.system.k[3 + d][i] for d in ti.static(range(3))])
        return 0.5 * dt * first.norm()

    @ti.func
    def _shift_all(self, starting, ops: ti.template(), edges: ti.template(), h):
        for op in range(edges[2 + starting], edges[3 + starting]):
            for block in range(self.system.blocks):
                self._move(block, op, h, ops, ops)

    @ti.func
    def _aim(self, step, h, driven: ti.template(), paths: ti.template()):
        """Give driven vertices the velocity that takes them along their path."""
        for n in range(driven.shape[0]):
            for d in ti.static(range(3)):
                self.system.z[3 + d][driven[n]] = (paths[step + 1, n, d] - self.system.z[d][driven[n]]) / h

    @ti.func
    def _place(self, step, driven: ti.template(), paths: ti.template()):
        for n in range(driven.shape[0]):
            for d in ti.static(range(3)):
                self.system.z[d][driven[n]] = paths[step, n, d]

    # What one block of vertices does.

    @ti.func
    def _begin(self, block):
        for lane in range(self.system.lanes):
            i = block * self.system.lanes + lane
            for d in ti.static(range(6)):
                self.system.z0[d][i] = self.system.z[d][i]

    @ti.func
    def _evaluate(self, block, slot, t, h):
        """k_s = f(t, z) = (v, a)."""
        lanes = ti.static(self.system.lanes)
        vectors = [ti.Vector([0.0] * lanes) for _ in range(ti.static(sum(self.layout.values())))]
        b = ti.static([Block(self.layout, vectors, [], self.system.lanes)])[0]
        self.system.gather(b, block, t)
        if ti.static(self.contact.any):
            self.contact.press(b, block, t, h)
        for lane in range(lanes):
            i = slot * self.system.padded + block * lanes + lane
            for d in ti.static(range(3)):
                self.system.k[d][i] = b.z[3 + d][lane]
                self.system.k[3 + d][i] = b.a[d][lane]

    @ti.func
    def _move(self, block, op, h, ops: ti.template(), coefficients: ti.template()):
        """Run an op that looks at nothing but a vertex itself."""
        kind = ops[op, 0]
        for lane in range(self.system.lanes):
            i = block * self.system.lanes + lane
            if kind == _COMBINE:
                for d in ti.static(range(6)):
                    self.system.z[d][i] = self.system.z0[d][i] + h * self._weighted(d, i, op, coefficients)
            if ti.static(_KICK in self.table.kinds):
                if kind == _KICK:
                    for d in ti.static(range(3, 6)):
                        self.system.z[d][i] += h * self._weighted(d, i, op, coefficients)
            if ti.static(_DRIFT in self.table.kinds):
                if kind == _DRIFT:
                    for d in ti.static(range(3)):
                        self.system.z[d][i] += h * coefficients[op, 1] * self.system.z[3 + d][i]
            if ti.static(_ROTATE in self.table.kinds):
                if kind == _ROTATE:
                    for d in ti.static(range(6)):
                        self.system.k[d][ops[op, 1] * self.system.padded + i] = self.system.k[d][ops[op, 2] * self.system.padded + i]
            if ti.static(_DIFFERENCE in self.table.kinds):
                if kind == _DIFFERENCE:
                    for d in ti.static(range(6)):
                        self.system.k[d][ops[op, 1] * self.system.padded + i] = (self.system.z[d][i] - self.system.z0[d][i]) / h

    @ti.func
    def _weighted(self, d: ti.template(), i, op, coefficients: ti.template()):
        """Return sum_j w_j k_j."""
        total = ti.cast(0.0, float)
        for j in range(ti.static(self.registers)):
            w = coefficients[op, 1 + j]
            if w != 0.0:
                total += w * self.system.k[d][j * self.system.padded + i]
        return total

    # A launch for every evaluation, and one for what follows it.

    def _one_step(self, t: float, h: float, paths: np.ndarray) -> None:
        table = self.table
        starting = int(self.held < self.steps_back)
        first, last = int(table.edges[starting]), int(table.edges[starting + 1])
        arguments = (table.ops, self.coefficients, self.system.parameters.array)
        if self.drives:
            self._aim_parallel(h, self.driven, paths)
        begin = 1
        op = first + self.fresh
        while op < last or begin:
            end = op
            while end < last and table.ops[end, 0] not in (_EVALUATE, _SOLVE):
                end += 1
            if end > op or begin:
                self._sweep(begin, op, end, h, *arguments)
                begin = 0
            if end < last:
                if table.ops[end, 0] == _EVALUATE:
                    self._evaluate_parallel(
                        int(table.ops[end, 1]), t + float(table.coefficients[end, 0]) * h, h, self.system.parameters.array
                    )
                else:
                    self._solve(end, t, h)
            op = end + 1
        met = self._finish_parallel(t, h, self.system.parameters.array) if self.contact.any or self.system.tears else 0
        if table.shifts:
            self._sweep(0, int(table.edges[2 + starting]), int(table.edges[3 + starting]), h, *arguments)
        self.held, self.fresh = min(self.held + 1, self.steps_back), self.reuses
        if met:
            self.contacts += met
            self.forget()
        if self.drives:
            self._place_parallel(self.driven, paths)

    @ti.kernel
    def _sweep(
        self,
        begin: ti.i32,
        first: ti.i32,
        last: ti.i32,
        h: float,
        ops: ti.types.ndarray(dtype=ti.i32, ndim=2),
        coefficients: ti.types.ndarray(ndim=2),
        values: ti.types.ndarray(ndim=1),
    ):
        for block in range(self.system.blocks):
            if begin > 0:
                self._begin(block)
            for op in range(first, last):
                self._move(block, op, h, ops, coefficients)

    @ti.kernel
    def _evaluate_parallel(self, slot: ti.i32, t: float, h: float, values: ti.types.ndarray(ndim=1)):
        ti.static(self.system.parameters.read_from(values))
        for block in range(self.system.blocks):
            self._evaluate(block, slot, t, h)

    @ti.kernel
    def _finish_parallel(self, t: float, h: float, values: ti.types.ndarray(ndim=1)) -> ti.i32:
        ti.static(self.system.parameters.read_from(values))
        met = 0
        if ti.static(self.contact.any):
            for i in range(self.system.count):
                met += self.contact.resolve(i, t, h)
        if ti.static(self.system.tears):
            for block in range(self.system.blocks):
                self.system.tear(block)
        return met

    @ti.kernel
    def _aim_parallel(self, h: float, driven: ti.types.ndarray(dtype=ti.i32, ndim=1), paths: ti.types.ndarray(ndim=3)):
        for _ in range(1):
            self._aim(0, h, driven, paths)

    @ti.kernel
    def _place_parallel(self, driven: ti.types.ndarray(dtype=ti.i32, ndim=1), paths: ti.types.ndarray(ndim=3)):
        for _ in range(1):
            self._place(1, driven, paths)

    def _solve(self, op: int, t: float, h: float) -> None:
        """Solve an implicit stage on the host: z = zbar + w h f(z), k = f(z)."""
        row = self.table.ops[op]
        w = float(self.table.coefficients[op, 1]) * h
        x, v = (np.asarray(a, float) for a in self.system.read())
        found = self.solver.solve(x, v, w, linear=bool(row[3]), t=t + float(self.table.coefficients[op, 0]) * h)
        if not found.converged:
            raise RunError(f"no solution of an implicit stage of '{self.table.scheme.name}' with a step of {h:.3g} s")
        self._put(int(row[1]), *(np.ascontiguousarray(a, self.coefficients.dtype) for a in (found.x, found.v, (found.v - v) / w)))

    @ti.kernel
    def _put(
        self, slot: ti.i32, x: ti.types.ndarray(ndim=2), v: ti.types.ndarray(ndim=2), a: ti.types.ndarray(ndim=2)
    ):
        for i in range(self.system.count):
            for d in ti.static(range(3)):
                self.system.z[d][i] = x[i, d]
                self.system.z[3 + d][i] = v[i, d]
                self.system.k[d][slot * self.system.padded + i] = v[i, d]
                self.system.k[3 + d][slot * self.system.padded + i] = a[i, d]


def velocity_free(forces: Sequence[Any]) -> bool:
    """Return whether no force depends on v, as far as the forces say."""
    return all(getattr(force, "velocity_free", False) for force in forces)
