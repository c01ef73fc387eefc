"""Spring meshes by formula: Lander's box, ropes, cloths, lattices, shells. Built around the origin: move, turn, launch them.

Common arguments: `mass` of the whole [kg], shared equally by its vertices; `stiffness` [N/m], `damping` [N s/m] and `tear`
of its springs, as in `Mesh`. A family of springs with stiffness None takes `stiffness`; with 0 it is left out.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from .. import backend
from ..errors import InputError
from ..spec import Vec3
from .mesh import Mesh, Reals, distances
from .mesh_checks import number, numbers, positive, vector
from .mesh_recipe import builder

_BYTES = 200  # that a vertex takes at least for each direction of its grid, while its springs are listed
Family = tuple[np.ndarray, float]  # pairs of vertices, stiffness [N/m]


@builder
def spring_box(
    *,
    size: float | Vec3 = 1.0,
    mass: float = 8.0,
    stiffness: float = 1000.0,
    face_diagonal: float | None = None,
    body_diagonal: float | None = None,
    damping: float = 0.1,
    tear: float = math.inf,
) -> Mesh:
    """Return Lander's box: 8 masses of 1 kg, 12 edges, 12 face diagonals and 4 body diagonals.

    Mass and damping are those of his simulator (J. Lander, "Collision response: bouncy, trouncy, fun", Game Developer 6(3), 1999).
    """
    return lattice(
        counts=(2, 2, 2),
        size=size,
        mass=mass,
        stiffness=stiffness,
        face_diagonal=face_diagonal,
        body_diagonal=body_diagonal,
        damping=damping,
        tear=tear,
    )


@builder
def rope(
    *,
    start: Vec3 = (0.0, 0.0, 0.0),
    end: Vec3 = (1.0, 0.0, 0.0),
    count: int = 32,
    length: float | None = None,
    mass: float = 0.1,
    stiffness: float = 1000.0,
    bend: float = 0.0,
    damping: float = 0.0,
    tear: float = math.inf,
) -> Mesh:
    """Return a chain of `count` vertices from `start` to `end` [m]: springs to the next and, with `bend`, the next but one.

    `length` is that of the rope at rest [m], by default from end to end; a longer one sags.
    """
    (count,) = _counts("rope.count", count, 1)
    a, b = vector("rope.start", start), vector("rope.end", end)
    distance = float(np.linalg.norm(b - a))
    if distance == 0:
        raise InputError(f"rope.start and rope.end are both {tuple(start)}: a rope needs two places")
    slack = 1.0 if length is None else positive("rope.length", length) / distance
    s = np.linspace(0.0, 1.0, count)[:, None]
    i = np.arange(count)
    families = [(_pairs(i[:-1], i[1:]), stiffness), (_pairs(i[:-2], i[2:]), bend)]
    return assembled("rope", (1.0 - s) * a + s * b, families, mass=mass, damping=damping, tear=tear, stretch=slack)


@builder
def cloth(
    *,
    counts: int | tuple[int, int] = (32, 32),
    size: float | tuple[float, float] = 1.0,
    mass: float = 0.2,
    stiffness: float = 1000.0,
    shear: float | None = None,
    bend: float | None = None,
    damping: float = 0.0,
    tear: float = math.inf,
) -> Mesh:
    """Return a sheet in the plane z = 0: `counts` vertices along x and y, `size` [m] from edge to edge; vertex j counts[0] + i.

    Springs: structural to the neighbours in the row and column, shear along both diagonals, bend to the next but one in
    the row and column (X. Provot, "Deformation constraints in a mass-spring model", Graphics Interface 1995).
    """
    columns, rows = _counts("cloth.counts", counts, 2)
    x, grid = _grid((columns, rows, 1), (*_size("cloth.size", size, 2), 0.0))
    i = grid[0]
    families = [
        (_links((i[:, :-1], i[:, 1:]), (i[:-1], i[1:])), stiffness),
        (_links((i[:-1, :-1], i[1:, 1:]), (i[:-1, 1:], i[1:, :-1])), or_default(shear, stiffness)),
        (_links((i[:, :-2], i[:, 2:]), (i[:-2], i[2:])), or_default(bend, stiffness)),
    ]
    return assembled("cloth", x, families, mass=mass, damping=damping, tear=tear, faces=_triangles(i))


@builder
def lattice(
    *,
    counts: int | tuple[int, int, int] = (8, 8, 8),
    size: float | Vec3 = 1.0,
    mass: float = 1.0,
    stiffness: float = 1000.0,
    face_diagonal: float | None = None,
    body_diagonal: float | None = None,
    damping: float = 0.0,
    tear: float = math.inf,
) -> Mesh:
    """Return a block of jelly: `counts` vertices along x, y, z, `size` [m]; vertex (k counts[1] + j) counts[0] + i.

    Springs along the edges and both kinds of diagonals of its cells; `faces` are its surface.
    """
    shape = _counts("lattice.counts", counts, 3)
    x, grid = _grid(shape, _size("lattice.size", size, 3))
    # half of the 26 directions: the first of (dx, dy, dz) that is not 0 is positive
    steps = [d for d in itertools.product((-1, 0, 1), repeat=3) if d > (0, 0, 0)]
    strengths = (stiffness, or_default(face_diagonal, stiffness), or_default(body_diagonal, stiffness))
    families = [
        (_links(*(_shifted(grid, d[::-1]) for d in steps if sum(map(abs, d)) == order)), strength)
        for order, strength in enumerate(strengths, start=1)
    ]
    return assembled("lattice", x, families, mass=mass, damping=damping, tear=tear, faces=_surface(grid))


@builder
def sphere_shell(
    *,
    radius: float = 0.5,
    subdivisions: int = 3,
    mass: float = 1.0,
    stiffness: float = 1000.0,
    bend: float | None = None,
    bracing: float | None = None,
    damping: float = 0.0,
    tear: float = math.inf,
) -> Mesh:
    """Return a ball of `radius` [m]: an icosahedron whose triangles are cut in four, `subdivisions` times, onto the sphere.

    It has 10 4^subdivisions + 2 vertices, springs along the edges, bend springs across them, and bracing from each vertex
    to the opposite one, which keeps the ball round.
    """
    (levels,) = _counts("sphere_shell.subdivisions", subdivisions, 1, least=0)
    if levels > 9:
        raise InputError(f"sphere_shell.subdivisions = {levels}: at most 9, which makes 2.6 million vertices")
    x, faces = _icosphere(levels)
    edges, across = triangle_links(faces)
    # its vertices come in pairs v, -v: sorted by coordinates, the first is opposite to the last
    order = np.lexsort(np.round(x, 9).T)
    half = len(x) // 2
    opposite = _pairs(order[:half], order[::-1][:half])
    families = [(edges, stiffness), (across, or_default(bend, stiffness)), (opposite, or_default(bracing, stiffness))]
    scaled = positive("sphere_shell.radius", radius) * x
    return assembled("sphere_shell", scaled, families, mass=mass, damping=damping, tear=tear, faces=faces)


def triangle_links(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges of triangles, each once, and the pairs of vertices that face each other across an edge of two of them."""
    corners = np.concatenate([faces[:, [0, 1, 2]], faces[:, [1, 2, 0]], faces[:, [2, 0, 1]]])
    edge, opposite = np.sort(corners[:, :2], axis=1), corners[:, 2]
    edges, which, uses = np.unique(edge, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(which.ravel(), kind="stable")
    starts = (np.cumsum(uses) - uses)[uses == 2]
    across = np.sort(np.stack([opposite[order[starts]], opposite[order[starts + 1]]], axis=1), axis=1)
    across = np.unique(across[across[:, 0] != across[:, 1]], axis=0)
    return edges, _without(across, edges)


def assembled(
    name: str,
    x: Reals,
    families: list[Family],
    *,
    mass: float,
    damping: float,
    tear: float,
    stretch: float = 1.0,
    shares: Reals | None = None,
    faces: np.ndarray | None = None,
) -> Mesh:
    """Put families of springs together.

    Rest lengths are `stretch` times the distances; `shares` are the parts of the mass that vertices get, by default equal ones.
    """
    kept = [(pairs, k) for pairs, k in families if number(f"{name}: stiffness", k) != 0]
    springs = np.concatenate([np.empty((0, 2), np.int64), *(pairs for pairs, _ in kept)])
    return Mesh(
        x=x,
        mass=positive(f"{name}.mass", mass) * (1.0 / len(x) if shares is None else shares),  # type: ignore[arg-type]
        springs=springs,  # type: ignore[arg-type]
        stiffness=np.repeat([float(k) for _, k in kept], [len(pairs) for pairs, _ in kept]),
        damping=damping,  # type: ignore[arg-type]
        rest=stretch * distances(x, springs),
        tear=tear,  # type: ignore[arg-type]
        faces=() if faces is None else faces,  # type: ignore[arg-type]
    )


def or_default(value: float | None, default: float) -> float:
    """Return the stiffness of a family of springs: that of all where it has none of its own."""
    return default if value is None else value


def _counts(name: str, value: int | tuple[int, ...], width: int, *, least: int = 2) -> tuple[int, ...]:
    array = numbers(name, value, np.int32, (width,))
    if (array < least).any():
        raise InputError(f"{name} = {value}: at least {least} is needed")
    total = math.prod(array.tolist())
    needed, available = total * width * _BYTES, backend.memory()
    if needed > available:
        raise InputError(
            f"{name} = {value}: {total} vertices take at least {needed / 2**30:.0f} GiB, "
            f"this machine has {available / 2**30:.0f} GiB"
        )
    return tuple(array.tolist())


def _size(name: str, value: float | tuple[float, ...], width: int) -> tuple[float, ...]:
    array = numbers(name, value, np.float64, (width,))
    return tuple(positive(name, v) for v in array.tolist())


def _grid(counts: tuple[int, ...], size: tuple[float, ...]) -> tuple[Reals, np.ndarray]:
    """Return the vertices of a grid around the origin, shape (n, 3), and their indices by (z, y, x)."""
    axes = [np.linspace(-0.5, 0.5, n) * s if n > 1 else np.zeros(1) for n, s in zip(counts, size, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), np.arange(x.size).reshape(x.shape)


def _pairs(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a.ravel(), b.ravel()], axis=1)


def _links(*ends: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return np.concatenate([_pairs(a, b) for a, b in ends])


def _shifted(grid: np.ndarray, step: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of all vertices that have a neighbour at `step`, and those of the neighbours."""
    here = tuple(slice(max(0, -d), n - max(0, d)) for d, n in zip(step, grid.shape, strict=True))
    there = tuple(slice(max(0, d), n - max(0, -d)) for d, n in zip(step, grid.shape, strict=True))
    return grid[here], grid[there]


def _triangles(i: np.ndarray) -> np.ndarray:
    """Return two triangles for each cell of a sheet of indices, turning left seen along its rows, then columns."""
    a, b, c, d = i[:-1, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel(), i[1:, :-1].ravel()
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _surface(grid: np.ndarray) -> np.ndarray:
    """Return the triangles of a block's six sides, outward."""
    sides = [grid[0].T, grid[-1], grid[:, 0], grid[:, -1].T, grid[:, :, 0].T, grid[:, :, -1]]
    return np.concatenate([_triangles(side) for side in sides])


def _icosphere(levels: int) -> tuple[Reals, np.ndarray]:
    """Return a unit sphere of triangles, outward."""
    g = (1.0 + math.sqrt(5.0)) / 2.0
    x = np.array([p for a, b in itertools.product((-1, 1), (-g, g)) for p in ((0, a, b), (a, b, 0), (b, 0, a))], float)
    # its faces are the triples at edge length 2 of each other
    close = np.isclose(np.linalg.norm(x[:, None] - x, axis=2), 2.0)
    triples = [
        t for t in itertools.combinations(range(12), 3) if close[t[0], t[1]] and close[t[1], t[2]] and close[t[0], t[2]]
    ]
    faces = np.array([t if np.linalg.det(x[list(t)]) > 0 else t[::-1] for t in triples])
    for _ in range(levels):
        edges, _ = triangle_links(faces)
        x = np.concatenate([x, x[edges].mean(axis=1)])
        a, b, c = faces.T
        ab, bc, ca = (_midpoints(edges, len(x), p, q) for p, q in ((a, b), (b, c), (c, a)))
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        faces = np.concatenate([np.stack(part, axis=1) for part in parts])
        x /= np.linalg.norm(x, axis=1, keepdims=True)
    return x / np.linalg.norm(x, axis=1, keepdims=True), faces


def _midpoints(edges: np.ndarray, count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the new vertices in the middle of edges a-b: they come after the old ones, in the order of `edges`."""
    keys = edges[:, 0].astype(np.int64) * count + edges[:, 1]
    return count - len(edges) + np.searchsorted(keys, np.minimum(a, b).astype(np.int64) * count + np.maximum(a, b))


def _without(pairs: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return those of the sorted pairs that are not among the others."""
    count = 1 + max(pairs.max(initial=0), others.max(initial=0))
    key = [p[:, 0].astype(np.int64) * count + p[:, 1] for p in (pairs, others)]
    return pairs[~np.isin(*key)]
