"""How fast a spring mesh can swing: bounds and estimates of its largest squared frequency and damping rate.

A spring of stiffness k, rest length l0 and length l along n has the stiffness matrix k (n n^T + (1 - l0 / l) (1 - n n^T)): never
more than k in any direction, however it turns and is stretched, and less than nothing across it where it is compressed. So the
Laplacian of the mesh with weights k bounds all that the mesh can do; what it does where it is now, the matrices at x say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .mesh import Mesh, Reals

_SWEEPS = 20  # of the bound
_GAIN = 0.003  # a sweep that gains less is the last
_RESIDUAL = 2e-3  # of the estimate, relative
_FEWEST = 20  # steps: of a symmetric mesh the first vector that settles need not be the largest
_EXACT = 1e-12  # of the estimate: no step can add to it


@dataclass(frozen=True, kw_only=True)
class Rates:
    """The largest eigenvalues of M^-1 K, a squared frequency [1/s^2], and of M^-1 C, a damping rate [1/s]."""

    stiffness: float
    damping: float

    @property
    def frequency(self) -> float:
        """The largest angular frequency [1/s]."""
        return self.stiffness**0.5


def largest_rates(mesh: Mesh) -> Rates:
    """Return bounds that hold wherever the vertices are, whatever the springs' strain: needed once for a mesh.

    With |L| the matrix of absolute values of M^-1 L and any y > 0, no eigenvalue exceeds max_i (|L| y)_i / y_i (Collatz & Wielandt;
    Gershgorin for y = 1); y is improved by power iteration. At most twice what the Laplacian's largest eigenvalue is.
    """
    return Rates(stiffness=_bound(mesh, mesh.stiffness), damping=_bound(mesh, mesh.damping))


def estimated_rates(mesh: Mesh, x: Reals | None = None, *, iterations: int = 40) -> Rates:
    """Return the largest rates with the vertices at `x` [m], shape (n, 3), or, without it, the largest that any `x` gives.

    By Lanczos' method on the springs, without a matrix: the Ritz value plus its residual, which is not proven to be enough; on the
    meshes of the tests it errs by less than 1 %. What holds at x holds until the mesh has moved.
    """
    count = mesh.spring_count
    if x is None:
        # all springs along one line, the worst that can be
        n, across, dimensions = np.ones((1, count)), np.zeros(count), 1
    else:
        d = np.asarray(x, np.float64).T[:, mesh.springs]
        n, dimensions = d[..., 1] - d[..., 0], 3
        length = np.maximum(np.sqrt((n * n).sum(axis=0)), np.finfo(float).tiny)
        n /= length
        across = mesh.stiffness * (1.0 - mesh.rest / length)
    start = np.random.default_rng(0).standard_normal((dimensions, mesh.vertex_count))
    return Rates(
        stiffness=_lanczos(_Springs(mesh, n, mesh.stiffness, across), start, iterations),
        damping=_lanczos(_Springs(mesh, n, mesh.damping, np.zeros(count)), start, iterations),
    )


class _Springs:
    """The matrix M^-1/2 K M^-1/2, K made of along n n^T + across (1 - n n^T) for each spring; n of shape (3, m) or (1, m)."""

    def __init__(self, mesh: Mesh, n: Reals, along: Reals, across: Reals):
        i, j = mesh.springs.T
        self.i, self.j = i.astype(np.intp), j.astype(np.intp)
        self.n, self.across, self.rest = n, across, (along - across) if len(n) > 1 else along
        self.scale = np.where(mesh.pinned, 0.0, mesh.mass**-0.5)
        self.stretch = np.empty_like(n)  # kept: to ask for memory takes longer than to fill it
        self.empty = not along.any()

    def __call__(self, u: Reals) -> Reals:
        """Return the product with u, shape (3, n) or (1, n)."""
        u = self.scale * u
        for d, row in zip(self.stretch, u, strict=True):
            np.take(row, self.j, out=d, mode="clip")
            d -= row[self.i]
        pull = np.einsum("cm,cm->m", self.n, self.stretch)
        pull *= self.rest
        for n, f, result in zip(self.n, self.stretch, u, strict=True):
            f *= self.across
            f += pull * n
            result[:] = np.bincount(self.j, f, len(result)) - np.bincount(self.i, f, len(result))
        return self.scale * u


def _bound(mesh: Mesh, weights: Reals) -> float:
    i, j = mesh.springs.T
    n = mesh.vertex_count
    inverse = np.where(mesh.pinned, 0.0, 1.0 / mesh.mass)
    degree = np.bincount(i, weights, n) + np.bincount(j, weights, n)
    moves = (inverse > 0) & (degree > 0)
    if not moves.any():
        return 0.0
    y, best = moves.astype(float), np.inf
    for _ in range(_SWEEPS):
        image = inverse * (degree * y + np.bincount(i, weights * y[j], n) + np.bincount(j, weights * y[i], n))
        found = float((image[moves] / y[moves]).max())
        last, best = best, min(best, found)
        if best > (1.0 - _GAIN) * last:
            break
        # any y > 0 will do: keep it within the range of numbers
        y = np.where(moves, np.maximum(image / image.max(), 1e-100), 0.0)
    return best


def _lanczos(matrix: _Springs, start: Reals, iterations: int) -> float:
    """Return the largest eigenvalue of a symmetric matrix, with its residual added; 0 if none is positive."""
    q = start * (matrix.scale > 0)
    if matrix.empty or not q.any():
        return 0.0
    q /= np.linalg.norm(q)
    before, beta, largest, residual = np.zeros_like(q), 0.0, 0.0, 0.0
    diagonal: list[float] = []
    beside: list[float] = []
    for _ in range(min(iterations, q.size)):
        r = matrix(q) - beta * before
        diagonal.append(float(np.vdot(q, r)))
        r -= diagonal[-1] * q
        beta = float(np.linalg.norm(r))
        ritz, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1))
        largest, residual = float(ritz[-1]), beta * abs(float(vectors[-1, -1]))
        if residual <= (_RESIDUAL if len(ritz) > _FEWEST else _EXACT) * abs(largest):
            break
        before, q = q, r / beta
        beside.append(beta)
    return max(largest + residual, 0.0)
