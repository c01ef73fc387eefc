"""The equations of an implicit stage of a spring mesh, and the symmetric positive definite matrix of a Newton step.

An implicit stage looks for v with x = xbar + h v and

    R(v) = m (v - vbar - h e(x, v)) + h sum_s T_s u_s = 0,    T = k (|d| - rest) + c u . (v_i - v_j),    u = d / |d|,

d = x_i - x_j, e the acceleration that springs do not give. With g the tension that turns with the spring (see `mesh_solver`),

    A = m (I - h de) + sum_s [(h^2 k + h c - h^2 g / |d|) u u^T + (h^2 g / |d|) I],    g = max(g, 0).

The last term is what a stretched spring does across its own direction. A compressed one would push outwards there, which makes A
indefinite; A only steers Newton's method, the solution is where R = 0. Leaving compressed springs out one by one holds a stiff
mesh far too fast: in a bent sheet they cancel nearly all that its stretched ones do, and what is then left over is as stiff as
they are. `steadied` cancels first: it leaves out what is compressed of the stress around a vertex (Teran, Sifakis, Irving,
Fedkiw, Robust Quasistatic Finite Elements, 2005, do it element by element).

Arrays here are component by component, (3, n), and sums over the springs of a vertex run in the order of the springs, so that
they do not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
_CG_ROUNDING = 1e-14
_HEAVY = 1e12  # times its mass is what a vertex weighs across a wall
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # the six numbers of a symmetric 3x3 block
_BLOCK = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # where entry (a, b) is among them


@dataclass(frozen=True)
class Springs:
    """The mesh as the solver sees it: ends (m), stiffness [N/m], damping [N s/m], rest length [m]; mass [kg] and `free` (n).

    `walls`, (3, n): a unit vector where a vertex in contact keeps its velocity in that direction, else 0.
    """

    first: Array
    second: Array
    stiffness: Array
    damping: Array
    rest: Array
    mass: Array
    free: Array
    walls: Array | None = None

    @property
    def vertex_count(self) -> int:
        """Number of vertices, the fixed ones too."""
        return len(self.mass)

    def differences(self, z: Array) -> Array:
        """Return z_i - z_j of every spring, shape (3, m)."""
        return np.stack([c[self.first] - c[self.second] for c in z])

    def spread(self, pull: Array) -> Array:
        """Return the sum over its springs of `pull` (3, m), added to the first end, taken from the second; 0 where fixed."""
        n = self.vertex_count
        total = [np.bincount(self.first, p, n) - np.bincount(self.second, p, n) for p in pull]
        return np.stack(total) * self.free

    def momentum(self, v: Array) -> Array:
        """Return m v (3, n), and a million million times that across a wall."""
        p = self.mass * v
        if self.walls is not None:
            p += _HEAVY * self.walls * (self.walls * p).sum(axis=0)
        return p

    def pushed(self, p: Array) -> Array:
        """Return the velocities that momenta `p` (3, n) give: none across a wall."""
        v = p / self.mass
        if self.walls is not None:
            v -= self.walls * (self.walls * v).sum(axis=0)
        return v

    def stretched(self, x: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return tension T [N] and length |d| [m], shape (m,), and direction u, shape (3, m), which is 0 at length 0."""
        d = self.differences(x)
        length = np.sqrt(np.einsum("cs,cs->s", d, d))
        u = d / np.where(length > 0.0, length, 1.0)
        tension = self.stiffness * (length - self.rest)
        if self.damping.any():
            tension += self.damping * np.einsum("cs,cs->s", u, self.differences(v))
        return tension, length, u

    def elastic(self, p: Array, tension: Array, length: Array, u: Array) -> Array:
        """Return -K p (3, n), K the derivative of the springs' forces by position, compressed springs as in A."""
        across = np.maximum(tension, 0.0) / np.where(length > 0.0, length, np.inf)
        d = self.differences(p)
        return self.spread((self.stiffness - across) * np.einsum("cs,cs->s", u, d) * u + across * d)

    def stiffness_over_step(self, h: float) -> Array:
        """Return h k + c [N s/m]: how much tension a velocity along the spring makes within the step, shape (m,)."""
        return h * self.stiffness + self.damping

    def fastest(self, h: float) -> float:
        """Return an upper bound, by Gershgorin's rows, of h omega: `sqrt(h^2 k + h c)` over the mass of a vertex."""
        row = 2.0 * h * self.stiffness_over_step(h)
        n = self.vertex_count
        total = (np.bincount(self.first, row, n) + np.bincount(self.second, row, n)) / self.mass
        return float(np.sqrt(total[self.free].max(initial=0.0)))


