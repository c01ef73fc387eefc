"""The local vectors of one block of lanes."""

# pyright: reportInvalidTypeForm=false

from typing import Any

import taichi as ti


@ti.data_oriented
class Block:
    """The local vectors of one block, by name, while a kernel is traced: a list of them where a name stands for several.

    `k`: the slopes; component d of register j in lane l is k[d][j * lanes + l].
    """

    z: list[Any]
    z0: list[Any]
    h: Any

    def __init__(self, layout: dict[str, int], vectors: list[Any], slopes: list[Any], lanes: int):
        self.k, self.lanes = slopes, lanes
        rest = iter(vectors)
        for name, count in layout.items():
            found = [next(rest) for _ in range(count)]
            setattr(self, name, found[0] if count == 1 else found)

    @ti.func
    def rotate(self, to, source, taking: ti.template()):
        """Copy register `source` to register `to`, for the lanes that are `taking` it."""
        for d in ti.static(range(len(self.k))):
            values = ti.Vector([0.0] * ti.static(self.lanes))  # for all that LLVM knows, the registers overlap
            for lane in range(self.lanes):
                there, here = self.k[d][source * self.lanes + lane], self.k[d][to * self.lanes + lane]
                values[lane] = ti.select(taking[lane] > 0, there, here)
            for lane in range(self.lanes):
                self.k[d][to * self.lanes + lane] = values[lane]

    @ti.func
    def difference(self, to, taking: ti.template()):
        """Put the mean slope (z - z0) / dt into register `to`, for the lanes that are `taking` it."""
        for lane in range(self.lanes):
            for d in ti.static(range(len(self.k))):
                i, value = to * self.lanes + lane, (self.z[d][lane] - self.z0[d][lane]) / self.h[lane]
                self.k[d][i] = ti.select(taking[lane] > 0, value, self.k[d][i])
