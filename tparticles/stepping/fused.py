"""The fused stepper: a whole frame of sub-steps for particles without neighbours, in one launch.

`for block of lanes: while any lane has time left: for op: for lane`. The ops of the scheme are walked at run time over coefficients
in a small array, so the law is compiled once whatever the scheme, and another scheme is other data. A block of particles
lives in local vectors that the compiler vectorises over (LANES = 16 on a CPU); on a GPU a block is one particle.
A lane that takes no step has a step of zero length, so no particle depends on its neighbours: neither on how many steps
they need, nor on whether they start, reject a step or wait for Newton's method.
"""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportOptionalSubscript=false
# Kernel signatures are Taichi's, and traced values have no Python type.

import copy
from typing import Any

import numpy as np
import taichi as ti

from .. import backend
from ..binding import Parameters
from ..errors import InputError, RunError
from ..schemes import Scheme
from ..systems.attributes import Columns
from ..systems.terms import FLOW_REGISTER, first_writers, is_heated, right_hand_side
from .block import Block
from .control import Tolerance
from .newton import Newton
from .pace import LONGEST, NOBODY, Pace
from .report import StepReport
from .table import Table

_COMBINE, _EVALUATE, _KICK, _DRIFT, _SOLVE, _ROTATE, _DIFFERENCE = range(7)
_PARTS = 4096  # of a group on a GPU
_RUN = 16  # blocks that a CPU thread takes in a row


