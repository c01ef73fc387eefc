"""Forces per mass on particles with inertia."""

import math
from typing import Any

import taichi as ti
from pydantic import SkipValidation

from ..spec import Positive, Vec3, spec
from .flows import Uniform
from .law import Bound, check_flow, flow_terms, jacobian_bound


@spec
class Gravity:
    """A constant acceleration `g` [m/s^2]."""

    g: Vec3 = (0.0, 0.0, -9.81)

    velocity_free = True

    @ti.func
    def acceleration(self, t, x, v):
        """Return g [m/s^2]."""
        return self.g

    def jacobian_bound(self) -> Bound:
        """Return zero: the force is the same everywhere."""
        return Bound()


@spec
class Drag:
    """Stokes drag towards a flow: a = (u(t, x) - v) / `time`, the response time [s] of the particle."""

    time: Positive
    flow: SkipValidation[Any] = Uniform()

    def __post_init__(self) -> None:
        check_flow("Drag.flow", self.flow)

    @ti.func
    def acceleration(self, t, x, v, u):
        """Return the drag [m/s^2]; `u` is the flow's velocity at the particle."""
        return (u - v) / self.time

    def damping(self) -> float:
        """Return the rate at which v relaxes [1/s], whatever the flow."""
        return 1.0 / self.time

    def jacobian_bound(self) -> Bound:
        """Return a bound on the roots of l^2 + l / time = g / time, g the flow's own bound: 1 / time in a uniform wind."""
        g = jacobian_bound(flow_terms(self.flow)).real
        return Bound(real=(1.0 + math.sqrt(1.0 + 4.0 * g * self.time)) / (2.0 * self.time))
