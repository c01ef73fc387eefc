"""The reference interpreter: a program as it reads, for numbers and arrays; executors are tested against it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from tparticles.errors import InputError
from tparticles.schemes.exact import rational, shown
from tparticles.schemes.newton import linearised, newton
from tparticles.schemes.program import Op, OpKind, Scheme

Slope = Callable[[Any, Any], Any]


def step(scheme: Scheme, f: Slope, t: Any, z: Any, dt: Any) -> Any:
    """Advance dz/dt = f(t, z) from `t` by one step `dt` of a one-step scheme and return the new z; `z` stays as it is.

    This is the reference that executors are tested against, not the fast path.
    `z`: number or array of any dtype and shape; f returns the same shape. Floating-point states keep their
    precision. Where z is an int, a Fraction or an object array the arithmetic of explicit schemes is exact, given an
    exact `dt`. Where the scheme kicks and drifts, z is an array whose leading axis of 2 holds (x, v), and f returns (v, a).
    Raises InputError for a multistep scheme, which needs `integrate`; RunError where an implicit stage has no solution.
    """
    if not scheme.one_step:
        raise InputError(f"scheme '{scheme.name}' needs {scheme.steps_back} previous steps: run it by integrate")
    return _run(scheme, scheme.ops, f, t, z, _number(z)(dt), [None] * scheme.slopes)


def integrate(
    scheme: Scheme, f: Slope, t0: Any, z0: Any, dt: Any, steps: int | None = None, *, velocity_free: bool = False
) -> list[Any]:
    """Return the states [z0, z1, ...] after `steps` steps of `dt`, or after each of the steps `dt` is a sequence of.

    History, starter and the ratios of unequal steps are as the scheme asks for: one that needs equal steps starts
    again after a step of another size. States and f as for `step`. `velocity_free`: the accelerations do not depend
    on v, so that splittings reuse the last one of a step.
    Raises InputError where `dt` is a number and `steps` is not a count, or the reverse, and for a multistep scheme without a
    starter; RunError as `step` does.
    """
    if scheme.starts_itself:
        raise InputError(f"scheme '{scheme.name}' has no starter: integrate makes steps of given sizes, which need one")
    run, states, t = _Run(scheme, f, velocity_free=velocity_free), [z0], t0
    for size in _sizes(dt, steps):
        states.append(run.step(t, states[-1], _number(z0)(size)))
        t = t + _number(z0)(size)
    return states


def _sizes(dt: Any, steps: int | None) -> Iterable[Any]:
    if isinstance(dt, Sequence | np.ndarray) and np.ndim(dt) == 1:
        if steps is not None:
            raise InputError(f"integrate: dt lists the steps already, steps must be left out, not {shown(steps)}")
        return dt
    if not isinstance(steps, int) or isinstance(steps, bool) or steps < 0:
        raise InputError(f"integrate: steps must be an integer >= 0 where dt is one number, not {shown(steps)}")
    return [dt] * steps


class _Run:
    """Registers and history of one run."""

    def __init__(self, scheme: Scheme, f: Slope, *, velocity_free: bool):
        self.scheme, self.f, self.velocity_free = scheme, f, velocity_free
        self.k: list[Any] = [None] * scheme.registers
        self.made = 0
        self.previous: Any = None
        self.k0_valid = False

    def step(self, t: Any, z0: Any, dt: Any) -> Any:
        scheme = self.scheme
        equal = self.previous is not None and math.isclose(dt, self.previous, rel_tol=1e-12)
        if not equal and not scheme.variable_steps:
            self.made = 0
        starting = self.made < scheme.steps_back
        program = scheme.starter if starting and scheme.starter else scheme
        ops = scheme.starting_ops if starting else scheme.ops
        if self.k0_valid and ops[0] == Op(OpKind.EVALUATE):
            ops = ops[1:]
        ratio = 1 if equal or self.previous is None else dt / self.previous
        z = _run(scheme, ops, self.f, t, z0, dt, self.k, ratio)
        _run(scheme, scheme.history, self.f, t, z, dt, self.k, ratio, z0)
        self.made, self.previous = self.made + 1, dt
        self.k0_valid = program.reuses and (self.velocity_free or not program.kicks_after_evaluation)
        return z


def _run(
    scheme: Scheme,
    ops: Iterable[Op],
    f: Slope,
    t: Any,
    z: Any,
    dt: Any,
    k: list[Any],
    ratio: Any = 1,
    z0: Any = None,
) -> Any:
    """Run `ops` on the registers `k`, which change, from z (and from z0, where the step began before) and return z."""
    number = _number(z)
    z0 = z if z0 is None else z0
    for i, op in enumerate(ops):
        weights = _weights(op, ratio, number)
        if op.kind == OpKind.COMBINE:
            z = _plus(z0, dt, _sum(weights, k))
        elif op.kind == OpKind.EVALUATE:
            k[op.slope] = f(t + number(op.time) * dt, z)
        elif op.kind == OpKind.KICK:
            z = _with_part(z, 1, _plus(z[1], dt, _sum(weights, [slope if slope is None else slope[1] for slope in k])))
        elif op.kind == OpKind.DRIFT:
            z = _with_part(z, 0, z[0] + dt * (weights[0] * z[1]))
        elif op.kind == OpKind.SOLVE:
            solve = linearised if op.linear else newton
            where = f"scheme '{scheme.name}', op {i} at t = {float(t):.6g}, dt = {float(dt):.6g}"
            z, k[op.slope] = solve(f, t + number(op.time) * dt, z, float(weights[0] * dt), where)
        elif op.kind == OpKind.ROTATE:
            k[op.slope] = k[op.source]
        else:
            k[op.slope] = (z - z0) / dt
    return z


def _weights(op: Op, ratio: Any, number: Callable[[Any], Any]) -> list[Any]:
    if ratio == 1 or not op.variable:
        return [number(weight) for weight in op.weights]
    # w = (n0 + n1 r) / (1 + d r)
    return [(number(n0) + number(n1) * ratio) / (1 + number(d) * ratio) for n0, n1, d in op.variable]


def _sum(weights: list[Any], k: list[Any]) -> Any:
    """Return sum_j w_j k_j, or None where it is empty; zeros are left out, as 0 * inf would be nan."""
    terms = [weight * k[j] for j, weight in enumerate(weights) if weight]
    return sum(terms[1:], start=terms[0]) if terms else None


def _plus(z: Any, dt: Any, slope: Any) -> Any:
    return z if slope is None else z + dt * slope


def _with_part(z: Any, part: int, value: Any) -> Any:
    changed = z.copy()
    changed[part] = value
    return changed


def _number(z: Any) -> Callable[[Any], Any]:
    """Return how coefficients and times enter the arithmetic with `z`: exactly, or as floats."""
    exact = isinstance(z, int | Fraction) or (isinstance(z, np.ndarray) and z.dtype == object)
    return rational if exact else float