@dataclass(frozen=True)
class StepMatrix:
    """A of one Newton step, six numbers a block: per spring (6, m), per vertex without its springs and with them (6, n)."""

    springs: Springs
    links: Array
    own: Array
    diagonal: Array

    @classmethod
    def assemble(
        cls, springs: Springs, h: float, turning: Array, length: Array, u: Array, extra: Array | None
    ) -> StepMatrix:
        """Build A from the tension that turns with each spring; `extra` (6, n) is -h m de, positive semi-definite."""
        across = h * h * np.maximum(turning, 0.0) / np.where(length > 0.0, length, np.inf)
        along = h * springs.stiffness_over_step(h) - across
        links = np.stack([along * u[a] * u[b] for a, b in _PAIRS])
        links[:3] += across
        n = springs.vertex_count
        own = np.zeros((6, n)) if extra is None else extra.copy()
        own[:3] += springs.mass
        if springs.walls is not None:
            own += _HEAVY * springs.mass * np.stack([springs.walls[a] * springs.walls[b] for a, b in _PAIRS])
        sums = [np.bincount(springs.first, b, n) + np.bincount(springs.second, b, n) for b in links]
        return cls(springs, links, own, own + np.stack(sums))

    def __matmul__(self, p: Array) -> Array:
        """Return A p, both (3, n), for p that is 0 at fixed vertices."""
        return (
            self.springs.spread(_times(self.links, self.springs.differences(p)))
            + _times(self.own, p) * self.springs.free
        )

    def inverse_diagonal(self) -> Array:
        """Return the inverse of the blocks on the diagonal (6, n): the block-Jacobi preconditioner."""
        inverse = np.linalg.inv(np.moveaxis(self.diagonal[_BLOCK], -1, 0))
        return np.stack([inverse[:, a, b] for a, b in _PAIRS])


def steadied(springs: Springs, tension: Array, length: Array, u: Array) -> Array:
    """Return tensions >= 0 [N] (m) that hold the mesh across its springs about as `tension` does.

    The stress around a vertex is S = sum_s g_s |d_s| u_s u_s^T. A spring gets u^T S+ u of its two ends, S+ being what is stretched
    of S, scaled so that the springs of a vertex have the trace of S+ again. Where no spring of a vertex is compressed, they keep
    theirs.
    """
    if (tension >= 0.0).all():
        return tension
    n, ends = springs.vertex_count, (springs.first, springs.second)

    def summed(values: Array) -> Array:
        return np.bincount(ends[0], values, n) + np.bincount(ends[1], values, n)

    compressed = np.flatnonzero(summed(tension < 0.0))
    stress = np.stack([summed(tension * length * u[a] * u[b])[compressed] for a, b in _PAIRS])
    stretched = np.zeros((6, n))
    stretched[:, compressed] = positive_part(stress)
    trace = stretched[:3].sum(axis=0)
    along = [np.einsum("cs,cs->s", u, _times(stretched[:, end], u)) for end in ends]
    total = np.bincount(ends[0], along[0] * length, n) + np.bincount(ends[1], along[1] * length, n)
    scale = trace / np.where(total > 0.0, total, 1.0)
    keeps = np.ones(n, bool)
    keeps[compressed] = False
    parts = [np.where(keeps[end], tension, scale[end] * share) for end, share in zip(ends, along, strict=True)]
    return 0.5 * np.maximum(parts[0] + parts[1], 0.0)


def positive_part(s: Array) -> Array:
    """Return symmetric 3x3 blocks (6, n) with their negative eigenvalues put to zero, right to about 1e-7 of the largest one.

    Eigenvalues by the cosine of a third of an angle (Smith, Comm. ACM 4, 1961), the function of the matrix by Newton's divided
    differences: a tenth of the time of LAPACK, one block after the other.
    """
    mean = s[:3].sum(axis=0) / 3.0
    off = s.copy()
    off[:3] -= mean
    spread = np.sqrt((np.square(off[:3]).sum(axis=0) + 2.0 * np.square(off[3:]).sum(axis=0)) / 6.0)
    xx, yy, zz, xy, xz, yz = off / np.where(spread > 0.0, spread, 1.0)
    det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    angle = np.arccos(np.clip(0.5 * det, -1.0, 1.0)) / 3.0
    high, low = (mean + 2.0 * spread * np.cos(angle + turn) for turn in (0.0, 2.0 * np.pi / 3.0))
    values = high, 3.0 * mean - high - low, low
    kept = [np.maximum(value, 0.0) for value in values]

    def ratio(rise: Array, run: Array) -> Array:
        return rise / np.where(run > 0.0, run, 1.0)

    first, second = (ratio(kept[i] - kept[i + 1], values[i] - values[i + 1]) for i in range(2))
    curve = ratio(first - second, values[0] - values[2])
    once, twice = s.copy(), s.copy()
    once[:3] -= values[0]
    twice[:3] -= values[1]
    found = first * once + curve * _product(once, twice)
    found[:3] += kept[0]
    return found


def _product(a: Array, b: Array) -> Array:
    """Return the products of symmetric blocks that commute."""
    return np.stack([sum(a[_BLOCK[i, k]] * b[_BLOCK[k, j]] for k in range(3)) for i, j in _PAIRS])


