"""The local vectors of one block of lanes."""

from typing import Any

import taichi as ti


@ti.data_oriented
class Block:
    """The local vectors of one block, by name, while a kernel is traced: a list of them where a name stands for several.

    `k`: the slopes; component d of register j in lane l is k[d][j * lanes + l].
    """

    def __init__(self, layout: dict[str, int], vectors: list[Any], slopes: list[Any], lanes: int):
        self.k, self.lanes = slopes, lanes
        rest = iter(vectors)
        for name, count in layout.items():
            found = [next(rest) for _ in range(count)]
            setattr(self, name, found[0] if count == 1 else found)
