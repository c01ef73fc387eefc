"""What makes a program well formed; `Scheme` asks at construction, so that executors need not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

from tparticles.errors import InputError
from tparticles.schemes.characteristic import AnyStability
from tparticles.schemes.exact import shown

if TYPE_CHECKING:
    from tparticles.schemes.program import Op, Scheme

NEEDS = ("equal steps", "second-order system", "velocity-free forces")

# What each kind writes and reads, by the name of the kind: this module is below the one that defines the kinds.
_WRITES_SLOPE = {"EVALUATE", "SOLVE", "ROTATE", "DIFFERENCE"}
_MOVES_STATE = {"COMBINE", "KICK", "DRIFT", "SOLVE"}
_WEIGHTS = {"COMBINE": None, "KICK": None, "DRIFT": 1, "SOLVE": 1, "EVALUATE": 0, "ROTATE": 0, "DIFFERENCE": 0}


def check(scheme: Scheme) -> None:
    """Raise InputError, naming the scheme, the op and the value, for the first thing that is wrong with `scheme`."""
    if not isinstance(scheme.name, str) or not scheme.name:
        raise InputError(f"a scheme's name must be a non-empty string, not {shown(scheme.name)}")
    where = f"scheme '{scheme.name}'"
    _check_traits(scheme, where)
    for what in ("ops", "history"):
        _check_ops(scheme, what, where)
    _check_registers(scheme, where)
    _check_result(scheme, where)
    _check_systems(scheme, where)
    _check_error_weights(scheme, where)
    if scheme.reuses:
        _check_reuse(scheme, where)
    if scheme.steps_back:
        _check_history(scheme, where)
        if not scheme.starts_itself:
            _check_starter(scheme, where)
        if scheme.interpolates and not interpolates(scheme.ops):
            raise InputError(f"{where}: it is said to interpolate slopes, but its weights are not Adams'")
    elif scheme.history or scheme.carried or scheme.starter is not None:
        raise InputError(f"{where}: history, carried and starter are for schemes with steps_back > 0, here it is 0")


def _check_traits(scheme: Scheme, where: str) -> None:
    for trait, value, least in (
        ("order", scheme.order, 1),
        ("slopes", scheme.slopes, 1),
        ("error_order", scheme.error_order, 0),
        ("steps_back", scheme.steps_back, 0),
    ):
        if not _is_index(value) or value < least:
            raise InputError(f"{where}: {trait} must be an integer >= {least}, not {shown(value)}")
    orders = scheme.system_orders
    if not isinstance(orders, frozenset) or not orders or not orders <= {1, 2}:
        raise InputError(f"{where}: system_orders must be a frozenset of 1, 2 or both, not {shown(orders)}")
    if not isinstance(scheme.needs, tuple) or not all(isinstance(need, str) for need in scheme.needs):
        raise InputError(f"{where}: needs must be a tuple of strings, not {shown(scheme.needs)}")
    for need in scheme.needs:
        if need not in NEEDS:
            raise InputError(f"{where}: needs '{need}', but allowed are {', '.join(NEEDS)}")
    if not isinstance(scheme.reference, str):
        raise InputError(f"{where}: reference must be a string, not {shown(scheme.reference)}")
    if not isinstance(scheme.stability, AnyStability):
        raise InputError(f"{where}: stability must be a Stability, not {shown(scheme.stability)}")
    if not isinstance(scheme.reuses, bool):
        raise InputError(f"{where}: reuses must be True or False, not {shown(scheme.reuses)}")
    if scheme.ssp is not None and not (isinstance(scheme.ssp, float) and scheme.ssp > 0):
        raise InputError(f"{where}: ssp must be a float > 0 or None, not {shown(scheme.ssp)}")
    carried = scheme.carried
    if not isinstance(carried, tuple) or not all(_is_index(j) and 0 < j < scheme.slopes for j in carried):
        raise InputError(f"{where}: carried must be a tuple of registers 1..{scheme.slopes - 1}, not {shown(carried)}")


def _check_ops(scheme: Scheme, what: str, where: str) -> None:
    from tparticles.schemes.program import Op, OpKind

    ops = getattr(scheme, what)
    if not isinstance(ops, tuple) or not all(isinstance(op, Op) for op in ops):
        raise InputError(f"{where}: {what} must be a tuple of Op, not {shown(ops)}")
    for i, op in enumerate(ops):
        here = _here(where, what, i)
        if not isinstance(op.kind, OpKind):
            raise InputError(f"{here}: kind must be an OpKind, not {shown(op.kind)}")
        _check_fields(op, scheme.slopes, here)
        if what == "history" and op.kind.name not in {"ROTATE", "DIFFERENCE"}:
            raise InputError(f"{here}: history consists of ROTATE and DIFFERENCE, not {op.kind.name}")


def _here(where: str, what: str, i: int) -> str:
    return f"{where}, {'op' if what == 'ops' else 'history op'} {i}"


def _check_fields(op: Op, slopes: int, here: str) -> None:
    kind = op.kind.name
    if not _is_register(op.slope, slopes):
        raise InputError(f"{here}: {kind} writes slope {shown(op.slope)}, but the registers are 0..{slopes - 1}")
    if not _is_register(op.source, slopes):
        raise InputError(f"{here}: {kind} reads slope {shown(op.source)}, but the registers are 0..{slopes - 1}")
    if not _is_finite(op.time):
        raise InputError(f"{here}: time must be a finite float, not {shown(op.time)}")
    if not isinstance(op.weights, tuple):
        raise InputError(f"{here}: weights must be a tuple of finite floats, not {shown(op.weights)}")
    for j, weight in enumerate(op.weights):
        if not _is_finite(weight):
            raise InputError(f"{here}: weights must be finite floats, but weight {j} is {shown(weight)}")
    wanted = _WEIGHTS[kind]
    if wanted is not None and len(op.weights) != wanted:
        raise InputError(
            f"{here}: {kind} takes {'no weights' if wanted == 0 else 'one weight'}, not {shown(op.weights)}"
        )
    if kind == "SOLVE" and op.weights[0] == 0:
        raise InputError(f"{here}: SOLVE needs a weight other than 0, with 0 there is nothing to solve")
    _check_unread(op, kind, here)
    _check_variable(op, here)


def _check_unread(op: Op, kind: str, here: str) -> None:
    """Refuse what the kind does not read: two programs that do the same are to be equal."""
    unread = {
        "slope": op.slope != 0 and kind not in _WRITES_SLOPE,
        "source": op.source != 0 and kind != "ROTATE",
        "time": op.time != 0 and kind not in {"EVALUATE", "SOLVE"},
        "linear": op.linear is not False and kind != "SOLVE",
    }
    for field, wrong in unread.items():
        if wrong:
            raise InputError(f"{here}: {kind} has no {field}, it is {shown(getattr(op, field))}")
    if not isinstance(op.linear, bool):
        raise InputError(f"{here}: linear must be True or False, not {shown(op.linear)}")


def _check_variable(op: Op, here: str) -> None:
    if not isinstance(op.variable, tuple):
        raise InputError(f"{here}: variable must be a tuple of (n0, n1, d), not {shown(op.variable)}")
    if op.variable and len(op.variable) != len(op.weights):
        raise InputError(f"{here}: variable has {len(op.variable)} entries, but there are {len(op.weights)} weights")
    for j, (triple, weight) in enumerate(zip(op.variable, op.weights, strict=False)):
        if not isinstance(triple, tuple) or len(triple) != 3 or not all(map(_is_finite, triple)) or triple[2] < 0:
            raise InputError(f"{here}: variable {j} must be finite (n0, n1, d) with d >= 0, not {shown(triple)}")
        n0, n1, d = triple
        # A ratio of 1 is an equal step, for which `weights` is what executors use.
        if not math.isclose((n0 + n1) / (1 + d), weight, rel_tol=1e-14, abs_tol=1e-15):
            raise InputError(
                f"{here}: variable {j} is {shown((n0 + n1) / (1 + d))} at r = 1, but weight {j} is {weight}"
            )


def _check_registers(scheme: Scheme, where: str) -> None:
    """Refuse reading a register before it is written."""
    written = set(scheme.carried)
    for i, op in enumerate(scheme.ops):
        here = _here(where, "ops", i)
        if op.kind.name in {"COMBINE", "KICK"}:
            for j, weight in enumerate(op.weights):
                # Zeros read nothing; but where there is nothing else, executors multiply k_0 by one.
                if j not in written and (weight or not any(op.weights)):
                    raise InputError(f"{here}: weight {j} ({shown(weight)}) refers to slope {j}, not evaluated yet")
        if op.kind.name == "ROTATE" and op.source not in written:
            raise InputError(f"{here}: ROTATE reads slope {op.source}, which is not evaluated yet")
        if op.kind.name in _WRITES_SLOPE:
            written.add(op.slope)


def _check_result(scheme: Scheme, where: str) -> None:
    kinds = [op.kind.name for op in scheme.ops]
    # Slopes for the next step, and one that an estimate of the error reads.
    after = {"EVALUATE", "ROTATE"} if scheme.reuses else {"DIFFERENCE"} if scheme.error_weights else set()
    while kinds and kinds[-1] in after:
        kinds.pop()
    last = kinds[-1] if kinds else "nothing"
    if last not in _MOVES_STATE:
        allowed = "a COMBINE, KICK, DRIFT or SOLVE"
        raise InputError(f"{where}: the last op must be {allowed}, it leaves the result in z, not {last}")


def _check_systems(scheme: Scheme, where: str) -> None:
    splits = any(op.kind.name in {"KICK", "DRIFT"} for op in scheme.ops)
    if splits and scheme.system_orders != {2}:
        raise InputError(
            f"{where}: it kicks and drifts, so system_orders must be {{2}}, not {set(scheme.system_orders)}"
        )
    if (scheme.system_orders == {2}) != ("second-order system" in scheme.needs):
        raise InputError(
            f"{where}: needs must hold 'second-order system' where system_orders is {{2}}, and only there; "
            f"they are {shown(scheme.needs)} and {set(scheme.system_orders)}"
        )


def _check_error_weights(scheme: Scheme, where: str) -> None:
    weights = scheme.error_weights
    if not isinstance(weights, tuple) or not all(map(_is_finite, weights)) or len(weights) > scheme.slopes:
        raise InputError(
            f"{where}: error_weights must be a tuple of up to {scheme.slopes} floats, not {shown(weights)}"
        )
    if bool(weights) != (scheme.error_order > 0):
        raise InputError(
            f"{where}: error_weights and error_order go together, not {shown(weights)} and {scheme.error_order}"
        )


def _origin(ops: Sequence[Op], register: int = 0) -> tuple[int, Op] | None:
    """Return the index and the EVALUATE or SOLVE whose slope `register` holds at the end; None if it has none."""
    for i in reversed(range(len(ops))):
        if ops[i].kind.name in _WRITES_SLOPE and ops[i].slope == register:
            if ops[i].kind.name == "ROTATE":
                return _origin(ops[:i], ops[i].source)
            return (i, ops[i]) if ops[i].kind.name in {"EVALUATE", "SOLVE"} else None
    return None


def _check_reuse(scheme: Scheme, where: str) -> None:
    first = scheme.ops[0]
    if first.kind.name != "EVALUATE" or first.slope != 0 or first.time != 0:
        raise InputError(f"{where}: reuses needs an EVALUATE of slope 0 at time 0 as its first op, not {first}")
    origin = _origin(scheme.ops)
    if origin is None or origin[1].time != 1 or origin[1].linear:
        raise InputError(
            f"{where}: reuses needs slope 0 to end as f at time 1, but it comes from {origin and origin[1]}"
        )
    for i, op in enumerate(scheme.ops[origin[0] + 1 :], start=origin[0] + 1):
        if op.kind.name not in {"EVALUATE", "ROTATE", "KICK"}:
            raise InputError(f"{where}, op {i}: {op.kind.name} changes z after the evaluation that reuses keeps")


def interpolates(ops: Sequence[Op]) -> bool:
    """Return whether `Scheme.interpolates` may be said of a program."""
    if [op.kind.name for op in ops] != ["COMBINE", "EVALUATE", "COMBINE"]:
        return False
    predictor, _, corrector = ops
    back = len(corrector.weights) - 1
    # k_j is f at 1 - j: the predictor has k_1, k_2, ..., the corrector k_0 as well
    wanted = [0, *quadrature(range(0, -back, -1))], quadrature(range(1, -back, -1))
    return len(predictor.weights) == back + 1 and all(
        math.isclose(weight, exact, rel_tol=1e-14)
        for op, weights in zip((predictor, corrector), wanted, strict=True)
        for weight, exact in zip(op.weights, weights, strict=True)
    )


def quadrature(nodes: Sequence[int]) -> list[Fraction]:
    """Return the weights of slopes at `nodes` that integrate from 0 to 1 the polynomial through them."""
    weights = []
    for node in nodes:
        polynomial = [Fraction(1)]  # the one that is 1 at this node and 0 at the others, lowest power first
        for other in nodes:
            if other != node:
                shifted = [Fraction(0), *polynomial]
                polynomial = [
                    (up - other * down) / (node - other) for up, down in zip(shifted, [*polynomial, 0], strict=True)
                ]
        weights.append(sum((c / (power + 1) for power, c in enumerate(polynomial)), Fraction(0)))
    return weights


def kicks_after(ops: Sequence[Op]) -> bool:
    """Return whether a KICK follows the evaluation that k_0 holds at the end."""
    origin = _origin(ops)
    return origin is not None and any(op.kind.name == "KICK" for op in ops[origin[0] :])


def _check_history(scheme: Scheme, where: str) -> None:
    targets = {op.slope for op in scheme.history}
    if targets != set(scheme.carried):
        raise InputError(
            f"{where}: history must fill the carried registers {sorted(scheme.carried)}, it fills {sorted(targets)}"
        )
    # Which registers hold something after each step of the starter, which itself leaves only k_0.
    filled = {0}
    for _ in range(scheme.steps_back):
        for i, op in enumerate(scheme.history):
            if op.kind.name == "ROTATE" and op.source not in {0, *scheme.carried}:
                raise InputError(
                    f"{_here(where, 'history', i)}: ROTATE reads slope {op.source}, allowed are 0 and carried"
                )
            known = op.kind.name == "DIFFERENCE" or op.source in filled
            filled = filled | {op.slope} if known else filled - {op.slope}
    missing = sorted(set(scheme.carried) - filled)
    if missing:
        raise InputError(f"{where}: steps_back is {scheme.steps_back}, but then slopes {missing} are not filled yet")
    varies = any(op.variable for op in scheme.ops)
    if varies and scheme.steps_back > 1:
        raise InputError(f"{where}: variable weights know one previous step, but steps_back is {scheme.steps_back}")
    if varies == ("equal steps" in scheme.needs):
        raise InputError(f"{where}: needs must hold 'equal steps' where no weight is variable, and only there")


def _check_starter(scheme: Scheme, where: str) -> None:
    starter = scheme.starter
    if not hasattr(starter, "starting_ops") or starter is None:
        raise InputError(
            f"{where}: steps_back is {scheme.steps_back}, so starter must be a Scheme, not {shown(starter)}"
        )
    if starter.steps_back:
        raise InputError(f"{where}: its starter '{starter.name}' must be a one-step scheme, it has steps_back")
    if starter.order < scheme.order - 1:
        raise InputError(
            f"{where}: its starter '{starter.name}' is of order {starter.order}, needed is at least {scheme.order - 1}"
        )
    if not scheme.system_orders <= starter.system_orders:
        raise InputError(
            f"{where}: its starter '{starter.name}' cannot run systems of order {set(scheme.system_orders)}"
        )
    if all(op.kind.name != "ROTATE" or op.source != 0 for op in scheme.history):
        return
    # The history copies k_0 after starting steps too: it must stand for the same time in both programs.
    started, own = k0_time(starter.ops), k0_time(scheme.ops)
    if started is None or (own is not None and started != own):
        raise InputError(
            f"{where}: its history copies slope 0, which its starter '{starter.name}' must leave as f at time "
            f"{shown(own)}, not {shown(started)}"
        )


def k0_time(ops: Sequence[Op]) -> float | None:
    """Return at which time of the step k_0 is f(t, z) when the program ends; None if it is not an EVALUATE's."""
    origin = _origin(ops)
    if origin is None or origin[1].kind.name != "EVALUATE":
        return None
    moved = any(op.kind.name in _MOVES_STATE for op in ops[: origin[0]])
    return origin[1].time if moved == (origin[1].time != 0) else None


def _is_register(value: object, slopes: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < slopes


def _is_index(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_finite(value: object) -> bool:
    # No Fractions: executors hand these numbers to kernels.
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
