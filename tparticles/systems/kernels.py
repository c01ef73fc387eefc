"""Kernels of a population: sampling newborns, and compaction."""

# pyright: reportInvalidTypeForm=false

import taichi as ti

from .. import backend
from ..binding import Parameters
from ..physics.emitters import (
    DRAW_LIFETIME,
    DRAW_POSITION,
    DRAW_SIZE,
    DRAW_TEMPERATURE,
    DRAW_VELOCITY,
    Births,
    Emitter,
)
from .attributes import Columns

_CHUNK = 1024  # slots that one GPU thread scans
_GRAIN = 512  # iterations that make one CPU task


@ti.data_oriented
class EmitKernel:
    """Samples the newborns of one emitter into free slots; every value is a function of (key, id) alone."""

    def __init__(self, emitter: Emitter, columns: Columns, *, key: int, index: int, of: int):
        self.columns, self.key, self.index, self.of = columns, key, index, of
        self.has = {name: getattr(emitter, name) is not None for name in ("velocity", "temperature", "lifetime")}
        self.parameters = Parameters()
        self.emitter = self.parameters.bind(emitter, skip=("births", "start", "stop", "preroll"))

    def emit(self, slot: int, births: Births) -> None:
        """Write the newborns into the slots from `slot` on."""
        self._emit(self.key, slot, births.first, births.times, self.parameters.array)

    @ti.kernel
    def _emit(
        self,
        key: ti.u32,
        slot: ti.i32,
        first: ti.i32,
        times: ti.types.ndarray(dtype=ti.f64, ndim=1),
        values: ti.types.ndarray(ndim=1),
    ):
        ti.static(self.parameters.read_from(values))
        for j in range(times.shape[0]):
            i = slot + j
            own = first + j  # the id inside the emitter keys the draws
            self.columns["id"][0][i] = own * self.of + self.index
            self.columns["birth"][0][i] = times[j]
            x = self.emitter.shape.sample(key, own, DRAW_POSITION)
            for d in ti.static(range(3)):
                self.columns["x"][d][i] = x[d]
            if ti.static("v" in self.columns):
                v = ti.Vector([0.0, 0.0, 0.0])
                if ti.static(self.has["velocity"]):
                    v = self.emitter.velocity.sample(key, own, DRAW_VELOCITY)
                for d in ti.static(range(3)):
                    self.columns["v"][d][i] = v[d]
            if ti.static(self.has["temperature"]):
                T = self.emitter.temperature.sample(key, own, DRAW_TEMPERATURE)
                for name in ti.static(("T", "T0")):
                    if ti.static(name in self.columns):
                        self.columns[name][0][i] = T
            if ti.static("size" in self.columns):
                self.columns["size"][0][i] = self.emitter.size.sample(key, own, DRAW_SIZE)
            if ti.static("lifetime" in self.columns):
                lifetime = ti.cast(ti.math.inf, float)
                if ti.static(self.has["lifetime"]):
                    lifetime = self.emitter.lifetime.sample(key, own, DRAW_LIFETIME)
                self.columns["lifetime"][0][i] = lifetime


@ti.data_oriented
class Compaction:
    """Stable compaction: survivors move to the front in their old order.

    On a GPU by a prefix sum over chunks of slots, through a scratch column. On a CPU each column is one task that moves its own
    survivors in place: half of the memory traffic, no scratch, and one launch instead of two for every column.
    `in_place` names the way; the backend's own by default.
    """

    def __init__(self, columns: Columns, dead, *, in_place: bool | None = None):
        self.columns, self.dead = columns, dead
        self.in_place = backend.current().is_cpu if in_place is None else in_place
        if not self.in_place:
            self.offsets = ti.field(ti.i32, columns.padded // _CHUNK + 2)
            self.scratch = {kind: ti.field(kind, columns.padded) for kind in {f.dtype for f in columns.all()}}

    def run(self, count: int) -> int:
        """Compact the first `count` slots; return how many survive."""
        if self.in_place:
            return self._squeeze(count)
        survivors = self._scan(count)
        if survivors < count:
            self._move(count)
        return survivors

    @ti.kernel
    def _squeeze(self, count: ti.i32) -> ti.i32:
        survivors = 0
        # A range of 512 is the least that Taichi gives a thread of its own.
        for task in range(ti.static(len(self.columns.all()) * _GRAIN)):
            if task % _GRAIN == 0:
                for column, field in ti.static(enumerate(self.columns.all())):
                    if task // _GRAIN == column:
                        to = 0
                        for i in range(count):
                            if self.dead[i] == 0:
                                field[to] = field[i]
                                to += 1
                        if ti.static(column == 0):
                            survivors = to
        return survivors

    @ti.kernel
    def _scan(self, count: ti.i32) -> ti.i32:
        chunks = (count + _CHUNK - 1) // _CHUNK
        for c in range(chunks):
            survivors = 0
            for i in range(c * _CHUNK, ti.min(count, (c + 1) * _CHUNK)):
                survivors += 1 - self.dead[i]
            self.offsets[c] = survivors
        total = 0
        ti.loop_config(serialize=True)
        for c in range(chunks):
            survivors = self.offsets[c]
            self.offsets[c] = total
            total += survivors
        return total

    @ti.kernel
    def _move(self, count: ti.i32):
        for field in ti.static(self.columns.all()):
            for i in range(count):
                self.scratch[field.dtype][i] = field[i]
            for c in range((count + _CHUNK - 1) // _CHUNK):
                to = self.offsets[c]
                for i in range(c * _CHUNK, ti.min(count, (c + 1) * _CHUNK)):
                    if self.dead[i] == 0:
                        field[to] = self.scratch[field.dtype][i]
                        to += 1
