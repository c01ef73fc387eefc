"""What the coefficients of a one-step method imply: its order, its stability function and its stability limits.

Order: a Runge-Kutta method has order p when every rooted tree of at most p vertices satisfies phi(tree) = 1/gamma(tree)
(Butcher 1963; Hairer, Norsett, Wanner, Solving ODEs I, theorem II.2.13).
Stability: on x' = lambda x a step multiplies x by R(z), z = dt lambda (Hairer, Wanner, Solving ODEs II, chapter IV.2).

Coefficients that are exact (int, Fraction, or floats that round a simple fraction) are treated exactly; the others
carry rounding errors, and sums of them are compared with a tolerance relative to their terms.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from typing import TypeAlias

import numpy as np

from tparticles.errors import InputError
from tparticles.schemes.exact import rational, shown
from tparticles.schemes.polynomial import first_sign_change, trimmed

Number: TypeAlias = int | float | Fraction
Rows: TypeAlias = Sequence[Sequence[Number]]
# A rooted tree is the sorted tuple of the trees that hang from its root; () is the single vertex.
Tree: TypeAlias = "tuple[Tree, ...]"

# Sums of products of rounded coefficients are trusted to this, relative to the sizes of their terms ...
_TOLERANCE = Fraction(1, 10**12)
# ... but a table of huge coefficients that cancel must not make every condition true.
_LARGEST_ROUNDING = Fraction(1, 10**9)


def rounding(size: Number) -> Fraction:
    """Return by how much a sum of rounded coefficients may be off; `size` is the sum of its terms' absolute values."""
    return min(_TOLERANCE * Fraction(size), _LARGEST_ROUNDING)


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


def elementary_weight(tree: Tree, a: Rows, b: Sequence[Number]) -> Number:
    """Return phi(tree) = sum_i b_i prod over the children (A phi_child)_i.

    `a` holds s rows of up to s entries (missing ones are zero), `b` holds s weights; exact for Fractions.
    """
    return _dot(b, _stage_weights(tree, a, len(b)))


def _stage_weights(tree: Tree, a: Rows, s: int) -> list[Number]:
    weights: list[Number] = [1] * s
    for child in tree:
        inner = _stage_weights(child, a, s)
        weights = [weight * _dot(row, inner) for weight, row in zip(weights, a, strict=True)]
    return weights


def _dot(row: Sequence[Number], column: Sequence[Number]) -> Number:
    # strict=False: a row of an explicit tableau stops at its diagonal.
    return sum((left * right for left, right in zip(row, column, strict=False)), start=Fraction(0))


def condition_formula(tree: Tree) -> str:
    """Return the left side of the order condition of `tree` as printed in the literature, such as `b·(c A(c²))`."""
    return f"b·{_formula(tree)}" if tree else "b·1"


