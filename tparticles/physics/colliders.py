"""What vertices and particles bounce off: shapes with a signed distance.

A collider is any object with two `@ti.func`: `signed_distance(self, x)` [m], positive where particles may be, exact or at least
right near the surface, and `normal(self, x)`, the unit vector in which it grows. Of its attributes those of `Surface` are used,
with the same defaults. A collider with a velocity moves: it stands as written at t = 0, so whoever asks it at time t asks at
x - velocity t.
"""

# Pyright cannot follow the code of kernels: attributes from derived(), vectors made of tuples.
# pyright: reportAttributeAccessIssue=false, reportOperatorIssue=false, reportIndexIssue=false, reportOptionalCall=false

from typing import Annotated, Any, Protocol, runtime_checkable

import taichi as ti
from pydantic import Field

from ..errors import InputError
from ..spec import NonNegative, Positive, Vec3, spec, unit

_UP = (0.0, 0.0, 1.0)


@runtime_checkable
class ColliderLike(Protocol):
    """What can be bounced off: `signed_distance(self, x)` [m] and `normal(self, x)`, both `@ti.func`."""

    def signed_distance(self, x): ...  # noqa: D102

    def normal(self, x): ...  # noqa: D102


@spec
class Surface:
    """How a collider throws back.

    `restitution`: the part of the normal velocity that is kept, 0 to 1. `friction`: Coulomb's coefficient. `velocity` [m/s].
    """

    restitution: Annotated[NonNegative, Field(le=1)] = 0.5
    friction: NonNegative = 0.0
    velocity: Vec3 = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, collider: Any) -> "Surface":
        """Return the surface of any collider.

        Raises:
            InputError: it has no `signed_distance` or `normal`, or a wrong value.
        """
        if not isinstance(collider, ColliderLike) or isinstance(collider, type):
            raise InputError(f"{collider!r} is no collider: it needs signed_distance(self, x) and normal(self, x)")
        names = ("restitution", "friction", "velocity")
        return Surface(**{name: getattr(collider, name) for name in names if hasattr(collider, name)})


@ti.func
def _direction(d):
    """Return `d` at unit length, or upward where it has none."""
    length = d.norm()
    return ti.select(length > 0.0, d / ti.max(length, 1e-30), ti.Vector([0.0, 0.0, 1.0]))


@spec
class Plane(Surface):
    """The half space in front of a plane through `point` [m]; `facing` points to where particles may be."""

    point: Vec3 = (0.0, 0.0, 0.0)
    facing: Vec3 = _UP

    def __post_init__(self) -> None:
        unit("Plane.facing", self.facing)

    def derived(self) -> dict[str, Vec3]:
        """Return `facing` at unit length."""
        return {"facing": unit("Plane.facing", self.facing)}

    @ti.func
    def signed_distance(self, x):
        """Return the height above the plane [m]."""
        return (x - self.point).dot(self.facing)

    @ti.func
    def normal(self, x):
        """Return the direction in which it grows."""
        return self.facing


@spec
class Room(Surface):
    """The inside of a box between the corners `low` and `high` [m], with six walls."""

    low: Vec3
    high: Vec3

    def __post_init__(self) -> None:
        if any(a >= b for a, b in zip(self.low, self.high, strict=True)):
            raise InputError(f"Room.low = {self.low} must be below Room.high = {self.high} in every coordinate")

    def derived(self) -> dict[str, Vec3]:
        """Return the middle and half the size [m]."""
        pairs = list(zip(self.low, self.high, strict=True))
        return {"middle": _vec(0.5 * (a + b) for a, b in pairs), "half": _vec(0.5 * (b - a) for a, b in pairs)}

    @property
    def walls(self) -> tuple[Plane, ...]:
        """The six walls, each facing inward: in a corner a vertex touches three of them at once."""
        common = {"restitution": self.restitution, "friction": self.friction, "velocity": self.velocity}
        axes = [_vec(float(i == d) for i in range(3)) for d in range(3)]
        floors = (Plane(point=self.low, facing=axis, **common) for axis in axes)
        ceilings = (Plane(point=self.high, facing=_vec(0.0 - a for a in axis), **common) for axis in axes)
        return (*floors, *ceilings)

    @ti.func
    def signed_distance(self, x):
        """Return the distance to the nearest wall [m], negative outside the room."""
        q = abs(x - self.middle) - self.half
        return -(ti.max(q, 0.0).norm() + ti.min(q.max(), 0.0))

    @ti.func
    def normal(self, x):
        """Return the direction in which it grows; on an edge between two walls that of the earlier axis."""
        d = x - self.middle
        q = abs(d) - self.half
        out = ti.max(q, 0.0)
        nearest = ti.Vector([1.0, 0.0, 0.0])
        if q[1] > q[0] and q[1] >= q[2]:
            nearest = ti.Vector([0.0, 1.0, 0.0])
        elif q[2] > q[0] and q[2] > q[1]:
            nearest = ti.Vector([0.0, 0.0, 1.0])
        n = ti.select(out.norm() > 0.0, _direction(out), nearest)
        return -n * ti.select(d >= 0.0, 1.0, -1.0)


@spec
class Ball(Surface):
    """The outside of a ball: `center`, `radius` [m]."""

    center: Vec3 = (0.0, 0.0, 0.0)
    radius: Positive

    @ti.func
    def signed_distance(self, x):
        """Return the distance to the surface [m], negative inside the ball."""
        return (x - self.center).norm() - self.radius

    @ti.func
    def normal(self, x):
        """Return the direction away from the centre."""
        return _direction(x - self.center)


@spec
class Capsule(Surface):
    """The outside of a rod with round ends: all within `radius` [m] of the line from `start` to `end` [m]."""

    start: Vec3
    end: Vec3
    radius: Positive

    def derived(self) -> dict[str, Any]:
        """Return the axis from start to end [m], and the same over its squared length [1/m]."""
        axis = _vec(b - a for a, b in zip(self.start, self.end, strict=True))
        square = sum(a * a for a in axis)
        return {"axis": axis, "slope": _vec(a / square if square else 0.0 for a in axis)}

    @ti.func
    def _from_axis(self, x):
        d = x - self.start
        return d - ti.min(ti.max(d.dot(self.slope), 0.0), 1.0) * self.axis

    @ti.func
    def signed_distance(self, x):
        """Return the distance to the surface [m], negative inside the capsule."""
        return self._from_axis(x).norm() - self.radius

    @ti.func
    def normal(self, x):
        """Return the direction away from the axis."""
        return _direction(self._from_axis(x))


def _vec(values: Any) -> Vec3:
    x, y, z = values
    return x, y, z
