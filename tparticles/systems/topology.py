"""Which springs meet at a vertex, as rows that kernels gather over. Their order within a vertex is that of its neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..physics.mesh import Mesh

Integers = NDArray[np.int32]

LANES = 16  # vertices side by side
LONGEST = 64  # springs of a vertex that lie in the slices
_DISTANCES = 128  # that springs lead in a mesh which is a grid, or some of them
_MORE = 1.5  # times the rows that a block needs at least: what its entries need not be looked at for is worth them


@dataclass(frozen=True, eq=False)
class Rows:
    """Compressed rows (CSR).

    The springs of vertex i are entries `starts[i]` to `starts[i + 1]` of `column`, the vertex at the other end, and `spring`.
    """

    starts: Integers
    column: Integers
    spring: Integers

    @classmethod
    def of(cls, mesh: Mesh) -> Self:
        """Return the rows of all vertices, each sorted by neighbour."""
        n, m = mesh.vertex_count, mesh.spring_count
        owner = mesh.springs.T.ravel()
        neighbour = mesh.springs[:, ::-1].T.ravel()
        order = np.argsort(owner.astype(np.int64) * n + neighbour, kind="stable")
        starts = np.zeros(n + 1, np.int32)
        np.cumsum(np.bincount(owner, minlength=n), out=starts[1:])
        spring = order.astype(np.int32)
        spring[spring >= m] -= m
        return cls(starts, neighbour[order], spring)


@dataclass(frozen=True, eq=False)
class Adjacency:
    """Sliced rows (ELLPACK): `LANES` consecutive vertices have a spring each side by side.

    - Block b of vertices 16 b to 16 b + 15 has rows `starts[b]` to `starts[b + 1]`; row e and lane l are entry 16 e + l.
    - `column`: the vertex at the other end, the vertex itself where there is no spring; `spring`: which one, or -1.
    - What a vertex i has beyond its first `LONGEST` springs comes after all slices: entries `overflow[i]` to `overflow[i + 1]`.
      Few meshes have any (`overflows`); it keeps one hub with a million spokes from padding 15 neighbours to its length.

    In a block of a grid (cloth, jelly, rope) all springs of a row lead equally far, where that takes few rows more; in any other
    the n-th springs are side by side, padded to the longest of them. A vertex meets its springs in the order of `Rows` either way.
    The last block is filled up with vertices that have no springs.
    """

    starts: Integers
    column: Integers
    spring: Integers
    overflow: Integers

    @classmethod
    def of(cls, mesh: Mesh) -> Self:
        """Return the slices of a mesh. Vertices keep their numbers: neighbours in memory are neighbours in space."""
        rows = Rows.of(mesh)
        degree = np.diff(rows.starts)
        blocks = -(-mesh.vertex_count // LANES)
        owner = np.repeat(np.arange(mesh.vertex_count, dtype=np.int32), degree)
        place = np.arange(len(owner), dtype=np.int32) - rows.starts[owner]
        long = np.zeros(blocks * LANES, np.int32)
        long[: len(degree)] = np.maximum(degree - LONGEST, 0)
        inside, beyond = (place < LONGEST, place >= LONGEST) if long.any() else (slice(None), slice(0))
        i = owner[inside]
        short = np.zeros(blocks * LANES, np.int32)
        short[: len(degree)] = np.minimum(degree, LONGEST)
        width = short.reshape(blocks, LANES).max(axis=1)
        row, width = _rows_of_blocks(i, rows.column[inside], place[inside], width)
        starts = np.zeros(blocks + 1, np.int32)
        np.cumsum(width, out=starts[1:])
        entry = (starts[i // LANES].astype(np.int64) + row) * LANES + i % LANES
        own = np.arange(blocks * LANES, dtype=np.int32).reshape(blocks, LANES)
        column = np.repeat(own, width, axis=0).ravel()
        spring = np.full(len(column), -1, np.int32)
        overflow = np.concatenate([[0], np.cumsum(long)]) + len(column)
        column[entry], spring[entry] = rows.column[inside], rows.spring[inside]
        return cls(
            starts,
            np.concatenate([column, rows.column[beyond]]),
            np.concatenate([spring, rows.spring[beyond]]),
            overflow.astype(np.int32),
        )

    @property
    def overflows(self) -> bool:
        """Whether a vertex has more than `LONGEST` springs."""
        return bool(self.overflow[-1] > self.overflow[0])

    def straight(self, values: NDArray) -> tuple[Integers, Integers, NDArray]:
        """Return which rows one run of vertices stands for, so that kernels need not look at their entries.

        `values`: (n, entries) numbers of every entry. Of each row: the vertex that lane 0 meets, lane l meets the l-th after it, or
        -1 if it is not so or the springs of the row have other values than each other; a bit for every lane that has a spring;
        and the values of the springs, (n, rows).
        """
        rows = self.starts[-1]
        spring = self.spring[: rows * LANES].reshape(-1, LANES)
        column = self.column[: rows * LANES].reshape(-1, LANES)
        values = values[:, : rows * LANES].reshape(len(values), -1, LANES)
        there, lanes = spring >= 0, np.arange(LANES, dtype=np.int32)
        some, all_rows = there.argmax(axis=1), np.arange(rows)  # a lane that has a spring
        first = column[all_rows, some] - some.astype(np.int32)
        one = values[:, all_rows, some]
        alike = (column - lanes == first[:, None]) & (values == one[..., None]).all(axis=0) | ~there
        vertices = (len(self.starts) - 1) * LANES
        fits = alike.all(axis=1) & there.any(axis=1) & (first >= 0) & (first + LANES <= vertices)
        bits = (there << lanes).sum(axis=1, dtype=np.int32)
        return np.where(fits, first, -1).astype(np.int32), bits, one


def _rows_of_blocks(
    owner: Integers, neighbour: Integers, place: Integers, width: Integers
) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
    """Return the row of each spring within the block of its owner, and how many rows each block has.

    `place`: of the spring among those of its owner, sorted by neighbour; `width`: of each block, how many rows it needs at least.
    """
    vertices = LANES * len(width)
    away = neighbour - owner + vertices
    occurs = np.zeros(2 * vertices, bool)
    occurs[away] = True
    count = int(occurs.sum())
    if not 0 < count <= _DISTANCES:
        return place, width
    # A row for each distance that a spring of the block leads.
    block, which = owner // LANES, (np.cumsum(occurs, dtype=np.int32) - 1)[away]
    taken = np.zeros((len(width), count), bool)
    taken[block, which] = True
    straight = taken.sum(axis=1)
    suits = straight <= np.minimum(_MORE * width, LONGEST)
    row = np.cumsum(taken, axis=1)[block, which] - 1
    return np.where(suits[block], row, place), np.where(suits, straight, width)
