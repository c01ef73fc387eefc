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
    """Sliced rows (ELLPACK): `LANES` consecutive vertices have their n-th springs side by side, padded to the longest of them.

    - Block b of vertices 16 b to 16 b + 15 has rows `starts[b]` to `starts[b + 1]`; row e and lane l are entry 16 e + l.
    - `column`: the vertex at the other end, the vertex itself where there is no spring; `spring`: which one, or -1.
    - What a vertex i has beyond its first `LONGEST` springs comes after all slices: entries `overflow[i]` to `overflow[i + 1]`.
      Few meshes have any (`overflows`); it keeps one hub with a million spokes from padding 15 neighbours to its length. A sum
      that goes on with them goes in the order of `Rows`.

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
        short = np.zeros(blocks * LANES, np.int32)
        short[: len(degree)] = np.minimum(degree, LONGEST)
        width = short.reshape(blocks, LANES).max(axis=1)
        starts = np.zeros(blocks + 1, np.int32)
        np.cumsum(width, out=starts[1:])
        owner = np.repeat(np.arange(mesh.vertex_count, dtype=np.int32), degree)
        place = np.arange(len(owner), dtype=np.int32) - rows.starts[owner]
        long = np.zeros(blocks * LANES, np.int32)
        long[: len(degree)] = np.maximum(degree - LONGEST, 0)
        inside, beyond = (place < LONGEST, place >= LONGEST) if long.any() else (slice(None), slice(0))
        i = owner[inside]
        entry = (starts[i // LANES].astype(np.int64) + place[inside]) * LANES + i % LANES
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
