"""An integration scheme as a value: a straight-line program over registers, walked by every executor.

Registers: z0 (the state at the start of the step), z (the running state) and the slopes k[0..]. A step starts with
z = z0 and its result is z. For a second-order system z = (x, v) and a slope is (v, a). New families of methods are
other programs, not other executors.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import IntEnum

from tparticles.schemes import program_checks
from tparticles.schemes.characteristic import AnyStability


class OpKind(IntEnum):
    """What an op does; the integers are what an executor stores."""

    COMBINE = 0  # z = z0 + dt sum_j weights[j] k_j
    EVALUATE = 1  # k_slope = f(t + time dt, z)
    KICK = 2  # v += dt sum_j weights[j] a_j : the velocity part of z; a_j is the velocity part of k_j
    DRIFT = 3  # x += dt weights[0] v : the position part of z; v is its present velocity part
    SOLVE = 4  # zbar = z; z = zbar + w dt f(t + time dt, z) with w = weights[0]; k_slope = (z - zbar) / (w dt)
    ROTATE = 5  # k_slope = k_source
    DIFFERENCE = 6  # k_slope = (z - z0) / dt : a past state, kept as the mean slope that led on from it


@dataclass(frozen=True)
class Op:
    """One instruction; `Scheme` checks it. Fields that its kind does not read keep their defaults.

    `slope`: register that EVALUATE, SOLVE, ROTATE and DIFFERENCE write; `source`: register that ROTATE copies.
    `weights`: COMBINE's and KICK's, one for each of k_0, k_1, ... (a zero weight reads nothing); DRIFT's and SOLVE's one.
    `time`: when EVALUATE and SOLVE look at f, in units of dt after the start of the step.
    `linear`: SOLVE takes one Newton step from zbar: k = (I - w dt df/dz(zbar))^-1 f(t + time dt, zbar).
    `variable`: for steps of varying size one (n0, n1, d) per weight: with r = dt / (the previous dt) the weight is
    (n0 + n1 r) / (1 + d r); `weights` holds the values at r = 1. Empty where the weights do not depend on r.
    """

    kind: OpKind
    slope: int = 0
    weights: tuple[float, ...] = ()
    time: float = 0.0
    source: int = 0
    linear: bool = False
    variable: tuple[tuple[float, float, float], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """An integration scheme: its program, and what is known about it. Hashable, compared by value.

    `order`: of accuracy. `slopes`: number of slope registers. `system_orders`: which systems it can advance, 1 for
    z = x and 2 for z = (x, v); programs with KICK or DRIFT have {2}. `reference`: where the coefficients come from.
    `needs`: what its order asks for: "equal steps", "second-order system", "velocity-free forces".
    `error_weights`: the local error estimate is dt sum_j e_j k_j; `error_order` the lower order of that pair.
    `reuses`: ops[0] puts f(t, z) into k_0 and at the end k_0 = f(t + dt, z) again, so that ops[0] may be left out where
    k_0 is still valid; where `kicks_after_evaluation`, that is with forces free of velocity only.
    `history`: ROTATE and DIFFERENCE ops run after every step, a starting step too, that fill the registers `carried`
    from step to step. `steps_back`: how many steps must have been made since a start before `ops` may run; until then
    `starter` runs, a one-step scheme. `ssp`: the strong-stability-preserving coefficient, where it has one.
    `interpolates`: each COMBINE integrates over the step the polynomial through the slopes that it has a weight for, where k_j
    is f at t + (1 - j) dt: a predictor, and a corrector of one slope more, whose difference is the error estimate. With steps of
    varying size the same slopes have other weights; and the first step after a start needs but the slope there, the second one
    more, and so on, so that where errors are held against a tolerance no `starter` is needed.
    Raises InputError, naming the scheme and the value, if the program is not well formed.
    """

    name: str
    order: int
    ops: tuple[Op, ...]
    slopes: int
    stability: AnyStability
    system_orders: frozenset[int] = frozenset({1, 2})
    needs: tuple[str, ...] = ()
    reference: str = ""
    error_weights: tuple[float, ...] = ()
    error_order: int = 0
    reuses: bool = False
    history: tuple[Op, ...] = ()
    carried: tuple[int, ...] = ()
    steps_back: int = 0
    starter: Scheme | None = None
    ssp: float | None = None
    interpolates: bool = False

    def __post_init__(self) -> None:
        program_checks.check(self)

    @property
    def stages(self) -> int:
        """EVALUATE and SOLVE ops of the program."""
        return sum(op.kind in (OpKind.EVALUATE, OpKind.SOLVE) for op in self.ops)

    @property
    def evaluations(self) -> int:
        """Evaluations of f and solutions of an implicit stage per step in the long run, reused ones not counted."""
        return self.stages - self.reuses

    @property
    def kicks_after_evaluation(self) -> bool:
        """Whether a KICK follows the evaluation that `reuses` keeps: it is valid for forces free of velocity only."""
        return self.reuses and program_checks.kicks_after(self.ops)

    @property
    def implicit(self) -> bool:
        """Whether a stage has to be solved for."""
        return any(op.kind is OpKind.SOLVE for op in self.ops)

    @property
    def variable_steps(self) -> bool:
        """Whether its steps may differ in size without a restart."""
        return "equal steps" not in self.needs

    @property
    def starts_itself(self) -> bool:
        """Whether it begins with one slope, by lower orders and short steps."""
        return self.interpolates and self.starter is None

    @property
    def one_step(self) -> bool:
        """Whether a step depends on nothing but the state at its start."""
        return self.steps_back == 0

    @property
    def registers(self) -> int:
        """Slope registers needed for the program and for its starter."""
        return self.slopes + (self.starter.slopes - 1 if self.starter else 0)

    @property
    def starting_ops(self) -> tuple[Op, ...]:
        """The starter's program on registers that are not carried: its k_0 stays k_0, its k_j is k_(slopes + j - 1)."""
        return tuple(_moved(op, self.slopes - 1) for op in self.starter.ops) if self.starter else ()

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


def _moved(op: Op, by: int) -> Op:
    weights = op.weights
    # DRIFT and SOLVE have one weight, of no register.
    if op.kind in (OpKind.COMBINE, OpKind.KICK) and len(weights) > 1:
        weights = (weights[0], *(0.0,) * by, *weights[1:])
    return dataclasses.replace(
        op,
        weights=weights,
        slope=op.slope + by if op.slope else 0,
        source=op.source + by if op.source else 0,
    )
