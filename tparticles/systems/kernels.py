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
    """Stable compaction: survivors move to the front in their old order, by a prefix sum over chunks of slots."""

    def __init__(self, columns: Columns, dead):
        self.columns, self.dead = columns, dead
        # On a CPU a range is cut into one piece per thread from 512 iterations on: many small chunks.
        self.chunk = 256 if backend.current().is_cpu else 1024
        self.offsets = ti.field(ti.i32, columns.padded // self.chunk + 2)
        self.scratch = {kind: ti.field(kind, columns.padded) for kind in {f.dtype for f in columns.all()}}

    def run(self, count: int) -> int:
        """Compact the first `count` slots; return how many survive."""
        survivors = self._scan(count)
        if survivors < count:
            self._move(count)
        return survivors

    @ti.kernel
    def _scan(self, count: ti.i32) -> ti.i32:
        chunks = (count + self.chunk - 1) // self.chunk
        for c in range(chunks):
            survivors = 0
            for i in range(c * self.chunk, ti.min(count, (c + 1) * self.chunk)):
                survivors += 1 - self.dead[i]
            self.offsets[c] = survivors
        total = 0
        ti.loop_config(serialize=True)
        for c in range(chunks):
            survivors = self.offsets[c]
            self.offsets[c] = total
            total += survivors
        self.offsets[chunks] = total
        return total

    @ti.kernel
    def _move(self, count: ti.i32):
        for field in ti.static(self.columns.all()):
            for i in range(count):
                self.scratch[field.dtype][i] = field[i]
            for c in range((count + self.chunk - 1) // self.chunk):
                begin, end = c * self.chunk, ti.min(count, (c + 1) * self.chunk)
                to = self.offsets[c]
                if self.offsets[c + 1] - to == end - begin:  # nobody died here: a plain copy, many times as fast
                    for i in range(begin, end):
                        field[to - begin + i] = self.scratch[field.dtype][i]
                else:
                    for i in range(begin, end):
                        if self.dead[i] == 0:
                            field[to] = self.scratch[field.dtype][i]
                            to += 1
