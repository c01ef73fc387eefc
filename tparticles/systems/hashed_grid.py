"""Vertices of a mesh that come near each other push each other off; a hashed grid finds them.

The grid is sorted anew for every evaluation, by one thread and in the order of the vertices, so that a vertex sums over its
neighbours in the same order for any number of threads.
"""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false
# pyright: reportOptionalCall=false

from typing import Any

import taichi as ti

from .. import backend
from ..physics.repulsion import Repulsion


@ti.data_oriented
class HashedGrid:
    """Cells as wide as the repulsion reaches, hashed into a table (Teschner et al., VMV 2003, eq. 1).

    Arguments:
        law: how vertices repel each other.
        z: fields of the state: positions and velocities. Their pages begin `away` values from the start.
        count: how many vertices there are.
    """

    def __init__(self, law: Repulsion, z: tuple[Any, ...], count: int):
        self.z, self.count = z, count
        self.values = law.distance, law.stiffness, law.damping
        self.law = ti.field(backend.current().real, 3)
        self.table = 1 << (2 * count - 1).bit_length()
        self.starts = ti.field(ti.i32, self.table + 1)  # where each bucket begins among the members
        self.member = ti.field(ti.i32, count)

    def fill(self) -> None:
        """Put the numbers of the law where kernels find them, once all fields are declared."""
        for n, value in enumerate(self.values):
            self.law[n] = value

    @ti.func
    def cell(self, i, away):
        """Return the cell of vertex i."""
        return ti.Vector([ti.cast(ti.floor(self.z[d][away + i] / self.law[0]), ti.i32) for d in ti.static(range(3))])

    @ti.func
    def bucket(self, cell):
        """Return the place of a cell in the table."""
        return (cell[0] * 73856093 ^ cell[1] * 19349663 ^ cell[2] * 83492791) & (self.table - 1)

    @ti.func
    def sort(self, away):
        """Put all vertices into their buckets, each in the order of the vertices. One thread."""
        for bucket in range(self.table + 1):
            self.starts[bucket] = 0
        for i in range(self.count):
            bucket = self.bucket(self.cell(i, away))
            self.starts[bucket] = self.starts[bucket] + 1
        total = 0
        for bucket in range(self.table + 1):
            total += self.starts[bucket]
            self.starts[bucket] = total
        # These are the ends; each moves to the beginning while its bucket is filled, from the last vertex on.
        for back in range(self.count):
            i = self.count - 1 - back
            bucket = self.bucket(self.cell(i, away))
            self.starts[bucket] = self.starts[bucket] - 1
            self.member[self.starts[bucket]] = i

    @ti.func
    def force(self, i, away):
        """Return the force [N] on vertex i: sum_j min(k (l - r) + c d.(v_j - v_i) / l, 0) d / l over l = |d| < r, d = x_j - x_i."""
        total = ti.Vector([ti.cast(0.0, float) for _ in ti.static(range(3))])
        here = self.cell(i, away)
        for n in range(27):
            there = here + ti.Vector([n % 3 - 1, n // 3 % 3 - 1, n // 9 - 1])
            bucket = self.bucket(there)
            for m in range(self.starts[bucket], self.starts[bucket + 1]):
                j = self.member[m]
                # Two cells may share a bucket.
                if j != i and (self.cell(j, away) == there).all():
                    total += self._push(away + i, away + j)
        return total

    @ti.func
    def _push(self, i, j):
        d = ti.Vector([self.z[c][j] - self.z[c][i] for c in ti.static(range(3))])
        square = d.dot(d)
        result = ti.Vector([ti.cast(0.0, float) for _ in ti.static(range(3))])
        distance, stiffness, damping = self.law[0], self.law[1], self.law[2]
        if square > 0.0 and square < distance * distance:
            inverse = 1.0 / ti.sqrt(square)
            along = d.dot(ti.Vector([self.z[3 + c][j] - self.z[3 + c][i] for c in ti.static(range(3))]))
            # Damping slows down; it does not hold back what leaves.
            result = ti.min(stiffness * (1.0 - distance * inverse) + damping * along * inverse * inverse, 0.0) * d
        return result