def _formula(tree: Tree) -> str:
    leaves = tree.count(())
    power = "c" + (str(leaves).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")) if leaves > 1 else "")
    factors = ([power] if leaves else []) + [f"A{_formula(child)}" for child in tree if child]
    return f"({' '.join(factors)})"


@dataclass(frozen=True)
class FailedCondition:
    """The first order condition that a tableau does not satisfy: phi(tree) is `value`, not `needed`."""

    tree: Tree
    value: Number
    needed: Fraction


def check_order_conditions(a: Rows, b: Sequence[Number]) -> tuple[int, FailedCondition]:
    """Return the order of a tableau and the first condition of the next order that fails.

    `a` holds s rows (explicit or implicit), `b` s weights, and c is taken to be the row sums of `a`.
    """
    rows, weights, exact = _as_fractions(a, b)
    order = 0
    # It ends: s stages reach order 2 s at most.
    while True:
        for tree in rooted_trees(order + 1):
            value, needed = elementary_weight(tree, rows, weights), Fraction(1, density(tree))
            allowed = 0 if exact else rounding(max(1, elementary_weight(tree, *_magnitudes(rows, weights))))
            if abs(value - needed) > allowed:
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


def stability_polynomial(a: Rows, b: Sequence[Number]) -> tuple[Number, ...]:
    """Return the coefficients of R(z) = 1 + sum_k z^(k+1) b^T A^k 1 of an explicit tableau, ascending.

    They are Fractions where the tableau is exact, floats where it carries rounding errors.
    Raises OverflowError if a float coefficient does not fit into float64.
    """
    rows, weights, exact = _as_fractions(a, b)
    R = _powers(rows, weights)
    if exact:
        return trimmed(R)
    sizes = _powers(*_magnitudes(rows, weights))
    kept = [c if abs(c) > rounding(size) else Fraction(0) for c, size in zip(R, sizes, strict=True)]
    # Trimmed after rounding, which may underflow to 0.
    return trimmed([float(coefficient) for coefficient in kept])


def _powers(a: Sequence[Sequence[Fraction]], b: Sequence[Fraction]) -> list[Fraction]:
    """Return [1, b^T 1, b^T A 1, b^T A^2 1, ...]."""
    column: list[Number] = [1] * len(b)
    R = [Fraction(1)]
    for _ in b:
        R.append(Fraction(_dot(b, column)))
        column = [_dot(row, column) for row in a]
    return R


def real_limit(R: Sequence[Number], denominator: Sequence[Number] = (1,)) -> float:
    """Return the largest r such that |R(-x)| <= 1 for all x in [0, r].

    R is given by its coefficients, ascending; a rational R also by its denominator's. 0.0 if every step grows,
    infinity if none does. Accurate to rounding.
    """
    return _stable_until(_excess(R, denominator, imaginary=False))


def imaginary_limit(R: Sequence[Number], denominator: Sequence[Number] = (1,)) -> float:
    """Return the largest r such that |R(iy)| <= 1 for all y in [0, r]; arguments and accuracy as `real_limit`."""
    return math.sqrt(_stable_until(_excess(R, denominator, imaginary=True)))


def _excess(N: Sequence[Number], D: Sequence[Number], *, imaginary: bool) -> list[Fraction]:
    """Return the coefficients of |N|^2 - |D|^2 in powers of x at z = -x, or of u = y^2 at z = iy."""
    N, D = [rational(n) for n in N], [rational(d) for d in D]
    exact = all(isinstance(entry, Fraction) for entry in [*N, *D])
    above = _squared_terms([Fraction(n) for n in N], imaginary=imaginary)
    below = _squared_terms([Fraction(d) for d in D], imaginary=imaginary)
    excess: list[Fraction] = []
    for m in range(max(len(above), len(below))):
        terms = [*(above[m] if m < len(above) else ()), *(-term for term in (below[m] if m < len(below) else ()))]
        total = sum(terms, start=Fraction(0))
        # What cancels in exact arithmetic leaves rounding errors in floats; they would decide the sign near 0.
        allowed = 0 if exact else _TOLERANCE * sum(abs(term) for term in terms)
        excess.append(total if abs(total) > allowed else Fraction(0))
    return excess


def _squared_terms(R: Sequence[Fraction], *, imaginary: bool) -> list[list[Fraction]]:
    """Return the terms of each coefficient of |R|^2, as for `_excess`."""
    terms: list[list[Fraction]] = [[] for _ in range(len(R) if imaginary else 2 * len(R) - 1)]
    for i, left in enumerate(R):
        for j, right in enumerate(R):
            if not imaginary:
                # r_i (-x)^i r_j (-x)^j
                terms[i + j].append((-1) ** (i + j) * left * right)
            elif (i + j) % 2 == 0:
                # r_i (iy)^i conj(r_j (iy)^j) = r_i r_j i^(i-j) y^(i+j); odd powers cancel in pairs
                terms[(i + j) // 2].append((-1) ** (abs(i - j) // 2) * left * right)
    return terms


def _stable_until(excess: Sequence[Fraction]) -> float:
    """Return the largest x such that the polynomial is <= 0 on [0, x]."""
    lowest = next((coefficient for coefficient in excess if coefficient), Fraction(0))
    return 0.0 if lowest > 0 else first_sign_change(excess)


@dataclass(frozen=True, kw_only=True)
class Stability:
    """The stability function R(z) = numerator(z) / denominator(z) of a one-step method, z = dt lambda.

    `numerator` and `denominator` are coefficients in ascending powers: int or Fraction where they are exact.
    Raises InputError if they are not tuples of finite numbers, or end with a zero (lengths tell the degrees).
    """

    numerator: tuple[Number, ...]
    denominator: tuple[Number, ...] = (1,)

    def __post_init__(self) -> None:
        for part in (self.numerator, self.denominator):
            numbers = isinstance(part, tuple) and all(isinstance(entry, int | float | Fraction) for entry in part)
            if not numbers or not part or not all(map(_is_finite, part)) or part[-1] == 0:
                raise InputError(
                    "a stability function needs tuples of finite coefficients in ascending powers "
                    f"whose last is not 0, not {shown(part)}"
                )

    def __call__(self, z: complex) -> complex:
        """Return R(z): the factor by which a step of dt multiplies the solution of x' = (z / dt) x."""
        return _horner(self.numerator, z) / _horner(self.denominator, z)

    @cached_property
    def real_limit(self) -> float:
        """Largest r with |R(-x)| <= 1 on [0, r]."""
        return real_limit(self.numerator, self.denominator)

    @cached_property
    def imaginary_limit(self) -> float:
        """Largest r with |R(iy)| <= 1 on [0, r]."""
        return imaginary_limit(self.numerator, self.denominator)

    @cached_property
    def a_stable(self) -> bool:
        """Whether |R| <= 1 in the whole left half-plane: on its border, and no pole inside (maximum principle)."""
        poles = np.roots([float(coefficient) for coefficient in reversed(self.denominator)])
        bounded_at_infinity = len(self.numerator) <= len(self.denominator)
        return bounded_at_infinity and self.imaginary_limit == math.inf and bool(np.all(poles.real > 0))

    @property
    def l_stable(self) -> bool:
        """Whether it is A-stable and R vanishes at infinity, so that one long step kills a stiff mode."""
        return len(self.numerator) < len(self.denominator) and self.a_stable


def _is_finite(value: Number) -> bool:
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _horner(coefficients: Sequence[Number], z: complex) -> complex:
    value = 0j
    for coefficient in reversed(coefficients):
        value = value * z + float(coefficient)
    return value
