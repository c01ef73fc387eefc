"""The film: additive light in fixed point, and its development to 8-bit pixels.

A pixel channel is a sum of i64 multiples of 2^-24 of film white. Integer sums do not depend on the order of their terms,
so a frame has the same bits for any number of threads, any chunking of the dots and any split into shards (`merge`).

On a CPU the rows are cut into bands. A counting sort lists every dot in each band that it touches, then each band is
drawn by one thread, without atomics. On a GPU the pieces of all dots are numbered by a prefix sum, and each is a thread
that adds atomically. Same arithmetic, same sums.

Sparks leave most of a frame dark. So on a CPU each tile that a dot may touch is marked, and only these are cleared and
developed; the rest of the picture is a copy of the background as it looks developed, kept from frame to frame.
"""
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false, reportArgumentType=false

import functools
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike, NDArray

from tparticles import backend
from tparticles.errors import InputError
from tparticles.hints import NO_WRAP, rolled
from tparticles.render import splat
from tparticles.render.bands import CHUNK, CHUNKS, LANES, TABLE, Bands
from tparticles.render.dots import Dots
from tparticles.render.look import bayer

_RUN = 256  # GPU: dots in a run of the prefix sum, and runs in a batch
# GPU: pieces in a launch, no more than Taichi starts threads for a loop. Mesa's software Vulkan (22.3, Debian 12) drops
# atomic additions from the third iteration of a loop on, and ends all loops of a thread after 65535 iterations.
_LAUNCH = 1 << 16
_NOTHING, _PICTURE, _COLUMN = 0, 1, 2  # what is behind the light: black, a picture, or one colour a row
_GRAIN = 512  # Taichi gives one CPU thread at least this many iterations: so many make one coarse task


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


@functools.cache
def _pattern(dither: bool) -> NDArray[np.float32]:
    """Return what dither adds to each lane of 8 rows, or zeros."""
    return np.repeat(bayer() if dither else np.zeros((8, 8)), 3).astype(np.float32)


