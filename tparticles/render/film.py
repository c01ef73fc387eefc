"""The film: additive light in fixed point, and its development to 8-bit pixels.

A pixel channel is a sum of i64 multiples of 2^-24 of film white. Integer sums do not depend on the order of their terms,
so a frame has the same bits for any number of threads, any chunking of the dots and any split into shards (`merge`).

On a CPU the rows are cut into bands. A counting sort lists every dot in each band that it touches, then each band is
drawn by one thread, without atomics. On a GPU the pieces of all dots are numbered by a prefix sum, and each is a thread
that adds atomically. Same arithmetic, same sums.
"""
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false, reportArgumentType=false

from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike, NDArray

from tparticles import backend
from tparticles.errors import InputError
from tparticles.render import splat
from tparticles.render.look import bayer

_BAND_BITS = 4
_BAND = 1 << _BAND_BITS  # rows owned by one thread at a time
_CHUNK = 2048  # dots that one thread counts and lists at a time
_CHUNKS = 512  # chunks in a round of the counting sort
_ENTRIES = 1 << 21  # most dots listed in a round (64 MiB); more dots take more rounds
_RECORD = 8  # f32 in a listed dot
_TABLE = 1 << 13  # most entries of a display table
_LANES = 24  # values developed together: 8 pixels, one row of the dither matrix
_RUN = 256  # GPU: dots in a run of the prefix sum, and runs in a batch
# GPU: pieces in a launch, no more than Taichi starts threads for a loop. Mesa's software Vulkan (22.3, Debian 12) drops
# atomic additions from the third iteration of a loop on, and ends all loops of a thread after 65535 iterations.
_LAUNCH = 1 << 16
_GRAIN = 512  # Taichi gives one CPU thread at least this many iterations: so many make one coarse task
_NAMES = ("u", "v", "du", "dv", "sigma", "r", "g", "b")


@ti.data_oriented
class Dots:
    """Buffers for up to `capacity` splats, one f32 field of shape (capacity,) per quantity.

    `u, v` [px]: position at shutter close; (0, 0) is the top left corner of the film, pixel centres are at +0.5, v grows
    downward. `du, dv` [px]: from there to the position at shutter open; zero is a dot. `sigma` [px]: standard deviation
    of the Gaussian; 0.3..1024, others are drawn at the nearer limit. `r, g, b` [film white * px]: energy, that is the
    sum over the film; a channel may be negative. Energies are clamped to +-2^30.

    A dot with a NaN or infinity, with sigma <= 0, or 2^24 px or more away draws nothing.

    Raises `InputError` if capacity < 1.
    """

    def __init__(self, capacity: int):
        if capacity < 1:
            raise InputError(f"capacity = {capacity}: room for at least 1 dot is needed")
        self.capacity = capacity
        self.u, self.v, self.du, self.dv, self.sigma, self.r, self.g, self.b = (
            ti.field(ti.f32, shape=capacity) for _ in _NAMES
        )

    def upload(
        self, u: ArrayLike, v: ArrayLike, *, sigma: ArrayLike, energy: ArrayLike, du: ArrayLike = 0, dv: ArrayLike = 0
    ) -> int:
        """Fill the buffers from arrays of shape (n,), `energy` (n, 3), or scalars to repeat; return n.

        Raises `InputError` if there are more dots than `capacity`.
        """
        e = np.asarray(energy, dtype=np.float32)
        columns = np.broadcast_arrays(u, v, du, dv, sigma, e[..., 0], e[..., 1], e[..., 2])
        count = columns[0].size
        if count > self.capacity:
            raise InputError(f"{count} dots do not fit into a capacity of {self.capacity}")
        for name, column in zip(_NAMES, columns, strict=True):
            padded = np.zeros(self.capacity, dtype=np.float32)
            padded[:count] = column.ravel()
            getattr(self, name).from_numpy(padded)
        return count

    @ti.func
    def read(self, i):
        """Return dot i as a record of 8 f32 in the order of the fields, its energy in quanta, sigma in its limits."""
        top = ti.f32(splat.ENERGY_MAX)
        energy = ti.min(ti.max(ti.Vector([self.r[i], self.g[i], self.b[i]]), -top), top) * ti.f32(1.0 / splat.QUANTUM)
        path, sigma = ti.Vector([self.u[i], self.v[i], self.du[i], self.dv[i]]), splat.limited(self.sigma[i])
        return ti.Vector([path[0], path[1], path[2], path[3], sigma, energy[0], energy[1], energy[2]])

    @ti.func
    def rows(self, i, width, height):
        """Return the film rows first..last that dot i may touch; first > last if it draws nothing."""
        first, last = 0, -1
        u, v, du, dv, sigma = self.u[i], self.v[i], self.du[i], self.dv[i], self.sigma[i]
        near = splat.reachable(u) and splat.reachable(v) and splat.reachable(du) and splat.reachable(dv)
        energy = splat.finite(self.r[i]) and splat.finite(self.g[i]) and splat.finite(self.b[i])
        if near and energy and splat.finite(sigma) and sigma > 0.0:
            R = splat.radius(splat.limited(sigma))
            u2, v2 = u + du, v + dv
            left, right = ti.cast(ti.floor(ti.min(u, u2)), ti.i32) - R, ti.cast(ti.floor(ti.max(u, u2)), ti.i32) + R
            if right >= 0 and left < width:
                first = ti.max(ti.cast(ti.floor(ti.min(v, v2)), ti.i32) - R, 0)
                last = ti.min(ti.cast(ti.floor(ti.max(v, v2)), ti.i32) + R, height - 1)
        return first, last


