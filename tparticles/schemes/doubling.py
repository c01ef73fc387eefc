"""Step doubling: the error estimate of a scheme that has none, from one step of dt next to two of dt/2.

Source: L. F. Richardson, Phil. Trans. A 226 (1927); Hairer, Norsett, Wanner, Solving ODEs I, section II.4.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from fractions import Fraction

from tparticles.errors import InputError
from tparticles.schemes.construct import Draft
from tparticles.schemes.construct import scheme as worked_out
from tparticles.schemes.exact import Number
from tparticles.schemes.program import Op, OpKind, Scheme
from tparticles.schemes.stability import Stability

_SOURCE = "step doubling: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, section II.4"


def doubled(scheme: Scheme) -> Scheme:
    """Return the scheme that runs under a tolerance: one that knows its error, and does without a starter.

    A scheme with an error estimate is returned as it is, a PEC method of Adams' without its starter. Others take two steps of dt/2
    and a third one of dt from the same start. Their result is z_two, that of the two half steps; the estimate is
    (z_two - z_one) / (2^p - 1), p the order: to leading order the true solution less z_two.
    Raises InputError, naming the scheme, if it looks back at earlier steps and does not interpolate them.
    """
    if scheme.interpolates:
        return dataclasses.replace(scheme, starter=None)
    if scheme.error_weights:
        return scheme
    if scheme.steps_back:
        raise InputError(
            f"scheme '{scheme.name}': its error cannot be estimated by step doubling, it looks back at earlier steps, "
            "which are of one size; take abm5-pec or a one-step scheme (bogacki-shampine, dormand-prince, tr-bdf2, velocity-verlet)"
        )
    if any(op.kind in (OpKind.KICK, OpKind.DRIFT) for op in scheme.ops):
        return _doubled_splitting(scheme)
    stability = scheme.stability
    assert isinstance(stability, Stability)  # that of a one-step method of slopes
    program = _Program()
    one = program.step(scheme.ops, start={}, begin=0.0, size=1.0)
    half = program.step(scheme.ops, start={}, begin=0.0, size=0.5)
    two = program.step(scheme.ops, start=half, begin=0.5, size=0.5)
    program.arrive(two)
    parts = 2**scheme.order - 1
    return dataclasses.replace(
        scheme,
        name=f"{scheme.name}-doubled",
        ops=tuple(program.ops),
        slopes=program.slopes,
        stability=_of_two_halves(stability),
        reference="; ".join(filter(None, (scheme.reference, _SOURCE))),
        error_weights=tuple((two.get(j, 0.0) - one.get(j, 0.0)) / parts for j in range(program.slopes)),
        error_order=scheme.order,
        # The last slope that `reuses` keeps is not evaluated: an estimate needs the slopes of the step itself.
        reuses=False,
        # Each half is as good as Euler's up to dt/2 = C dt_0.
        ssp=None if scheme.ssp is None else 2 * scheme.ssp,
    )


def _doubled_splitting(scheme: Scheme) -> Scheme:
    """Return the doubled scheme of one that moves x and v by turns: its results are no sums of slopes.

    Each becomes one, its mean slope (z - z0) / dt, in a register of its own behind the scheme's. The step of dt comes first.
    """
    ops = _up_to_result(scheme.ops)
    # k_0 serves both sizes of step, unless it is written over.
    kept = ops[0] == Op(OpKind.EVALUATE) and all(op.slope or op.kind in (OpKind.KICK, OpKind.DRIFT) for op in ops[1:])
    first = _scaled(ops[1:] if kept else ops, begin=0.0)
    one, two = scheme.slopes, scheme.slopes + 1
    draft = Draft(
        ops=(
            *ops,
            Op(OpKind.DIFFERENCE, slope=one),
            Op(OpKind.COMBINE),  # back to z0
            *first,
            *_scaled(ops, begin=0.5),
            Op(OpKind.DIFFERENCE, slope=two),
        ),
        slopes=two + 1,
    )
    part = 1 / (2**scheme.order - 1)
    return worked_out(
        draft,
        name=f"{scheme.name}-doubled",
        order=scheme.order,
        reference="; ".join(filter(None, (scheme.reference, _SOURCE))),
        error_weights=(*(0.0,) * scheme.slopes, -part, part),
        error_order=scheme.order,
    )


def _scaled(ops: Sequence[Op], *, begin: float) -> list[Op]:
    """Return the ops of half a step from t + `begin` dt on."""
    moves = (OpKind.KICK, OpKind.DRIFT)
    return [
        dataclasses.replace(op, weights=tuple(0.5 * weight for weight in op.weights))
        if op.kind in moves
        else dataclasses.replace(op, time=begin + 0.5 * op.time)
        if op.kind is OpKind.EVALUATE
        else op
        for op in ops
    ]


class _Program:
    """A program as it is put together. Its states are z0 + dt sum_j weights[j] k_j: they are known by their weights.

    Each EVALUATE and SOLVE writes a register of its own, so that no slope is lost that a later sum needs, and ROTATE only
    renames. An EVALUATE at a time and a state that were looked at before takes that slope: k_0 serves both sizes of step.
    """

    def __init__(self) -> None:
        self.ops: list[Op] = []
        self.slopes = 0
        self.z: Mapping[int, float] = {}
        self.known: dict[tuple[float, frozenset[tuple[int, float]]], int] = {}

    def step(self, ops: Sequence[Op], *, start: Mapping[int, float], begin: float, size: float) -> Mapping[int, float]:
        """Add a step of `size` dt from the state `start` at t + `begin` dt; return the state that it leads to."""
        z, names = start, dict[int, int]()
        for op in _up_to_result(ops):
            time = begin + size * op.time
            if op.kind is OpKind.COMBINE:
                z = _sum(start, op.weights, names, size)
            elif op.kind is OpKind.EVALUATE:
                names[op.slope] = self._evaluated(z, time)
            elif op.kind is OpKind.SOLVE:
                weight = size * op.weights[0]
                names[op.slope] = self._solved(z, weight, time, linear=op.linear)
                z = self.z = {**z, names[op.slope]: weight}
            else:
                names[op.slope] = names[op.source]
        return z

    def arrive(self, z: Mapping[int, float]) -> None:
        """Make `z` the running state, if it is not."""
        if z != self.z:
            # As many weights as it needs: those of registers not yet written are refused.
            width = max(z, default=-1) + 1
            self.ops.append(Op(OpKind.COMBINE, weights=tuple(z.get(j, 0.0) for j in range(width))))
            self.z = z

    def _evaluated(self, z: Mapping[int, float], time: float) -> int:
        state = (time, frozenset(z.items()))
        if state not in self.known:
            self.arrive(z)
            self.known[state] = self._new_slope(Op(OpKind.EVALUATE, time=time))
        return self.known[state]

    def _solved(self, zbar: Mapping[int, float], weight: float, time: float, *, linear: bool) -> int:
        self.arrive(zbar)
        return self._new_slope(Op(OpKind.SOLVE, weights=(weight,), time=time, linear=linear))

    def _new_slope(self, op: Op) -> int:
        self.ops.append(dataclasses.replace(op, slope=self.slopes))
        self.slopes += 1
        return self.slopes - 1


def _up_to_result(ops: Sequence[Op]) -> Sequence[Op]:
    """Return `ops` without those behind the result: a slope for the next step, and copies."""
    moves = [i for i, op in enumerate(ops) if op.kind not in (OpKind.EVALUATE, OpKind.ROTATE)]
    return ops[: moves[-1] + 1] if moves else ()


def _sum(
    start: Mapping[int, float], weights: Sequence[float], names: Mapping[int, int], size: float
) -> Mapping[int, float]:
    total = dict(start)
    for j, weight in enumerate(weights):
        if weight:
            total[names[j]] = total.get(names[j], 0.0) + size * weight
    return total


def _of_two_halves(stability: Stability) -> Stability:
    """Return R(z/2)^2."""
    return Stability(numerator=_squared(stability.numerator), denominator=_squared(stability.denominator))


def _squared(R: Sequence[Number]) -> tuple[Number, ...]:
    # r_i (z/2)^i r_j (z/2)^j
    halves = [coefficient * Fraction(1, 2**i) for i, coefficient in enumerate(R)]
    out: list[Number] = [0] * (2 * len(halves) - 1)
    for i, left in enumerate(halves):
        for j, right in enumerate(halves):
            out[i + j] += left * right
    return tuple(out)
