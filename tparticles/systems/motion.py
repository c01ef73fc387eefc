"""The kinds of particle system without neighbours: carried by a flow, with inertia, or at rest.

A system says which attributes are its state and lists the terms of its right-hand side; a stepper does the rest.
"""

from __future__ import annotations

from typing import Any

from pydantic import SkipValidation

from ..physics.flows import Uniform
from ..physics.law import Bound, check_flow, check_force, flow_terms, jacobian_bound
from ..spec import spec
from . import terms


@spec
class Advected:
    """First order: x' = u(t, x), the particle moves with the `flow` (slide 12)."""

    flow: SkipValidation[Any]

    order = 1
    state = ("x",)
    moves = True
    velocity_free = True
    damping = 0.0

    def __post_init__(self) -> None:
        check_flow("Advected.flow", self.flow)

    def terms(self, parameters: Any) -> list[terms.Term]:
        """Return the terms of dx/dt."""
        return terms.flow(self.flow, parameters, 0)

    def jacobian_bound(self) -> Bound:
        """Return the bound on du/dx [1/s]."""
        return jacobian_bound(flow_terms(self.flow))


@spec
class Newtonian:
    """Second order: x' = v, v' = sum of `forces`, each an acceleration [m/s^2]."""

    forces: SkipValidation[tuple[Any, ...]]

    order = 2
    state = ("x", "v")
    moves = True

    def __post_init__(self) -> None:
        for force in self.forces if isinstance(self.forces, tuple | list) else (self.forces,):
            check_force("Newtonian.forces", force)
        object.__setattr__(
            self, "forces", tuple(self.forces) if isinstance(self.forces, tuple | list) else (self.forces,)
        )

    @property
    def velocity_free(self) -> bool:
        """Whether no force depends on v, as far as the forces say."""
        return all(getattr(force, "velocity_free", False) for force in self.forces)

    @property
    def damping(self) -> float:
        """The rate at which v certainly relaxes [1/s]."""
        return sum(force.damping() for force in self.forces if hasattr(force, "damping"))

    def terms(self, parameters: Any) -> list[terms.Term]:
        """Return the terms of dx/dt and dv/dt."""
        return [terms.motion(), *(term for force in self.forces for term in terms.force(force, parameters))]

    def jacobian_bound(self) -> Bound:
        """Return the bound on the eigenvalues of the first-order form [1/s]."""
        return jacobian_bound(self.forces)


@spec
class Still:
    """At rest: particles stay where they were born, as embers do. Only a cooling law that is integrated takes steps."""

    order = 1
    state = ("x",)
    moves = False
    velocity_free = True
    damping = 0.0

    def terms(self, parameters: Any) -> list[terms.Term]:
        """Return the terms of dx/dt = 0."""
        return terms.flow(Uniform(), parameters, 0)

    def jacobian_bound(self) -> Bound:
        """Return the bound on the eigenvalues, 0 [1/s]."""
        return Bound()


System = Advected | Newtonian | Still
