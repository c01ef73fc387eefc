"""Where particles are born and where they may live: points, lines, discs, spheres, boxes; and cones of velocity."""

# Pyright cannot follow the code of kernels: attributes from derived(), vectors made of tuples.
# pyright: reportAttributeAccessIssue=false, reportOperatorIssue=false

import math
from typing import Annotated, Any

import taichi as ti
from pydantic import Field

from ..errors import InputError
from ..rng import device_uniform
from ..spec import NonNegative, Positive, Vec3, spec, unit
from .spread import Spread, SpreadLike

_TURN = 2 * math.pi


@ti.func
def _across(n):
    """Return two directions across the unit vector `n` (Duff et al., JCGT 6, 2017)."""
    sign = ti.select(n[2] >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return (
        ti.Vector([1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]]),
        ti.Vector([b, sign + n[1] * n[1] * a, -n[1]]),
    )


@spec
class Point:
    """Always at `position` [m]."""

    position: Vec3 = (0.0, 0.0, 0.0)

    @ti.func
    def sample(self, stream, draw):
        """Return the point [m]."""
        return self.position


@spec
class Line:
    """Uniform between `start` and `end` [m]."""

    start: Vec3
    end: Vec3

    @ti.func
    def sample(self, stream, draw):
        """Return a point [m]."""
        return self.start + device_uniform(stream, draw) * (self.end - self.start)


@spec
class Disc:
    """Uniform on a disc: `center`, `radius` [m], `normal`."""

    center: Vec3 = (0.0, 0.0, 0.0)
    radius: Positive
    normal: Vec3 = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        unit("Disc.normal", self.normal)

    def derived(self) -> dict[str, Vec3]:
        """Return the normal at unit length."""
        return {"normal": unit("Disc.normal", self.normal)}

    @ti.func
    def sample(self, stream, draw):
        """Return a point [m]."""
        across, along = _across(self.normal)
        r = self.radius * ti.sqrt(device_uniform(stream, draw))
        angle = _TURN * device_uniform(stream, draw + 1)
        return self.center + r * (ti.cos(angle) * across + ti.sin(angle) * along)


@spec
class Sphere:
    """Uniform in a ball, or on its `surface`: `center`, `radius` [m]. As a region: its inside."""

    center: Vec3 = (0.0, 0.0, 0.0)
    radius: Positive
    surface: bool = False

    @ti.func
    def sample(self, stream, draw):
        """Return a point [m]."""
        z = 2.0 * device_uniform(stream, draw) - 1.0
        angle = _TURN * device_uniform(stream, draw + 1)
        r = self.radius
        if ti.static(not self.surface):
            r *= device_uniform(stream, draw + 2) ** ti.static(1 / 3)
        across = ti.sqrt(ti.max(0.0, 1.0 - z * z))
        return self.center + r * ti.Vector([across * ti.cos(angle), across * ti.sin(angle), z])

    @ti.func
    def contains(self, x):
        """Tell whether `x` [m] is inside."""
        return (x - self.center).norm_sqr() <= self.radius * self.radius


@spec
class Box:
    """Uniform in a box between the corners `low` and `high` [m]; a flat one is a rectangle. As a region: its inside."""

    low: Vec3
    high: Vec3

    def __post_init__(self) -> None:
        if any(a > b for a, b in zip(self.low, self.high, strict=True)):
            raise InputError(f"Box.low = {self.low} must not exceed Box.high = {self.high} in any coordinate")

    @ti.func
    def sample(self, stream, draw):
        """Return a point [m]."""
        u = ti.Vector([device_uniform(stream, draw + d) for d in ti.static(range(3))])
        return self.low + u * (self.high - self.low)

    @ti.func
    def contains(self, x):
        """Tell whether `x` [m] is inside."""
        return (x >= self.low).all() and (x <= self.high).all()


@spec
class Cone:
    """Reeves' ejection cone: directions uniform in the solid angle within `angle` [degrees] of `axis`, `speed` [m/s]."""

    axis: Vec3 = (0.0, 0.0, 1.0)
    angle: Annotated[NonNegative, Field(le=180)] = 0.0
    speed: SpreadLike = Spread(mean=0.0)

    def __post_init__(self) -> None:
        unit("Cone.axis", self.axis)

    def derived(self) -> dict[str, Any]:
        """Return the axis at unit length and the height of the cap, 1 - cos(angle) without cancellation."""
        return {"axis": unit("Cone.axis", self.axis), "cap": 2.0 * math.sin(math.radians(self.angle) / 2) ** 2}

    @ti.func
    def sample(self, stream, draw):
        """Return a velocity [m/s]; takes four draws."""
        across, along = _across(self.axis)
        # h = 1 - cos(polar angle) is uniform over the cap; its sine is sqrt(h (2 - h)), exact for narrow cones too
        h = self.cap * device_uniform(stream, draw)
        s = ti.sqrt(ti.max(0.0, h * (2.0 - h)))
        angle = _TURN * device_uniform(stream, draw + 1)
        direction = (1.0 - h) * self.axis + s * (ti.cos(angle) * across + ti.sin(angle) * along)
        return self.speed.sample(stream, draw + 2) * direction


Shape = Point | Line | Disc | Sphere | Box
Region = Sphere | Box
