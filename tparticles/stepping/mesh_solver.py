"""Implicit stages of spring meshes at any stiffness: Newton's method on velocity and tension together.

SOLVE asks for v with x = xbar + h v, v = vbar + h a(x, v) (`mesh_solver_matrix` prints the equations). Plain Newton crawls on
stiff springs: a step that turns a spring by an angle stretches it in second order, and k times that swamps every other force. So
the tension g of a spring is an unknown of its own, tied to its length by the compliance 1 / k, as in a constrained system; g
follows the *linearised* length. Eliminating it leaves the matrix of plain Newton with g in place of the tension in the term
that turns with the spring, and the same right-hand side: the same cost, and about as many iterations at any stiffness.
(Tournier, Nesme, Gilles, Faure, Stable Constrained Dynamics, 2015; Macklin et al., Primal/Dual Descent Methods, 2020.)

Two misfits, both lengths, end the iteration, whatever the stiffness: how far a spring is from the length at which it would pull
with g (the largest), and how far what is out of balance, with g, would push a vertex without springs in h (root mean square,
counted at a tenth, since its springs hold it). The best solver for A does not care for its condition: a sparse Cholesky factor
whose ordering is kept. Conjugate gradients need about h omega iterations and serve small and soft meshes, and where nothing else
is installed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, unknown
from . import mesh_solver_direct as direct
from .mesh_solver_matrix import Springs, StepMatrix, UpperPattern, acceleration_blocks, conjugate_gradients, steadied

Array = np.ndarray
Acceleration = Callable[[Array, Array], Array]

METHODS = ("auto", "direct", "cg")
_NEWTON_LIMIT = 50
_HALVINGS = 6
_ASTRAY = 10.0  # a misfit of ten springs is no reason yet to shorten a step
_BALANCE_WEIGHT = 0.1  # of what is out of balance, in the misfit
_CG_NEWTON, _CG_LINEAR = 1e-2, 1e-10  # of the right-hand side
_CG_LIMIT = 30  # iterations per free vertex
_CG_PER_OMEGA = 1.4  # iterations per h omega, measured on draped cloth
# Seconds of one CG iteration and of one factorisation, by vertices (n) and springs (m): only their ratio decides, once per mesh.
_CG_FIXED, _CG_PER_SPRING = 1.1e-4, 5e-8
_FACTOR = {"pardiso": (1.5e-4, 1e-7), "superlu": (3e-4, 9e-7)}  # fixed, times n^1.5


@dataclass(frozen=True)
class SolveResult:
    """What a stage gave: x [m] and v [m/s], shape (n, 3), and what it took.

    `residual` is the misfit as a part of the mean rest length (of a linear stage: what is left of the linear system, relative);
    where `converged` is False it lies above the tolerance, x and v are the best found, and the caller halves its step.
    `pushes`: the speed [m/s] that its wall gave each vertex, (n,), negative where it had to pull; 0 without walls.
    """

    x: Array
    v: Array
    iterations: int
    linear_iterations: int
    residual: float
    converged: bool
    method: str
    pushes: Array | float = 0.0


@dataclass
class _Iterate:
    """A velocity with all that depends on it; `misfit` uses the turning tension g."""

    v: Array
    tension: Array
    length: Array
    u: Array
    imbalance: Array
    turning: Array
    misfit: float


class MeshSolver:
    """Solves the implicit stages of one mesh; keeps the matrix's ordering and the tensions from stage to stage.

    Parameters
    ----------
    springs
        Vertices at the ends, shape (m, 2).
    stiffness, damping, rest
        [N/m], [N s/m] along the spring and [m], a number or one per spring.
    mass
        [kg], a number or one per vertex.
    fixed
        Vertices whose velocity is given, shape (n,).
    method
        `"direct"` (sparse Cholesky), `"cg"`, or `"auto"`: the cheaper one by an estimate from h omega and the size.
    tolerance
        Largest misfit, as a part of the mean rest length. By default 0.1 for a state in f32 (pictures: below a pixel, where a
        spring is some pixels long) and 1e-10 for one in f64 (studies).

    `tension` [N] (m) is the guess for the next stage, None at the start. It changes how soon a stage converges, and so its last
    digits: save it with the state for a run that resumes bit for bit, and drop it where springs break.
    `reason` says in words why the last stage was solved as it was.

    Raises
    ------
    InputError
        A spring with one end or an end outside the mesh, a mass that is not positive, an unknown method, or `"direct"` where
        no direct solver is installed.
    """

    def __init__(
        self, springs, stiffness, damping, rest, mass, fixed, *, method: str = "auto", tolerance: float | None = None
    ):
        if method not in METHODS:
            raise unknown("method of the mesh solver", method, METHODS)
        self.springs = _checked(springs, stiffness, damping, rest, mass, fixed)
        self.method, self.tolerance, self.tension, self.reason = method, tolerance, None, ""
        lengths = self.springs.rest[self.springs.rest > 0.0]
        self.length = float(lengths.mean()) if len(lengths) else 1.0
        self._direct = direct.available()
        if method == "direct" and self._direct is None:
            raise InputError(f"method 'direct' of the mesh solver needs MKL or scipy: {direct.INSTALL}")
        self._pattern: UpperPattern | None = None
        self._factors: direct.Factors | None = None

    def solve(
        self,
        zbar_x: Array,
        zbar_v: Array,
        h: float,
        extra_acceleration: Acceleration | None = None,
        *,
        linear: bool = False,
        start: Array | None = None,
        walls: Array | None = None,
        speeds: Array | None = None,
    ) -> SolveResult:
        """Find x = zbar_x + h v and v = zbar_v + h a(x, v); a fixed vertex keeps v = zbar_v.

        Parameters
        ----------
        zbar_x, zbar_v
            [m] and [m/s], shape (n, 3), f32 or f64. The work is done in f64.
        h
            Step times the weight of the stage [s], positive.
        extra_acceleration
            (x, v) -> [m/s^2], all (n, 3): what the springs do not give, of each vertex by itself.
        linear
            One Newton step from (zbar_x, zbar_v), as semi-implicit schemes do (Baraff and Witkin 1998).
        start
            Guess for v, shape (n, 3); zbar_v by default.
        walls, speeds
            Of vertices in contact: the unit vector (n, 3) across which they move with the speed [m/s] (n,) this time; 0 for all
            others. They count as a million million times heavier in that direction, so that the matrix keeps its pattern.
        """
        springs = self.springs if walls is None else replace(self.springs, walls=_by_component(walls))
        stage = _Stage(springs, zbar_x, zbar_v, h, extra_acceleration, self.length, speeds)
        if not stage.finite:
            return SolveResult(np.asarray(zbar_x), np.asarray(zbar_v), 0, 0, np.inf, False, "none")
        method = self._choose(h)
        tolerance = self.tolerance or (0.1 if np.result_type(zbar_x, zbar_v) == np.float32 else 1e-10)
        with np.errstate(over="ignore", invalid="ignore"):  # reported as not converged
            if linear:
                return self._solve_linear(stage, method)
            return self._solve_newton(stage, method, tolerance, stage.vbar if start is None else _by_component(start))

    def _solve_linear(self, stage: _Stage, method: str) -> SolveResult:
        """(m - h D - h^2 K) dv = h (f + h K vbar), with everything taken at (xbar, vbar)."""
        springs, h, v = stage.springs, stage.h, stage.vbar
        tension, length, u = springs.stretched(stage.xbar, v)
        matrix = StepMatrix.assemble(springs, h, tension, length, u, stage.blocks(stage.xbar, v))
        pull = springs.spread(tension * u) + h * springs.elastic(v, tension, length, u)
        # The extra acceleration at x + h vbar: its own derivative by x, applied to h vbar, is in it.
        b = h * (springs.mass * springs.free * stage.extra(stage.position(v), v) - pull)
        dv, count, good = self._linear_solve(matrix, b, method, _CG_LINEAR, np.inf)
        left = float(np.abs(matrix @ dv - b).max(initial=0.0) / (np.abs(b).max(initial=0.0) or 1.0))
        return stage.result(v + dv, 1, count, left, good and bool(np.isfinite(left)), method)

    def _solve_newton(self, stage: _Stage, method: str, tolerance: float, v: Array) -> SolveResult:
        springs = stage.springs
        v = np.where(springs.free, v, stage.vbar)
        turning = np.zeros(len(springs.rest)) if self.tension is None else self.tension
        now = _look(stage, v, turning)
        blocks = stage.blocks(stage.position(v), v)
        count, iteration = 0, 0
        remainder = 0.3 * tolerance / _BALANCE_WEIGHT * stage.size / stage.h * springs.mass
        while np.isfinite(now.misfit) and iteration < _NEWTON_LIMIT:
            steady = steadied(springs, now.turning, now.length, now.u)
            matrix = StepMatrix.assemble(springs, stage.h, steady, now.length, now.u, blocks)
            dv, inner, good = self._linear_solve(matrix, -now.imbalance, method, _CG_NEWTON, remainder)
            iteration, count = iteration + 1, count + inner
            if not good:
                break
            now = _search(stage, now, dv)
            if now.misfit <= tolerance:
                self.tension = now.turning
                return stage.result(now.v, iteration, count, now.misfit, True, method, stage.pushes(now))
        return stage.result(now.v, iteration, count, now.misfit, False, method)

    def _linear_solve(
        self, matrix: StepMatrix, b: Array, method: str, tolerance: float, left
    ) -> tuple[Array, int, bool]:
        """Return the solution, the CG iterations, and whether it is one."""
        if not self.springs.free.any():
            return np.zeros_like(b), 0, True
        if method == "cg":
            limit = _CG_LIMIT * int(self.springs.free.sum()) + 100
            y, count = conjugate_gradients(matrix, b, tolerance=tolerance, left=left, limit=limit)
            return y, count, count < limit and bool(np.isfinite(y).all())
        if self._pattern is None or self._factors is None:
            self._pattern = UpperPattern(self.springs)
            self._factors = direct.factors(self._pattern.starts, self._pattern.columns)
        if not self._factors.factor(self._pattern.values(matrix)):
            return np.zeros_like(b), 0, False
        y = self._pattern.unpack(self._factors.solve(self._pattern.pack(b)), self.springs.vertex_count)
        return y, 0, bool(np.isfinite(y).all())

    def _choose(self, h: float) -> str:
        """Return "direct" or "cg" and put the reason into words."""
        fastest = self.springs.fastest(h)
        free = int(self.springs.free.sum())
        iterations = min(_CG_PER_OMEGA * fastest, 3.0 * free) + 3.0
        self.reason = f"h omega = {fastest:.3g}: about {iterations:.0f} CG iterations"
        if self.method != "auto":
            self.reason += f"; '{self.method}' was asked for"
            return self.method
        if self._direct is None:
            self.reason += f"; for a direct solver: {direct.INSTALL}"
            return "cg"
        fixed, scaled = _FACTOR[self._direct]
        factor = fixed + scaled * free**1.5
        iterate = iterations * (_CG_FIXED + _CG_PER_SPRING * len(self.springs.rest))
        self.reason += f", {iterate:.2g} s, against {factor:.2g} s of one factorisation ({self._direct})"
        return "cg" if iterate < factor else "direct"


class _Stage:
    """One equation v = vbar + h a(xbar + h v, v), component by component, in f64."""

    def __init__(
        self,
        springs: Springs,
        zbar_x: Array,
        zbar_v: Array,
        h: float,
        extra: Acceleration | None,
        size: float,
        speeds: Array | None = None,
    ):
        self.springs, self.h, self.size = springs, float(h), size
        self.xbar, self.vbar = _by_component(zbar_x), _by_component(zbar_v)
        self.loose = self.vbar  # what vbar would be without walls
        if springs.walls is not None:
            self.vbar = self.loose + springs.walls * (speeds - (springs.walls * self.loose).sum(axis=0))
        self._kinds = np.asarray(zbar_x).dtype, np.asarray(zbar_v).dtype
        self._extra = extra
        self.finite = bool(np.isfinite(self.xbar).all() and np.isfinite(self.vbar).all() and np.isfinite(h))

    def position(self, v: Array) -> Array:
        """Return x = xbar + h v."""
        return self.xbar + self.h * v

    def extra(self, x: Array, v: Array) -> Array:
        """Return the acceleration that the springs do not give, (3, n)."""
        if self._extra is None:
            return np.zeros_like(x)
        return _by_component(self._extra(x.T.astype(self._kinds[0]), v.T.astype(self._kinds[1])))

    def blocks(self, x: Array, v: Array) -> Array | None:
        """Return the extra acceleration's part of A, (6, n), or None."""
        if self._extra is None:
            return None
        speed = max(float(np.abs(v).max(initial=0.0)), self.size / self.h)
        nudge = float(np.sqrt(np.finfo(self._kinds[1]).eps)) * speed
        return acceleration_blocks(self.extra, x, v, self.h, self.springs, nudge)

    def pushes(self, there: _Iterate) -> Array | float:
        """Return the speed that its wall gave each vertex, beside springs and the extra acceleration."""
        if self.springs.walls is None:
            return 0.0
        pull = self.springs.spread(there.turning * there.u) / self.springs.mass
        given = there.v - self.loose + self.h * (pull - self.extra(self.position(there.v), there.v))
        return (self.springs.walls * given).sum(axis=0)

    def result(
        self,
        v: Array,
        iterations: int,
        count: int,
        residual: float,
        converged: bool,
        method: str,
        pushes: Array | float = 0.0,
    ) -> SolveResult:
        """Return x and v vertex by vertex, as precise as they came."""
        x = np.ascontiguousarray(self.position(v).T, self._kinds[0])
        v = np.ascontiguousarray(v.T, self._kinds[1])
        return SolveResult(x, v, iterations, count, residual, converged, method, pushes)


