"""Multistep methods: Adams-Bashforth, predictor-correctors of Adams and Milne, backward differentiation (Gear).

Registers: k_0 = f(t_n, z_n), then the slopes of earlier steps, k_j = f(t_(n-j), z_(n-j)). Earlier states enter as mean slopes
d_j = (z_(n-j+1) - z_(n-j)) / dt, so that every program is a sum of slopes on top of z_n.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any, Literal

from tparticles.errors import InputError
from tparticles.schemes.construct import Draft, scheme
from tparticles.schemes.exact import Number, shown
from tparticles.schemes.implicit import IMPLICIT
from tparticles.schemes.one_step import EXPLICIT
from tparticles.schemes.program import Op, OpKind, Scheme
from tparticles.schemes.program_checks import interpolates
from tparticles.schemes.series import order_of
from tparticles.schemes.tables import check_sum_is_one, checked_name, numbers

_MOST_STEPS = 8

Mode = Literal["PECE", "PEC"]

# With r = dt / (the previous dt), the Adams-Bashforth weights of two steps are 1 + r / 2 and -r / 2.
ADAMS_BASHFORTH_2 = ((1.0, 0.5, 0.0), (0.0, -0.5, 0.0))


def adams(
    explicit: Sequence[Number],
    implicit: Sequence[Number] | None = None,
    *,
    name: str,
    mode: Mode = "PECE",
    order: int | None = None,
    starter: Scheme | None = None,
    reference: str = "",
) -> Scheme:
    """Return z_(n+1) = z_n + dt sum_j b_j f_(n-j), or with `implicit` the predictor-corrector that begins with it.

    `explicit`: the weights of f_n, f_(n-1), ...; they sum to 1. `implicit`: the corrector's weights of f_(n+1), f_n, f_(n-1), ...,
    which sum to 1; its f_(n+1) is evaluated at the predicted state. In the `mode` PECE f_n is evaluated at the corrected one; PEC
    keeps the predicted one's for it, which halves the evaluations. Entries are int, float or Fraction. Two explicit weights of
    Adams-Bashforth follow the ratio of unequal steps where the corrector does not look back; other methods need equal steps.
    A PEC method of Adams' weights whose corrector has one more than its predictor runs under a tolerance too: the difference of the
    two is held against it, the weights follow the steps, and it starts by itself, from order 1 on.
    `order`: what the caller believes; it is worked out, and a wrong claim is refused. `starter`: a one-step scheme that makes
    the first steps, of order - 1 at least; left out, an explicit Runge-Kutta method of the same order up to 4, for PEC
    Dormand and Prince's, which ends with f_(n+1).
    Raises InputError, naming the scheme and the value: entries that are not finite numbers, sums that are not 1, too many
    entries, a wrong claim, a starter that does not fit, another mode, PEC without a corrector.
    Source: Hairer, Norsett, Wanner, Solving ODEs I, sections III.1 and III.5; modes: L. F. Shampine, M. K. Gordon, Computer
    Solution of Ordinary Differential Equations (1975).
    """
    where = checked_name(name)
    predictor = _weights(explicit, "explicit", where)
    corrector = _weights(implicit, "implicit", where) if implicit is not None else []
    if mode == "PEC" and corrector:
        draft, traits = _pec(predictor, corrector), dict[str, Any]()
        if interpolates(draft.ops):
            weights = [c - p for c, p in zip(corrector, [0, *predictor], strict=True)]
            traits = {"interpolates": True, "error_weights": _floats(weights), "error_order": len(predictor)}
        return _with_starter(draft, name, order, starter, _fsal_starter, reference, **traits)
    if mode != "PECE":
        allowed = "for a method with a corrector PECE or PEC, for others PECE"
        raise InputError(f"{where}: mode is {shown(mode)}, allowed are {allowed}")
    steps_back = max(len(predictor), len(corrector) - 1) - 1
    predicted = steps_back + 1
    varies = [Fraction(3, 2), Fraction(-1, 2)] == predictor and len(corrector) <= 2
    ops = [
        Op(OpKind.EVALUATE),
        Op(OpKind.COMBINE, weights=_floats(predictor), variable=ADAMS_BASHFORTH_2 if varies else ()),
    ]
    if corrector:
        new, *old = _floats(corrector)
        weights = (*old, *[0.0] * (predicted - len(old)), new)
        ops += [Op(OpKind.EVALUATE, slope=predicted, time=1.0), Op(OpKind.COMBINE, weights=weights)]
    draft = Draft(
        ops=tuple(ops),
        slopes=predicted + bool(corrector),
        history=_shifts(range(steps_back, 0, -1)),
        carried=tuple(range(1, steps_back + 1)),
        steps_back=steps_back,
    )
    return _with_starter(draft, name, order, starter, _explicit_starter, reference)


def _pec(predictor: Sequence[Number], corrector: Sequence[Number]) -> Draft:
    """Return z' = z + dt sum_j b_j f_(n-j), f' = f(z'), z_(n+1) with f' for f_(n+1): f' is in k_0, f_n in k_1, and so on."""
    back = max(len(predictor), len(corrector) - 1)
    return Draft(
        ops=(
            Op(OpKind.COMBINE, weights=(0.0, *_floats(predictor))),
            Op(OpKind.EVALUATE, time=1.0),
            Op(OpKind.COMBINE, weights=_floats(corrector)),
        ),
        slopes=back + 1,
        history=_shifts(range(back, 0, -1)),
        carried=tuple(range(1, back + 1)),
        steps_back=back,
    )


def bdf(steps: int, *, name: str, starter: Scheme | None = None, reference: str = "") -> Scheme:
    """Return the backward differentiation formula of `steps` steps: sum_j (1/j) nabla^j z_(n+1) = dt f(t_(n+1), z_(n+1)).

    Its order is `steps`, 1..6 (from 7 on it is unstable). Two steps follow the ratio r of unequal steps, and are then
    zero-stable for r < 1 + sqrt 2; more need equal ones. `starter`: a one-step scheme that makes the first steps, of order
    steps - 1 at least; left out, an L-stable diagonally implicit method, up to 4 steps.
    Raises InputError, naming the scheme and the value, for other numbers of steps and for a starter that does not fit.
    Source: Gear, Numerical Initial Value Problems in ODEs (1971); Hairer, Norsett, Wanner, sections III.1 and III.5.
    """
    where = checked_name(name)
    if not isinstance(steps, int) or isinstance(steps, bool) or not 1 <= steps <= 6:
        raise InputError(f"{where}: steps must be an integer from 1 to 6, not {shown(steps)}")
    harmonic = sum(Fraction(1, j) for j in range(1, steps + 1))
    # nabla^j z_(n+1) = sum_m (-1)^m binom(j-1, m) dt d_m, where d_0 leads to the unknown z_(n+1)
    past = [
        -sum(Fraction((-1) ** m * math.comb(j - 1, m), j) for j in range(m + 1, steps + 1)) / harmonic
        for m in range(1, steps)
    ]
    # d_1 is copied to register 0, which is not carried: it has to be written before anything can be summed.
    first, *rest = _floats(past) if past else (0.0,)
    ops = [Op(OpKind.SOLVE, weights=(float(1 / harmonic),), time=1.0, variable=((1.0, 1.0, 2.0),) * (steps == 2))]
    if past:
        # Of two steps: d_1 r / (1 + 2 r) and dt f (1 + r) / (1 + 2 r).
        combine = Op(
            OpKind.COMBINE,
            weights=(first, *[0.0] * bool(rest), *rest),
            variable=((0.0, 1.0, 2.0),) * (steps == 2),
        )
        ops = [Op(OpKind.ROTATE, slope=0, source=1), combine, *ops]
    draft = Draft(
        ops=tuple(ops),
        slopes=steps,
        history=(*_shifts(range(steps - 1, 1, -1)), *[Op(OpKind.DIFFERENCE, slope=1)] * (steps > 1)),
        carried=tuple(range(1, steps)),
        steps_back=steps - 1,
    )
    return _with_starter(draft, name, steps, starter, _implicit_starter, reference)


def milne(*, name: str, reference: str) -> Scheme:
    """Return Milne's predictor-corrector (PECE).

    Predictor z_(n+1) = z_(n-3) + (4 dt / 3) (2 f_n - f_(n-1) + 2 f_(n-2)); corrector, which is Simpson's rule,
    z_(n+1) = z_(n-1) + (dt / 3) (f_(n+1) + 4 f_n + f_(n-1)). Simpson's root -1 at dt = 0 makes it weakly unstable.
    """
    f_1, f_2, d_1, d_2, d_3, predicted = range(1, 7)
    # z_(n-3) = z_n - dt (d_1 + d_2 + d_3)
    predictor = Op(OpKind.COMBINE, weights=(8 / 3, -4 / 3, 8 / 3, -1.0, -1.0, -1.0))
    corrector = Op(OpKind.COMBINE, weights=(4 / 3, 1 / 3, 0.0, -1.0, 0.0, 0.0, 1 / 3))
    draft = Draft(
        ops=(Op(OpKind.EVALUATE), predictor, Op(OpKind.EVALUATE, slope=predicted, time=1.0), corrector),
        slopes=7,
        history=(*_shifts((f_2, f_1)), *_shifts((d_3, d_2)), Op(OpKind.DIFFERENCE, slope=d_1)),
        carried=(f_1, f_2, d_1, d_2, d_3),
        steps_back=3,
    )
    return _with_starter(draft, name, 4, None, _explicit_starter, reference)


def _explicit_starter(order: int) -> Scheme:
    """Return a scheme of that order, or the highest there is, that leaves k_0 = f(t_n, z_n) as it was."""
    return EXPLICIT[("euler", "midpoint", "rk3", "rk4")[min(order, 4) - 1]]


def _fsal_starter(order: int) -> Scheme:
    """Return a scheme of that order, up to 5, that leaves k_0 = f(t_(n+1), z_(n+1))."""
    return EXPLICIT["bogacki-shampine" if order < 4 else "dormand-prince"]


def _implicit_starter(order: int) -> Scheme:
    return IMPLICIT[("backward-euler", "sdirk2", "sdirk3")[min(order, 3) - 1]]


def _with_starter(
    draft: Draft,
    name: str,
    order: int | None,
    starter: Scheme | None,
    starter_of: Callable[[int], Scheme],
    reference: str,
    **traits: Any,
) -> Scheme:
    if draft.steps_back == 0:
        if starter is not None:
            raise InputError(f"scheme '{name}': it is a one-step method, so it takes no starter")
        return scheme(draft, name=name, order=order, reference=reference)
    if starter is None:
        starter = starter_of(order_of(draft, where=f"scheme '{name}'"))
    return scheme(draft, name=name, order=order, reference=reference, starter=starter, **traits)


def _weights(values: object, what: str, where: str) -> list[Number]:
    weights = numbers(values, what, where)
    if not 1 <= len(weights) <= _MOST_STEPS:
        raise InputError(f"{where}: {what} has {len(weights)} weights, allowed are 1 to {_MOST_STEPS}")
    check_sum_is_one(weights, what, where)
    return weights


def _floats(values: Sequence[Number]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _shifts(registers: Sequence[int]) -> tuple[Op, ...]:
    """Return the moves of each of the registers, last first, to itself from the one before."""
    return tuple(Op(OpKind.ROTATE, slope=register, source=register - 1) for register in registers)
