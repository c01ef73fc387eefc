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
from ..systems.terms import is_heated, right_hand_side
from .block import Block
from .control import Tolerance
from .newton import Newton
from .pace import LONGEST, NOBODY, Pace
from .report import StepReport
from .table import Table
from .walk import Walk

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
        self.streaks = system.order == 1 and "v" in columns
        components = len(self.state)
        self.table = Table.of(scheme)
        self.coefficients = self.table.coefficients.astype(self.parameters.array.dtype)
        self.reuses = int(self.table.reuses(velocity_free=getattr(system, "velocity_free", False)))
        self.tolerance = tolerance
        self.pace = Pace(self.table, components, clamp=clamp, tolerance=tolerance, columns=columns)
        newton = Newton(first=0 if system.order == 1 else 3, components=components, heated=self.heated)
        self.walk = Walk(self.table, self.terms, pace=self.pace, newton=newton, components=components)
        # the local vectors of a block by name, and how many scalars of a particle each name stands for
        self.layout = {"z0": components, "z": components, "u": 3, "age": 1, "size": 1} | self.pace.vectors()
        if self.table.implicit:
            self.layout |= newton.vectors()
        self.width = sum(self.layout.values())
        on = backend.current()
        self.serial = on.in_one_thread(columns.padded)
        # a scheme that starts itself has that slope, of its predictor
        self.probes = self.streaks and not self.pace.starts_itself
        # The blocks are dealt out in runs, so that the parts of a group have much the same to do.
        self.parts = (1 if self.serial else on.threads) if on.is_cpu else _PARTS
        self.run = _RUN if on.is_cpu else 1
        # A CPU thread gets no less than so many iterations of a loop: all but the first of them are idle.
        self.grain = backend.GRAIN if on.is_cpu and not self.serial else 1

    def twin(
        self, system: Any, *, cooling: Any, columns: Columns, size: float, tolerance: Tolerance | None
    ) -> "FusedStepper":
        """Return a stepper for other particles, in a part of the same columns, that runs this one's kernel: see `likeness`."""
        twin = copy.copy(self)
        twin.columns, twin.size, twin.parameters, twin.tolerance = columns, size, Parameters(), tolerance
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
            raise RunError(self._why_stuck(stuck - 1))
        return StepReport.of_bits(*counts)

    def _why_stuck(self, slot: int) -> str:
        who, floor = f"particle {self.columns['id'][0][slot]}", f"{self.pace.smallest:.2g} of a frame"
        if self.pace.adaptive:
            return f"{who}: the tolerance asks for steps below {floor}, where rounding rules; loosen it or use --precision f64"
        return f"{who}: Newton's method finds no solution of scheme '{self.table.scheme.name}', not even with steps of {floor}"

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
                    # blocks of lanes one after another, or one block whose lanes take the particles of the run in turn
                    first, last = r * self.run, ti.min(blocks, (r + 1) * self.run)
                    if ti.static(self.pace.starts_itself):
                        last = first + 1
                    for block in range(first, last):
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
        slots = ti.Vector([0] * lanes)  # of the particles in the lanes, from 1 on; 0: nobody
        self.pace.reset(b)
        queue = block * lanes
        end = ti.min(queue + lanes * self.run, count)
        if ti.static(self.pace.starts_itself):
            queue = self._take_on(b, slots, queue, end, count, t0, t1, dt, size)
        else:
            for lane in range(lanes):
                slots[lane] = queue + lane + 1
                self._load(b, lane, queue + lane, count, t0, t1, dt, size)
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
            self.walk.walk(b, first, last, ops, coefficients, span, start)
            if busy > 0:
                if ti.static(not self.pace.counted):
                    stuck = ti.min(stuck, self.pace.judge(b, slots, coefficients, target, dt, span))
                if ti.static(self.table.shifts):
                    self.walk.shift(b, edges[2 + starting], edges[3 + starting], ops)
                busy = self.pace.commit(b)
                fresh = ti.static(self.reuses)
                if ti.static(self.pace.starts_itself):
                    queue = self._take_on(b, slots, queue, end, count, t0, t1, dt, size)
                    busy = self.pace.busy(b)
        if ti.static(not self.pace.starts_itself):
            for lane in range(lanes):
                self._store(b, lane, slots[lane] - 1, 0)
        return self.pace.totals(b, stuck)

    @ti.func
    def _take_on(self, b: ti.template(), slots: ti.template(), queue, end, count, t0, t1, dt, size):
        """Let the next particles of the queue into the lanes of those that have arrived; return who comes next.

        Lanes that wait for the slowest of a block would cost as much as lanes at work, where particles choose their own steps.
        """
        for lane in range(b.lanes):
            if b.left[lane] <= 0.0:
                if slots[lane] > 0:
                    self._store(b, lane, slots[lane] - 1, 1)
                slots[lane] = 0
                while (queue < end) & (slots[lane] == 0):
                    self._load(b, lane, queue, count, t0, t1, dt, size)
                    queue += 1
                    slots[lane] = ti.select(b.left[lane] > 0.0, queue, 0)
        return queue

    @ti.func
    def _load(self, b: ti.template(), lane, i, count, t0, t1, dt, size):
        for d in ti.static(range(len(self.state))):
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
    def _store(self, b: ti.template(), lane, i, slope: ti.template()):
        """Write particle `i` back; `slope`: the register of the slope where it is."""
        for d in ti.static(range(len(self.state))):
            self.state[d][i] = b.z0[d][lane]
        if ti.static(self.streaks):
            for d in ti.static(range(3)):
                self.columns["v"][d][i] = b.k[d][slope * b.lanes + lane]
        self.pace.store(b, lane, i)
