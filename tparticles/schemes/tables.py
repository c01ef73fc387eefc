"""Tables of coefficients as users write them: lists, tuples or arrays of int, float and Fraction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from numbers import Rational, Real

import numpy as np

from tparticles.errors import InputError
from tparticles.schemes.exact import Number, rational, rounding, shown


def checked_name(name: object) -> str:
    """Return how messages about the scheme of that name begin.

    Raises InputError if it is not a non-empty string.
    """
    if not isinstance(name, str) or not name:
        raise InputError(f"a scheme's name must be a non-empty string, not {shown(name)}")
    return f"scheme '{name}'"


def numbers(values: object, what: str, where: str) -> list[Number]:
    """Return the numbers of a sequence: Fractions where they stand for one, else floats.

    Raises InputError, beginning with `where` and naming `what`, for anything that is not a sequence of finite numbers.
    """
    return [_number(value, f"{what}[{i}]", where) for i, value in enumerate(listed(values, what, "numbers", where))]


def listed(values: object, what: str, items: str, where: str) -> list[object]:
    """Return the items of a list, tuple or array; a set has no order, and an iterator could be endless.

    Raises InputError for anything else.
    """
    if isinstance(values, np.ndarray) and values.ndim > 0:
        return list(values)
    if isinstance(values, Sequence) and not isinstance(values, str | bytes):
        return list(values)
    raise InputError(f"{where}: {what} must be a sequence of {items}, not {shown(values)}")


def _number(value: object, what: str, where: str) -> Number:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(f"{where}: {what} must be a number, not {shown(value)}")
    try:
        as_float = float(value)
    except OverflowError:
        as_float = math.inf
    if not math.isfinite(as_float):
        raise InputError(f"{where}: {what} must be finite in float64, not {shown(value)}")
    return rational(value if isinstance(value, Rational) else as_float)


def total(values: Sequence[Number]) -> Fraction:
    """Return the exact sum."""
    return sum((Fraction(value) for value in values), start=Fraction(0))


def is_sum(claimed: Number, values: Sequence[Number]) -> bool:
    """Return whether `values` sum to `claimed`: exactly, or up to rounding where some are rounded."""
    exact = all(isinstance(value, int | Fraction) for value in [claimed, *values])
    allowed = 0 if exact else rounding(max(1, total([abs(value) for value in values])))
    return abs(Fraction(claimed) - total(values)) <= allowed


def check_sum_is_one(values: Sequence[Number], what: str, where: str) -> None:
    """Raise InputError, naming the sum, if `values` do not sum to 1."""
    if not is_sum(1, values):
        raise InputError(f"{where}: {what} must sum to 1, not {shown(total(values))}")


def as_float(value: Number, what: str, where: str) -> float:
    """Return `value` as a float; raises InputError if it is out of range."""
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{where}: {what} must be finite in float64, not {shown(value)}") from None
