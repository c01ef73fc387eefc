"""A scheme's program as the arrays that kernels walk, and what has to be known of it when they are compiled."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..schemes import Op, OpKind, Scheme


@dataclass(frozen=True)
class Table:
    """The programs of a scheme in one table of ops.

    `ops`, int32 (n, 5 + registers): kind; register written; register read by a ROTATE; whether a SOLVE is linear; from 4 on the
    registers with a weight other than 0, or register 0, and behind them -1: LLVM cannot count a loop that ends there,
    and does not unroll it.
    `edges`: where in it the parts begin: the program, the starter's, what follows an accepted step of the one and of the other, the
    probe k_0 = f(t, z), the row of error weights.
    `coefficients`, (n + 1, w): time and weights of each op, after them (n0, n1, d) for each weight where steps vary; in the last
    row the error weights.
    """

    scheme: Scheme
    ops: np.ndarray
    edges: np.ndarray
    coefficients: np.ndarray
    inner: tuple[Op, ...]  # ops that run before it is known whether the step is accepted

    @classmethod
    def of(cls, scheme: Scheme) -> Table:
        """Lay out the programs of `scheme`."""
        run, after = _split(scheme.ops)
        start, after_start = _split(scheme.starting_ops)
        parts = [run, start, [*after, *scheme.history], [*after_start, *scheme.history], [Op(OpKind.EVALUATE)]]
        ops = [op for part in parts for op in part]
        width, variable = scheme.registers, any(op.variable for op in ops)
        table = np.zeros((len(ops), 5 + width), np.int32)
        rows = np.zeros((len(ops) + 1, 1 + width * (4 if variable else 1)))
        for i, op in enumerate(ops):
            weighted = [j for j, weight in enumerate(op.weights) if weight] or [0]
            table[i, :4] = op.kind, op.slope, op.source, op.linear
            table[i, 4 : 5 + len(weighted)] = *weighted, -1
            rows[i, 0] = op.time
            rows[i, 1 : 1 + len(op.weights)] = op.weights
            if variable:
                triples = op.variable or [(weight, 0.0, 0.0) for weight in op.weights]
                rows[i, 1 + width : 1 + width + 3 * len(triples)] = np.ravel(triples)
        # The error is measured before the copies at the program's end: a weight goes to the register that is copied.
        source = list(range(width))
        for op in after:
            source[op.slope] = source[op.source]
        for j, weight in enumerate(scheme.error_weights):
            rows[-1, 1 + source[j]] += weight
        edges = np.cumsum([0, *map(len, parts)]).astype(np.int32)
        return cls(scheme, table, edges, rows, (*run, *start))

    @cached_property
    def kinds(self) -> frozenset[int]:
        """The kinds of ops that occur."""
        return frozenset(int(kind) for kind in self.ops[:, 0])

    @property
    def implicit(self) -> bool:
        """Whether a stage has to be solved for, by the scheme or its starter."""
        return int(OpKind.SOLVE) in self.kinds

    @property
    def probe(self) -> int:
        """The register for the slope where a step begins, beyond the scheme's own; -1 where the program begins with that slope."""
        first = self.edges[: 1 if self.edges[1] == self.edges[2] else 2]
        begins = (self.ops[first, 0] == int(OpKind.EVALUATE)) & (self.coefficients[first, 0] == 0.0)
        own = not self.implicit and int(OpKind.DIFFERENCE) not in self.kinds
        return -1 if own and begins.all() else self.scheme.registers

    @property
    def rotates(self) -> bool:
        """Whether slopes are copied within a step."""
        return any(op.kind is OpKind.ROTATE for op in self.inner)

    @property
    def differs(self) -> bool:
        """Whether a mean slope is taken within a step."""
        return any(op.kind is OpKind.DIFFERENCE for op in self.inner)

    @property
    def shifts(self) -> bool:
        """Whether slopes are copied after a step."""
        return bool(self.edges[4] > self.edges[2])

    @property
    def variable(self) -> bool:
        """Whether weights depend on the ratio of a step to the one before."""
        return self.coefficients.shape[1] > 1 + self.scheme.registers

    def reuses(self, *, velocity_free: bool) -> bool:
        """Whether k_0 of the next step is known: nothing changes v after its evaluation, or v does not matter."""
        scheme = self.scheme
        known = scheme.reuses and (scheme.starter is None or scheme.starter.reuses)
        return known and (velocity_free or not scheme.kicks_after_evaluation)


def _split(ops: tuple[Op, ...]) -> tuple[list[Op], list[Op]]:
    """Split a program behind the last op that computes something: copies after it wait until the step is accepted."""
    end = max((i + 1 for i, op in enumerate(ops) if op.kind is not OpKind.ROTATE), default=0)
    return list(ops[:end]), list(ops[end:])
