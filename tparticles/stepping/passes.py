"""How the steps of a mesh are cut into passes over its vertices: every evaluation with the ops behind it, in one.

Ops that look at nothing but a vertex itself ride along with the evaluation before them: what a pass over a large mesh costs is
memory. Where nothing looks at the mesh between two steps, they do so across the end of a step, too. Then symplectic Euler and
velocity Verlet take one pass a step, and a Runge-Kutta scheme one for each stage.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..schemes import OpKind
from .table import Table

PARTS = 3  # ranges of ops in a pass


class Pass(NamedTuple):
    """One pass, as the numbers that kernels read.

    `stage`: the op that evaluates, or is solved for, before all else; -1: none. `turns`: whether other vertices may still need the
    state that the ops change. The ops run in three ranges: what follows the stage, what ends the step, what begins the next one.
    `begins`: bit n is set where a step begins before range n.
    """

    stage: int
    turns: int
    first: int
    last: int
    end_first: int = 0
    end_last: int = 0
    next_first: int = 0
    next_last: int = 0
    begins: int = 0

    @property
    def runs(self) -> bool:
        """Whether there are any ops in it."""
        return self.last > self.first or self.end_last > self.end_first or self.next_last > self.next_first


class Passes:
    """The passes of a scheme.

    Arguments:
        table: its programs.
        reuses: 1 if the last slope of a step is the first of the next.
    """

    def __init__(self, table: Table, *, reuses: int):
        self.table, self.reuses = table, reuses
        self._steps_back = table.scheme.steps_back
        self.step = cache(self._step)

    def run(self, count: int, held: int, fresh: int) -> Iterator[tuple[int, np.ndarray]]:
        """Yield (how many times, passes) for `count` steps on end that nothing comes between.

        `held`: how many steps the past holds; `fresh`: 1 if k_0 is known.
        """
        begun = 0
        while count > 0:
            starting, held = int(held < self._steps_back), min(held + 1, self._steps_back)
            steady = not starting and bool(begun) and fresh == self.reuses
            times = count - 1 if steady and count > 1 else 1
            count -= times
            after = int(held < self._steps_back) if count else -1
            yield times, self.step(starting, fresh, begun, after, ends=True)
            fresh, begun = self.reuses, 1

    def programs(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the passes of all programs without what ends a step, and where each begins: 2 starting + fresh of them."""
        # a record works k_0 out before a step, where the program begins with it
        known = (0, 1) if self.reuses or self.table.probe < 0 else (0,)
        there = [e > 0 for e in np.diff(self.table.edges[:3])]
        found = [
            self.step(starting, fresh, ends=False) if there[starting] and fresh in known else np.zeros((0, 9), np.int32)
            for starting in (0, 1)
            for fresh in (0, 1)
        ]
        return np.concatenate(found), np.cumsum([0, *map(len, found)]).astype(np.int32)

    def _step(self, starting: int, fresh: int, begun: int = 0, after: int = -1, *, ends: bool) -> np.ndarray:
        """Return the passes of a step, int32 (n, 9), by the scheme's program, or where `starting` by its starter's.

        `fresh`: 1 if k_0 is known. `begun`: 1 if the step before has begun this one. `after`: begin the next step, which is
        `starting` or not; -1: leave it alone. `ends`: run what ends the step.
        """
        edges = self.table.edges
        found = self._parts(starting, fresh)
        if begun and found[0].stage < 0:
            del found[0]
        else:
            found[0] = found[0]._replace(begins=1)
        if ends:
            found[-1] = found[-1]._replace(end_first=edges[2 + starting], end_last=edges[3 + starting])
        if after >= 0 and (head := self._parts(after, self.reuses)[0]).stage < 0:
            found[-1] = found[-1]._replace(next_first=head.first, next_last=head.last, begins=found[-1].begins | 4)
        return np.array([p._replace(turns=int(p.stage >= 0 and p.runs)) for p in found], np.int32)

    def _parts(self, starting: int, fresh: int) -> list[Pass]:
        """Return the passes of a program: what comes before its first stage, if anything does, and one for each stage."""
        kinds = self.table.ops[:, 0]
        op, last = (int(edge) for edge in self.table.edges[starting : starting + 2])
        op += fresh
        stops = [*(n for n in range(op, last) if kinds[n] in (OpKind.EVALUATE, OpKind.SOLVE)), last]
        found = []
        # what is solved for is put in place from outside: nothing rides along
        if stops[0] > op or kinds[op] == OpKind.SOLVE:
            found.append(Pass(-1, 0, op, stops[0]))
        for stage, end in pairwise(stops):
            if kinds[stage] == OpKind.EVALUATE:
                found.append(Pass(stage, 0, stage + 1, end))
            else:
                found.append(Pass(stage, 0, end, end))
                if end > stage + 1:
                    found.append(Pass(-1, 0, stage + 1, end))
        return found