@ti.data_oriented
class _Bands:
    """The sums, and the scratch of the counting sort: a histogram for each chunk of dots and a list for each band.

    All in one SNode tree: LLVM keeps the root of a loop that touches a single tree in a register and vectorises; with
    two trees it loads both roots again after every store, and drawing takes twice as long (Taichi 1.7.4).
    """

    def __init__(self, size: int, height: int, capacity: int):
        self.bands = -(-height // _BAND)
        # One chunk must fit even if each of its dots touches every band.
        self.entries = max(_CHUNK * self.bands, min(2 * capacity, _ENTRIES))
        self.light = ti.field(ti.i64)
        self.counts, self.starts, self.taken = ti.field(ti.i32), ti.field(ti.i32), ti.field(ti.i32)
        self.records, self.table, self.pattern = ti.field(ti.f32), ti.field(ti.f32), ti.field(ti.f32)
        tree = ti.FieldsBuilder()
        tree.dense(ti.i, size).place(self.light)
        tree.dense(ti.ij, (_CHUNKS, self.bands)).place(self.counts)
        tree.dense(ti.i, self.bands + 1).place(self.starts)
        tree.dense(ti.i, 1).place(self.taken)
        tree.dense(ti.i, self.entries * _RECORD).place(self.records)
        tree.dense(ti.i, _TABLE).place(self.table)
        tree.dense(ti.i, 8 * _LANES).place(self.pattern)
        tree.finalize()

    @ti.func
    def fit(self, chunks):
        """Turn counts into positions in the list, for as many chunks as it can hold."""
        total, taken, room = 0, 0, True
        for chunk in range(chunks):
            needed = 0
            for band in range(self.bands):
                needed += self.counts[chunk, band]
            room = room and total + needed <= self.entries
            if room:
                total += needed
                taken = chunk + 1
        position = 0
        for band in range(self.bands):
            self.starts[band] = position
            for chunk in range(taken):
                count = self.counts[chunk, band]
                self.counts[chunk, band] = position
                position += count
        self.starts[self.bands] = position
        self.taken[0] = taken

    @ti.func
    def append(self, chunk, band, record):
        """List a dot in a band, at the position that belongs to its chunk."""
        position = self.counts[chunk, band]
        self.counts[chunk, band] = position + 1
        for k in ti.static(range(_RECORD)):
            self.records[position * _RECORD + k] = record[k]


@ti.data_oriented
class _Pieces:
    """Scratch of the GPU path: where the pieces of each dot begin in the row of all pieces of a batch of dots."""

    def __init__(self):
        self.starts = ti.field(ti.i64, shape=_RUN * _RUN + 1)
        self.totals = ti.field(ti.i64, shape=_RUN)

    @ti.func
    def find(self, piece):
        """Return the dot that a piece belongs to: starts[dot] <= piece < starts[dot + 1]."""
        low, high = 0, _RUN * _RUN
        for _ in range(ti.static((_RUN * _RUN).bit_length())):
            middle = (low + high) >> 1
            if high - low > 1:
                if self.starts[middle] <= piece:
                    low = middle
                else:
                    high = middle
        return low


@ti.data_oriented
class Film:
    """A film of `width` x `height` pixels, 3 channels, in linear sRGB relative to film white.

    Raises `InputError` unless both are at least 1 and the film has fewer than 2^30 values.
    """

    def __init__(self, width: int, height: int, *, capacity: int = 1 << 20):
        self.stride = (width + 2 * splat.PAD) * 3
        if width < 1 or height < 1:
            raise InputError(f"film size {width}x{height} is not allowed (at least 1x1)")
        if (size := self.stride * height + splat.LANES) >= 1 << 30:
            raise InputError(f"film size {width}x{height} is not allowed (at most {2**30 // 3} pixels)")
        self.width, self.height = width, height
        self.threads = backend.current().threads
        self.pieces: Any = None if backend.current().is_cpu else _Pieces()
        self.bands_per_thread = -(-height // (_BAND * self.threads))
        self.bands = _Bands(size, height, capacity)
        self.light = self.bands.light
        self._background: Any = None
        self._lit = False

    def clear(self) -> None:
        """Make the film black."""
        self._clear()

    def add(self, dots: Dots, count: int) -> None:
        """Add the first `count` of `dots`. Raises `InputError` unless 0 <= count <= dots.capacity."""
        if not 0 <= count <= dots.capacity:
            raise InputError(f"count = {count} dots is not allowed (0 to the capacity {dots.capacity})")
        if self.pieces is not None:
            for first in range(0, count, _RUN * _RUN):
                total = self._count_pieces(dots, first, count)
                for piece in range(0, total, _LAUNCH):
                    self._add_pieces(dots, first, piece, min(_LAUNCH, total - piece))
            return
        first = 0
        while first < count:
            first += _CHUNK * self._add_round(dots, first, count)

    def sums(self) -> NDArray[np.int64]:
        """Return the film in quanta of 2^-24, shape (height, width, 3)."""
        out = np.empty((self.height, self.width, 3), dtype=np.int64)
        self._read(out)
        return out

    def linear(self) -> NDArray[np.float64]:
        """Return the film relative to film white, shape (height, width, 3)."""
        return self.sums().astype(np.float64) * np.float64(splat.QUANTUM)

    def merge(self, sums: NDArray[np.int64]) -> None:
        """Add the `sums()` of another film. Raises `InputError` if shape or type differ."""
        shape = (self.height, self.width, 3)
        if sums.shape != shape or sums.dtype != np.int64:
            raise InputError(f"sums of {sums.dtype} {sums.shape} cannot be merged into a film of int64 {shape}")
        self._merge(np.ascontiguousarray(sums))

    def set_background(self, image: ArrayLike | None) -> None:
        """Set what `develop` adds to the film: shape (height, width, 3), relative to film white; None is black.

        Raises `InputError` if the shape differs or a value is not finite.
        """
        self._lit = image is not None
        if image is None:
            return
        pixels = np.ascontiguousarray(image, dtype=np.float32)
        shape = (self.height, self.width, 3)
        if pixels.shape != shape or not np.isfinite(pixels).all():
            raise InputError(f"a background of shape {pixels.shape} must be finite and of the film's shape, {shape}")
        if self._background is None:
            self._background = ti.field(ti.f32, shape=self.stride * self.height)
        side = 3 * splat.PAD
        self._background.from_numpy(np.pad(pixels.reshape(self.height, -1), ((0, 0), (side, side))).ravel())

    def develop(self, table: ArrayLike, film_max: float, *, dither: bool = True) -> NDArray[np.uint8]:
        """Return the 8-bit picture, shape (height, width, 3), a new array.

        Arguments:
            table: display values 0..255 for n >= 2 film values uniform in sqrt(film / film_max), see `Look.display_table`.
            film_max: film value of the last entry; brighter film looks the same, negative film looks black.
            dither: add the 8x8 Bayer matrix, in (-0.5, 0.5) of a display step, before rounding.

        Raises `InputError` if the table has another shape or film_max is not above 0.
        """
        values = np.ascontiguousarray(table, dtype=np.float32)
        if values.ndim != 1 or not 2 <= values.size <= _TABLE or not film_max > 0.0:
            raise InputError(
                f"table of shape {values.shape}, film_max = {film_max}: shape (2..{_TABLE},) and above 0 are needed"
            )
        pattern = np.repeat(bayer() if dither else np.zeros((8, 8)), 3).astype(np.float32)
        out = np.empty((self.height, self.width, 3), dtype=np.uint8)
        background = self._background if self._lit else self.light
        self._develop(out.reshape(-1), values, values.size, film_max, pattern, background, self._lit)
        return out

    @ti.kernel
    def _clear(self):
        for i in self.light:
            self.light[i] = 0

    @ti.kernel
    def _count_pieces(self, dots: ti.template(), start: ti.i32, count: ti.i32) -> ti.i64:
        """Prefix sums of the pieces of dots from `start` on, runs of _RUN dots at a time; return their total."""
        for run in range(_RUN):
            total = ti.i64(0)
            for k in range(_RUN):
                i = start + run * _RUN + k
                self.pieces.starts[run * _RUN + k] = total
                if i < count:
                    first, last = dots.rows(i, self.width, self.height)
                    if first <= last:
                        u, v, du, dv, sigma, _r, _g, _b = dots.read(i)
                        total += splat.streak_pieces((self.width, self.height), u, v, du, dv, sigma)
            self.pieces.totals[run] = total
        for _ in range(1):
            total = ti.i64(0)
            for run in range(_RUN):
                count_here = self.pieces.totals[run]
                self.pieces.totals[run] = total
                total += count_here
            self.pieces.starts[_RUN * _RUN] = total
        for k in range(_RUN * _RUN):
            self.pieces.starts[k] = self.pieces.starts[k] + self.pieces.totals[k // _RUN]
        return self.pieces.starts[_RUN * _RUN]

    @ti.kernel
    def _add_pieces(self, dots: ti.template(), start: ti.i32, first: ti.i64, count: ti.i32):
        for k in range(count):
            piece = first + k
            dot = self.pieces.find(piece)
            u, v, du, dv, sigma, r, g, b = dots.read(start + dot)
            left = piece - self.pieces.starts[dot]
            size = (self.width, self.height)
            splat.draw_streak_piece(self.light, size, left, u, v, du, dv, sigma, ti.Vector([r, g, b]))

    @ti.kernel
    def _add_round(self, dots: ti.template(), start: ti.i32, count: ti.i32) -> ti.i32:
        """Add dots from `start` on, as many chunks as the lists hold; return how many chunks that was."""
        chunks = ti.min((count - start + _CHUNK - 1) // _CHUNK, _CHUNKS)
        for task in range(chunks * _GRAIN):
            if task % _GRAIN == 0:
                chunk = task // _GRAIN
                for band in range(self.bands.bands):
                    self.bands.counts[chunk, band] = 0
                for i in range(start + chunk * _CHUNK, ti.min(start + (chunk + 1) * _CHUNK, count)):
                    first, last = dots.rows(i, self.width, self.height)
                    if first <= last:
                        for band in range(first >> _BAND_BITS, (last >> _BAND_BITS) + 1):
                            self.bands.counts[chunk, band] = self.bands.counts[chunk, band] + 1
        for _ in range(1):
            self.bands.fit(chunks)
        for task in range(self.bands.taken[0] * _GRAIN):
            if task % _GRAIN == 0:
                chunk = task // _GRAIN
                for i in range(start + chunk * _CHUNK, ti.min(start + (chunk + 1) * _CHUNK, count)):
                    first, last = dots.rows(i, self.width, self.height)
                    if first <= last:
                        record = dots.read(i)
                        for band in range(first >> _BAND_BITS, (last >> _BAND_BITS) + 1):
                            self.bands.append(chunk, band, record)
        for task in range(self.threads * self.bands_per_thread * _GRAIN):
            if task % _GRAIN == 0:
                # Thread t gets consecutive tasks; give it every threads-th band, or one thread would own the bright rows.
                rank = task // _GRAIN
                band = rank % self.bands_per_thread * self.threads + rank // self.bands_per_thread
                if band < self.bands.bands:
                    top = band * _BAND
                    bottom = ti.min(top + _BAND, self.height)
                    for k in range(self.bands.starts[band], self.bands.starts[band + 1]):
                        record = ti.Vector([self.bands.records[k * _RECORD + j] for j in range(_RECORD)])
                        u, v, du, dv, sigma, r, g, b = record
                        size, energy = (self.width, self.height), ti.Vector([r, g, b])
                        splat.draw_streak(self.light, size, top, bottom, u, v, du, dv, sigma, energy)
        return self.bands.taken[0]

    @ti.kernel
    def _read(self, out: ti.types.ndarray(ti.i64, 3)):
        for y, x, c in ti.ndrange(self.height, self.width, 3):
            out[y, x, c] = self.light[y * self.stride + (x + splat.PAD) * 3 + c]

    @ti.kernel
    def _merge(self, sums: ti.types.ndarray(ti.i64, 3)):
        for y, x, c in ti.ndrange(self.height, self.width, 3):
            i = y * self.stride + (x + splat.PAD) * 3 + c
            self.light[i] = self.light[i] + sums[y, x, c]

    @ti.kernel
    def _develop(
        self,
        out: ti.types.ndarray(ti.u8, 1),
        table: ti.types.ndarray(ti.f32, 1),
        n: ti.i32,
        film_max: ti.f32,
        pattern: ti.types.ndarray(ti.f32, 1),
        background: ti.template(),
        lit: ti.template(),
    ):
        # Kept next to the sums, in their SNode tree, see _Bands.
        for i in range(n):
            self.bands.table[i] = table[i]
        for i in range(8 * _LANES):
            self.bands.pattern[i] = pattern[i]
        for y, block in ti.ndrange(self.height, (self.width + 7) // 8):
            scale, per_max = ti.cast(n - 1, ti.f32), ti.f32(1.0) / film_max
            code = ti.Vector([ti.i32(0)] * _LANES)
            start = (y * self.stride + splat.PAD * 3 + block * _LANES) & splat.NO_WRAP
            for lane in range(_LANES):
                value = ti.cast(self.light[start + lane], ti.f32) * ti.f32(splat.QUANTUM)
                if ti.static(lit):
                    value += background[start + lane]
                s = ti.sqrt(ti.min(ti.max(value * per_max, ti.f32(0.0)), ti.f32(1.0))) * scale
                k = ti.min(ti.cast(s, ti.i32), n - 2)
                low, high = self.bands.table[k], self.bands.table[k + 1]
                level = low + (s - ti.cast(k, ti.f32)) * (high - low)
                level += self.bands.pattern[(y & 7) * _LANES + lane] + ti.f32(0.5)
                code[lane] = ti.cast(ti.min(ti.max(level, ti.f32(0.0)), ti.f32(255.0)), ti.i32)
            first = (y * self.width + block * 8) * 3
            for lane in range(ti.min(_LANES, (self.width - block * 8) * 3)):
                out[first + lane] = ti.cast(code[lane], ti.u8)
