"""The signed distance to a closed surface of triangles, by libigl."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .mesh import Mesh, Reals


def closed_faces(mesh: Mesh) -> np.ndarray:
    """Return the faces of a closed surface, turned outward as a whole.

    Raises:
        InputError: there are none, or an edge does not belong to two faces that run along it in opposite directions.
    """
    faces = mesh.faces.astype(np.int64)
    if not len(faces):
        raise InputError(f"{mesh!r} has no faces: a closed surface of triangles is needed")
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = edges[:, 0] * mesh.vertex_count + edges[:, 1]
    back = edges[:, 1] * mesh.vertex_count + edges[:, 0]
    open_edges = len(key) - int(np.isin(key, back).sum()) + len(key) - len(np.unique(key))
    if open_edges:
        raise InputError(f"the surface of {mesh!r} is not closed: {open_edges} edges have no face on the other side")
    a, b, c = (mesh.x[faces[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
    return np.ascontiguousarray(faces if volume > 0 else faces[:, ::-1])


def surface_distance(points: Reals, x: Reals, faces: np.ndarray) -> Reals:
    """Return the distance [m] of each point to the surface, negative inside (Barill et al., ACM TOG 37(4), 2018, for the sign).

    Raises:
        InputError: libigl is not installed.
    """
    try:
        import igl
    except ImportError:
        raise InputError("distances to a surface need libigl: pip install 'tparticles[mesh]'") from None
    kind = igl.SignedDistanceType.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
    distance, *_ = igl.signed_distance(points, np.ascontiguousarray(x), faces, sign_type=kind)
    return np.asarray(distance)
