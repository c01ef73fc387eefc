"""An integration scheme as a value: a straight-line program over registers, walked by every executor.

Registers: z0 (the state at the start of the step), z (the running state) and the slopes k[0..s-1]. A step starts with
z = z0 and its result is z. New families of methods add kinds of ops, not executors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from fractions import Fraction
from typing import Any

import numpy as np

from tparticles.errors import InputError
from tparticles.schemes.analysis import Stability
from tparticles.schemes.exact import rational, shown


class OpKind(IntEnum):
    """What an op does; the integers are what an executor stores."""

    COMBINE = 0  # z = z0 + dt sum_j weights[j] k_j
    EVALUATE = 1  # k_slope = f(t + time dt, z)


@dataclass(frozen=True)
class Op:
    """One instruction; `Scheme` checks it. Fields that its kind does not read keep their defaults.

    `slope`: register that EVALUATE writes. `weights`: COMBINE's, one for each of k_0, k_1, ...
    `time`: when EVALUATE looks at f, in units of dt after the start of the step.
    """

    kind: OpKind
    slope: int = 0
    weights: tuple[float, ...] = ()
    time: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """An integration scheme: its program, and what is known about it. Hashable, compared by value.

    `order`: of accuracy. `slopes`: number of slope registers. `system_orders`: which systems it can advance, 1 for
    z = x and 2 for z = (x, v). `needs`: what it asks for beyond that, by name (such as equal steps).
    `reference`: where the coefficients come from.
    Raises InputError, naming the scheme and the value, if the program is not well formed.
    """

    name: str
    order: int
    ops: tuple[Op, ...]
    slopes: int
    stability: Stability
    system_orders: frozenset[int] = frozenset({1, 2})
    needs: tuple[str, ...] = ()
    reference: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InputError(f"a scheme's name must be a non-empty string, not {shown(self.name)}")
        _check_traits(self)
        _check_program(self)

    @property
    def evaluations(self) -> int:
        """Evaluations of f per step."""
        return sum(op.kind is OpKind.EVALUATE for op in self.ops)

    @property
    def real_limit(self) -> float:
        """Largest r such that x' = -lambda x stays bounded for all 0 <= dt lambda <= r."""
        return self.stability.real_limit

    @property
    def imaginary_limit(self) -> float:
        """Largest r such that x' = i omega x stays bounded for all 0 <= dt omega <= r."""
        return self.stability.imaginary_limit

    @property
    def a_stable(self) -> bool:
        """Whether every decaying linear problem stays bounded at any step."""
        return self.stability.a_stable

    @property
    def l_stable(self) -> bool:
        """Whether it is A-stable and damps infinitely stiff modes completely."""
        return self.stability.l_stable


def _check_traits(scheme: Scheme) -> None:
    where = f"scheme '{scheme.name}'"
    for trait, value in (("order", scheme.order), ("slopes", scheme.slopes)):
        if not _is_index(value) or value < 1:
            raise InputError(f"{where}: {trait} must be an integer >= 1, not {shown(value)}")
    orders = scheme.system_orders
    if not isinstance(orders, frozenset) or not orders or not orders <= {1, 2}:
        raise InputError(f"{where}: system_orders must be a frozenset of 1, 2 or both, not {shown(orders)}")
    if not isinstance(scheme.needs, tuple) or not all(isinstance(need, str) for need in scheme.needs):
        raise InputError(f"{where}: needs must be a tuple of strings, not {shown(scheme.needs)}")
    if not isinstance(scheme.reference, str):
        raise InputError(f"{where}: reference must be a string, not {shown(scheme.reference)}")
    if not isinstance(scheme.stability, Stability):
        raise InputError(f"{where}: stability must be a Stability, not {shown(scheme.stability)}")


def _check_program(scheme: Scheme) -> None:
    where = f"scheme '{scheme.name}'"
    if not isinstance(scheme.ops, tuple) or not all(isinstance(op, Op) for op in scheme.ops):
        raise InputError(f"{where}: ops must be a tuple of Op, not {shown(scheme.ops)}")
    evaluated: set[int] = set()
    for i, op in enumerate(scheme.ops):
        here = f"{where}, op {i}"
        if not isinstance(op.kind, OpKind):
            raise InputError(f"{here}: kind must be an OpKind, not {shown(op.kind)}")
        if op.kind is OpKind.EVALUATE:
            _check_evaluate(op, scheme.slopes, here)
            evaluated.add(op.slope)
        else:
            _check_combine(op, evaluated, here)
    if not scheme.ops or scheme.ops[-1].kind is not OpKind.COMBINE:
        last = scheme.ops[-1].kind.name if scheme.ops else "nothing"
        raise InputError(f"{where}: the last op must be a COMBINE, it leaves the result in z, not {last}")


def _check_evaluate(op: Op, slopes: int, here: str) -> None:
    if not _is_index(op.slope) or not 0 <= op.slope < slopes:
        raise InputError(f"{here}: EVALUATE writes slope {shown(op.slope)}, but the registers are 0..{slopes - 1}")
    if not _is_finite(op.time):
        raise InputError(f"{here}: time must be a finite float, not {shown(op.time)}")
    if op.weights:
        raise InputError(f"{here}: EVALUATE takes no weights, not {shown(op.weights)}")


def _check_combine(op: Op, evaluated: set[int], here: str) -> None:
    if not isinstance(op.weights, tuple):
        raise InputError(f"{here}: weights must be a tuple of finite floats, not {shown(op.weights)}")
    for j, weight in enumerate(op.weights):
        if not _is_finite(weight):
            raise InputError(f"{here}: weights must be finite floats, but weight {j} is {shown(weight)}")
        # A zero is no excuse: an executor may multiply it with whatever the register holds.
        if j not in evaluated:
            raise InputError(f"{here}: weight {j} ({shown(weight)}) refers to slope {j}, which is not evaluated yet")


def _is_index(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_finite(value: object) -> bool:
    # No Fractions: executors hand these numbers to kernels.
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def step(scheme: Scheme, f: Callable[[Any, Any], Any], t: Any, z: Any, dt: Any) -> Any:
    """Advance dz/dt = f(t, z) from `t` by one step `dt` and return the new z; `z` is left as it is.

    This is the reference that executors are tested against, not the fast path.
    `z`: number or array of any dtype and shape; f returns the same shape. Floating-point states keep their
    precision. Where z is an int, a Fraction or an object array the arithmetic is exact, given an exact `dt`.
    """
    number = rational if _is_exact(z) else float
    dt = number(dt)
    k: list[Any] = [None] * scheme.slopes
    z0 = z
    for op in scheme.ops:
        if op.kind == OpKind.EVALUATE:
            # k_s = f(t + c dt, z)
            k[op.slope] = f(t + number(op.time) * dt, z)
        else:
            # z = z0 + dt sum_j w_j k_j; zeros are left out, as 0 * inf would be nan
            terms = [number(weight) * k[j] for j, weight in enumerate(op.weights) if weight]
            z = z0 + dt * sum(terms[1:], start=terms[0]) if terms else z0
    return z


def _is_exact(z: Any) -> bool:
    return isinstance(z, int | Fraction) or (isinstance(z, np.ndarray) and z.dtype == object)