def _look(stage: _Stage, v: Array, turning: Array) -> _Iterate:
    """Evaluate the equations at v, with the tension g that turns."""
    springs, h = stage.springs, stage.h
    x = stage.position(v)
    tension, length, u = springs.stretched(x, v)
    momentum = springs.free * (springs.momentum(v - stage.vbar) - springs.mass * h * stage.extra(x, v))
    imbalance = momentum + h * springs.spread(tension * u)
    push = h * springs.pushed(momentum + h * springs.spread(turning * u))
    # |T - g| over k + c / h: by so much the length is off
    compliance = h / np.maximum(springs.stiffness_over_step(h), np.finfo(float).tiny)
    off = np.where(springs.stiffness_over_step(h) > 0.0, np.abs(tension - turning) * compliance, 0.0)
    mean_push = float(np.sqrt((push * push).sum() / max(springs.free.sum(), 1)))
    misfit = max(float(off.max(initial=0.0)), _BALANCE_WEIGHT * mean_push) / stage.size
    return _Iterate(v, tension, length, u, imbalance, turning, misfit if np.isfinite(imbalance).all() else np.nan)


def _search(stage: _Stage, now: _Iterate, dv: Array) -> _Iterate:
    """Go along the Newton step, half as far as long as that leads astray.

    A full step may well make the misfit larger for once, as it turns springs; that is how far it gets in few steps.
    """
    springs = stage.springs
    target = now.tension + springs.stiffness_over_step(stage.h) * np.einsum("cs,cs->s", now.u, springs.differences(dv))
    allowed = max(_ASTRAY, 100.0 * now.misfit)

    def part(share: float) -> _Iterate:
        return _look(stage, now.v + share * dv, now.turning + share * (target - now.turning))

    there = part(1.0)
    for halving in range(1, _HALVINGS + 1):
        if there.misfit <= allowed:
            break
        there = part(0.5**halving)
    return there


