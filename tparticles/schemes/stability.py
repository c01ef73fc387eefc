"""Stability functions as data: the limits and the damping that follow from them.

On x' = lambda x a step multiplies x by R(z), z = dt lambda (Hairer, Wanner, Solving ODEs II, chapter IV.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from tparticles.errors import InputError
from tparticles.schemes.exact import TOLERANCE, Number, is_finite, rational, shown
from tparticles.schemes.polynomial import first_sign_change
from tparticles.schemes.roots import damped_direction, on_ray, stable_until


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
        allowed = 0 if exact else TOLERANCE * sum(abs(term) for term in terms)
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
            numbers = isinstance(part, tuple) and all(map(is_finite, part))
            if not numbers or not part or part[-1] == 0:
                raise InputError(
                    "a stability function needs tuples of finite coefficients in ascending powers "
                    f"whose last is not 0, not {shown(part)}"
                )

    def __call__(self, z: complex) -> complex:
        """Return R(z): the factor by which a step of dt multiplies the solution of x' = (z / dt) x."""
        return _horner(self.numerator, z) / _horner(self.denominator, z)

    def amplification(self, z: complex) -> float:
        """Return |R(z)|."""
        return abs(self(z))

    def oscillator_limit(self, zeta: float = 0.0) -> float:
        """Largest omega dt up to which x'' = -omega^2 x - 2 zeta omega x' stays bounded, zeta >= 0."""
        if zeta == 0:
            return self.imaginary_limit
        if zeta >= 1:
            return self.real_limit / (zeta + math.sqrt(zeta**2 - 1))
        # R(z) = N / D is the root of D zeta - N.
        width = max(len(self.numerator), len(self.denominator))
        numerator, denominator = (
            [float(entry) for entry in part] + [0.0] * (width - len(part))
            for part in (self.numerator, self.denominator)
        )
        return stable_until(on_ray([[-entry for entry in numerator], denominator], damped_direction(zeta)))

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


def _horner(coefficients: Sequence[Number], z: complex) -> complex:
    value = 0j
    for coefficient in reversed(coefficients):
        value = value * z + float(coefficient)
    return value
