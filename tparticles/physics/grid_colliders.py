"""Colliders sampled on regular grids: a landscape of heights, and the distance to any closed surface."""

# Pyright cannot follow the code of kernels: attributes from derived(), vectors made of tuples.
# pyright: reportAttributeAccessIssue=false, reportOperatorIssue=false, reportIndexIssue=false, reportCallIssue=false

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import taichi as ti
from pydantic import BeforeValidator

from ..errors import InputError
from ..spec import Finite, Vec3, spec
from .colliders import Surface
from .mesh import Mesh
from .mesh_checks import number, positive
from .samples import Samples, samples

_MOST = 256**3  # samples of a distance grid


@spec
class Heightfield(Surface):
    """A landscape z = h(x, y): `heights` [m], shape (nx, ny), on a regular grid from `low` to `high` (x, y) [m].

    Between the samples h is bilinear; beyond the grid it goes on level. The signed distance is the height above the ground times
    the cosine of its slope, right to first order near the ground.
    """

    heights: Annotated[Samples, BeforeValidator(samples(2))]
    low: tuple[Finite, Finite] = (-1.0, -1.0)
    high: tuple[Finite, Finite] = (1.0, 1.0)

    def __post_init__(self) -> None:
        _check_corners("Heightfield", self.low, self.high)

    @classmethod
    def from_image(cls, path: str | Path, *, bottom: float = 0.0, top: float = 1.0, **options: Any) -> "Heightfield":
        """Return the landscape of a picture, black at height `bottom` and white at `top` [m]; its top row lies at the largest y.

        Raises:
            InputError: the picture cannot be read.
        """
        from PIL import Image

        try:
            with Image.open(path) as image:
                deep = image.mode.startswith("I")  # 16 bits
                grey = np.asarray(image if deep else image.convert("L"), np.float64)
        except (OSError, ValueError) as error:
            raise InputError(f"height picture '{path}' cannot be read: {error}") from None
        heights = bottom + (top - bottom) / (65535.0 if deep else 255.0) * grey[::-1].T
        return cls(heights=heights, **options)  # type: ignore[arg-type]

    def derived(self) -> dict[str, Any]:
        """Return the heights as a table and samples per metre."""
        counts = self.heights.values.shape
        return {
            "heights": self.heights.values.ravel(),
            "counts": counts,
            "per_metre": tuple((n - 1) / (b - a) for n, a, b in zip(counts, self.low, self.high, strict=True)),
        }

    @ti.func
    def _ground(self, x):
        """Return h [m] and its slopes dh/dx, dh/dy."""
        rows, columns = ti.static(*self.counts)
        p = (ti.Vector([x[0], x[1]]) - self.low) * self.per_metre
        last = ti.Vector([rows - 1.0, columns - 1.0])
        within = ti.cast(p >= 0.0, float) * ti.cast(p <= last, float)
        p = ti.min(ti.max(p, 0.0), last)
        cell = ti.min(ti.cast(p, ti.i32), ti.Vector([rows - 2, columns - 2]))
        f = p - cell
        first = cell[0] * columns + cell[1]
        a, b = self.heights[first], self.heights[first + 1]
        c, d = self.heights[first + columns], self.heights[first + columns + 1]
        h = (1.0 - f[0]) * ((1.0 - f[1]) * a + f[1] * b) + f[0] * ((1.0 - f[1]) * c + f[1] * d)
        slope = ti.Vector([(1.0 - f[1]) * (c - a) + f[1] * (d - b), (1.0 - f[0]) * (b - a) + f[0] * (d - c)])
        return h, slope * self.per_metre * within

    @ti.func
    def signed_distance(self, x):
        """Return the distance to the ground [m], to first order; negative below."""
        h, slope = self._ground(x)
        return (x[2] - h) / ti.sqrt(1.0 + slope.norm_sqr())

    @ti.func
    def normal(self, x):
        """Return the normal of the ground under `x`."""
        _, slope = self._ground(x)
        return ti.Vector([-slope[0], -slope[1], 1.0]) / ti.sqrt(1.0 + slope.norm_sqr())


