"""The right-hand side as a list of terms, the form in which the fused stepper walks it.

A term adds `rate(p, t, z, u, q)` to `width` components of the slope from `first` on, or to the flow register u (`first` < 0): z the
state, u the flow's velocity at the particle, q = (age, size). The term of a noise runs once an octave, its law
says how often: that loop stays outside the lane loop, where it costs neither vectorisation nor compile time.
"""

# pyright: reportInvalidTypeForm=false

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import taichi as ti
from taichi.lang.expr import Expr

from ..binding import Parameters
from ..physics.law import flow_terms

FLOW_REGISTER = -1


class LawError(ti.TaichiCompilationError):
    """A law returned something else than a vector of 3. Taichi keeps the kind of its own errors, and writes where before them."""

    @property
    def reason(self) -> str:
        """What is wrong, without the frames of kernels."""
        return str(self).rstrip().rpartition("\n")[2]


@dataclass(frozen=True)
class Term:
    """One summand; `evaluate` is the `@ti.func` and `law` the bound law it belongs to."""

    law: Any
    evaluate: Any
    first: int
    width: int
    in_passes: bool = False
    resets_flow: bool = False  # clears the flow register first

    @ti.func
    def passes(self):
        """Return how often it runs."""
        count = 1
        if ti.static(self.in_passes):
            count = ti.cast(self.law.passes, ti.i32)
        return count


@ti.func
def _kinematics(law: ti.template(), p, t, z, u, q):
    return ti.Vector([z[3], z[4], z[5]])


@ti.func
def _flow(law: ti.template(), p, t, z, u, q):
    return law.velocity(t, ti.Vector([z[0], z[1], z[2]]))


@ti.func
def _flow_pass(law: ti.template(), p, t, z, u, q):
    return law.velocity_pass(p, t, ti.Vector([z[0], z[1], z[2]]))


@ti.func
def _force(law: ti.template(), p, t, z, u, q):
    return law.acceleration(t, ti.Vector([z[0], z[1], z[2]]), ti.Vector([z[3], z[4], z[5]]))


@ti.func
def _force_in_flow(law: ti.template(), p, t, z, u, q):
    return law.acceleration(t, ti.Vector([z[0], z[1], z[2]]), ti.Vector([z[3], z[4], z[5]]), u)


def flow(law: Any, parameters: Any, first: int) -> list[Term]:
    """Return the terms of a flow or a sum of flows, added from component `first` on."""
    return [
        Term(
            law=_checked(parameters.bind(term), "velocity_pass" if hasattr(term, "velocity_pass") else "velocity"),
            evaluate=_flow_pass if hasattr(term, "velocity_pass") else _flow,
            first=first,
            width=3,
            in_passes=hasattr(term, "velocity_pass"),
            resets_flow=first == FLOW_REGISTER and k == 0,
        )
        for k, term in enumerate(_joined(flow_terms(law)))
    ]


def _checked(law: Any, name: str) -> Any:
    """Let a bound law say, while a kernel is traced, that its function `name` returns no vector of 3."""
    function = getattr(law, name)

    @functools.wraps(function)  # which Taichi knows by its attributes
    def checked(*arguments: Any) -> Any:
        value = function(*arguments)
        if (shape := _shape(value)) != (3,):
            found = {None: "nothing", (): "a number"}.get(shape, f"one of shape {shape}")
            raise LawError(f"{type(law).__name__}.{name} must return a vector of 3, not {found}")
        return value

    law.__dict__[name] = checked
    return law


def _shape(value: Any) -> tuple[int, ...] | None:
    """Return the shape of what a function returned while it was traced; None for nothing."""
    if value is None:
        return None
    if isinstance(value, tuple | list):
        return (len(value),)
    tensor = isinstance(value, ti.Matrix) or (isinstance(value, Expr) and value.is_tensor())
    return tuple(cast(Any, value).get_shape()) if tensor else ()


def _joined(laws: Sequence[Any]) -> list[Any]:
    """Return the summands, noises of a kind as one: what is compiled twice takes twice as long."""
    found: list[Any] = []
    for law in laws:
        law = getattr(law, "as_octaves", lambda law=law: law)()
        for i, before in enumerate(found):
            both = before.joined(law) if hasattr(before, "joined") else None
            if both is not None:
                found[i] = both
                break
        else:
            found.append(law)
    return found


def motion() -> Term:
    """Return dx/dt = v."""
    return Term(law=None, evaluate=_kinematics, first=0, width=3)


def force(law: Any, parameters: Any) -> list[Term]:
    """Return the terms of a force: first its flow, if it has one, into the flow register."""
    inside = getattr(law, "flow", None)
    before = [] if inside is None else flow(inside, parameters, FLOW_REGISTER)
    evaluate = _force if inside is None else _force_in_flow
    bound = _checked(parameters.bind(law, skip=("flow",)), "acceleration")
    return [*before, Term(law=bound, evaluate=evaluate, first=3, width=3)]


def heat(law: Any, parameters: Any, first: int) -> Term:
    """Return dT/dt of a cooling law that is integrated, with T in component `first`."""

    @ti.func
    def rate(law: ti.template(), p, t, z, u, q):
        return ti.Vector([law.rate(z[first], q[0], q[1])])

    return Term(law=parameters.bind(law), evaluate=rate, first=first, width=1)


def is_heated(cooling: Any) -> bool:
    """Whether the temperature is part of the state."""
    return cooling is not None and cooling.integrated


def right_hand_side(system: Any, cooling: Any, parameters: Parameters) -> list[Term]:
    """Return the terms of a system, and of its cooling law if that is integrated."""
    terms = system.terms(parameters)
    if is_heated(cooling):
        terms.append(heat(cooling, parameters, 3 * len(system.state)))
    return terms


def likeness(system: Any, cooling: Any) -> list[Any]:
    """Return what of a right-hand side is compiled: where it is the same, one kernel serves both."""
    parameters = Parameters()
    terms = right_hand_side(system, cooling, parameters)
    return [*parameters.structure, *((t.evaluate.__qualname__, t.first, t.width) for t in terms)]


def first_writers(terms: list[Term]) -> list[tuple[Term, bool]]:
    """Pair each term with whether it sets its components, as the first that writes them, or adds to them."""
    written: set[int] = set()
    pairs = []
    for term in terms:
        if term.first == FLOW_REGISTER:
            pairs.append((term, term.resets_flow))
            continue
        own = set(range(term.first, term.first + term.width))
        pairs.append((term, not own & written))
        written |= own
    return pairs