def _times(blocks: Array, p: Array) -> Array:
    return np.stack([np.einsum("cn,cn->n", blocks[_BLOCK[a]], p) for a in range(3)])


def conjugate_gradients(
    matrix: StepMatrix, b: Array, *, tolerance: float, left: Array, limit: int
) -> tuple[Array, int]:
    """Return y of A y = b, both (3, n), and the iterations; block-Jacobi preconditioned.

    It ends where the remainder is `tolerance` of the right-hand side, and at every vertex at most `left` (n), or all that rounding
    allows. The right-hand side must be 0 at fixed vertices. Sums are numpy's pairwise ones, the same for any number of threads.
    """
    inverse = matrix.inverse_diagonal()
    y, r = np.zeros_like(b), b.copy()
    z = _times(inverse, r)
    p, rz = z.copy(), float((r * z).sum())
    goal, floor = tolerance**2 * rz, _CG_ROUNDING**2 * rz
    for iteration in range(limit):
        if not rz > floor or (rz <= goal and (np.abs(r) <= left).all()):  # done, or not a number
            return y, iteration
        q = matrix @ p
        step = rz / float((p * q).sum())
        y += step * p
        r -= step * q
        z = _times(inverse, r)
        rz, before = float((r * z).sum()), rz
        p = z + (rz / before) * p
    return y, limit


def acceleration_blocks(
    acceleration: Callable[[Array, Array], Array], x: Array, v: Array, h: float, springs: Springs, step: float
) -> Array | None:
    """Return the positive semi-definite part of -h m de/dv (6, n), x and v moving together, by differences; None where it is 0.

    An acceleration of a vertex is taken to depend on that vertex alone, as wind, drag and gravity do.
    """
    base = acceleration(x, v)
    if not np.isfinite(base).all():
        return None
    columns = []
    for axis in range(3):
        change = np.zeros((3, 1))
        change[axis] = step
        columns.append((acceleration(x + h * change, v + change) - base) / step)
    jacobian = np.stack(columns, 1)  # (3, 3, n): component, axis
    blocks = -0.5 * h * springs.mass * np.stack([jacobian[a, b] + jacobian[b, a] for a, b in _PAIRS])
    if not blocks.any():
        return None
    if (blocks[:3] - np.abs(blocks[[3, 3, 4]]) - np.abs(blocks[[4, 5, 5]]) < 0.0).any():
        blocks = positive_part(blocks)
    return blocks


class UpperPattern:
    """Upper triangle of A over the free vertices as compressed rows: the places are found once, values filled at each step."""

    def __init__(self, springs: Springs):
        self._free = np.flatnonzero(springs.free)
        n = len(self._free)
        number = np.full(springs.vertex_count, -1)
        number[self._free] = np.arange(n)
        ends = np.sort(np.stack([number[springs.first], number[springs.second]]), axis=0)
        linked = np.flatnonzero(ends[0] >= 0)
        key, self._pair = np.unique(ends[0, linked] * n + ends[1, linked], return_inverse=True)
        self._alone = len(key) == len(linked)
        self._linked = linked[np.argsort(self._pair)] if self._alone else linked
        row, column = key // n, key % n
        degree = np.bincount(row, minlength=n)
        lengths = 3 * degree[:, None] + np.array([3, 2, 1])
        self.starts = np.concatenate([[0], np.cumsum(lengths.ravel())]).astype(np.int32)
        rank = np.arange(len(key)) - (np.cumsum(degree) - degree)[row]
        start = self.starts[:-1].reshape(n, 3)
        # `_take`: where each value comes from among the six numbers of all vertices and then of all pairs
        self.columns, self._take = np.empty(self.starts[-1], np.int32), np.empty(self.starts[-1], np.int64)
        for k, (a, b) in enumerate(_PAIRS):
            places = start[:, a] + b - a
            self.columns[places], self._take[places] = 3 * np.arange(n) + b, k * n + np.arange(n)
        for a, b in np.ndindex(3, 3):
            # row (i, a) begins with its 3 - a entries of the diagonal block
            places = start[row, a] + (3 - a) + 3 * rank + b
            self.columns[places], self._take[places] = (
                3 * column + b,
                6 * n + _BLOCK[a, b] * len(key) + np.arange(len(key)),
            )

    def values(self, matrix: StepMatrix) -> Array:
        """Return the numbers of A in the order of `columns`."""
        links = matrix.links[:, self._linked]
        if not self._alone:  # two springs between the same vertices
            links = np.stack([np.bincount(self._pair, block) for block in links])
        return np.concatenate([matrix.diagonal[:, self._free].ravel(), -links.ravel()])[self._take]

    def pack(self, r: Array) -> Array:
        """Return (3, n) as the unknowns of the free vertices, one after the other."""
        return np.ascontiguousarray(r[:, self._free].T).ravel()

    def unpack(self, y: Array, n: int) -> Array:
        """Return the unknowns as (3, n), 0 at fixed vertices."""
        r = np.zeros((3, n))
        r[:, self._free] = y.reshape(-1, 3).T
        return r
