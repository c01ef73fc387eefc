"""Kernels of a population: sampling newborns, and compaction."""

# pyright: reportInvalidTypeForm=false

import taichi as ti

from .. import backend
from ..binding import Parameters
from ..hints import rolled
from ..physics.emitters import (
    DRAW_LIFETIME,
    DRAW_POSITION,
    DRAW_SIZE,
    DRAW_TEMPERATURE,
    DRAW_TIME,
    DRAW_VELOCITY,
    Births,
    Emitter,
)
from ..rng import device_bits, device_stream
from .attributes import Columns

_CHUNK = 1024  # slots that one GPU thread scans
_GRAIN = 512  # iterations that make one CPU task
_RUN = 8  # blocks that are moved at once where nobody is dead
FEW = 1 << 16  # slots up to which quick code is not worth the time that it takes to compile


@ti.data_oriented
class EmitKernel:
    """Samples the newborns of one emitter into free slots; every value is a function of (key, id) alone."""

    def __init__(self, emitter: Emitter, columns: Columns, *, key: int, index: int, of: int):
        self.columns, self.key, self.index, self.of = columns, key, index, of
        self.has = {name: getattr(emitter, name) is not None for name in ("velocity", "temperature", "lifetime")}
        self.serial = backend.current().in_one_thread(columns.padded)
        self.parameters = Parameters()
        self.emitter = self.parameters.bind(emitter, skip=("births", "start", "stop", "preroll"))

    def emit(self, slot: int, births: Births, first: int, count: int, stride: int) -> None:
        """Write `count` of the newborns into the slots from `slot` on: `first`, first + stride, ... by their own ids."""
        self._emit(self.key, self.columns.first + slot, first, count, stride, births.spans, 0, self.parameters.array)

    @ti.kernel
    def _emit(
        self,
        key: ti.u32,
        slot: ti.i32,
        first: ti.i32,
        count: ti.i32,
        stride: ti.i32,
        spans: ti.types.ndarray(dtype=ti.f64, ndim=2),
        zero: ti.i64,
        values: ti.types.ndarray(ndim=1),
    ):
        ti.static(self.parameters.read_from(values))
        ti.loop_config(serialize=ti.static(self.serial))
        for j in range(count):
            i = slot + j
            own = first + j * stride  # the id inside the emitter keys the draws
            stream = device_stream(key, own)
            self.columns["id"][0][i] = own * self.of + self.index
            self.columns["birth"][0][i] = self._birth(spans, own, stream, zero)
            x = self.emitter.shape.sample(stream, DRAW_POSITION)
            for d in ti.static(range(3)):
                self.columns["x"][d][i] = x[d]
            if ti.static("v" in self.columns):
                v = ti.Vector([0.0, 0.0, 0.0])
                if ti.static(self.has["velocity"]):
                    v = self.emitter.velocity.sample(stream, DRAW_VELOCITY)
                for d in ti.static(range(3)):
                    self.columns["v"][d][i] = v[d]
            if ti.static(self.has["temperature"]):
                T = self.emitter.temperature.sample(stream, DRAW_TEMPERATURE)
                for name in ti.static(("T", "T0")):
                    if ti.static(name in self.columns):
                        self.columns[name][0][i] = T
            if ti.static("size" in self.columns):
                self.columns["size"][0][i] = self.emitter.size.sample(stream, DRAW_SIZE)
            if ti.static("lifetime" in self.columns):
                lifetime = ti.cast(ti.math.inf, float)
                if ti.static(self.has["lifetime"]):
                    lifetime = self.emitter.lifetime.sample(stream, DRAW_LIFETIME)
                self.columns["lifetime"][0][i] = lifetime

    @ti.func
    def _birth(self, spans: ti.template(), own, stream, zero):
        """Return the time of birth [s] of the newborn `own`, as `Births.times` has it; `zero` is 0, and no constant."""
        # the last interval whose first id is not after it
        low, high = 0, spans.shape[0] - 1
        while low < high:
            middle = (low + high + 1) // 2
            if spans[middle, 3] <= own:
                low = middle
            else:
                high = middle - 1
        # start + length ((j + u) / count), rounded after each operation
        u = (ti.cast(device_bits(stream, DRAW_TIME) >> 9, ti.f64) + 0.5) * ti.static(2.0**-23)
        j = own - ti.cast(spans[low, 3], ti.i32)
        share = _rounded(_rounded(j + u, zero) / spans[low, 2], zero)
        return spans[low, 0] + _rounded(spans[low, 1] * share, zero)


@ti.func
def _rounded(x, zero):
    """Return the f64 `x`; the optimiser cannot see through it, so it neither fuses nor reorders what is on both sides."""
    return ti.bit_cast(ti.bit_cast(x, ti.i64) ^ zero, ti.f64)


@ti.func
def lowest_bit(mask):
    """Return the number of the lowest bit that is set in `mask`, which is not 0 and below 2^31: its exponent as a float."""
    return (ti.bit_cast(ti.cast(mask & -mask, ti.f32), ti.i32) >> 23) - 127


