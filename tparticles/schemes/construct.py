"""From a program to a scheme: its order and stability are worked out, and a wrong claim is refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tparticles.errors import InputError
from tparticles.schemes.characteristic import AnyStability, MultistepStability, SplittingStability
from tparticles.schemes.exact import shown
from tparticles.schemes.linear import first_order_characteristic, oscillator_characteristic
from tparticles.schemes.program import Op, OpKind, Scheme
from tparticles.schemes.series import FIRST_ORDER, SECOND_ORDER, VELOCITY_FREE, check_order
from tparticles.schemes.stability import Stability


@dataclass(frozen=True, kw_only=True)
class Draft:
    """The program of a scheme to be: fields as in `Scheme`."""

    ops: tuple[Op, ...]
    slopes: int
    history: tuple[Op, ...] = ()
    carried: tuple[int, ...] = ()
    steps_back: int = 0


def scheme(draft: Draft, *, name: str, order: int | None, needs: tuple[str, ...] = (), **traits: Any) -> Scheme:
    """Return the scheme of a program, with its order, stability and the needs that follow from them.

    `order`: what the caller believes, or None. `needs`: those that the program does not show. `traits`: other fields.
    Raises InputError, naming the scheme: no order, a claimed order that is not the computed one, stage times that are not
    the states' times, a multistep method that is not zero-stable.
    """
    where = f"scheme '{name}'"
    if order is not None and (not isinstance(order, int) or isinstance(order, bool)):
        raise InputError(f"{where}: order must be an integer, not {shown(order)}")
    splits = any(op.kind in (OpKind.KICK, OpKind.DRIFT) for op in draft.ops)
    computed = _checked_order(draft, FIRST_ORDER if not splits else SECOND_ORDER, where)
    if splits:
        needs = (*needs, "second-order system")
        without_velocity = _checked_order(draft, VELOCITY_FREE, where)
        if without_velocity > computed:
            computed, needs = without_velocity, (*needs, "velocity-free forces")
    if computed < 1:
        raise InputError(f"{where}: its coefficients are not consistent, the error does not vanish with dt")
    if order is not None and order != computed:
        raise InputError(f"{where}: claimed order {shown(order)}, but the order conditions hold up to order {computed}")
    if draft.steps_back and not any(op.variable for op in draft.ops):
        needs = ("equal steps", *needs)
    return Scheme(
        name=name,
        order=computed,
        ops=draft.ops,
        slopes=draft.slopes,
        history=draft.history,
        carried=draft.carried,
        steps_back=draft.steps_back,
        stability=stability(draft, where),
        system_orders=frozenset({2}) if splits else frozenset({1, 2}),
        needs=needs,
        **traits,
    )


def _checked_order(draft: Draft, system: str, where: str) -> int:
    return check_order(draft, system, where)[0]


def stability(draft: Draft, where: str) -> AnyStability:
    """Return what a program does to linear problems.

    Raises InputError, beginning with `where`, if it is not zero-stable: a root at dt = 0 out of the unit disc, or a
    double one on its border (Dahlquist 1956; Hairer, Norsett, Wanner, section III.3), or if its weights are too large.
    """
    try:
        return _stability(draft, where)
    except OverflowError:
        raise InputError(
            f"{where}: its weights are so large that its characteristic polynomial overflows float64"
        ) from None


def _stability(draft: Draft, where: str) -> AnyStability:
    characteristic = first_order_characteristic(draft)
    at_zero = np.roots([float(row[0]) if row else 0.0 for row in reversed(characteristic)])
    on_circle = at_zero[np.abs(at_zero) > 1 - 1e-6]
    doubled = any(np.sum(np.abs(on_circle - root) < 1e-5) > 1 for root in on_circle)
    if np.any(np.abs(at_zero) > 1 + 1e-6) or doubled:
        raise InputError(f"{where}: it is not zero-stable, its roots at dt = 0 are {np.round(at_zero, 6).tolist()}")
    if any(op.kind in (OpKind.KICK, OpKind.DRIFT) for op in draft.ops):
        return SplittingStability(velocity=characteristic, oscillator=oscillator_characteristic(draft))
    if len(characteristic) == 2:
        # D zeta - N, scaled to D(0) = 1
        (numerator, denominator), one = characteristic, characteristic[1][0]
        return Stability(
            numerator=tuple(-entry / one for entry in numerator),
            denominator=tuple(entry / one for entry in denominator),
        )
    return MultistepStability(characteristic=characteristic)
