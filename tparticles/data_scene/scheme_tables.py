"""From a scheme back to what makes it: its name in the catalogue, or the coefficients of one of the functions that build schemes.

A scheme is a program, which keeps no record of how it was built. So coefficients are read off the program, and hold if they build
an equal scheme again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

from .. import schemes
from ..errors import InputError
from ..schemes import Op, OpKind, Scheme
from ..schemes.exact import rational

_LARGEST = 10**15  # of numerator and denominator, as `kinds` reads them


def scheme_value(scheme: Scheme, path: str) -> Any:
    """Return a scheme as a document has it: a name, or a table.

    Raises:
        InputError: no name and no coefficients make it, as for a program written op by op.
    """
    if scheme.name in schemes.CATALOGUE and schemes.CATALOGUE[scheme.name] == scheme:
        return scheme.name
    for build, arguments in _candidates(scheme):
        try:
            if build(**arguments) == scheme:
                return _table(build, arguments, path)
        except InputError:
            continue
    raise InputError(
        f"{path}: scheme '{scheme.name}' is no coefficients of adams, bdf, runge_kutta or splitting; a data scene cannot say it"
    )


def _table(build: Callable[..., Scheme], arguments: dict[str, Any], path: str) -> dict[str, Any]:
    table: dict[str, Any] = {"kind": build.__name__}
    for name, value in arguments.items():
        table[name] = scheme_value(value, f"{path}.{name}") if isinstance(value, Scheme) else _shown(value)
    return table


def _candidates(scheme: Scheme) -> Iterator[tuple[Callable[..., Scheme], dict[str, Any]]]:
    """Yield functions and arguments that may make the scheme, the shorter ones first."""
    head = {"name": scheme.name} | ({"reference": scheme.reference} if scheme.reference else {})
    kinds = {op.kind for op in scheme.ops}
    if kinds & {OpKind.KICK, OpKind.DRIFT}:
        yield schemes.splitting, head | _splitting(scheme)
        return
    tables: list[dict[str, Any]] = []
    if scheme.one_step:
        table = _runge_kutta(scheme)
        if table is not None:
            yield schemes.runge_kutta, head | {name: table[name] for name in table if name != "c"}
            yield schemes.runge_kutta, head | table
    if OpKind.SOLVE in kinds:
        tables.append({"steps": scheme.slopes})
    for table in (*tables, *_adams(scheme)):
        build = schemes.bdf if "steps" in table else schemes.adams
        yield build, head | table
        if scheme.starter:
            yield build, head | table | {"starter": scheme.starter}


def _runge_kutta(scheme: Scheme) -> dict[str, Any] | None:
    rows: list[list[float]] = []
    times: list[float] = []
    before: tuple[float, ...] = ()
    for op in scheme.ops:
        if op.kind is OpKind.COMBINE:
            before = op.weights
        elif op.kind in (OpKind.EVALUATE, OpKind.SOLVE):
            rows.append([*before, *op.weights])
            times.append(op.time)
            before = ()
    if not rows:
        return None
    b = _exact(before or rows[-1])
    b += [Fraction(0)] * (len(rows) - len(b))
    table: dict[str, Any] = {"a": [_exact(row) for row in rows], "b": b}
    if scheme.error_weights:
        difference = _exact(_by_stage(scheme, len(rows)))
        table["b_embedded"] = [weight - off for weight, off in zip(b, difference, strict=True)]
    return table | {"c": _exact(times)}


def _by_stage(scheme: Scheme, stages: int) -> tuple[float, ...]:
    """Return b - b_embedded by stage: the program ends with slopes in other registers where the last one is kept."""
    weights = scheme.error_weights
    if len(weights) > stages:
        return weights[-1], *weights[1:-1]
    return (weights[-1], *weights[1:-1], weights[0]) if scheme.reuses else weights


def _splitting(scheme: Scheme) -> dict[str, Any]:
    turns = [op for op in scheme.ops if op.kind in (OpKind.KICK, OpKind.DRIFT)]
    weights = {
        kind: _exact([w for op in turns if op.kind is kind for w in op.weights]) for kind in (OpKind.KICK, OpKind.DRIFT)
    }
    first = {"first": turns[0].kind.name.lower()} if len({len(w) for w in weights.values()}) == 1 else {}
    return {"kicks": weights[OpKind.KICK], "drifts": weights[OpKind.DRIFT]} | first


def _adams(scheme: Scheme) -> Iterator[dict[str, Any]]:
    combines: list[Op] = [op for op in scheme.ops if op.kind is OpKind.COMBINE]
    if not combines:
        return
    explicit = {"explicit": _exact(combines[0].weights)}
    if len(combines) == 1:
        yield explicit
        return
    if scheme.ops[0].kind is OpKind.COMBINE:  # k_0 is the slope at the end
        predictor, corrector = _exact(combines[0].weights[1:]), _exact(combines[1].weights)
        yield {"explicit": predictor, "implicit": corrector, "mode": "PEC"}
        return
    *old, new = combines[1].weights
    for end in range(len(old), -1, -1):  # zeros may be the corrector's own, or fill up the registers
        yield explicit | {"implicit": _exact([new, *old[:end]])}
        if end and old[end - 1] != 0.0:
            return


def _exact(values: Any) -> list[Fraction | float]:
    return [rational(value) for value in values]


def _shown(value: Any) -> Any:
    """Return coefficients as a document has them: whole numbers, fractions as text, other numbers."""
    if isinstance(value, list):
        return [_shown(item) for item in value]
    if isinstance(value, Fraction):
        if value.denominator == 1:
            return int(value)
        return str(value) if max(abs(value.numerator), value.denominator) < _LARGEST else float(value)
    return value
