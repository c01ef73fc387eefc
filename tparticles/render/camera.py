"""Where the film looks from: a pin-hole camera, still or key-framed, and the pose that projects the world onto pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tparticles.errors import InputError
from tparticles.spec import Finite, Vec3, spec
from tparticles.track import Track

Array = NDArray[np.float64]

# Nearer than this [m] has no direction; sine of the smallest angle that `up` may make with the view.
_NEAR = 1e-9
_PARALLEL = 1e-6


@dataclass(frozen=True, eq=False)
class Pose:
    """The camera at one time. `right`, `up`, `forward`: unit vectors, shape (3,); right x up = -forward.

    `position` [m], shape (3,); `tan_half` is the tangent of half the vertical field of view.
    """

    position: Array
    right: Array
    up: Array
    forward: Array
    tan_half: float

    def focal(self, height: float) -> float:
        """Return the distance from the pin-hole to a film of `height` pixels [px]."""
        return 0.5 * height / self.tan_half

    def project(self, points: ArrayLike, width: int, height: int) -> tuple[Array, Array, Array]:
        """Return `(u, v, depth)` of points [m], shape (..., 3); each result has shape (...).

        `u, v` [px]: (0, 0) is the top left corner of the film, pixel centres are at +0.5, v grows downward. `depth` [m]
        is along `forward`; u and v are NaN where it is not above 0.
        """
        offset = np.asarray(points, dtype=np.float64) - self.position
        depth = offset @ self.forward
        # u = width / 2 + focal x / depth, v = height / 2 - focal y / depth
        scale = self.focal(height) / np.where(depth > 0.0, depth, np.nan)
        return 0.5 * width + scale * (offset @ self.right), 0.5 * height - scale * (offset @ self.up), depth


@spec
class Camera:
    """A pin-hole at `position` [m] that looks at `target` [m] with `up` pointing upward on the film.

    `fov` is the vertical field of view [degrees], above 0 and below 180. Each may be a `Track`.

    Raises `InputError` for a still camera that looks at itself or along `up`, for a field of view out of range,
    a Track of the wrong kind, a wrong type or a value that is not finite.
    """

    position: Vec3 | Track
    target: Vec3 | Track
    up: Vec3 | Track = (0.0, 0.0, 1.0)
    fov: Finite | Track = 40.0

    def __post_init__(self) -> None:
        for name in ("position", "target", "up", "fov"):
            value = getattr(self, name)
            if isinstance(value, Track) and value.is_vector != (name != "fov"):
                raise InputError(f"camera {name}: a Track of {'numbers' if name == 'fov' else 'vectors'} is needed")
        for fov in [value for _, value in self.fov.keys] if isinstance(self.fov, Track) else [self.fov]:
            if not (isinstance(fov, float) and 0.0 < fov < 180.0):
                raise InputError(f"camera fov = {fov} degrees is not allowed (above 0 and below 180)")
        if not self.moves:
            self.pose(0.0)

    @property
    def moves(self) -> bool:
        """Whether anything of the camera changes in time."""
        return any(isinstance(value, Track) for value in (self.position, self.target, self.up, self.fov))

    def pose(self, t: float) -> Pose:
        """Return the pose at time `t` [s]. Raises `InputError` if the camera has no direction or no upright then."""
        when = f" at t = {t:g} s" if self.moves else ""
        position, target, up = _at(self.position, t), _at(self.target, t), _at(self.up, t)
        distance = float(np.linalg.norm(target - position))
        if distance < _NEAR:
            raise InputError(f"the camera looks at itself{when}: position and target are both {_show(position)}")
        forward = (target - position) / distance
        side = np.cross(forward, up)
        sine = float(np.linalg.norm(side))
        if sine <= _PARALLEL * float(np.linalg.norm(up)):
            raise InputError(f"camera up = {_show(up)} is parallel to the view direction {_show(forward)}{when}")
        right = side / sine
        tan_half = math.tan(0.5 * math.radians(float(_at(self.fov, t))))
        return Pose(position, right, np.cross(right, forward), forward, tan_half)


def _at(value: float | Vec3 | Track, t: float) -> Array:
    return value.at(t) if isinstance(value, Track) else np.asarray(value, dtype=np.float64)


def _show(vector: Array) -> str:
    return f"({', '.join(f'{x:g}' for x in vector)})"
