"""A spring mesh as described: masses, the springs between them, and what is held or driven. NumPy only, allocates no fields."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..spec import Vec3, unit
from ..track import Track
from .mesh_checks import check, check_indices, number, numbers, positive, vector
from .mesh_recipe import change
from .shapes import Box, Sphere

Reals = NDArray[np.float64]
Integers = NDArray[np.int32]
Where = Box | Sphere | Callable[[Reals], ArrayLike]

# kinds of number and shapes
_ROWS = {"x": (np.float64, 3), "springs": (np.int32, 2), "faces": (np.int32, 3)}
_PER_VERTEX = {"mass": np.float64, "pinned": np.bool_, "driver": np.int32}
_PER_SPRING = {"stiffness": np.float64, "damping": np.float64, "rest": np.float64, "tear": np.float64}
_ARRAYS = (*_ROWS, "v", *_PER_VERTEX, *_PER_SPRING)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Mesh:
    """Point masses joined by springs. Its arrays are read-only; two meshes of the same content are equal.

    - `x` [m], `v` [m/s], shape (n, 3): where the vertices start; `mass` [kg], shape (n,), above 0.
    - `springs`, shape (m, 2): pairs of vertices, each pair once. Per spring, shape (m,): `stiffness` [N/m], `damping` along the
      spring [N s/m], both at least 0; `rest`, the length at which it pulls on nothing [m], above 0, as drawn if it is not given;
      `tear`, the strain (length / rest - 1) beyond which it breaks, infinite if it never does.
    - `pinned`, shape (n,): vertices that forces do not move. They stay where they are or, where `driver` is not -1, go along
      `paths[driver]`, a `Track` of offsets [m] from where they start.
    - `faces`, shape (k, 3): triangles, for pictures and exports; no force comes from them.

    What is per vertex or per spring may be one number for all. A vertex without a spring falls freely.

    Raises:
        InputError: no vertex, a wrong shape or number, an index out of range, a spring given twice, from a vertex to
            itself, or between vertices at the same place, which has no direction; the message names it.
    """

    x: Reals
    v: Reals = 0.0  # type: ignore[assignment]
    mass: Reals = 1.0  # type: ignore[assignment]
    springs: Integers = ()  # type: ignore[assignment]
    stiffness: Reals = 1000.0  # type: ignore[assignment]
    damping: Reals = 0.0  # type: ignore[assignment]
    rest: Reals = None  # type: ignore[assignment]
    tear: Reals = np.inf  # type: ignore[assignment]
    pinned: NDArray[np.bool_] = False  # type: ignore[assignment]
    driver: Integers = -1  # type: ignore[assignment]
    faces: Integers = ()  # type: ignore[assignment]
    paths: tuple[Track, ...] = ()

    def __post_init__(self) -> None:
        for name, (kind, width) in _ROWS.items():
            self._keep(name, kind, (None, width))
        n, m = len(self.x), len(self.springs)
        if not n:
            raise InputError("a mesh needs at least one vertex")
        for name, rows in (("spring", self.springs), ("face", self.faces)):
            check_indices(name, rows, n)
        if self.rest is None:
            object.__setattr__(self, "rest", self.lengths)
        self._keep("v", np.float64, (n, 3))
        for names, count in ((_PER_VERTEX, n), (_PER_SPRING, m)):
            for name, kind in names.items():
                self._keep(name, kind, (count,))
        object.__setattr__(self, "paths", tuple(self.paths))
        check(self)

    def _keep(self, name: str, kind: Any, shape: tuple[int | None, ...]) -> None:
        object.__setattr__(self, name, numbers(f"mesh.{name}", getattr(self, name), kind, shape))

    @property
    def vertex_count(self) -> int:
        """How many vertices there are."""
        return len(self.x)

    @property
    def spring_count(self) -> int:
        """How many springs there are."""
        return len(self.springs)

    @property
    def center(self) -> Reals:
        """The centre of mass [m], shape (3,)."""
        return self.mass @ self.x / self.mass.sum()

    @property
    def lengths(self) -> Reals:
        """How long the springs are at the start [m], shape (m,)."""
        return distances(self.x, self.springs)

    @cached_property
    def content(self) -> str:
        """A hash of all arrays and paths, the same in any process."""
        digest = hashlib.sha256(repr(self.paths).encode())
        for name in _ARRAYS:
            value = getattr(self, name)
            digest.update(f"{name} {value.shape}".encode())
            digest.update(value.tobytes())
        return digest.hexdigest()[:16]

    def __repr__(self) -> str:
        # the hash is there for what describes a scene by its repr
        return f"Mesh({self.vertex_count} vertices, {self.spring_count} springs, content {self.content})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mesh) and self.content == other.content

    def __hash__(self) -> int:
        return hash(self.content)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        for name in _ARRAYS:
            getattr(self, name).flags.writeable = False

    @change
    def moved(self, offset: Vec3) -> Self:
        """Return the mesh moved by `offset` [m]."""
        return self._with(x=self.x + vector("moved.offset", offset))

    @change
    def turned(self, axis: Vec3, degrees: float, *, about: Vec3 | None = None) -> Self:
        """Return the mesh turned about an axis through a point [m], its centre of mass by default.

        Velocities and paths turn with it.
        """
        n = np.array(unit("turned.axis", tuple(vector("turned.axis", axis).tolist())))  # type: ignore[arg-type]
        angle = np.radians(number("turned.degrees", degrees))
        # Rodrigues: R = cos a I + sin a [n]x + (1 - cos a) n n^T
        turn = (
            np.cos(angle) * np.eye(3) + np.sin(angle) * np.cross(n, -np.eye(3)) + (1 - np.cos(angle)) * np.outer(n, n)
        )
        return self._mapped(turn, about)

    @change
    def scaled(self, factor: float, *, about: Vec3 | None = None) -> Self:
        """Return the mesh grown `factor` times about a point [m], its centre of mass by default.

        Rest lengths, velocities and paths grow with it; masses and stiffnesses stay.
        """
        grown = self._mapped(positive("scaled.factor", factor) * np.eye(3), about)
        return grown._with(rest=factor * self.rest)

    @change
    def launched(self, velocity: Vec3 = (0.0, 0.0, 0.0), *, spin: Vec3 = (0.0, 0.0, 0.0)) -> Self:
        """Return the mesh with a velocity [m/s] and a spin about its centre of mass [rad/s] added; pinned vertices stay at rest."""
        turning = np.cross(vector("launched.spin", spin), self.x - self.center)
        gain = vector("launched.velocity", velocity) + turning
        return self._with(v=np.where(self.pinned[:, None], self.v, self.v + gain))

    @change
    def pin(self, vertices: ArrayLike | None = None, *, where: Where | None = None) -> Self:
        """Return the mesh with some vertices held where they are.

        `vertices` are indices; `where` is a `Box` or `Sphere` that holds them, or a function of the positions [m], shape
        (n, 3), that tells which, shape (n,).

        Raises:
            InputError: neither or both are given, an index is out of range, or no vertex is chosen.
        """
        return self._held(self._chosen("pin", vertices, where), -1)

    @change
    def driven(self, path: Track, vertices: ArrayLike | None = None, *, where: Where | None = None) -> Self:
        """Return the mesh with some vertices carried along `path`, offsets [m] from where they start; chosen as in `pin`.

        Raises:
            InputError: as `pin`, or the path is no Track of vectors.
        """
        chosen = self._chosen("driven", vertices, where)
        return self._with(paths=(*self.paths, path))._held(chosen, len(self.paths))

    @change
    def with_springs(
        self,
        pairs: ArrayLike,
        *,
        stiffness: ArrayLike = 1000.0,
        damping: ArrayLike = 0.0,
        rest: ArrayLike | None = None,
        tear: ArrayLike = np.inf,
    ) -> Self:
        """Return the mesh with more springs between pairs of vertices, shape (m, 2); the other arguments as in `Mesh`."""
        more = Mesh(x=self.x, springs=pairs, stiffness=stiffness, damping=damping, rest=rest, tear=tear)  # type: ignore[arg-type]
        changes = {
            name: np.concatenate([getattr(self, name), getattr(more, name)]) for name in ("springs", *_PER_SPRING)
        }
        return self._with(**changes)

    @change
    def joined(self, other: Mesh) -> Self:
        """Return one mesh of both; the other's vertices come after this one's. Springs between them: `with_springs`."""
        parts = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("x", "v", *_PER_VERTEX, *_PER_SPRING)
        }
        parts["driver"][self.vertex_count :] += np.where(other.driver < 0, 0, len(self.paths)).astype(np.int32)
        for name in ("springs", "faces"):
            parts[name] = np.concatenate([getattr(self, name), getattr(other, name) + self.vertex_count])
        return self._with(**parts, paths=(*self.paths, *other.paths))

    def _with(self, **changes: Any) -> Self:
        return dataclasses.replace(self, **changes)

    def _mapped(self, matrix: Reals, about: Vec3 | None) -> Self:
        """Return the mesh under a linear map about a point; rest lengths stay."""
        middle = self.center if about is None else vector("about", about)
        paths = (
            dataclasses.replace(path, keys=tuple((t, tuple(matrix @ np.asarray(value))) for t, value in path.keys))
            for path in self.paths
        )
        return self._with(x=middle + (self.x - middle) @ matrix.T, v=self.v @ matrix.T, paths=tuple(paths))

    def _held(self, chosen: NDArray[np.bool_], driver: int) -> Self:
        return self._with(
            pinned=self.pinned | chosen,
            v=np.where(chosen[:, None], 0.0, self.v),
            driver=np.where(chosen, driver, self.driver),
        )

    def _chosen(self, method: str, vertices: ArrayLike | None, where: Where | None) -> NDArray[np.bool_]:
        """Return which vertices are meant, shape (n,)."""
        if (vertices is None) == (where is None):
            raise InputError(f"{method}: give either vertices (indices) or where (a Box, a Sphere or a function)")
        if vertices is not None:
            indices = numbers(f"{method}.vertices", np.atleast_1d(np.asarray(vertices)), np.int32, (None,))
            outside = indices[(indices < 0) | (indices >= self.vertex_count)]
            if len(outside):
                raise InputError(
                    f"{method}: there is no vertex {outside[0]} (the mesh has 0 to {self.vertex_count - 1})"
                )
            chosen = np.zeros(self.vertex_count, bool)
            chosen[indices] = True
        else:
            chosen = numbers(f"{method}.where", _inside(where, self.x), np.bool_, (self.vertex_count,))
        if not chosen.any():
            raise InputError(f"{method}: no vertex is chosen by {vertices if where is None else where}")
        return chosen


def distances(x: Reals, pairs: NDArray[Any]) -> Reals:
    """Return how far apart pairs of points are [m]: x of shape (n, 3), pairs (m, 2)."""
    d = x[pairs[:, 1]]
    d -= x[pairs[:, 0]]
    return np.sqrt(np.einsum("ij,ij->i", d, d))


def _inside(where: Any, x: Reals) -> Any:
    if isinstance(where, Box):
        return ((x >= where.low) & (x <= where.high)).all(axis=1)
    if isinstance(where, Sphere):
        return np.linalg.norm(x - where.center, axis=1) <= where.radius
    if not callable(where):
        raise InputError(f"where = {where!r}: a Box, a Sphere or a function of the positions is needed")
    return where(x)