@ti.data_oriented
class Compaction:
    """Stable compaction: survivors move to the front in their old order.

    On a GPU by a prefix sum over chunks of slots, through a scratch column. On a CPU each thread moves the survivors of its share
    of the columns in place: half of the memory traffic, no scratch, and one launch instead of two for every column.
    `dead` holds a bit for every slot of a block (see `Mortality`). `in_place` names the way; the backend's own by default.
    `divided`: whether several groups have their particles in the columns.
    """

    def __init__(self, columns: Columns, dead, *, in_place: bool | None = None, divided: bool = False):
        running = backend.current()
        self.columns, self.dead, self.lanes = columns, dead, columns.padded // dead.shape[0]
        self.divided = divided
        self.in_place = running.is_cpu if in_place is None else in_place
        self.in_runs = columns.padded > FEW
        if self.in_place:
            self.shares = _shares(columns.all(), running.threads if self.in_runs else 1)
            self.grain = _GRAIN if self.in_runs else 1
        else:
            self.offsets = ti.field(ti.i32, columns.padded // _CHUNK + 2)
            self.scratch = {kind: ti.field(kind, columns.padded) for kind in {f.dtype for f in columns.all()}}

    def run(self, count: int, first: int = 0) -> int:
        """Compact `count` slots from `first` on, which begins a lane block; return how many survive."""
        if self.in_place:
            return self._squeeze(first, count)
        survivors = self._scan(first, count)
        if survivors < count:
            self._move(first, count)
        return survivors

    @ti.kernel
    def _squeeze(self, first: ti.i32, count: ti.i32) -> ti.i32:
        survivors = 0
        # A range of 512 is the least that Taichi gives a thread of its own.
        ti.loop_config(serialize=ti.static(not self.in_runs))
        for task in range(ti.static(len(self.shares) * self.grain)):
            if task % self.grain == 0:
                for share, fields in ti.static(enumerate(self.shares)):
                    if task // self.grain == share:
                        to = self._squeeze_columns(first, count, fields)
                        if ti.static(share == 0):
                            survivors = to
        return survivors

    @ti.func
    def _squeeze_columns(self, first_slot, count, fields: ti.template()):
        """Move the survivors' values in `fields`, whole runs where nobody is dead; return how many there are."""
        lanes, width = ti.static(self.lanes, self.lanes * _RUN)
        to, base = 0, 0
        if ti.static(self.divided):
            base = first_slot
        marks = base // lanes
        for run in range((count + width - 1) // width):
            start, dead = run * width, 1
            if ti.static(self.in_runs):
                if start + width <= count:
                    dead = 0
                    for block in ti.static(range(_RUN)):
                        dead |= self.dead[marks + run * _RUN + block]
            if dead == 0:
                if to < start:
                    for slot in range(width):
                        for field in ti.static(fields):
                            field[base + to + slot] = field[base + start + slot]
                to += width
            else:
                for block in range(ti.min((count - start + lanes - 1) // lanes, _RUN)):
                    rolled(self.dead)
                    first = start + block * lanes
                    lives = ~self.dead[marks + run * _RUN + block] & ((1 << ti.min(count - first, lanes)) - 1)
                    while lives != 0:
                        i = first + lowest_bit(lives)
                        for field in ti.static(fields):
                            field[base + to] = field[base + i]
                        to += 1
                        lives &= lives - 1
        return to

    @ti.func
    def _lives(self, i):
        return 1 - ((self.dead[i // self.lanes] >> (i % self.lanes)) & 1)

    @ti.kernel
    def _scan(self, first: ti.i32, count: ti.i32) -> ti.i32:
        chunks = (count + _CHUNK - 1) // _CHUNK
        for c in range(chunks):
            survivors = 0
            for i in range(c * _CHUNK, ti.min(count, (c + 1) * _CHUNK)):
                survivors += self._lives(first + i)
            self.offsets[c] = survivors
        total = 0
        ti.loop_config(serialize=True)
        for c in range(chunks):
            survivors = self.offsets[c]
            self.offsets[c] = total
            total += survivors
        return total

    @ti.kernel
    def _move(self, first: ti.i32, count: ti.i32):
        for field in ti.static(self.columns.all()):
            for i in range(count):
                self.scratch[field.dtype][i] = field[first + i]
            for c in range((count + _CHUNK - 1) // _CHUNK):
                to = self.offsets[c]
                for i in range(c * _CHUNK, ti.min(count, (c + 1) * _CHUNK)):
                    if self._lives(first + i) == 1:
                        field[first + to] = self.scratch[field.dtype][i]
                        to += 1


def _shares(fields, threads: int) -> tuple:
    """Split the columns into as many parts as there are threads, about as many bytes in each."""
    shares: list[list] = [[] for _ in range(min(threads, len(fields)))]
    taken = [0] * len(shares)
    for field in sorted(fields, key=_width, reverse=True):
        lightest = taken.index(min(taken))
        shares[lightest].append(field)
        taken[lightest] += _width(field)
    return tuple(map(tuple, shares))


def _width(field) -> int:
    return 8 if field.dtype in (ti.f64, ti.i64) else 4
