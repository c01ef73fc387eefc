"""Spring meshes from files: surfaces by trimesh, tetrahedra (and surfaces in the formats of simulators) by meshio."""

from __future__ import annotations

import contextlib
import importlib
import io
import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .mesh import Mesh, Reals
from .mesh_builders import assembled, or_default, triangle_links

_SURFACES = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf")
_CORNERS = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])  # of a tetrahedron's faces, outward


def read_mesh(
    path: str | Path,
    *,
    mass: float = 1.0,
    stiffness: float = 1000.0,
    bend: float | None = None,
    damping: float = 0.0,
    tear: float = math.inf,
) -> Mesh:
    """Return a spring mesh of a file: a surface of triangles, or, where there are any, tetrahedra.

    Springs lie along the edges; on a surface, bend springs join the vertices that face each other across an edge (`bend`: their
    stiffness [N/m], None for `stiffness`, 0 for none). `mass` of the whole [kg] is shared by area or volume. Vertices at the
    same place become one, vertices of no element are left out.

    STL, OBJ, PLY, OFF and glTF are read by trimesh; VTK, VTU, Gmsh, Medit, Abaqus and what else it knows by meshio:
    `pip install 'tparticles[mesh]'`.

    Raises:
        InputError: the file cannot be read, or holds neither triangles nor tetrahedra; a library is not installed.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"mesh '{path}': there is no such file")
    x, cells = _welded(*(_by_trimesh if path.suffix.lower() in _SURFACES else _by_meshio)(path))
    if not len(cells):
        raise InputError(f"mesh '{path}': it holds neither triangles nor tetrahedra")
    if not np.isfinite(x).all():
        raise InputError(f"mesh '{path}': it has a vertex that is not finite")
    common = {"mass": mass, "damping": damping, "tear": tear, "shares": _shares(x, cells)}
    if cells.shape[1] == 4:
        return assembled(
            "read_mesh", x, [(_edges(cells), stiffness)], faces=_boundary(_right_handed(x, cells)), **common
        )
    edges, across = triangle_links(cells)
    families = [(edges, stiffness), (across, or_default(bend, stiffness))]
    return assembled("read_mesh", x, families, faces=cells, **common)


def _by_trimesh(path: Path) -> tuple[Reals, np.ndarray]:
    """Return vertices and triangles of a file of surfaces."""
    trimesh = _library("trimesh")
    try:
        found = trimesh.load_mesh(path, process=False)
    except Exception as error:  # of many kinds, by format
        raise _unreadable(path, error) from None
    faces = getattr(found, "faces", ())  # a cloud of points has none
    return np.asarray(found.vertices, np.float64), np.asarray(faces, np.int64).reshape(-1, 3)


def _by_meshio(path: Path) -> tuple[Reals, np.ndarray]:
    """Return vertices and tetrahedra of a file, or triangles if it has none."""
    meshio = _library("meshio")
    said = io.StringIO()  # it prints what is wrong, and exits
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
            found = meshio.read(path)
    except (Exception, SystemExit) as error:
        damaged = f"it is no {path.suffix} file, or a damaged one"
        raise _unreadable(
            path, said.getvalue().strip() or (damaged if isinstance(error, SystemExit) else error)
        ) from None
    x = np.zeros((len(found.points), 3))
    x[:, : found.points.shape[1]] = found.points  # a plane mesh has no z
    triangles = [np.empty((0, 3), np.int64)]
    for block in found.cells:
        if block.type == "triangle":
            triangles.append(block.data)
        elif block.type == "quad":
            triangles += [block.data[:, [0, 1, 2]], block.data[:, [0, 2, 3]]]
    solids = [block.data for block in found.cells if block.type == "tetra"]
    return x, np.concatenate(solids or triangles).astype(np.int64)


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(f"reading this mesh needs {name}: pip install 'tparticles[mesh]'") from None


def _unreadable(path: Path, reason: Any) -> InputError:
    text = str(reason).strip() or type(reason).__name__
    return InputError(f"mesh '{path}' cannot be read: {text.splitlines()[0]}")


def _welded(x: Reals, cells: np.ndarray) -> tuple[Reals, np.ndarray]:
    """Return the mesh with vertices at the same place made one, in the file's order, and only those of an element that is left."""
    _, first, which = np.unique(x, axis=0, return_index=True, return_inverse=True)
    cells = first[which.ravel()][cells]
    ordered = np.sort(cells, axis=1)
    cells = cells[(np.diff(ordered, axis=1) > 0).all(axis=1)]  # an element with two corners in one place is none
    kept, cells_kept = np.unique(cells, return_inverse=True)
    return x[kept], cells_kept.reshape(cells.shape)


def _shares(x: Reals, cells: np.ndarray) -> Reals:
    """Return each vertex's part of the whole: equal parts of its elements' areas or volumes."""
    edges = x[cells[:, 1:]] - x[cells[:, :1]]
    size = (
        np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) if cells.shape[1] == 3 else abs(np.linalg.det(edges))
    )
    parts = np.bincount(cells.ravel(), np.repeat(size, cells.shape[1]), len(x))
    return parts / parts.sum()


def _edges(cells: np.ndarray) -> np.ndarray:
    pairs = [cells[:, list(pair)] for pair in itertools.combinations(range(4), 2)]
    return np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)


def _right_handed(x: Reals, cells: np.ndarray) -> np.ndarray:
    """Return tetrahedra of positive volume, whichever way the file turns them."""
    wrong = np.linalg.det(x[cells[:, 1:]] - x[cells[:, :1]]) < 0
    return np.where(wrong[:, None], cells[:, [0, 2, 1, 3]], cells)


def _boundary(cells: np.ndarray) -> np.ndarray:
    """Return the triangles that belong to one tetrahedron only, outward."""
    faces = cells[:, _CORNERS].reshape(-1, 3)
    _, first, uses = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[uses == 1])]
