"""The memory of a film: the sums, which tiles of it hold light, and the lists of the counting sort."""
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

from typing import Any

import taichi as ti

from tparticles.hints import NO_WRAP, rolled
from tparticles.render import splat

CHUNK = 2048  # dots that one thread counts and lists at a time
CHUNKS = 512  # chunks in a round of the counting sort
RECORD = 8  # f32 in a listed dot
TABLE = 1 << 13  # most entries of a display table
LANES = 24  # values cleared or developed together: 8 pixels, one row of the dither matrix
_ENTRIES = 1 << 21  # most dots listed in a round (64 MiB); more dots take more rounds


@ti.data_oriented
class Bands:
    """The sums, a mark for each tile that holds light, and the scratch of the counting sort.

    The scratch is a histogram for each chunk of dots and a list of dots for each band.

    All in one SNode tree: LLVM keeps the root of a loop that touches a single tree in a register and vectorises; with
    two trees it loads both roots again after every store, and drawing takes twice as long (Taichi 1.7.4).
    """

    def __init__(self, width: int, height: int, capacity: int):
        self.bands = -(-height // splat.BAND)
        # One chunk must fit even if each of its dots touches every band.
        self.entries = max(CHUNK * self.bands, min(2 * capacity, _ENTRIES))
        self.light: Any = ti.field(ti.i64)
        self.marks: Any = ti.field(ti.i32)
        self.counts, self.starts, self.taken = ti.field(ti.i32), ti.field(ti.i32), ti.field(ti.i32)
        self.records, self.numbers = ti.field(ti.f32), ti.field(ti.f32)
        tree = ti.FieldsBuilder()
        tree.dense(ti.i, splat.stride(width) * height + splat.LANES).place(self.light)
        tree.dense(ti.i, self.bands * splat.tiles(width)).place(self.marks)
        tree.dense(ti.ij, (CHUNKS, self.bands + 1)).place(self.counts)  # the last column is a chunk's total
        tree.dense(ti.i, self.bands + 1).place(self.starts)
        tree.dense(ti.i, 1).place(self.taken)
        tree.dense(ti.i, self.entries * RECORD).place(self.records)
        tree.dense(ti.i, (8 + height) * LANES + TABLE).place(self.numbers)  # dither pattern, display table, background
        tree.finalize()

    @ti.func
    def clear(self, chunk):
        """Begin the histogram of a chunk."""
        for band in range(self.bands + 1):
            self.counts[chunk, band] = 0
            rolled(self.marks)

    @ti.func
    def count(self, chunk, first, last):
        """Count a dot in bands first..last, as differences: one more from `first` on, one less after `last`."""
        rolled(self.marks)
        self.counts[chunk, first] = self.counts[chunk, first] + 1
        self.counts[chunk, last + 1] = self.counts[chunk, last + 1] - 1

    @ti.func
    def sum_up(self, chunk):
        """Turn the differences of a chunk into counts, and put their total behind them."""
        here, total = 0, 0
        for band in range(self.bands):
            here += self.counts[chunk, band]
            self.counts[chunk, band] = here
            total += here
            rolled(self.marks)
        self.counts[chunk, self.bands] = total

    @ti.func
    def fit(self, chunks):
        """Turn counts into positions in the list, for as many chunks as it can hold."""
        total, taken = 0, 0
        while taken < chunks and total + self.counts[taken, self.bands] <= self.entries:
            total += self.counts[taken, self.bands]
            taken += 1
        position = 0
        for band in range(self.bands):
            self.starts[band] = position
            rolled(self.marks)
            for chunk in range(taken):
                count = self.counts[chunk, band]
                self.counts[chunk, band] = position
                position += count
                rolled(self.marks)
        self.starts[self.bands] = position
        self.taken[0] = taken

    @ti.func
    def append(self, chunk, band, record):
        """List a dot in a band, at the position that belongs to its chunk."""
        rolled(self.marks)
        position = self.counts[chunk, band]
        self.counts[chunk, band] = position + 1
        start = position * RECORD & NO_WRAP
        for k in ti.static(range(RECORD)):
            self.records[start + k] = record[k]

    @ti.func
    def read(self, k):
        """Return listed dot k."""
        start = k * RECORD & NO_WRAP
        return ti.Vector([self.records[start + j] for j in range(RECORD)])
