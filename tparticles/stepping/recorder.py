"""What a mesh does, step by step, copied out while it runs: states, slopes, energies and contacts, into memory of a sink.

A row is the state at the beginning of a step with the slope there, which the scheme works out anyhow where its program begins with
it: then recording costs a copy. Where it does not, a slope is evaluated for the row alone.
"""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false

from typing import Any

import numpy as np
import taichi as ti

from .. import backend
from ..hints import NO_WRAP
from ..systems.spring_mesh import SpringMesh
from .block import Block
from .rows import ENERGIES, Request, Rows, Sink

# What kernels take where nothing is recorded.
UNRECORDED = (0, 0, np.zeros(1, np.float32), np.zeros((1, 3)), np.zeros((1, 12)), np.zeros(1, np.int32))
_LAYOUT = {"s": 9, "e": 3}  # x, v, a, and the energies of a block


@ti.data_oriented
class Recorder:
    """Records a mesh while a stepper advances it. Nothing is recorded until there is a `sink`.

    Arguments:
        system: the mesh, which tallies energies.
        request: what to record.
        gravity: the field that the energy of position is taken in [m/s^2], (3,).
    """

    def __init__(self, system: SpringMesh, request: Request, *, gravity: np.ndarray):
        self.system = system
        self.every = request.every
        self.whole = request.ids is None
        self.chosen = (
            np.arange(system.count, dtype=np.int32) if request.ids is None else np.asarray(request.ids, np.int32)
        )
        self.kind = np.float64 if backend.current().precision == "f64" else np.float32
        self.gravity = tuple(map(float, gravity))
        self.mass = ti.field(system.real, system.padded)
        mass = np.zeros(system.padded, self.kind)
        mass[: system.count] = system.mesh.mass
        self.mass.from_numpy(mass)
        self.parts = np.zeros((system.blocks, len(ENERGIES)))
        self.sink: Sink | None = None
        self.rows: Rows | None = None
        self.step, self.due, self.given = 0, 0, 0  # steps taken, steps until the next row, rows given away
        self._met = 0  # contacts in the present rows

    @property
    def room(self) -> int:
        """How many steps can be recorded before other memory is needed."""
        rows = self._open()
        return self.due + self.every * (len(rows.step) - rows.filled)

    def claim(self) -> tuple[Any, ...]:
        """Return what kernels take: steps before the next row, its place, the memory, the recorded vertices."""
        rows = self._open()
        return self.due, rows.filled, rows.state.reshape(-1), rows.energy, rows.events, self.chosen

    def took(self, t: float, h: float, count: int) -> None:
        """Note that `count` steps of `h` from `t` [s] were taken, `room` at most, with what was claimed."""
        rows = self.rows
        assert rows is not None
        steps = np.arange(self.due, count, self.every)
        self._note(rows, self.step + steps, t + steps * h, h)
        new = rows.events[1 + self._met : 1 + self._held(rows)]
        new[:, 1] += t + new[:, 0] * h
        new[:, 0] += self.step
        self._met = self._held(rows)
        self.due += len(steps) * self.every - count
        self.step += count

    @property
    def met_at(self) -> np.ndarray:
        """Memory for contacts."""
        return self._open().events

    def end(self, t: float) -> None:
        """Note that the state at `t` [s] after the last step was recorded."""
        rows = self.rows
        assert rows is not None
        self._note(rows, np.array([self.step]), np.array([t]), 0.0)

    def hand_over(self) -> None:
        """Give the rows away that there are."""
        if self.rows is not None and self.sink is not None:
            self.given += self.rows.filled
            self.sink.give(self.rows)
            self.rows = None

    def mark(self) -> tuple[int, int, int]:
        """Return where the record stands, for `rewind`."""
        return self.given + (self.rows.filled if self.rows else 0), self.step, self.due

    def rewind(self, mark: tuple[int, int, int], time: float) -> None:
        """Forget what was recorded since `mark`, which was at `time` [s]."""
        self.hand_over()
        self.given, self.step, self.due = mark
        if self.sink is not None:
            self.sink.rewind(self.given, time)

    def _open(self) -> Rows:
        assert self.sink is not None
        rows = self.rows
        if rows is not None and (rows.filled == len(rows.step) or 2 * self._held(rows) > len(rows.events)):
            self.hand_over()
        if self.rows is None:
            self.rows, self._met = self.sink.take(), 0
        return self.rows

    def _held(self, rows: Rows) -> int:
        """Return how many contacts there are in `rows`."""
        return min(int(rows.events[0, 0]), len(rows.events) - 1)

    def _note(self, rows: Rows, steps: np.ndarray, times: np.ndarray, h: float) -> None:
        place = slice(rows.filled, rows.filled + len(steps))
        rows.step[place], rows.time[place], rows.dt[place] = steps, times, h
        rows.filled += len(steps)

    @ti.func
    def row(self, n, slot, state: ti.template(), energy: ti.template(), chosen: ti.template()):
        """Record the present state with the slope in register `slot` as row `n`, on one thread."""
        total = ti.Vector([0.0, 0.0, 0.0], ti.f64)
        for block in range(self.system.blocks):
            total += self._block(block, n, energy.shape[0], slot, state)
        self._pick(n, energy.shape[0], slot, state, chosen)
        for e in ti.static(range(3)):
            energy[n, e] = total[e]

    def record(self, slot: int) -> None:
        """Do as `row` for the next row, from the host."""
        rows = self._open()
        row = np.empty_like(rows.state[:, :1])  # a kernel takes its arrays to a GPU and back: no more than the row
        self._record(slot, row.reshape(-1), self.parts, self.chosen)
        rows.state[:, rows.filled], rows.energy[rows.filled] = row[:, 0], self.parts.sum(axis=0)

    @ti.kernel
    def _record(
        self,
        slot: ti.i32,
        state: ti.types.ndarray(ndim=1),
        parts: ti.types.ndarray(dtype=ti.f64, ndim=2),
        chosen: ti.types.ndarray(dtype=ti.i32, ndim=1),
    ):
        for block in range(self.system.blocks):
            total = self._block(block, 0, 1, slot, state)
            for e in ti.static(range(3)):
                parts[block, e] = total[e]
        for _ in range(1):
            self._pick(0, 1, slot, state, chosen)

    @ti.func
    def wants(self, step, due):
        """Return whether the step of this number in a launch is recorded."""
        return (step >= due) & ((step - due) % self.every == 0)

    @ti.func
    def bounce(self, bounced, step, after, i, before, events: ti.template()):
        """Note, where vertex `i` has `bounced`, that it did `after` seconds in a step, and its velocity `before`."""
        if bounced > 0:
            at = ti.cast(ti.atomic_add(events[0, 0], 1.0), ti.i32) + 1
            if at < events.shape[0]:
                events[at, 0], events[at, 1], events[at, 2] = step, after, i
                for d in ti.static(range(3)):
                    events[at, 3 + d] = self.system.z[d][i]
                    events[at, 6 + d] = before[d]
                    events[at, 9 + d] = self.system.z[3 + d][i]

    @ti.func
    def _block(self, block, n, rows, slot, state: ti.template()):
        """Copy a block of vertices into row `n`; return its energies."""
        lanes = ti.static(self.system.lanes)
        first = block * lanes
        away = slot * self.system.padded + first
        # through local vectors: a store into the row might change a field, for all that the compiler knows
        vectors = [ti.Vector([0.0] * lanes) for _ in range(ti.static(sum(_LAYOUT.values())))]
        b = ti.static([Block(_LAYOUT, vectors, [], self.system.lanes)])[0]
        for lane in range(lanes):
            for d in ti.static(range(3)):
                b.s[d][lane] = self.system.z[d][first + lane]
                b.s[3 + d][lane] = self.system.z[3 + d][first + lane]
                b.s[6 + d][lane] = self.system.k[3 + d][away + lane]
            b.e[1][lane] = self.system.k[6][away + lane]
            m = self.mass[first + lane]
            for d in ti.static(range(3)):
                b.e[0][lane] += 0.5 * m * b.s[3 + d][lane] * b.s[3 + d][lane]
                b.e[2][lane] -= m * ti.static(self.gravity[d]) * b.s[d][lane]
        if ti.static(self.whole):
            for c in ti.static(range(9)):
                to = ((((c // 3) * rows + n) * 3 + c % 3) * self.system.count + first) & NO_WRAP
                if first + lanes <= self.system.count:  # a fixed number of lanes is copied twice as fast
                    for lane in range(lanes):
                        state[to + lane] = b.s[c][lane]
                else:
                    for lane in range(self.system.count - first):
                        state[to + lane] = b.s[c][lane]
        total = ti.Vector([0.0, 0.0, 0.0], ti.f64)
        for e in ti.static(range(3)):
            part = ti.cast(0.0, float)
            for lane in range(lanes):
                part += b.e[e][lane]
            total[e] = part
        return total

    @ti.func
    def _pick(self, n, rows, slot, state: ti.template(), chosen: ti.template()):
        if ti.static(not self.whole):
            for j in range(chosen.shape[0]):
                i = chosen[j]
                for d in ti.static(range(3)):
                    to, away = (3 * n + d) * chosen.shape[0] + j, 3 * rows * chosen.shape[0]
                    state[to] = self.system.z[d][i]
                    state[to + away] = self.system.z[3 + d][i]
                    state[to + 2 * away] = self.system.k[3 + d][slot * self.system.padded + i]