def _by_component(z: Array) -> Array:
    return np.ascontiguousarray(np.asarray(z, float).T)


def _checked(springs, stiffness, damping, rest, mass, fixed) -> Springs:
    fixed = np.asarray(fixed, bool)
    pairs = np.asarray(springs, np.int64).reshape(-1, 2)
    n, m = len(fixed), len(pairs)
    bad = np.flatnonzero((pairs < 0).any(1) | (pairs >= n).any(1) | (pairs[:, 0] == pairs[:, 1]))
    if len(bad):
        i, j = pairs[bad[0]]
        raise InputError(
            f"spring {bad[0]} joins vertices {i} and {j}; allowed are two different ones from 0 to {n - 1}"
        )
    masses = np.broadcast_to(np.asarray(mass, float), n).copy()
    light = np.flatnonzero(~(masses > 0.0) & ~fixed)
    if len(light):
        raise InputError(f"vertex {light[0]} has mass {masses[light[0]]:g} kg; a vertex that moves needs more than 0")
    masses[fixed & ~(masses > 0.0)] = 1.0  # never used
    stiff, damp, length = (np.broadcast_to(np.asarray(value, float), m).copy() for value in (stiffness, damping, rest))
    return Springs(pairs[:, 0].copy(), pairs[:, 1].copy(), stiff, damp, length, masses, ~fixed)
