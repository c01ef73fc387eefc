"""Laws: what a flow and a force are, how flows add up, and bounds on their Jacobians.

A law is any object with the right `@ti.func`; it needs no base class and no entry in a list. Its float attributes are
run-time parameters of the kernels (see `tparticles.binding`).
"""

import dataclasses
import inspect
from collections.abc import Iterable
from typing import Any, Protocol, Self, runtime_checkable

from ..errors import InputError


@runtime_checkable
class FlowLike(Protocol):
    """A velocity field: `velocity(self, t, x)` [m/s], a `@ti.func` of the time [s] and the position [m]."""

    def velocity(self, t, x): ...  # noqa: D102


@runtime_checkable
class ForceLike(Protocol):
    """A force per mass: `acceleration(self, t, x, v)` [m/s^2], a `@ti.func`.

    A force with an attribute `flow` is given the flow's velocity at the particle too: `acceleration(self, t, x, v, u)`.
    Splittings of high order ask for forces that say `velocity_free = True`: they do not depend on v.
    A force whose v certainly relaxes at some rate says so by `damping()` [1/s]: too long a step is then refused beforehand.
    """

    def acceleration(self, t, x, v): ...  # noqa: D102


class Flow:
    """Base of the built-in flows: they add up with `+`, also with a flow of the user's own."""

    def __add__(self, other: FlowLike) -> "Sum":
        return Sum(self, other)

    def __radd__(self, other: FlowLike) -> "Sum":
        return Sum(other, self)


class Sum(Flow):
    """Several flows at once: u = u1 + u2 + ... Nested sums are flattened.

    Raises:
        InputError: an operand has no `velocity`.
    """

    def __init__(self, *flows: Any):
        for flow in flows:
            check_flow("Sum", flow)
        self.flows = tuple(term for flow in flows for term in flow_terms(flow))

    def __repr__(self) -> str:
        return " + ".join(map(repr, self.flows))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sum) and self.flows == other.flows

    def __hash__(self) -> int:
        return hash(self.flows)


def check_flow(where: str, flow: Any) -> None:
    """Refuse what is no flow.

    Raises:
        InputError: it has neither `velocity(self, t, x)` nor `velocity_pass(self, p, t, x)` for kernels; `where` names the place.
    """
    for term in flow_terms(flow):
        if hasattr(term, "velocity_pass"):
            _check_function(where, term, "velocity_pass", "p, t, x")
        elif hasattr(term, "velocity"):
            _check_function(where, term, "velocity", "t, x")
        else:
            raise InputError(f"{where}: {term!r} is no flow, it has no velocity(self, t, x)")


def check_force(where: str, force: Any) -> None:
    """Refuse what is no force.

    Raises:
        InputError: it has no `acceleration(self, t, x, v)` for kernels, with `u` too where it has a flow; `where` names the place.
    """
    if not isinstance(force, ForceLike):
        raise InputError(f"{where}: {force!r} is no force: it has no acceleration(self, t, x, v)")
    _check_function(where, force, "acceleration", "t, x, v" if getattr(force, "flow", None) is None else "t, x, v, u")


def _check_function(where: str, law: Any, name: str, arguments: str) -> None:
    """Refuse what a kernel cannot call: Taichi would only warn of a plain function, and trace it wrongly."""
    function, here = getattr(law, name), f"{where}: {type(law).__name__}.{name}"
    if not getattr(function, "_is_taichi_function", False):
        raise InputError(f"{here} is no @ti.func")
    signature = inspect.signature(function)
    try:
        signature.bind(*arguments.split(", "))
    except TypeError:
        taken = ", ".join(["self", *signature.parameters])
        raise InputError(f"{here} must take (self, {arguments}), not ({taken})") from None


def flow_terms(flow: Any) -> tuple[Any, ...]:
    """Return the elementary flows of a flow or a sum of flows."""
    return flow.flows if isinstance(flow, Sum) else (flow,)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Bound:
    """Bounds on the eigenvalues of a law's Jacobian [1/s]: along the negative real axis (damping) and the imaginary one.

    A scheme with stability limits (R, I) is stable for dt <= min(R / real, I / imaginary) in the linear analysis.
    """

    real: float = 0.0
    imaginary: float = 0.0

    def __add__(self, other: Self) -> "Bound":
        return Bound(real=self.real + other.real, imaginary=self.imaginary + other.imaginary)


def jacobian_bound(laws: Iterable[Any]) -> Bound:
    """Add up the bounds of several laws.

    Raises:
        InputError: a law has no method `jacobian_bound()`; the message names it.
    """
    total = Bound()
    for law in laws:
        if not hasattr(law, "jacobian_bound"):
            raise InputError(
                f"{type(law).__name__} has no jacobian_bound(self) -> Bound: add one to use StabilityLimit, or step with Fixed(dt)"
            )
        total = total + law.jacobian_bound()
    return total
