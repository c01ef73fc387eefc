"""The stages of a mesh on the device: the ops of a scheme on blocks of vertices, in one launch for many steps or one at a time."""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false
# pyright: reportCallIssue=false, reportOptionalMemberAccess=false

import numpy as np
import taichi as ti

from .. import backend
from ..schemes import OpKind
from ..systems.spring_mesh import SpringMesh
from .block import Block
from .contact import Contact
from .recorder import Recorder
from .table import Table

# Ops by number: inside a kernel an enum member is no number.
_COMBINE, EVALUATE, _KICK, _DRIFT = (int(k) for k in (OpKind.COMBINE, OpKind.EVALUATE, OpKind.KICK, OpKind.DRIFT))
_ROTATE, _DIFFERENCE, SOLVE = int(OpKind.ROTATE), int(OpKind.DIFFERENCE), int(OpKind.SOLVE)

_EXACT = 512  # vertices: up to here the whole mesh goes back to the moment of a contact
_EVENTS = 32  # contacts in a step before they are resolved vertex by vertex


@ti.data_oriented
class Stages:
    """The kernels of a mesh and a scheme.

    Arguments:
        system: the mesh.
        table: the scheme's programs.
        contact: the mesh's colliders.
        reuses: 1 if the last slope of a step is the first of the next.
        drives: whether there are vertices that follow a path.
        record: records the steps.
    """

    def __init__(
        self, system: SpringMesh, table: Table, contact: Contact, *, reuses: int, drives: bool, record: Recorder | None
    ):
        self.system, self.table, self.contact = system, table, contact
        self.reuses, self.drives = reuses, drives
        self.registers, self.steps_back = table.scheme.registers, table.scheme.steps_back
        self.exact = contact.any and system.count <= _EXACT and not table.implicit
        self.coefficients = table.coefficients.astype(
            np.float64 if backend.current().precision == "f64" else np.float32
        )
        self.layout = {"z": 6, "f": 3, "a": 3, "u": 3} | ({"e": 1} if system.tallies else {})
        self.recorder, self.records = record, record is not None
        # What nobody reads is not written: the state a step began with, the part v of a slope.
        self.moves = bool({_COMBINE, SOLVE} & table.kinds)
        self.remembers = self.moves or _DIFFERENCE in table.kinds or contact.any

    @ti.kernel
    def run(
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
        due: ti.i32,
        row: ti.i32,
        state: ti.types.ndarray(ndim=4),
        energy: ti.types.ndarray(dtype=ti.f64, ndim=2),
        met_at: ti.types.ndarray(dtype=ti.f64, ndim=2),
        chosen: ti.types.ndarray(dtype=ti.i32, ndim=1),
    ) -> ti.types.vector(3, ti.i32):
        """Take `count` steps of `dt` from `t0` [s] on one thread.

        Return how many steps the past holds, whether k_0 is known, and how many vertices bounced.
        """
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
                    if ti.static(self.records):
                        if (events == 0) & self.recorder.wants(step, due):
                            slot = self._probed(starting, fresh, t, left, ops, edges)
                            fresh = ti.select(ti.static(self.table.probe < 0), 1, fresh)
                            self.recorder.row(row + (step - due) // self.recorder.every, slot, state, energy, chosen)
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
                                self._program(
                                    ti.select(ti.static(self.steps_back > 0), 1, 0),
                                    0,
                                    t,
                                    reached,
                                    dt,
                                    ops,
                                    edges,
                                    coefficients,
                                )
                            left -= reached
                            events += 1
                    met = self._finish_all(
                        t, reached, dt, hit < 1.0, step, dt - ti.select(hit < 1.0, left, 0.0), met_at
                    )
                    bounces += met
                    if ti.static(self.table.shifts):
                        self._shift_all(starting, ops, edges, coefficients, reached)
                    kept = (met == 0) & (hit >= 1.0)
                    held = ti.select(kept, ti.min(held + 1, self.steps_back), 0)
                    fresh = ti.select(kept, self.reuses, 0)
                    if hit >= 1.0:
                        left = 0.0
                if ti.static(self.drives):
                    self._place(step + 1, driven, paths)
        return ti.Vector([held, fresh, bounces])

    @ti.func
    def _program(
        self, starting, fresh, t, h, dt, ops: ti.template(), edges: ti.template(), coefficients: ti.template()
    ):
        """Run the scheme's program, or its starter's, on all blocks, and remember the state it began with."""
        op, last, begin = edges[0] + fresh, edges[1], 1
        if starting > 0:
            op, last = edges[1] + fresh, edges[2]
        while (op < last) | (begin > 0):
            end = op
            while self._alone(end, last, ops):
                end += 1
            if (end > op) | (begin > 0):
                for block in range(self.system.blocks):
                    self._move(block, begin, op, end, h, ops, coefficients)
                begin = 0
            if end < last:
                for block in range(self.system.blocks):
                    self._evaluate(block, ops[end, 1], t + coefficients[end, 0] * h, h)
            op = end + 1

    @ti.func
    def _alone(self, op, last, ops: ti.template()):
        """Return whether `op` is one that looks at nothing but a vertex itself."""
        result = False
        if op < last:
            result = ops[op, 0] != EVALUATE
        return result

    @ti.func
    def _probed(self, starting, fresh, t, h, ops: ti.template(), edges: ti.template()):
        """Return the register with the slope at the beginning of a step, which is worked out if it is not known."""
        slot = ti.select(ti.static(self.table.probe < 0), ops[edges[starting], 1], ti.static(self.table.probe))
        if ti.static(self.table.probe >= 0) or fresh == 0:
            for block in range(self.system.blocks):
                self._evaluate(block, slot, t, h)
        return slot

    @ti.func
    def _finish_all(self, t, h, dt, at_contact, step, after, met_at: ti.template()):
        """What ends a step: contacts and tears. Return how many vertices bounced."""
        met = 0
        if ti.static(self.contact.any):
            for i in range(self.system.count):
                before = ti.Vector([self.system.z[3 + d][i] for d in ti.static(range(3))])
                bounced = self._touch(i, t, h, dt, at_contact)
                if ti.static(self.records):
                    self.recorder.bounce(bounced, step, after, i, before, met_at)
                met += bounced
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
    def _shift_all(self, starting, ops: ti.template(), edges: ti.template(), coefficients: ti.template(), h):
        for block in range(self.system.blocks):
            self._move(block, 0, edges[2 + starting], edges[3 + starting], h, ops, coefficients)

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
                if ti.static(self.moves):
                    self.system.k[d][i] = b.z[3 + d][lane]
                self.system.k[3 + d][i] = b.a[d][lane]
            if ti.static(self.system.tallies):
                self.system.k[6][i] = b.e[lane]

    @ti.func
    def _move(self, block, begin, first, last, h, ops: ti.template(), coefficients: ti.template()):
        """Run ops first..last-1, which look at nothing but a vertex itself; `begin` a step before them."""
        lanes, away = ti.static(self.system.lanes, self.system.padded)
        vectors = [ti.Vector([0.0] * lanes) for _ in range(6)]
        b = ti.static([Block({"z": 6}, vectors, [], self.system.lanes)])[0]
        i = block * lanes
        for lane in range(lanes):
            for d in ti.static(range(6)):
                b.z[d][lane] = self.system.z[d][i + lane]
        if ti.static(self.remembers):
            if begin > 0:
                for lane in range(lanes):
                    for d in ti.static(range(6)):
                        self.system.z0[d][i + lane] = b.z[d][lane]
        for op in range(first, last):
            kind = ops[op, 0]
            if ti.static(_COMBINE in self.table.kinds):
                if kind == _COMBINE:
                    for lane in range(lanes):
                        for d in ti.static(range(6)):
                            b.z[d][lane] = self.system.z0[d][i + lane]
                    self._add(b, i, op, h, ti.static(range(6)), coefficients)
            if ti.static(_KICK in self.table.kinds):
                if kind == _KICK:
                    self._add(b, i, op, h, ti.static(range(3, 6)), coefficients)
            if ti.static(_DRIFT in self.table.kinds):
                if kind == _DRIFT:
                    for lane in range(lanes):
                        for d in ti.static(range(3)):
                            b.z[d][lane] += h * coefficients[op, 1] * b.z[3 + d][lane]
            if ti.static(_ROTATE in self.table.kinds):
                if kind == _ROTATE:
                    for lane in range(lanes):
                        for d in ti.static(range(len(self.system.k))):
                            self.system.k[d][ops[op, 1] * away + i + lane] = self.system.k[d][
                                ops[op, 2] * away + i + lane
                            ]
            if ti.static(_DIFFERENCE in self.table.kinds):
                if kind == _DIFFERENCE:
                    for lane in range(lanes):
                        for d in ti.static(range(6)):
                            off = b.z[d][lane] - self.system.z0[d][i + lane]
                            self.system.k[d][ops[op, 1] * away + i + lane] = off / h
        for lane in range(lanes):
            for d in ti.static(range(6)):
                self.system.z[d][i + lane] = b.z[d][lane]

    @ti.func
    def _add(self, b: ti.template(), i, op, h, components: ti.template(), coefficients: ti.template()):
        """z += h sum_j w_j k_j, in some components."""
        for j in range(ti.static(self.registers)):
            w = coefficients[op, 1 + j] * h
            if w != 0.0:
                for lane in range(b.lanes):
                    for d in ti.static(components):
                        b.z[d][lane] += w * self.system.k[d][j * self.system.padded + i + lane]

    @ti.kernel
    def sweep(
        self,
        begin: ti.i32,
        first: ti.i32,
        last: ti.i32,
        h: float,
        ops: ti.types.ndarray(dtype=ti.i32, ndim=2),
        coefficients: ti.types.ndarray(ndim=2),
        values: ti.types.ndarray(ndim=1),
    ):
        """Run ops that look at nothing but a vertex itself, first..last-1, on all blocks; `begin` a step before it."""
        for block in range(self.system.blocks):
            self._move(block, begin, first, last, h, ops, coefficients)

    @ti.kernel
    def evaluate(self, slot: ti.i32, t: float, h: float, values: ti.types.ndarray(ndim=1)):
        """Put f(t, z) into register `slot`."""
        ti.static(self.system.parameters.read_from(values))
        for block in range(self.system.blocks):
            self._evaluate(block, slot, t, h)

    @ti.kernel
    def finish(
        self, t: float, h: float, values: ti.types.ndarray(ndim=1), after: float, met_at: ti.types.ndarray(ndim=2)
    ) -> ti.i32:
        """End a step: contacts and tears. Return how many vertices bounced."""
        ti.static(self.system.parameters.read_from(values))
        return self._finish_all(t, h, h, False, 0, after, met_at)

    @ti.kernel
    def aim(self, h: float, driven: ti.types.ndarray(dtype=ti.i32, ndim=1), paths: ti.types.ndarray(ndim=3)):
        """Give driven vertices the velocity that takes them along their path in a step."""
        for _ in range(1):
            self._aim(0, h, driven, paths)

    @ti.kernel
    def place(self, driven: ti.types.ndarray(dtype=ti.i32, ndim=1), paths: ti.types.ndarray(ndim=3)):
        """Put driven vertices where their path is at the end of the step."""
        for _ in range(1):
            self._place(1, driven, paths)

    def outside(self, x: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        """Return the accelerations beside the springs [m/s^2], (n, 3), with the vertices at `x` and `v`, (n, 3) each."""
        kind = self.coefficients.dtype
        a = np.zeros((self.system.count, 3), kind)
        self._outside(*(np.ascontiguousarray(array, kind) for array in (x, v)), a, t, self.system.parameters.array)
        return a

    @ti.kernel
    def _outside(
        self,
        x: ti.types.ndarray(ndim=2),
        v: ti.types.ndarray(ndim=2),
        a: ti.types.ndarray(ndim=2),
        t: float,
        values: ti.types.ndarray(ndim=1),
    ):
        ti.static(self.system.parameters.read_from(values))
        for block in range(self.system.blocks):
            vectors = [ti.Vector([0.0] * self.system.lanes) for _ in range(ti.static(sum(self.layout.values())))]
            b = ti.static([Block(self.layout, vectors, [], self.system.lanes)])[0]
            for lane in range(self.system.lanes):
                i = ti.min(block * self.system.lanes + lane, self.system.count - 1)
                for d in ti.static(range(3)):
                    b.z[d][lane], b.z[3 + d][lane] = x[i, d], v[i, d]
            self.system.push(b, t)
            for lane in range(self.system.lanes):
                i = block * self.system.lanes + lane
                if i < self.system.count:
                    for d in ti.static(range(3)):
                        a[i, d] = b.a[d][lane]

    @ti.kernel
    def back(self):
        """Undo a step."""
        for block in range(self.system.blocks):
            for lane in range(self.system.lanes):
                for d in ti.static(range(6)):
                    self.system.z[d][block * self.system.lanes + lane] = self.system.z0[d][
                        block * self.system.lanes + lane
                    ]

    @ti.kernel
    def put(self, slot: ti.i32, x: ti.types.ndarray(ndim=2), v: ti.types.ndarray(ndim=2), a: ti.types.ndarray(ndim=2)):
        """Set the state, and the slope (v, a) in register `slot`."""
        for i in range(self.system.count):
            for d in ti.static(range(3)):
                self.system.z[d][i] = x[i, d]
                self.system.z[3 + d][i] = v[i, d]
                self.system.k[d][slot * self.system.padded + i] = v[i, d]
                self.system.k[3 + d][slot * self.system.padded + i] = a[i, d]