@spec
class DistanceGrid(Surface):
    """Any shape by its signed `distances` [m], shape (nx, ny, nz), on a regular grid from `low` to `high` [m], trilinear between.

    Distances are positive where particles may be. Beyond the grid the distance to the grid is added.
    """

    distances: Annotated[Samples, BeforeValidator(samples(3))]
    low: Vec3
    high: Vec3

    def __post_init__(self) -> None:
        _check_corners("DistanceGrid", self.low, self.high)

    @classmethod
    def around(cls, mesh: Mesh, *, cell: float, margin: float | None = None, **options: Any) -> "DistanceGrid":
        """Return the outside of a closed surface, the `faces` of a mesh (`tp.read_mesh`), sampled every `cell` [m].

        `margin` [m] is how far the grid reaches beyond the surface, three cells by default. Features below a cell are lost.

        Raises:
            InputError: the surface has holes, or the grid would have more than 256^3 samples; libigl is not installed.
        """
        from .surface_distance import closed_faces, surface_distance

        faces = closed_faces(mesh)
        beyond = 3.0 * positive("DistanceGrid.around: cell", cell) if margin is None else number("margin", margin)
        corners = mesh.x[np.unique(faces)]
        low, high = corners.min(axis=0) - beyond, corners.max(axis=0) + beyond
        counts = np.maximum(np.ceil((high - low) / cell).astype(np.int64) + 1, 2)
        if counts.prod() > _MOST:
            raise InputError(
                f"DistanceGrid.around: cell = {cell} m makes {'x'.join(map(str, counts))} samples, at most {_MOST}"
            )
        high = low + (counts - 1) * cell
        axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        distances = surface_distance(points, mesh.x, faces).reshape(counts)
        corners = {"low": tuple(low.tolist()), "high": tuple(high.tolist())}
        return cls(distances=distances, **corners, **options)  # type: ignore[arg-type]

    def derived(self) -> dict[str, Any]:
        """Return the distances as a table and samples per metre."""
        counts = self.distances.values.shape
        return {
            "distances": self.distances.values.ravel(),
            "counts": counts,
            "per_metre": tuple((n - 1) / (b - a) for n, a, b in zip(counts, self.low, self.high, strict=True)),
        }

    @ti.func
    def _sample(self, x):
        """Return the trilinear distance [m], its gradient, and how far beyond the grid `x` is, as a vector [m]."""
        nx, ny, nz = ti.static(*self.counts)
        held = ti.min(ti.max(x, self.low), self.high)
        p = (held - self.low) * self.per_metre
        cell = ti.min(ti.max(ti.cast(p, ti.i32), 0), ti.Vector([nx - 2, ny - 2, nz - 2]))
        f = p - cell
        first = (cell[0] * ny + cell[1]) * nz + cell[2]
        value = ti.cast(0.0, float)
        gradient = ti.Vector([0.0, 0.0, 0.0])
        for i, j, k in ti.static(ti.ndrange(2, 2, 2)):
            d = self.distances[first + ti.static((i * ny + j) * nz + k)]
            wx, wy, wz = (f[0] if i else 1.0 - f[0]), (f[1] if j else 1.0 - f[1]), (f[2] if k else 1.0 - f[2])
            value += wx * wy * wz * d
            gradient += d * ti.Vector([(2 * i - 1) * wy * wz, (2 * j - 1) * wx * wz, (2 * k - 1) * wx * wy])
        return value, gradient * self.per_metre, x - held

    @ti.func
    def signed_distance(self, x):
        """Return the distance to the surface [m], negative inside."""
        value, _, beyond = self._sample(x)
        return value + beyond.norm()

    @ti.func
    def normal(self, x):
        """Return the direction in which the distance grows; upward where it has none."""
        _, gradient, beyond = self._sample(x)
        if beyond.norm_sqr() > 0.0:
            # along the clamped axes the sampled part does not change
            gradient = ti.select(beyond == 0.0, gradient, 0.0) + beyond.normalized()
        length = gradient.norm()
        return ti.select(length > 0.0, gradient / ti.max(length, 1e-30), ti.Vector([0.0, 0.0, 1.0]))


def _check_corners(name: str, low: tuple[float, ...], high: tuple[float, ...]) -> None:
    if any(a >= b for a, b in zip(low, high, strict=True)):
        raise InputError(f"{name}.low = {low} must be below {name}.high = {high} in every coordinate")