@ti.data_oriented
class FusedStepper:
    """Advances the particles of one group.

    Arguments:
        system: what moves them (`Advected` or `Newtonian`).
        cooling: a cooling law or None; T joins the state if the law is integrated.
        scheme: the integrator, as data.
        clamp: how steps are fitted to the frame: `equal`, `slide32` or `dyadic`.
        columns: the particles' attributes, those of `memory` included.
        size: the common diameter [m] where it is no attribute.
        tolerance: what the error of a step is held against, where particles choose their own steps.
        lanes: particles per block; the backend's choice by default.
    """

    def __init__(
        self,
        system: Any,
        *,
        cooling: Any,
        scheme: Scheme,
        clamp: str,
        columns: Columns,
        size: float,
        tolerance: Tolerance | None = None,
        lanes: int | None = None,
    ):
        self.lanes = lanes or backend.current().lanes
        if columns.padded % self.lanes:
            raise InputError(f"blocks of {self.lanes} lanes do not fit columns that are padded to {columns.padded}")
        self.columns, self.size = columns, size
        self.parameters = Parameters()
        self.terms = right_hand_side(system, cooling, self.parameters)
        self.heated = is_heated(cooling)
        self.state = [field for name in (*system.state, *["T"] * self.heated) for field in columns[name]]
        self.compiled = self  # whose kernel runs
        # first-order particles have no velocity of their own; where one is wanted, it is the slope at the frame's end
        self.probes = system.order == 1 and "v" in columns
        components = len(self.state)
        self.table = Table.of(scheme)
        self.coefficients = self.table.coefficients.astype(self.parameters.array.dtype)
        self.reuses = int(self.table.reuses(velocity_free=getattr(system, "velocity_free", False)))
        self.tolerance = tolerance
        self.pace = Pace(self.table, components, clamp=clamp, tolerance=tolerance, columns=columns)
        self.newton = Newton(first=0 if system.order == 1 else 3, components=components, heated=self.heated)
        self.firsts = first_writers(self.terms)
        # the local vectors of a block by name, and how many scalars of a particle each name stands for
        self.layout = {"z0": components, "z": components, "u": 3, "age": 1, "size": 1} | self.pace.vectors()
        if self.table.implicit:
            self.layout |= self.newton.vectors()
        self.width = sum(self.layout.values())
        on = backend.current()
        self.serial = on.in_one_thread(columns.padded)
        # The blocks are dealt out in runs, so that the parts of a group have much the same to do.
        self.parts = (1 if self.serial else on.threads) if on.is_cpu else _PARTS
        self.run = _RUN if on.is_cpu else 1
        # A CPU thread gets no less than so many iterations of a loop: all but the first of them are idle.
        self.grain = backend.GRAIN if on.is_cpu and not self.serial else 1

    def twin(self, system: Any, *, cooling: Any, columns: Columns, size: float) -> "FusedStepper":
        """Return a stepper for other particles, in a part of the same columns, that runs this one's kernel: see `likeness`."""
        twin = copy.copy(self)
        twin.columns, twin.size, twin.parameters = columns, size, Parameters()
        right_hand_side(system, cooling, twin.parameters)
        assert twin.parameters.structure == self.parameters.structure
        return twin

    def advance(self, count: int, t0: float, t1: float, dt: float, *, camera: np.ndarray | None = None) -> StepReport:
        """Advance the first `count` particles from `t0`, or from their birth if it is later, to `t1` [s] in steps <= `dt`.

        `camera`: the row of numbers that a tolerance in pixels is projected with.

        Raises:
            RunError: a particle finds no step; its id is named.
        """
        if count == 0:
            return StepReport()
        target = np.zeros(1, np.float32) if self.tolerance is None else self.tolerance.numbers(t1 - t0, camera)
        table, before = self.table, self.columns.first // self.lanes
        program = table.ops, table.edges, self.coefficients
        result = self.compiled._advance(before, count, t0, t1, dt, self.size, *program, target, self.parameters.array)
        *counts, stuck = (int(v) for v in result)
        if stuck != NOBODY:
            raise RunError(self._why_stuck(stuck))
        return StepReport.of_bits(*counts)

    def _why_stuck(self, slot: int) -> str:
        who, floor = f"particle {self.columns['id'][0][slot]}", f"{self.pace.smallest:.2g} of a frame"
        if self.pace.adaptive:
            return f"{who}: the tolerance asks for steps below {floor}, where rounding rules; loosen it or use --precision f64"
        return f"{who}: Newton's method finds no solution of scheme '{self.table.scheme.name}', not even with steps of {floor}"

    @ti.func
    def _rate(self, term: ti.template(), p, t, z, u, q):
        return term.evaluate(term.law, p, t, z, u, q)

    @ti.kernel
    def _advance(
        self,
        before: ti.i32,
        count: ti.i32,
        t0: ti.f64,
        t1: ti.f64,
        dt: float,
        size: float,
        ops: ti.types.ndarray(dtype=ti.i32, ndim=2),
        edges: ti.types.ndarray(dtype=ti.i32, ndim=1),
        coefficients: ti.types.ndarray(ndim=2),
        target: ti.types.ndarray(dtype=ti.f32, ndim=1),
        values: ti.types.ndarray(ndim=1),
    ) -> ti.types.vector(6, ti.i64):
        ti.static(self.parameters.read_from(values))
        steps, starting, rejected = ti.cast(0, ti.i64), ti.cast(0, ti.i64), ti.cast(0, ti.i64)
        low, high, stuck = LONGEST, 0, NOBODY
        blocks = (count + self.lanes - 1) // self.lanes
        runs = (blocks + self.run - 1) // self.run
        ti.loop_config(serialize=ti.static(self.serial))
        for task in range(ti.min(runs, self.parts) * self.grain):
            if task % self.grain == 0:
                scalars = ti.Vector([values[i] for i in ti.static(range(len(self.parameters.scalars) + 1))])
                ti.static(self.parameters.hoist(scalars))
                taken, started, missed = ti.cast(0, ti.i64), ti.cast(0, ti.i64), ti.cast(0, ti.i64)
                shortest, longest = LONGEST, 0
                r = task // self.grain
                while r < runs:
                    for block in range(r * self.run, ti.min(blocks, (r + 1) * self.run)):
                        n, new, no, low_, high_, slot = self._advance_block(
                            before + block,
                            before * self.lanes + count,
                            t0,
                            t1,
                            dt,
                            size,
                            ops,
                            edges,
                            coefficients,
                            target,
                        )
                        taken += n
                        started += new
                        missed += no
                        shortest, longest = ti.min(shortest, low_), ti.max(longest, high_)
                        if ti.static(self.pace.chooses):
                            if slot < NOBODY:
                                ti.atomic_min(stuck, slot)
                    r += self.parts
                ti.atomic_add(steps, taken)
                if ti.static(self.pace.steps_back > 0):
                    ti.atomic_add(starting, started)
                if ti.static(self.pace.chooses):
                    ti.atomic_add(rejected, missed)
                if taken > 0:
                    ti.atomic_min(low, shortest)
                    ti.atomic_max(high, longest)
        return ti.Vector([steps, starting, rejected, low, high, stuck], ti.i64)

    @ti.func
    def _advance_block(
        self,
        block,
        count,
        t0,
        t1,
        dt,
        size,
        ops: ti.template(),
        edges: ti.template(),
        coefficients: ti.template(),
        target: ti.template(),
    ):
        lanes = ti.static(self.lanes)
        vectors = [ti.Vector([0.0] * lanes) for _ in range(ti.static(self.width))]
        slopes = [ti.Vector([0.0] * (lanes * self.table.scheme.registers)) for _ in range(ti.static(len(self.state)))]
        b = ti.static([Block(self.layout, vectors, slopes, self.lanes)])[0]
        span, start = ti.cast(t1 - t0, float), ti.cast(t0, float)
        self._load(b, block, count, t0, t1, dt, size)
        busy = self.pace.busy(b)
        fresh, probing, stuck = 0, ti.cast(ti.static(1 if self.probes else 0), ti.i32), NOBODY
        while busy + probing > 0:
            first, last, starting = edges[0] + fresh, edges[1], 0
            if busy == 0:
                first, last, probing = edges[4], edges[4] + 1, 0
            elif ti.static(not self.pace.counted):
                starting = self.pace.choose(b, dt, span)
                if starting > 0:
                    first, last = edges[1] + fresh, edges[2]
            self._walk(b, first, last, ops, coefficients, span, start)
            if busy > 0:
                if ti.static(not self.pace.counted):
                    stuck = ti.min(stuck, self.pace.judge(b, block, coefficients, target, dt, span))
                if ti.static(self.table.shifts):
                    self._shift(b, edges[2 + starting], edges[3 + starting], ops)
                busy = self.pace.commit(b)
                fresh = ti.static(self.reuses)
        self._store(b, block)
        return self.pace.totals(b, stuck)

    @ti.func
    def _load(self, b: ti.template(), block, count, t0, t1, dt, size):
        m = ti.static(len(self.state))
        for lane in range(b.lanes):
            i = block * b.lanes + lane
            for d in ti.static(range(m)):
                b.z0[d][lane] = self.state[d][i]
                b.z[d][lane] = b.z0[d][lane]
            birth = self.columns["birth"][0][i]
            b.left[lane] = ti.select(i < count, ti.cast(t1 - ti.max(t0, birth), float), 0.0)
            b.age[lane] = ti.cast(t0 - birth, float)
            b.size[lane] = size
            if ti.static("size" in self.columns):
                b.size[lane] = self.columns["size"][0][i]
            self.pace.load(b, lane, i, birth >= t0, dt, ti.cast(t1 - t0, float))

    @ti.func
    def _store(self, b: ti.template(), block):
        m = ti.static(len(self.state))
        for lane in range(b.lanes):
            i = block * b.lanes + lane
            for d in ti.static(range(m)):
                self.state[d][i] = b.z0[d][lane]
            if ti.static(self.probes):
                for d in ti.static(range(3)):
                    self.columns["v"][d][i] = b.k[d][lane]
            self.pace.store(b, lane, i)

    @ti.func
    def _walk(self, b: ti.template(), first, last, ops: ti.template(), coefficients: ti.template(), span, start):
        """Run ops first..last-1 of the program."""
        for op in range(first, last):
            kind = ops[op, 0]
            if kind == _COMBINE:
                self._combine(b, op, ops, coefficients)
            if ti.static(_KICK in self.table.kinds):
                if kind == _KICK:
                    self._kick(b, op, ops, coefficients)
            if ti.static(_DRIFT in self.table.kinds):
                if kind == _DRIFT:
                    for lane in range(b.lanes):
                        for d in ti.static(range(3)):
                            b.z[d][lane] += coefficients[op, 1] * b.h[lane] * b.z[3 + d][lane]
            if ti.static(self.table.rotates or self.table.differs):
                if (kind == _ROTATE) | (kind == _DIFFERENCE):
                    going = ti.Vector([0] * ti.static(self.lanes))
                    for lane in range(b.lanes):
                        going[lane] = ti.select(b.h[lane] > 0.0, 1, 0)
                    if ti.static(self.table.rotates):
                        if kind == _ROTATE:
                            b.rotate(ops[op, 1], ops[op, 2], going, going.min())
                    if ti.static(self.table.differs):
                        if kind == _DIFFERENCE:
                            b.difference(ops[op, 1], going)
            if ti.static(not self.table.implicit):
                if kind == _EVALUATE:
                    self._evaluate(b, ops[op, 1] * b.lanes, coefficients[op, 0], span, start)
            else:
                if (kind == _EVALUATE) | (kind == _SOLVE):
                    self._evaluate_or_solve(b, op, ops, coefficients, span, start)

    @ti.func
    def _evaluate_or_solve(self, b: ti.template(), op, ops: ti.template(), coefficients: ti.template(), span, start):
        """An implicit stage is a number of evaluations: one copy of the law serves both kinds of op."""
        solving, linear, slot = ops[op, 0] == _SOLVE, ops[op, 3], ops[op, 1] * b.lanes
        rounds, r = 1, 0
        if solving:
            rounds = ti.select(linear > 0, self.newton.rounds_linear, self.newton.rounds)
            for lane in range(b.lanes):
                b.w[lane] = self._weight(b, op, 0, lane, coefficients)
            r = self.newton.begin(b, linear)
        while r < rounds:
            self._evaluate(b, slot, coefficients[op, 0], span, start)
            if solving:
                if self.newton.digest(b, slot, r, linear) > 0:
                    r = rounds
            r += 1
        if solving:
            self.newton.finish(b, slot)
            for lane in range(b.lanes):
                b.failed[lane] = ti.max(b.failed[lane], b.waiting[lane])

    @ti.func
    def _weight(self, b: ti.template(), op, j, lane, coefficients: ti.template()):
        """Return weight `j` of an op; with steps of varying size (n0 + n1 r) / (1 + d r), r the ratio to the last one."""
        w = coefficients[op, 1 + j]
        if ti.static(self.table.variable):
            at, r = ti.static(1 + self.table.scheme.registers) + 3 * j, b.ratio[lane]
            w = (coefficients[op, at] + coefficients[op, at + 1] * r) / (1.0 + coefficients[op, at + 2] * r)
        return w

    @ti.func
    def _combine(self, b: ti.template(), op, ops: ti.template(), coefficients: ti.template()):
        """z = z0 + dt sum_j w_j k_j; the first j comes last but z0, the largest of all: one rounding counts."""
        m = ti.static(len(self.state))
        first, begun = ops[op, 4], 0
        while ops[op, 5 + begun] >= 0:
            j = ops[op, 5 + begun]
            for lane in range(b.lanes):
                w = self._weight(b, op, j, lane, coefficients) * b.h[lane]
                for d in ti.static(range(m)):
                    b.z[d][lane] = ti.select(begun > 0, b.z[d][lane], 0.0) + w * b.k[d][j * b.lanes + lane]
            begun += 1
        for lane in range(b.lanes):
            w = self._weight(b, op, first, lane, coefficients) * b.h[lane]
            for d in ti.static(range(m)):
                others = ti.select(begun > 0, b.z[d][lane], 0.0)
                b.z[d][lane] = b.z0[d][lane] + (others + w * b.k[d][first * b.lanes + lane])

    @ti.func
    def _kick(self, b: ti.template(), op, ops: ti.template(), coefficients: ti.template()):
        """v += dt sum_j w_j a_j."""
        i = 4
        while ops[op, i] >= 0:
            j = ops[op, i]
            for lane in range(b.lanes):
                w = self._weight(b, op, j, lane, coefficients) * b.h[lane]
                for d in ti.static(range(3)):
                    b.z[3 + d][lane] += w * b.k[3 + d][j * b.lanes + lane]
            i += 1

    @ti.func
    def _evaluate(self, b: ti.template(), slot, c, span, start):
        """k_s = f(t + c dt, z), one loop over the lanes for each pass of each term; the first to write a component sets it."""
        m = ti.static(len(self.state))
        for term, sets in ti.static(self.firsts):
            for p in range(term.passes()):
                for lane in range(b.lanes):
                    # time since the frame began: what is done, plus the stage
                    tau = span - b.left[lane] + c * b.h[lane]
                    value = self._rate(
                        term,
                        p,
                        start + tau,
                        ti.Vector([b.z[d][lane] for d in ti.static(range(m))]),
                        ti.Vector([b.u[d][lane] for d in ti.static(range(3))]),
                        ti.Vector([b.age[lane] + tau, b.size[lane]]),
                    )
                    for d in ti.static(range(term.width)):
                        if ti.static(term.first == FLOW_REGISTER):
                            b.u[d][lane] = self._sum(term, sets, p, b.u[d][lane], value[d])
                        else:
                            i = slot + lane
                            b.k[term.first + d][i] = self._sum(term, sets, p, b.k[term.first + d][i], value[d])

    @ti.func
    def _sum(self, term: ti.template(), sets: ti.template(), p, before, value):
        total = before + value
        if ti.static(sets and term.in_passes):
            total = ti.select(p > 0, before, 0.0) + value
        elif ti.static(sets):
            total = value
        return total

    @ti.func
    def _shift(self, b: ti.template(), first, last, ops: ti.template()):
        """Run ops first..last-1, ROTATE and DIFFERENCE, for the lanes whose step is accepted."""
        accepted = ti.Vector([0] * ti.static(self.lanes))
        for lane in range(b.lanes):
            accepted[lane] = ti.select(self.pace.accepted(b, lane), 1, 0)
        all_accepted = accepted.min()
        for op in range(first, last):
            if ops[op, 0] == _ROTATE:
                b.rotate(ops[op, 1], ops[op, 2], accepted, all_accepted)
            if ti.static(_DIFFERENCE in self.table.kinds):
                if ops[op, 0] == _DIFFERENCE:
                    b.difference(ops[op, 1], accepted)
