"""The passes of a scheme over a mesh on the device: in one launch for many steps, or a launch for each."""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false
# pyright: reportCallIssue=false, reportOptionalMemberAccess=false

import numpy as np
import taichi as ti

from .. import backend
from ..hints import rolled
from ..schemes import OpKind
from ..systems.spring_mesh import SpringMesh
from .block import Block
from .block_passes import LAYOUT, TURNS, BlockPasses
from .contact import Contact
from .recorder import Recorder
from .table import Table

SOLVE = int(OpKind.SOLVE)

# Vertices: up to here the whole mesh goes back to the moment of a contact. Of more of them some touch in nearly every step, and
# splittings gain energy by steps that are cut again and again.
EXACT = 16
_EVENTS = 32  # contacts in a step before they are resolved vertex by vertex
_CHUNKS = 16  # of a mesh for each thread: loops within one are quicker than a call for every block of it


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
        self.edges = [int(edge) for edge in table.edges]
        self.per_block = BlockPasses(system, table, contact)
        self.steps_back = table.scheme.steps_back
        self.exact = contact.any and system.count <= EXACT and not table.implicit
        self.kind = np.float64 if backend.current().precision == "f64" else np.float32
        cpu = backend.current().is_cpu
        self.width = max(1, system.blocks // (_CHUNKS * backend.current().threads)) if cpu else 1
        self.chunks = -(-system.blocks // self.width)
        self.grain = backend.GRAIN if cpu else 1  # what a CPU thread gets at least; all but the first are idle
        self.recorder, self.records = record, record is not None

    @ti.kernel
    def pass_over(
        self,
        passes: ti.types.ndarray(dtype=ti.i32, ndim=2),
        n: ti.i32,
        page: ti.i32,
        t: ti.f64,
        h: float,
        values: ti.types.ndarray(ndim=1),
    ):
        """Do pass `n` of a step of `h` from `t` [s], from `page` of the state."""
        ti.static(self.system.parameters.read_from(values))
        if ti.static(self.system.repels):
            for _ in range(1):
                self.system.meet(page)
        for task in range(self.chunks * self.grain):
            if task % self.grain == 0:
                chunk = task // self.grain
                for block in range(chunk * self.width, ti.min((chunk + 1) * self.width, self.system.blocks)):
                    self.per_block.take(block, page, passes, n, ti.cast(t, float), h)

    @ti.kernel
    def walk(
        self,
        t0: ti.f64,
        h: ti.f64,
        passes: ti.types.ndarray(dtype=ti.i32, ndim=2),
        steps: ti.types.ndarray(dtype=ti.i32, ndim=2),
        values: ti.types.ndarray(ndim=1),
    ):
        """Take steps of `h` from `t0` [s] that nothing comes between, on one thread.

        `steps`, (m, 3): so many times, the passes from here, to there.
        """
        ti.static(self.system.parameters.read_from(values))
        ti.loop_config(serialize=True)
        for _ in range(1):
            page, step, dt = 0, 0, ti.cast(h, float)
            for kind in range(steps.shape[0]):
                for _again in range(steps[kind, 0]):
                    t = ti.cast(t0 + step * h, float)
                    page = self._passes(page, passes, steps[kind, 1], steps[kind, 2], t, dt)
                    step += 1
            self._turn_all(page)

    @ti.kernel
    def run(
        self,
        t0: ti.f64,
        h: ti.f64,
        count: ti.i32,
        held0: ti.i32,
        fresh0: ti.i32,
        passes: ti.types.ndarray(dtype=ti.i32, ndim=2),
        edges: ti.types.ndarray(dtype=ti.i32, ndim=1),
        driven: ti.types.ndarray(dtype=ti.i32, ndim=1),
        paths: ti.types.ndarray(ndim=3),
        values: ti.types.ndarray(ndim=1),
        ends: ti.i32,
        due: ti.i32,
        row: ti.i32,
        state: ti.types.ndarray(ndim=1),
        energy: ti.types.ndarray(dtype=ti.f64, ndim=2),
        met_at: ti.types.ndarray(dtype=ti.f64, ndim=2),
        chosen: ti.types.ndarray(dtype=ti.i32, ndim=1),
    ) -> ti.types.vector(3, ti.i32):
        """Take `count` steps of `h` from `t0` [s] with what comes between them, on one thread.

        `ends`: 1 to record where the last one leads to. Return how many steps the past holds, whether k_0 is known, and how many
        vertices bounced.
        """
        ti.static(self.system.parameters.read_from(values))
        held, fresh, bounces = held0, fresh0, 0
        ti.loop_config(serialize=True)
        for _ in range(1):
            for step in range(count + ends):
                dt = ti.cast(h, float)
                left, events = dt, 0
                if ti.static(self.drives):
                    self._aim(step, dt, driven, paths)
                while left > 0.0:
                    t = ti.cast(t0 + step * h, float) + (dt - left)
                    starting = ti.select(held < self.steps_back, 1, 0)
                    if ti.static(self.records):
                        if (events == 0) & self.recorder.wants(step, due):
                            slot = self._probed(starting, fresh, t, left)
                            fresh = ti.select(ti.static(self.table.probe < 0), 1, fresh)
                            self.recorder.row(row + (step - due) // self.recorder.every, slot, state, energy, chosen)
                        if step == count:
                            break
                    self._program(2 * starting + fresh, t, left, passes, edges)
                    reached, hit = left, ti.cast(2.0, float)
                    if ti.static(self.exact):
                        if events < _EVENTS:
                            for i in range(self.system.count):
                                hit = ti.min(hit, self.contact.entry(i, t, left))
                        if hit < 1.0:
                            # Go back, and step to the moment of the first contact.
                            reached = hit * left
                            for i in range(self.system.padded):
                                rolled(self.system.starts)
                                for d in ti.static(range(6)):
                                    self.system.z[d][i] = self.system.z0[d][i]
                            if reached > 0.0:
                                starter = ti.select(ti.static(self.steps_back > 0), 2, 0)
                                self._program(starter, t, reached, passes, edges)
                            left -= reached
                            events += 1
                    met = self._finish_all(
                        t, reached, dt, hit < 1.0, step, dt - ti.select(hit < 1.0, left, 0.0), met_at
                    )
                    bounces += met
                    if ti.static(self.table.shifts):
                        for block in range(self.system.blocks):
                            self.per_block.end(block, starting, reached)
                    kept = (met == 0) & (hit >= 1.0)
                    held = ti.select(kept, ti.min(held + 1, self.steps_back), 0)
                    fresh = ti.select(kept, self.reuses, 0)
                    if hit >= 1.0:
                        left = 0.0
                if ti.static(self.drives):
                    if step < count:
                        self._place(step + 1, driven, paths)
        return ti.Vector([held, fresh, bounces])

    @ti.func
    def _program(self, variant, t, h, passes: ti.template(), edges: ti.template()):
        """Run one of the programs in `Passes.programs`, from the first page of the state to the first page."""
        self._turn_all(self._passes(0, passes, edges[variant], edges[variant + 1], t, h))

    @ti.func
    def _passes(self, page0, passes: ti.template(), first, last, t, h):
        """Do passes first..last-1 on one thread; return the page that the state is on."""
        page = page0
        for n in range(first, last):
            self.system.meet(page)
            for block in range(self.system.blocks):
                self.per_block.take(block, page, passes, n, t, h)
            page ^= passes[n, TURNS]
        return page

    @ti.func
    def _turn_all(self, page):
        if page > 0:
            for block in range(self.system.blocks):
                self.per_block.turn(block)

    @ti.func
    def _probed(self, starting, fresh, t, h):
        """Return the register with the slope at the beginning of a step, which is worked out if it is not known."""
        first = ti.select(starting > 0, ti.static(self.edges[1]), ti.static(self.edges[0]))
        slot = ti.select(ti.static(self.table.probe < 0), self.per_block.ops[first, 1], ti.static(self.table.probe))
        if ti.static(self.table.probe >= 0) or fresh == 0:
            self.system.meet(0)
            for block in range(self.system.blocks):
                self.per_block.evaluate(block, slot, t, h)
        return slot

    @ti.func
    def _finish_all(self, t, h, dt, at_contact, step, after, met_at: ti.template()):
        """What ends a step: contacts and tears. Return how many vertices bounced."""
        met = 0
        if ti.static(self.contact.any):
            for block in range(self.system.blocks):
                if self.contact.near(block, t + h):
                    first = block * self.system.lanes
                    for i in range(first, ti.min(first + self.system.lanes, self.system.count)):
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
        if ti.static(self.table.implicit):
            met = self.contact.stop(i, t + h)
        elif ti.static(self.exact):
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

    @ti.kernel
    def end(self, starting: ti.i32, h: float):
        """Run what ends a step, on all vertices."""
        for block in range(self.system.blocks):
            self.per_block.end(block, starting, h)

    @ti.kernel
    def turn(self):
        """Copy the state from the second page to the first."""
        for block in range(self.system.blocks):
            self.per_block.turn(block)

    @ti.kernel
    def evaluate(self, slot: ti.i32, t: float, h: float, values: ti.types.ndarray(ndim=1)):
        """Put f(t, z) into register `slot`."""
        ti.static(self.system.parameters.read_from(values))
        if ti.static(self.system.repels):
            for _ in range(1):
                self.system.meet(0)
        for block in range(self.system.blocks):
            self.per_block.evaluate(block, slot, t, h)

    @ti.kernel
    def finish(
        self,
        page: ti.i32,
        t: float,
        h: float,
        values: ti.types.ndarray(ndim=1),
        after: float,
        met_at: ti.types.ndarray(ndim=2),
    ) -> ti.i32:
        """End a step that has led to `page` of the state: contacts and tears. Return how many vertices bounced."""
        ti.static(self.system.parameters.read_from(values))
        for block in range(page * self.system.blocks):
            self.per_block.turn(block)
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
        kind = self.kind
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
            vectors = [ti.Vector([0.0] * self.system.lanes) for _ in range(ti.static(sum(LAYOUT.values())))]
            b = ti.static([Block(LAYOUT, vectors, [], self.system.lanes)])[0]
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
                rolled(self.system.starts)
                i = block * self.system.lanes + lane
                for d in ti.static(range(6)):
                    self.system.z[d][i] = self.system.z0[d][i]

    @ti.kernel
    def put(self, slot: ti.i32, x: ti.types.ndarray(ndim=2), v: ti.types.ndarray(ndim=2), a: ti.types.ndarray(ndim=2)):
        """Set the state, and the slope (v, a) in register `slot`."""
        for i in range(self.system.count):
            rolled(self.system.starts)
            for d in ti.static(range(3)):
                self.system.z[d][i] = x[i, d]
                self.system.z[3 + d][i] = v[i, d]
                self.system.k[d][slot * self.system.padded + i] = v[i, d]
                self.system.k[3 + d][slot * self.system.padded + i] = a[i, d]
