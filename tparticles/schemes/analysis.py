"""What the coefficients of a Runge-Kutta tableau imply: its order and its stability function.

Order: a Runge-Kutta method has order p when every rooted tree of at most p vertices satisfies phi(tree) = 1/gamma(tree)
(Butcher 1963; Hairer, Norsett, Wanner, Solving ODEs I, theorem II.2.13).

Coefficients that are exact (int, Fraction, or floats that round a simple fraction) are treated exactly; the others
carry rounding errors, and sums of them are compared with a tolerance relative to their terms.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cache
from typing import NamedTuple, TypeAlias

from tparticles.schemes.exact import Number, rational, rounding
from tparticles.schemes.polynomial import trimmed

Rows: TypeAlias = Sequence[Sequence[Number]]
# A rooted tree is the sorted tuple of the trees that hang from its root; () is the single vertex.
Tree: TypeAlias = "tuple[Tree, ...]"


@cache
def rooted_trees(order: int) -> tuple[Tree, ...]:
    """Return every rooted tree of `order` >= 1 vertices: 1, 1, 2, 4, 9, 20, 48 ... of them, each once."""
    if order == 1:
        return ((),)
    return tuple(sorted({tree for smaller in rooted_trees(order - 1) for tree in _with_one_more_leaf(smaller)}))


def _with_one_more_leaf(tree: Tree) -> Iterator[Tree]:
    yield tuple(sorted((*tree, ())))
    for i, child in enumerate(tree):
        for grown in _with_one_more_leaf(child):
            yield tuple(sorted((*tree[:i], grown, *tree[i + 1 :])))


def tree_order(tree: Tree) -> int:
    """Return the number of vertices of `tree`."""
    return 1 + sum(tree_order(child) for child in tree)


@cache
def density(tree: Tree) -> int:
    """Return gamma(tree): its vertex count times the densities of the trees that hang from its root."""
    return tree_order(tree) * math.prod(density(child) for child in tree)


class _Tableau:
    """Elementary weights of one tableau. What hangs from a root is worked out once: trees of higher order share it."""

    def __init__(self, a: Rows, b: Sequence[Number]):
        self.a, self.b = a, b
        self._known: dict[Tree, list[Number]] = {}

    def weight(self, tree: Tree) -> Number:
        """Return phi(tree) = sum_i b_i prod over the children (A phi_child)_i."""
        return _dot(self.b, self._stages(tree))

    def _stages(self, tree: Tree) -> list[Number]:
        weights: list[Number] = [1] * len(self.b)
        for child in tree:
            if child not in self._known:
                inner = self._stages(child)
                self._known[child] = [_dot(row, inner) for row in self.a]
            weights = [left * right for left, right in zip(weights, self._known[child], strict=True)]
        return weights


def elementary_weight(tree: Tree, a: Rows, b: Sequence[Number]) -> Number:
    """Return phi(tree) = sum_i b_i prod over the children (A phi_child)_i.

    `a` holds s rows of up to s entries (missing ones are zero), `b` holds s weights; exact for Fractions.
    """
    return _Tableau(a, b).weight(tree)


def _dot(row: Sequence[Number], column: Sequence[Number]) -> Number:
    # strict=False: a row of an explicit tableau stops at its diagonal.
    return sum((left * right for left, right in zip(row, column, strict=False) if left), start=Fraction(0))


def condition_formula(tree: Tree) -> str:
    """Return the left side of the order condition of `tree` as printed in the literature, such as `b·(c A(c²))`."""
    return f"b·{_formula(tree)}" if tree else "b·1"


def _formula(tree: Tree) -> str:
    leaves = tree.count(())
    power = "c" + (str(leaves).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")) if leaves > 1 else "")
    factors = ([power] if leaves else []) + [f"A{_formula(child)}" for child in tree if child]
    return f"({' '.join(factors)})"


class FailedCondition(NamedTuple):
    """The first order condition that a tableau does not satisfy: phi(tree) is `value`, not `needed`."""

    tree: Tree
    value: Number
    needed: Fraction


def check_order_conditions(a: Rows, b: Sequence[Number]) -> tuple[int, FailedCondition]:
    """Return the order of a tableau and the first condition of the next order that fails.

    `a` holds s rows (explicit or implicit), `b` s weights, and c is taken to be the row sums of `a`.
    """
    rows, weights, exact = _as_fractions(a, b)
    tableau, magnitudes = _Tableau(rows, weights), _Tableau(*_magnitudes(rows, weights))
    order = 0
    # It ends: s stages reach order 2 s at most.
    while True:
        for tree in rooted_trees(order + 1):
            value, needed = tableau.weight(tree), Fraction(1, density(tree))
            off = abs(value - needed)
            # what rounding may do grows with the terms; they need not be looked at where one as large as 1 explains it
            if off and (exact or (off > rounding(1) and off > rounding(max(1, magnitudes.weight(tree))))):
                return order, FailedCondition(tree, value, needed)
        order += 1


def runge_kutta_order(a: Rows, b: Sequence[Number]) -> int:
    """Return the order of the Runge-Kutta method with matrix `a` (s rows) and weights `b` (s); 0 if sum(b) != 1."""
    return check_order_conditions(a, b)[0]


def _as_fractions(a: Rows, b: Sequence[Number]) -> tuple[list[list[Fraction]], list[Fraction], bool]:
    rows = [[rational(entry) for entry in row] for row in a]
    weights = [rational(entry) for entry in b]
    exact = all(isinstance(entry, Fraction) for row in [*rows, weights] for entry in row)
    return [[Fraction(entry) for entry in row] for row in rows], [Fraction(entry) for entry in weights], exact


def _magnitudes(a: Sequence[Sequence[Fraction]], b: Sequence[Fraction]) -> tuple[list[list[Fraction]], list[Fraction]]:
    return [[abs(entry) for entry in row] for row in a], [abs(entry) for entry in b]


def stability_function(a: Rows, b: Sequence[Number]) -> tuple[tuple[Number, ...], tuple[Number, ...]]:
    """Return numerator and denominator of R(z) = 1 + z b^T (I - z A)^-1 1 of a tableau with zeros above its diagonal.

    Coefficients ascend; Fractions where the tableau is exact, floats where it carries rounding errors.
    Raises OverflowError if a float coefficient does not fit into float64.
    """
    rows, weights, exact = _as_fractions(a, b)
    diagonal = [row[i] for i, row in enumerate(rows) if len(row) > i]
    series, D = _powers(rows, weights), _denominator(diagonal)
    # N = D R as power series; its degree is s at most.
    N = _truncated_product(series, D)
    if exact:
        return trimmed(N), trimmed(D)
    sizes = _truncated_product(_powers(*_magnitudes(rows, weights)), _denominator([-abs(entry) for entry in diagonal]))
    kept = [c if abs(c) > rounding(size) else Fraction(0) for c, size in zip(N, sizes, strict=True)]
    # Trimmed after rounding, which may underflow to 0.
    return trimmed([float(entry) for entry in kept]), trimmed([float(entry) for entry in D])


def _denominator(diagonal: Sequence[Fraction]) -> list[Fraction]:
    """Return the product of (1 - a_ii z)."""
    D = [Fraction(1)]
    for entry in diagonal:
        D = [left - entry * right for left, right in zip([*D, Fraction(0)], [Fraction(0), *D], strict=True)]
    return list(trimmed(D))


def _truncated_product(series: Sequence[Fraction], factor: Sequence[Fraction]) -> list[Fraction]:
    return [
        sum((series[k - j] * entry for j, entry in enumerate(factor[: k + 1])), start=Fraction(0))
        for k in range(len(series))
    ]


def _powers(a: Sequence[Sequence[Fraction]], b: Sequence[Fraction]) -> list[Fraction]:
    """Return [1, b^T 1, b^T A 1, b^T A^2 1, ...]."""
    column: list[Number] = [1] * len(b)
    R = [Fraction(1)]
    for _ in b:
        R.append(Fraction(_dot(b, column)))
        column = [_dot(row, column) for row in a]
    return R
