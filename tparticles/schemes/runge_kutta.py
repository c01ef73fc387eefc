"""Explicit and diagonally implicit Runge-Kutta methods from their Butcher tableau."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from tparticles.errors import InputError
from tparticles.schemes.analysis import check_order_conditions, condition_formula, stability_function
from tparticles.schemes.exact import Number, shown
from tparticles.schemes.monotonicity import ssp_coefficient
from tparticles.schemes.program import Op, OpKind, Scheme
from tparticles.schemes.stability import Stability
from tparticles.schemes.tables import as_float, check_sum_is_one, checked_name, is_sum, listed, numbers, total


def runge_kutta(
    a: Sequence[Sequence[Number]],
    b: Sequence[Number],
    *,
    name: str,
    order: int | None = None,
    c: Sequence[Number] | None = None,
    b_embedded: Sequence[Number] | None = None,
    reference: str = "",
) -> Scheme:
    """Return the Runge-Kutta method k_i = f(t + c_i dt, z0 + dt sum_j a_ij k_j), z = z0 + dt sum_i b_i k_i.

    `a`: s rows; row i holds up to i entries (missing ones are zero), one more where stage i is implicit, or all s with
    zeros above the diagonal. `b`: s weights that sum to 1. `c`: s stage times, the row sums of `a` if left out. Entries
    are int, float or Fraction; Fractions, and floats that round a simple fraction, are analysed exactly.
    `b_embedded`: the s weights of a second method with the same stages; the difference estimates the local error.
    `order`: what the caller believes; the order is worked out from the order conditions, and a wrong claim is refused.
    `reference`: citation.
    An explicit method whose last stage is the result (a[s-1] = b) evaluates there for the next step ("first same as
    last"), as does an implicit one that begins with an explicit stage; a last stage that is the result is not combined again.
    Raises InputError, naming the scheme and the value: entries that are not finite numbers, wrong shapes, stages that
    depend on later ones, weights that do not sum to 1, c that are not the row sums of a, a claimed order that is not the
    computed one.
    Source: Butcher, Numerical Methods for Ordinary Differential Equations, section 23; Hairer, Wanner, section IV.6.
    """
    where = checked_name(name)
    weights = numbers(b, "b", where)
    if not weights:
        raise InputError(f"{where}: b is empty, a method has at least one stage")
    rows = _rows(a, len(weights), where)
    check_sum_is_one(weights, "b", where)
    times = _stage_times(c, rows, where)
    embedded = _embedded(b_embedded, len(weights), where)
    computed = _checked_order(rows, weights, order, where)
    again = _ends_as_it_begins(rows, weights)
    # One more register keeps the old k_0 for the error estimate where the last slope is solved for.
    keeps = bool(embedded) and again and rows[-1][-1] != 0
    return Scheme(
        name=name,
        order=computed,
        ops=_program(rows, weights, times, again=again, keeps=keeps, where=where),
        slopes=len(weights) + keeps,
        stability=_stability(rows, weights, where),
        reference=reference,
        error_weights=_error_weights(weights, embedded, again=again, keeps=keeps, where=where),
        error_order=min(computed, check_order_conditions(rows, embedded)[0]) if embedded else 0,
        reuses=again,
        ssp=ssp_coefficient(rows, weights),
    )


def _rows(a: object, s: int, where: str) -> list[list[Number]]:
    """Return row i of `a` with i + 1 entries, the last one 0 where the stage is explicit."""
    table = listed(a, "a", "rows", where)
    if len(table) != s:
        raise InputError(f"{where}: a has {len(table)} rows, but b has {s} weights")
    rows: list[list[Number]] = []
    for i, row in enumerate(table):
        entries = numbers(row, f"a[{i}]", where)
        if len(entries) not in {*range(i + 2), s}:
            raise InputError(f"{where}: a[{i}] has {len(entries)} entries, allowed are up to {i + 1}, or all {s}")
        for j, entry in enumerate(entries[i + 1 :], start=i + 1):
            if entry != 0:
                raise InputError(
                    f"{where}: a[{i}][{j}] is {shown(entry)}, but entries above the diagonal must be 0: stage {i} would "
                    f"depend on stage {j}; fully implicit methods are not supported, diagonally implicit ones are"
                )
        rows.append([*entries[: i + 1], *[Fraction(0)] * (i + 1 - len(entries))])
    return rows


def _stage_times(c: object, rows: list[list[Number]], where: str) -> list[Number]:
    if c is None:
        return [total(row) for row in rows]
    times = numbers(c, "c", where)
    if len(times) != len(rows):
        raise InputError(f"{where}: c has {len(times)} entries, but b has {len(rows)} weights")
    for i, (time, row) in enumerate(zip(times, rows, strict=True)):
        if not is_sum(time, row):
            raise InputError(f"{where}: c[{i}] is {shown(time)}, but row {i} of a sums to {shown(total(row))}")
    return times


def _embedded(b_embedded: object, s: int, where: str) -> list[Number]:
    if b_embedded is None:
        return []
    weights = numbers(b_embedded, "b_embedded", where)
    if len(weights) != s:
        raise InputError(f"{where}: b_embedded has {len(weights)} weights, but b has {s}")
    check_sum_is_one(weights, "b_embedded", where)
    return weights


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
        numerator, denominator = stability_function(rows, b)
        _ = [float(coefficient) for coefficient in (*numerator, *denominator)]
    except OverflowError:
        raise InputError(f"{where}: the coefficients of a are so large that R(z) overflows float64") from None
    return Stability(numerator=numerator, denominator=denominator)


def _ends_as_it_begins(rows: list[list[Number]], b: list[Number]) -> bool:
    """Return whether the last stage is f at the result, and the first is f at the start: first same as last."""
    return len(b) > 1 and rows[0][0] == 0 and rows[-1] == b


def _program(
    rows: list[list[Number]], b: list[Number], c: list[Number], *, again: bool, keeps: bool, where: str
) -> tuple[Op, ...]:
    ops: list[Op] = []
    last = len(rows) - 1
    for i, (row, time) in enumerate(zip(rows, c, strict=True)):
        *explicit, diagonal = (float(entry) for entry in row)
        at = as_float(time, f"c[{i}]", where)
        # The first stage looks at z as it is; every later one first builds its own.
        if i > 0:
            ops.append(Op(OpKind.COMBINE, weights=tuple(explicit)))
        if diagonal:
            ops.append(Op(OpKind.SOLVE, slope=i, weights=(diagonal,), time=at))
        elif again and i == last:
            # The old k_0 moves to the last register: the error estimate needs it.
            ops += [Op(OpKind.ROTATE, slope=i, source=0), Op(OpKind.EVALUATE, slope=0, time=1.0)]
        else:
            ops.append(Op(OpKind.EVALUATE, slope=i, time=at))
    solved_last = rows[-1][-1] != 0
    if again and solved_last:
        ops += [Op(OpKind.ROTATE, slope=last + 1, source=0)] * keeps + [Op(OpKind.ROTATE, slope=0, source=last)]
    elif not again and not (solved_last and rows[-1] == b):
        ops.append(Op(OpKind.COMBINE, weights=tuple(float(weight) for weight in b)))
    return tuple(ops)


def _error_weights(
    b: list[Number], embedded: list[Number], *, again: bool, keeps: bool, where: str
) -> tuple[float, ...]:
    """Return b - b_embedded by the registers that hold the slopes when the program ends."""
    difference = [as_float(left - right, "b_embedded", where) for left, right in zip(b, embedded, strict=False)]
    if keeps:
        return (0.0, *difference[1:], difference[0])
    if again and difference:
        return (difference[-1], *difference[1:-1], difference[0])
    return tuple(difference)
