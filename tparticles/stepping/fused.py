"""The fused stepper: a whole frame of sub-steps for particles without neighbours, in one launch.

`for block of lanes: while any lane has time left: for op: for lane`. The ops of the scheme are walked at run time over coefficients
in a small field, so the law is compiled once whatever the scheme, and another scheme is other data. A block of particles
lives in local vectors that the compiler vectorises over (LANES = 16 on a CPU); on a GPU a block is one particle.
A lane whose particle has arrived takes steps of zero length, so no particle depends on its neighbours.
"""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false
# Kernel signatures are Taichi's, and traced values have no Python type.

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from .. import backend
from ..binding import Parameters
from ..errors import InputError
from ..schemes import OpKind, Scheme
from ..systems.attributes import Columns
from ..systems.terms import FLOW_REGISTER, heat
from .control import CLAMPS

_COMBINE = int(OpKind.COMBINE)
_RUNS = 4096  # in which a large group's blocks are counted
_LONG = 0x7F7FFFFF  # bits of the largest f32: non-negative floats order like their bits


@dataclass(frozen=True)
class StepReport:
    """What one advance took: sub-steps over all particles, the smallest and the largest dt [s] (0 if none was taken)."""

    steps: int = 0
    dt_min: float = 0.0
    dt_max: float = 0.0


