"""Explicit Runge-Kutta methods from their Butcher tableau."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from numbers import Rational, Real

import numpy as np

from tparticles.errors import InputError
from tparticles.schemes.analysis import (
    Number,
    Stability,
    check_order_conditions,
    condition_formula,
    rounding,
    stability_polynomial,
)
from tparticles.schemes.exact import rational, shown
from tparticles.schemes.program import Op, OpKind, Scheme


def runge_kutta(
    a: Sequence[Sequence[Number]],
    b: Sequence[Number],
    *,
    name: str,
    order: int | None = None,
    c: Sequence[Number] | None = None,
    reference: str = "",
) -> Scheme:
    """Return the explicit Runge-Kutta method k_i = f(t + c_i dt, z0 + dt sum_j a_ij k_j), z = z0 + dt sum_i b_i k_i.

    `a`: s rows; row i holds up to i entries (missing ones are zero), or all s with zeros on and above the diagonal.
    `b`: s weights that sum to 1. `c`: s stage times, the row sums of `a` if left out. Entries are int, float or
    Fraction; Fractions, and floats that round a simple fraction, are analysed exactly.
    `order`: what the caller believes; the order is worked out from the order conditions, and a wrong claim is refused.
    `reference`: citation.
    Raises InputError, naming the scheme and the value: entries that are not finite numbers, wrong shapes, implicit
    stages, sum(b) != 1, c that are not the row sums, a claimed order that is not the computed one.
    Source: Butcher, Numerical Methods for Ordinary Differential Equations, section 23.
    """
    if not isinstance(name, str) or not name:
        raise InputError(f"a scheme's name must be a non-empty string, not {shown(name)}")
    where = f"scheme '{name}'"
    weights = _numbers(b, "b", where)
    if not weights:
        raise InputError(f"{where}: b is empty, a method has at least one stage")
    rows = _explicit_rows(a, len(weights), where)
    _check_weights(weights, where)
    times = _stage_times(c, rows, where)
    computed = _checked_order(rows, weights, order, where)
    return Scheme(
        name=name,
        order=computed,
        ops=_program(rows, weights, times, where),
        slopes=len(weights),
        stability=_stability(rows, weights, where),
        reference=reference,
    )


def _numbers(values: object, what: str, where: str) -> list[Number]:
    return [_number(value, f"{what}[{i}]", where) for i, value in enumerate(_listed(values, what, "numbers", where))]


def _listed(values: object, what: str, items: str, where: str) -> list[object]:
    """Return the items of a list, tuple or array; a set has no order, and an iterator could be endless."""
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


def _explicit_rows(a: object, s: int, where: str) -> list[list[Number]]:
    """Return row i of `a` with exactly i entries."""
    listed = _listed(a, "a", "rows", where)
    if len(listed) != s:
        raise InputError(f"{where}: a has {len(listed)} rows, but b has {s} weights")
    rows: list[list[Number]] = []
    for i, row in enumerate(listed):
        entries = _numbers(row, f"a[{i}]", where)
        if len(entries) not in {*range(i + 1), s}:
            raise InputError(f"{where}: a[{i}] has {len(entries)} entries, allowed are up to {i}, or all {s}")
        for j, entry in enumerate(entries[i:], start=i):
            if entry != 0:
                raise InputError(
                    f"{where}: a[{i}][{j}] is {shown(entry)}, but entries on and above the diagonal must be 0: "
                    "runge_kutta takes explicit methods"
                )
        rows.append([*entries[:i], *[Fraction(0)] * (i - len(entries))])
    return rows


def _check_weights(b: list[Number], where: str) -> None:
    if not _is_sum(1, b):
        raise InputError(f"{where}: b must sum to 1, not {shown(_sum(b))}")


def _stage_times(c: object, rows: list[list[Number]], where: str) -> list[Number]:
    if c is None:
        return [_sum(row) for row in rows]
    times = _numbers(c, "c", where)
    if len(times) != len(rows):
        raise InputError(f"{where}: c has {len(times)} entries, but b has {len(rows)} weights")
    for i, (time, row) in enumerate(zip(times, rows, strict=True)):
        if not _is_sum(time, row):
            raise InputError(f"{where}: c[{i}] is {shown(time)}, but row {i} of a sums to {shown(_sum(row))}")
    return times


def _sum(values: list[Number]) -> Fraction:
    return sum((Fraction(value) for value in values), start=Fraction(0))


def _is_sum(claimed: Number, values: list[Number]) -> bool:
    exact = all(isinstance(value, int | Fraction) for value in [claimed, *values])
    allowed = 0 if exact else rounding(max(1, _sum([abs(value) for value in values])))
    return abs(Fraction(claimed) - _sum(values)) <= allowed


def _checked_order(rows: list[list[Number]], b: list[Number], claimed: object, where: str) -> int:
    if claimed is not None and (not isinstance(claimed, int) or isinstance(claimed, bool)):
        raise InputError(f"{where}: order must be an integer, not {shown(claimed)}")
    computed, failed = check_order_conditions(rows, b)
    if claimed is None or claimed == computed:
        return computed
    message = f"{where}: claimed order {shown(claimed)}, but the order conditions hold up to order {computed}"
    if claimed > computed:
        message += (
            f"; the first that fails, at order {computed + 1}, is {condition_formula(failed.tree)} = "
            f"{failed.needed}: it is {shown(failed.value)}"
        )
    raise InputError(message)


def _stability(rows: list[list[Number]], b: list[Number], where: str) -> Stability:
    try:
        R = stability_polynomial(rows, b)
        _ = [float(coefficient) for coefficient in R]
    except OverflowError:
        raise InputError(f"{where}: the coefficients of a are so large that R(z) overflows float64") from None
    return Stability(numerator=R)


def _program(rows: list[list[Number]], b: list[Number], c: list[Number], where: str) -> tuple[Op, ...]:
    ops: list[Op] = []
    for i, (row, time) in enumerate(zip(rows, c, strict=True)):
        # The first stage looks at z as it is; every later one first builds its own.
        if i > 0:
            ops.append(Op(OpKind.COMBINE, weights=tuple(float(weight) for weight in row)))
        ops.append(Op(OpKind.EVALUATE, slope=i, time=_as_float(time, f"c[{i}]", where)))
    ops.append(Op(OpKind.COMBINE, weights=tuple(float(weight) for weight in b)))
    return tuple(ops)


def _as_float(value: Number, what: str, where: str) -> float:
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{where}: {what} must be finite in float64, not {shown(value)}") from None
