"""Numbers as they stand in tables of coefficients: which are exact, and how they are shown in a message."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache
from numbers import Rational
from typing import TypeAlias

Number: TypeAlias = int | float | Fraction

# Fractions with denominators up to this are further apart than the spacing of float64 near 1 by far (1e-12 against
# 1e-16), so that a float up to there is the rounding of at most one of them.
_LARGEST_DENOMINATOR = 10**6

# Sums of products of rounded coefficients are trusted to this, relative to the sizes of their terms ...
TOLERANCE = Fraction(1, 10**12)
# ... but a table of huge coefficients that cancel must not make every condition true.
_LARGEST_ROUNDING = Fraction(1, 10**9)


def rounding(size: Number) -> Fraction:
    """Return by how much a sum of rounded coefficients may be off; `size` is the sum of its terms' absolute values."""
    return min(TOLERANCE * Fraction(size), _LARGEST_ROUNDING)


def is_finite(value: object) -> bool:
    """Return whether `value` is an int, float or Fraction that float64 can hold."""
    try:
        return isinstance(value, int | float | Fraction) and math.isfinite(float(value))
    except OverflowError:
        return False


def rational(value: float | Rational) -> Fraction | float:
    """Return the Fraction that `value` stands for, or `value` itself where it stands for none.

    A float that is the rounding of a fraction with a small denominator (1/6, 0.1, 46732/5247) is that fraction;
    any other float ((3 - sqrt 3)/6) is returned as it is, which tells the caller that it carries a rounding error.
    """
    if not isinstance(value, float) and isinstance(value, Rational):
        # numpy's integers count as rational too, but overflow.
        return Fraction(int(value.numerator), int(value.denominator))
    return _simple(float(value))


# The same few coefficients come again and again.
@lru_cache(maxsize=4096)
def _simple(value: float) -> Fraction | float:
    guess = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return guess if float(guess) == value else value


def shown(value: object) -> str:
    """Return `value` for a message: fractions short or rounded, anything else as Python prints it, cut at 80."""
    try:
        if isinstance(value, Fraction):
            short = max(abs(value.numerator), value.denominator) < 10**8
            return str(value) if short else f"{float(value):.15g}"
        text = repr(value)
    except (OverflowError, ValueError):
        # Python refuses to print integers of thousands of digits.
        return f"a {type(value).__name__} too large to print"
    return text if len(text) <= 80 else f"{text[:77]}..."