@ti.data_oriented
class FusedStepper:
    """Advances the particles of one group.

    Arguments:
        system: what moves them (`Advected` or `Newtonian`).
        cooling: a cooling law or None; T joins the state if the law is integrated.
        scheme: the integrator, as data.
        clamp: how steps are fitted to the frame, `equal` or `slide32`.
        columns: the particles' attributes.
        size: the common diameter [m] where it is no attribute.
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
        lanes: int | None = None,
    ):
        self.lanes = lanes or backend.current().lanes
        if columns.padded % self.lanes:
            raise InputError(f"blocks of {self.lanes} lanes do not fit columns that are padded to {columns.padded}")
        self.columns = columns
        self.clamp = CLAMPS[clamp]
        self.parameters = Parameters()
        self.terms = system.terms(self.parameters)
        self.state = [field for name in system.state for field in columns[name]]
        self.heated = cooling is not None and cooling.integrated
        if self.heated:
            self.terms.append(heat(cooling, self.parameters, len(self.state)))
            self.state += columns["T"]
        self.size = size
        # first-order particles have no velocity of their own; where one is wanted, it is the slope at the frame's end
        self.probes = system.order == 1 and "v" in columns
        self._load_scheme(scheme)

    def _load_scheme(self, scheme: Scheme) -> None:
        self.slopes = scheme.slopes
        kinds, slopes, times = (np.zeros(len(scheme.ops) + 1, t) for t in (np.int32, np.int32, float))
        weights = np.zeros((len(scheme.ops) + 1, scheme.slopes))
        for i, op in enumerate(scheme.ops):
            kinds[i], slopes[i], times[i] = op.kind, op.slope, op.time
            weights[i, : len(op.weights)] = op.weights
        kinds[-1] = OpKind.EVALUATE  # one op more, after the last: the probe, k_0 = f(t, z)
        real = self.parameters.array.dtype
        self.ops = np.stack([kinds, slopes], axis=1)
        self.coefficients = np.concatenate([times[:, None], weights], axis=1).astype(real)

    def advance(self, count: int, t0: float, t1: float, dt: float) -> StepReport:
        """Advance the first `count` particles from `t0`, or from their birth if it is later, to `t1` [s] in steps <= `dt`."""
        if count == 0:
            return StepReport()
        result = self._advance(count, t0, t1, dt, self.size, self.ops, self.coefficients, self.parameters.array)
        steps, low, high = (int(v) for v in result)
        low, high = (float(v) for v in np.array([low, high], np.int32).view(np.float32))
        return StepReport(steps, low, high) if steps else StepReport()

    @ti.func
    def _rate(self, term: ti.template(), p, t, z, u, q):
        return term.evaluate(term.law, p, t, z, u, q)

    @ti.kernel
    def _advance(
        self,
        count: ti.i32,
        t0: ti.f64,
        t1: ti.f64,
        dt: float,
        size: float,
        ops: ti.types.ndarray(dtype=ti.i32, ndim=2),
        coefficients: ti.types.ndarray(ndim=2),
        values: ti.types.ndarray(ndim=1),
    ) -> ti.types.vector(3, ti.i64):
        ti.static(self.parameters.read_from(values))
        steps, low, high = ti.cast(0, ti.i64), _LONG, 0
        blocks = (count + self.lanes - 1) // self.lanes
        # The counts are shared: blocks go in runs, so that threads rarely meet there, but in enough runs for many threads.
        run = ti.max(blocks // _RUNS, 1)
        for r in range((blocks + run - 1) // run):
            scalars = ti.Vector([values[i] for i in ti.static(range(len(self.parameters.scalars) + 1))])
            ti.static(self.parameters.hoist(scalars))
            taken, shortest, longest = 0, ti.cast(ti.math.inf, float), ti.cast(0.0, float)
            for block in range(r * run, ti.min(blocks, (r + 1) * run)):
                n, a, b = self._advance_block(block, count, t0, t1, dt, size, ops, coefficients)
                taken += n
                shortest, longest = ti.min(shortest, a), ti.max(longest, b)
            ti.atomic_add(steps, ti.cast(taken, ti.i64))
            if taken > 0:
                ti.atomic_min(low, ti.bit_cast(ti.cast(shortest, ti.f32), ti.i32))
                ti.atomic_max(high, ti.bit_cast(ti.cast(longest, ti.f32), ti.i32))
        return ti.Vector([steps, ti.cast(low, ti.i64), ti.cast(high, ti.i64)])

    @ti.func
    def _advance_block(self, block, count, t0, t1, dt, size, ops: ti.template(), coefficients: ti.template()):
        lanes = ti.static(self.lanes)
        m = ti.static(len(self.state))
        z0 = [ti.Vector([0.0] * lanes) for _ in range(m)]
        z = [ti.Vector([0.0] * lanes) for _ in range(m)]
        k = [ti.Vector([0.0] * (lanes * self.slopes)) for _ in range(m)]
        u = [ti.Vector([0.0] * lanes) for _ in range(3)]
        left, start, h = ti.Vector([0.0] * lanes), ti.Vector([0.0] * lanes), ti.Vector([0.0] * lanes)
        age, sizes = ti.Vector([0.0] * lanes), ti.Vector([0.0] * lanes)
        longest = ti.cast(0.0, float)
        for lane in range(lanes):
            i = block * lanes + lane
            for d in ti.static(range(m)):
                z0[d][lane] = self.state[d][i]
                z[d][lane] = z0[d][lane]
            birth = self.columns["birth"][0][i]
            begin = ti.max(t0, birth)
            left[lane] = ti.select(i < count, ti.cast(t1 - begin, float), 0.0)
            start[lane] = ti.cast(t1 - t0, float)
            age[lane] = ti.cast(t0 - birth, float)
            sizes[lane] = size
            if ti.static("size" in self.columns):
                sizes[lane] = self.columns["size"][0][i]
            longest = ti.max(longest, left[lane])
        taken = ti.Vector([0] * lanes)
        shortest, longest_step = ti.Vector([ti.math.inf] * lanes), ti.Vector([0.0] * lanes)
        probing = ti.cast(ti.static(1 if self.probes else 0), ti.i32)
        while longest > 0.0 or probing > 0:
            first, last = 0, ops.shape[0] - 1
            if longest <= 0.0:
                first, last, probing = last, last + 1, 0
            for lane in range(lanes):
                h[lane] = ti.select(left[lane] > 0.0, ti.min(left[lane], self.clamp(left[lane], dt)), 0.0)
            for op in range(first, last):
                if ops[op, 0] == _COMBINE:
                    self._combine(op, coefficients, z0, z, k, h)
                else:
                    self._evaluate(op, ops, coefficients, z, k, u, h, start, left, age, sizes, ti.cast(t0, float))
            longest = 0.0
            for lane in range(lanes):
                # A lane that has arrived keeps its state to the bit, even where 0 * k is NaN.
                for d in ti.static(range(m)):
                    z0[d][lane] = ti.select(h[lane] > 0.0, z[d][lane], z0[d][lane])
                    z[d][lane] = z0[d][lane]
                taken[lane] += ti.select(h[lane] > 0.0, 1, 0)
                shortest[lane] = ti.min(shortest[lane], ti.select(h[lane] > 0.0, h[lane], ti.math.inf))
                longest_step[lane] = ti.max(longest_step[lane], h[lane])
                left[lane] -= h[lane]
                longest = ti.max(longest, left[lane])
        for lane in range(lanes):
            i = block * lanes + lane
            for d in ti.static(range(m)):
                self.state[d][i] = z0[d][lane]
            if ti.static(self.probes):
                for d in ti.static(range(3)):
                    self.columns["v"][d][i] = k[d][lane]
        return taken.sum(), shortest.min(), longest_step.max()

    @ti.func
    def _combine(
        self,
        op,
        coefficients: ti.template(),
        z0: ti.template(),
        z: ti.template(),
        k: ti.template(),
        h: ti.template(),
    ):
        """z = z0 + dt sum_j w_j k_j."""
        lanes, m = ti.static(self.lanes, len(self.state))
        for lane in range(lanes):
            for d in ti.static(range(m)):
                z[d][lane] = z0[d][lane]
        for j in range(self.slopes):
            w = coefficients[op, 1 + j]
            if w != 0.0:
                for lane in range(lanes):
                    for d in ti.static(range(m)):
                        z[d][lane] += (w * h[lane]) * k[d][j * lanes + lane]

    @ti.func
    def _evaluate(
        self,
        op,
        ops: ti.template(),
        coefficients: ti.template(),
        z: ti.template(),
        k: ti.template(),
        u: ti.template(),
        h: ti.template(),
        start: ti.template(),
        left: ti.template(),
        age: ti.template(),
        sizes: ti.template(),
        t0,
    ):
        """k_s = f(t + c dt, z), one loop over the lanes for each pass of each term."""
        lanes, m = ti.static(self.lanes, len(self.state))
        c, slot = coefficients[op, 0], ops[op, 1] * lanes
        for lane in range(lanes):
            for d in ti.static(range(m)):
                k[d][slot + lane] = 0.0
        for term in ti.static(self.terms):
            if ti.static(term.resets_flow):
                for lane in range(lanes):
                    for d in ti.static(range(3)):
                        u[d][lane] = 0.0
            for p in range(term.passes):
                for lane in range(lanes):
                    # time since the frame began: what is done, plus the stage
                    tau = start[lane] - left[lane] + c * h[lane]
                    value = self._rate(
                        term,
                        p,
                        t0 + tau,
                        ti.Vector([z[d][lane] for d in ti.static(range(m))]),
                        ti.Vector([u[d][lane] for d in ti.static(range(3))]),
                        ti.Vector([age[lane] + tau, sizes[lane]]),
                    )
                    for d in ti.static(range(term.width)):
                        if ti.static(term.first == FLOW_REGISTER):
                            u[d][lane] += value[d]
                        else:
                            k[term.first + d][slot + lane] += value[d]