@ti.data_oriented
class Film:
    """A film of `width` x `height` pixels, 3 channels, in linear sRGB relative to film white.

    Raises `InputError` unless both are at least 1 and the film has fewer than 2^30 values.
    """

    def __init__(self, width: int, height: int, *, capacity: int = 1 << 20):
        self.stride = splat.stride(width)
        if width < 1 or height < 1:
            raise InputError(f"film size {width}x{height} is not allowed (at least 1x1)")
        if self.stride * height + splat.LANES >= 1 << 30:
            raise InputError(f"film size {width}x{height} is not allowed (at most {2**30 // 3} pixels)")
        self.width, self.height = width, height
        self.threads = backend.current().threads
        self.pieces: Any = None if backend.current().is_cpu else _Pieces()
        self.bands_per_thread = -(-height // (splat.BAND * self.threads))
        # A cell, rows x blocks of `LANES`, is cleared or developed in one go; it lies in one tile.
        self.cell_rows, self.cell_blocks = (4, splat.TILE * 3 // LANES) if self.pieces is None else (1, 1)
        self.across = -(-self.stride // (LANES * self.cell_blocks))
        self.down_per_thread = -(-height // (self.cell_rows * self.threads))
        self.bands = Bands(width, height, capacity)
        self.light = self.bands.light
        self._black = True
        self._everywhere = False  # light may be in tiles that are not marked
        self._picture: Any = None
        self._column = np.zeros(1, np.float32)
        self._behind = _NOTHING
        self._dark: tuple[Any, Any] = None, None  # the picture of the film without light, and what it was made with

    def clear(self) -> None:
        """Make the film black."""
        if not self._black:
            self._clear(self._everywhere)
        self._black, self._everywhere = True, False

    def add(self, dots: Dots, count: int) -> None:
        """Add the first `count` of `dots`. Raises `InputError` unless 0 <= count <= dots.capacity."""
        if not 0 <= count <= dots.capacity:
            raise InputError(f"count = {count} dots is not allowed (0 to the capacity {dots.capacity})")
        self._black = False
        if self.pieces is not None:
            self._everywhere = True
            for first in range(0, count, _RUN * _RUN):
                total = self._count_pieces(dots, first, count)
                for piece in range(0, total, _LAUNCH):
                    self._add_pieces(dots, first, piece, min(_LAUNCH, total - piece))
            return
        first = 0
        with backend.thorough():
            while first < count:
                first += CHUNK * self._add_round(dots, first, count)

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
        self._black, self._everywhere = False, True
        self._merge(np.ascontiguousarray(sums))

    def set_background(self, image: ArrayLike | None) -> None:
        """Set what `develop` adds to the film: shape (height, width or 1, 3), relative to film white; None is black.

        Raises `InputError` if the shape differs or a value is not finite.
        """
        self._dark = None, None
        if image is None:
            self._behind = _NOTHING
            return
        values = np.ascontiguousarray(image, dtype=np.float32)
        if values.shape not in ((self.height, self.width, 3), (self.height, 1, 3)) or not np.isfinite(values).all():
            raise InputError(
                f"a background of shape {values.shape} must be finite and of the film's shape, "
                f"{(self.height, self.width, 3)}, or have one column"
            )
        if values.shape[1] == 1:
            self._column, self._behind = np.tile(values[:, 0], LANES // 3).reshape(-1), _COLUMN
            return
        if self._picture is None:
            self._picture = ti.field(ti.f32, shape=self.height * self.stride)
        self._set_picture(self._picture, values)
        self._behind = _PICTURE

    def develop(self, table: ArrayLike, film_max: float, *, dither: bool = True) -> NDArray[np.uint8]:
        """Return the 8-bit picture, shape (height, width, 3), a new array.

        Arguments:
            table: display values 0..255 for n >= 2 film values uniform in sqrt(film / film_max), see `Look.display_table`.
            film_max: film value of the last entry; brighter film looks the same, negative film looks black.
            dither: add the 8x8 Bayer matrix, in (-0.5, 0.5) of a display step, before rounding.

        Raises `InputError` if the table has another shape or film_max is not above 0.
        """
        values = np.ascontiguousarray(table, dtype=np.float32)
        if values.ndim != 1 or not 2 <= values.size <= TABLE or not film_max > 0.0:
            raise InputError(
                f"table of shape {values.shape}, film_max = {film_max}: shape (2..{TABLE},) and above 0 are needed"
            )
        dark = None if self._everywhere else self._developed_dark(values, film_max, dither)
        out = np.empty((self.height, self.width, 3), dtype=np.uint8) if dark is None else dark.copy()
        self._expose(out, values, film_max, dither, quantum=splat.QUANTUM, everywhere=dark is None)
        return out

    def _developed_dark(self, table: NDArray[np.float32], film_max: float, dither: bool) -> NDArray[np.uint8] | None:
        """Return the picture of a film without light, kept until an argument or the background changes.

        None when it is first asked for: a single picture is developed sooner without.
        """
        wanted = table.tobytes(), film_max, dither
        if self._dark[1] != wanted:
            self._dark = None, wanted
            return None
        if self._dark[0] is None:
            out = np.empty((self.height, self.width, 3), dtype=np.uint8)
            self._expose(out, table, film_max, dither, quantum=0.0, everywhere=True)
            self._dark = out, wanted
        return self._dark[0]

    def _expose(
        self,
        out: NDArray[np.uint8],
        table: NDArray[np.float32],
        film_max: float,
        dither: bool,
        *,
        quantum: float,
        everywhere: bool,
    ) -> None:
        """Develop the tiles that hold light, or all, into `out`. A quantum of 0 instead of 2^-24 leaves the light out."""
        picture = self._picture if self._behind == _PICTURE else self.light
        numbers = np.concatenate((_pattern(dither), table, self._column))
        self._develop(
            out.reshape(-1), numbers, numbers.size, table.size, film_max, quantum, everywhere, picture, self._behind
        )

    @ti.func
    def cell(self, i):
        """Return the top row and the first block of cell i; some cells are below the film.

        Thread t gets consecutive cells; give it every threads-th row of cells, or one thread would own the bright ones.
        """
        rank = i // self.across
        down = rank % self.down_per_thread * self.threads + rank // self.down_per_thread
        return down * self.cell_rows, i % self.across * self.cell_blocks

    @ti.func
    def holds_light(self, y, block):
        """Whether the tile of a cell is marked."""
        tile = block * ti.static(LANES // 3) >> splat.TILE_BITS
        return self.bands.marks[(y >> splat.BAND_BITS) * splat.tiles(self.width) + tile] != 0

    @ti.kernel
    def _clear(self, everywhere: ti.i32):
        for i in range(self.threads * self.down_per_thread * self.across):
            top, block = self.cell(i)
            if top < self.height and (everywhere != 0 or self.holds_light(top, block)):
                for y in range(top, ti.min(top + self.cell_rows, self.height)):
                    start = (y * self.stride + block * LANES) & NO_WRAP
                    for lane in range(ti.min(self.cell_blocks * LANES, self.stride - block * LANES)):
                        self.light[start + lane] = 0
        for tile in self.bands.marks:
            self.bands.marks[tile] = 0

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
        chunks = ti.min((count - start + CHUNK - 1) // CHUNK, CHUNKS)
        for task in range(chunks * _GRAIN):
            if task % _GRAIN == 0:
                chunk = task // _GRAIN
                self.bands.clear(chunk)
                for i in range(start + chunk * CHUNK, ti.min(start + (chunk + 1) * CHUNK, count)):
                    first, last = dots.rows(i, self.width, self.height)
                    if first <= last:
                        self.bands.count(chunk, first >> splat.BAND_BITS, last >> splat.BAND_BITS)
                self.bands.sum_up(chunk)
        for _ in range(1):
            self.bands.fit(chunks)
        for task in range(self.bands.taken[0] * _GRAIN):
            if task % _GRAIN == 0:
                chunk = task // _GRAIN
                for i in range(start + chunk * CHUNK, ti.min(start + (chunk + 1) * CHUNK, count)):
                    first, last = dots.rows(i, self.width, self.height)
                    if first <= last:
                        record = dots.read(i)
                        for band in range(first >> splat.BAND_BITS, (last >> splat.BAND_BITS) + 1):
                            self.bands.append(chunk, band, record)
        for task in range(self.threads * self.bands_per_thread * _GRAIN):
            if task % _GRAIN == 0:
                # Thread t gets consecutive tasks; give it every threads-th band, or one thread would own the bright rows.
                rank = task // _GRAIN
                band = rank % self.bands_per_thread * self.threads + rank // self.bands_per_thread
                if band < self.bands.bands:
                    top = band * splat.BAND
                    bottom = ti.min(top + splat.BAND, self.height)
                    for k in range(self.bands.starts[band], self.bands.starts[band + 1]):
                        u, v, du, dv, sigma, r, g, b = self.bands.read(k)
                        size, energy = (self.width, self.height), ti.Vector([r, g, b])
                        splat.draw_streak(self.light, self.bands.marks, size, top, bottom, u, v, du, dv, sigma, energy)
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
    def _set_picture(self, picture: ti.template(), values: ti.types.ndarray(ti.f32, 3)):
        for y, x, c in ti.ndrange(self.height, self.width, 3):
            picture[y * self.stride + (x + splat.PAD) * 3 + c] = values[y, x, c]

    @ti.kernel
    def _develop(
        self,
        out: ti.types.ndarray(ti.u8, 1),
        numbers: ti.types.ndarray(ti.f32, 1),
        size: ti.i32,
        n: ti.i32,
        film_max: ti.f32,
        quantum: ti.f32,
        everywhere: ti.i32,
        picture: ti.template(),
        behind: ti.template(),
    ):
        # The dither pattern, n table entries and the column, kept next to the sums, in their SNode tree, see Bands.
        for i in range(size):
            rolled(self.bands.marks)
            self.bands.numbers[i] = numbers[i]
        for i in range(self.threads * self.down_per_thread * self.across):
            top, left = self.cell(i)
            if top < self.height and (everywhere != 0 or self.holds_light(top, left)):
                scale, per_max = ti.cast(n - 1, ti.f32), ti.f32(1.0) / film_max
                # From here on blocks are counted from the first pixel of the film, `PAD` pixels into the row.
                first = left - ti.static(splat.PAD * 3 // LANES)
                for y in range(top, ti.min(top + self.cell_rows, self.height)):
                    for block in range(ti.max(first, 0), ti.min(first + self.cell_blocks, (self.width + 7) // 8)):
                        pixel, last = (y * self.width + block * 8) * 3, (self.width - block * 8) * 3
                        for part in range(LANES // 8):
                            rolled(self.bands.marks)
                            code = ti.Vector([ti.i32(0)] * 8)
                            start = (y * self.stride + splat.PAD * 3 + block * LANES + 8 * part) & NO_WRAP
                            column = (8 * LANES + n + y * LANES + 8 * part) & NO_WRAP
                            dither = ((y & 7) * LANES + 8 * part) & NO_WRAP
                            for lane in range(8):
                                value = ti.cast(self.light[start + lane], ti.f32) * quantum
                                if ti.static(behind == _PICTURE):
                                    value += picture[start + lane]
                                if ti.static(behind == _COLUMN):
                                    value += self.bands.numbers[column + lane]
                                s = ti.sqrt(ti.min(ti.max(value * per_max, ti.f32(0.0)), ti.f32(1.0))) * scale
                                k = ti.min(ti.cast(s, ti.i32), n - 2)
                                entry = (8 * LANES + k) & NO_WRAP
                                low, high = self.bands.numbers[entry], self.bands.numbers[entry + 1]
                                level = low + (s - ti.cast(k, ti.f32)) * (high - low)
                                level += self.bands.numbers[dither + lane] + ti.f32(0.5)
                                code[lane] = ti.cast(ti.min(ti.max(level, ti.f32(0.0)), ti.f32(255.0)), ti.i32)
                            if 8 * part + 8 <= last:
                                for lane in range(8):
                                    out[pixel + 8 * part + lane] = ti.cast(code[lane], ti.u8)
                            else:
                                for lane in range(last - 8 * part):
                                    rolled(self.bands.marks)
                                    out[pixel + 8 * part + lane] = ti.cast(code[lane], ti.u8)
