"""Exact polynomials in one variable: where does one first change sign on the positive axis?

Stability limits are such places. Near them the polynomial is tiny (|R(iy)|^2 - 1 ~ y^6 for RK4) and touching roots
are common by design, so rounding must not decide: all arithmetic is in integers and Fractions.

A polynomial is a tuple of coefficients in ascending powers, without leading zeros; `()` is the zero polynomial.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from typing import TypeAlias, TypeVar

Poly: TypeAlias = tuple[Fraction, ...]

# Roots are bisected to this relative width: below the spacing of float64, so that 2 comes out as 2.0.
_ROOT_WIDTH = Fraction(1, 2**60)


_Number = TypeVar("_Number", Fraction, float)


def trimmed(p: Sequence[_Number]) -> tuple[_Number, ...]:
    """Return `p` without leading zeros."""
    n = len(p)
    while n and p[n - 1] == 0:
        n -= 1
    return tuple(p[:n])


def first_sign_change(p: Sequence[Fraction]) -> float:
    """Return the smallest x > 0 at which `p` changes sign, or infinity.

    Roots of even multiplicity, where `p` touches zero and turns back, do not count. Yun's square-free factors give
    the roots of odd multiplicity, a Sturm chain isolates the smallest, and bisection places it to float64 accuracy.
    Raises nothing for finite coefficients.
    """
    lowest = next((k for k, coefficient in enumerate(p) if coefficient), len(p))
    odd = _odd_part(trimmed(p[lowest:]))
    if len(odd) < 2:
        return math.inf
    return _smallest_positive_root(odd)


def _derivative(p: Poly) -> Poly:
    return tuple(k * coefficient for k, coefficient in enumerate(p))[1:]


def _divide(p: Poly, q: Poly) -> tuple[Poly, Poly]:
    """Return quotient and remainder of p / q."""
    rest = list(p)
    quotient = [Fraction(0)] * max(len(p) - len(q) + 1, 0)
    for shift in reversed(range(len(quotient))):
        factor = quotient[shift] = rest[shift + len(q) - 1] / q[-1]
        for k, coefficient in enumerate(q):
            rest[shift + k] -= factor * coefficient
    return tuple(quotient), trimmed(rest[: len(q) - 1])


def _primitive(p: Poly) -> Poly:
    """Return `p` times the positive number that makes its coefficients coprime integers: it keeps them small."""
    if not p:
        return p
    scale = math.lcm(*(coefficient.denominator for coefficient in p))
    numerators = [int(coefficient * scale) for coefficient in p]
    common = math.gcd(*numerators)
    return tuple(Fraction(numerator // common) for numerator in numerators)


def quotient(p: Poly, q: Poly) -> Poly:
    """Return p / q, which must leave no remainder."""
    return _divide(p, q)[0]


def greatest_common_divisor(p: Poly, q: Poly) -> Poly:
    """Return the common divisor of `p` and `q` of the highest degree, with coprime integers."""
    while q:
        p, q = q, _primitive(_divide(p, q)[1])
    return _primitive(p)


def _odd_part(p: Poly) -> Poly:
    """Return the product of the distinct factors of `p` of odd multiplicity (Yun's square-free factorisation)."""
    if len(p) < 2:
        return p
    odd: Poly = (Fraction(1),)
    repeated = greatest_common_divisor(p, _derivative(p))
    distinct = _divide(p, repeated)[0]
    multiplicity = 1
    while len(distinct) > 1:
        common = greatest_common_divisor(distinct, repeated)
        if multiplicity % 2:
            odd = _product(odd, _divide(distinct, common)[0])
        distinct, repeated = common, _divide(repeated, common)[0]
        multiplicity += 1
    return _primitive(odd)


def _product(p: Poly, q: Poly) -> Poly:
    out = [Fraction(0)] * (len(p) + len(q) - 1)
    for i, left in enumerate(p):
        for j, right in enumerate(q):
            out[i + j] += left * right
    return tuple(out)


def _sturm_chain(p: Poly) -> list[list[int]]:
    """Return p, p', and the negated remainders, scaled to integers."""
    chain = [_primitive(p), _primitive(_derivative(p))]
    while remainder := _divide(chain[-2], chain[-1])[1]:
        chain.append(_primitive(tuple(-coefficient for coefficient in remainder)))
    return [[int(coefficient) for coefficient in q] for q in chain]


def _sign_variations(chain: list[list[int]], x: Fraction) -> int:
    """Return how often the sign changes along the chain at x; its drop over (lo, hi] counts the roots there."""
    negative: list[bool] = []
    for q in chain:
        # Horner on q(m/d) d^n, which has the sign of q(x) and stays in integers.
        value, power = 0, 1
        for coefficient in reversed(q):
            value = value * x.numerator + coefficient * power
            power *= x.denominator
        if value:
            negative.append(value < 0)
    return sum(left != right for left, right in pairwise(negative))


def _power_of_two_above(value: Fraction) -> int:
    """Return an exponent e with 2^e > value > 0."""
    return value.numerator.bit_length() - value.denominator.bit_length() + 1


def _smallest_positive_root(p: Poly) -> float:
    """Return the smallest positive root of the square-free `p`, p(0) != 0, or infinity if it has none."""
    # Cauchy: every root is smaller than 1 + max |p_k / p_n|, and its inverse than 1 + max |p_k / p_0|.
    largest = max(abs(coefficient) for coefficient in p)
    high = _power_of_two_above(1 + largest / abs(p[-1]))
    low = -_power_of_two_above(1 + largest / abs(p[0]))
    chain = _sturm_chain(p)
    at_low = _sign_variations(chain, _two_to(low))
    if at_low == _sign_variations(chain, _two_to(high)):
        return math.inf
    # Halve the exponent range first, the interval after: coefficients may span hundreds of decades.
    while high - low > 1:
        middle = (low + high) // 2
        if _sign_variations(chain, _two_to(middle)) < at_low:
            high = middle
        else:
            low = middle
    lo, hi = _two_to(low), _two_to(high)
    while hi - lo > _ROOT_WIDTH * hi:
        x = (lo + hi) / 2
        if _sign_variations(chain, x) < at_low:
            hi = x
        else:
            lo = x
    return float((lo + hi) / 2)


def _two_to(exponent: int) -> Fraction:
    return Fraction(2) ** exponent
