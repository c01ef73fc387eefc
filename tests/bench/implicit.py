"""Implicit stages of a draped cloth: cost against stiffness, the explicit peer, the settled picture, and scipy's stiff solvers.

`python -m tests.bench implicit`, or `python -m tests.bench.implicit --size 64 --seconds 2`. A sheet of 1 m with structural, shear
and bend springs of one stiffness, held at two corners, falls from a slight sag through drag (2 / s). Implicit: backward Euler, 24
steps a second, f32. Explicit: velocity Verlet at dt = 2 / sqrt(8 k / m), compiled by numba, timed over some hundred steps.
S = k L0 / (m g).
"""

import argparse
import functools
import time

import numpy as np

from tests.bench.table import Table
from tparticles.stepping.mesh_solver import MeshSolver

GRAVITY, DRAG, FPS = np.array([0.0, -9.81, 0.0]), 2.0, 24
PIXELS = 720  # to the metre, in the settled picture
ALEXANDER = 1.0 - 1.0 / np.sqrt(2.0)  # SDIRK2: stiffly accurate, order 2


def sheet(count: int, ratio: float) -> tuple[dict, np.ndarray]:
    """Return the arguments of a MeshSolver and the positions at the start."""
    size, mass = 1.0 / (count - 1), 0.2 / count**2
    index = np.arange(count**2).reshape(count, count)
    ends = [(index[1:], index[:-1]), (index[:, 1:], index[:, :-1]), (index[1:, 1:], index[:-1, :-1])]
    ends += [(index[1:, :-1], index[:-1, 1:]), (index[2:], index[:-2]), (index[:, 2:], index[:, :-2])]
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], 1) for a, b in ends])
    axis = np.linspace(0.0, 1.0, count)
    x = np.stack([a.ravel() for a in np.meshgrid(axis, [0.0], axis, indexing="ij")], 1)
    rest = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    # A cylinder of radius 2 m: bent, not stretched.
    x[:, 0], x[:, 1] = 2.0 * np.sin(x[:, 0] / 2.0), 2.0 * (np.cos(x[:, 0] / 2.0) - 1.0)
    mesh = {
        "springs": pairs,
        "stiffness": np.full(len(pairs), ratio * mass * 9.81 / size),
        "damping": 0.0,
        "rest": rest,
        "mass": np.full(count**2, mass),
        "fixed": np.isin(np.arange(count**2), [0, count - 1]),
    }
    return mesh, x


def outside(x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return gravity and drag [m/s^2]."""
    return (GRAVITY - DRAG * v).astype(v.dtype)


class Implicit:
    """Backward Euler, SDIRK2 or the implicit midpoint rule, with a fixed step."""

    def __init__(self, mesh: dict, x: np.ndarray, kind: type, tolerance: float | None = None):
        self.solver = MeshSolver(**mesh, tolerance=tolerance)
        self.x, self.v = x.astype(kind), np.zeros_like(x, kind)
        self.iterations = self.failures = 0

    def stage(self, x: np.ndarray, v: np.ndarray, h: float):
        """Solve one stage and count."""
        result = self.solver.solve(x, v, h, outside)
        self.iterations += result.iterations
        self.failures += not result.converged
        self.method = result.method
        return result.x, result.v

    def euler(self, h: float) -> None:
        """x, v = one step of backward Euler."""
        self.x, self.v = self.stage(self.x, self.v, h)

    def midpoint(self, h: float) -> None:
        """x, v = one step of the implicit midpoint rule."""
        x, v = self.stage(self.x, self.v, 0.5 * h)
        self.x, self.v = 2.0 * x - self.x, 2.0 * v - self.v

    def sdirk2(self, h: float) -> None:
        """x, v = one step of Alexander's method."""
        x, v = self.stage(self.x, self.v, ALEXANDER * h)
        weight = (1.0 - ALEXANDER) / ALEXANDER
        self.x, self.v = self.stage(self.x + weight * (x - self.x), self.v + weight * (v - self.v), ALEXANDER * h)


@functools.cache
def verlet_kernel():
    """Compile some steps of velocity Verlet, a gather over the springs of every vertex, drag by its exponential."""
    import numba

    @numba.njit(parallel=True, fastmath=True)
    def run(x, v, a, starts, others, stiff, rest, mass, free, dt, steps):
        decay = np.exp(-0.5 * DRAG * dt)
        for _ in range(steps):
            for i in numba.prange(len(x)):
                for c in range(3):
                    v[i, c] = (v[i, c] * decay + 0.5 * dt * a[i, c]) * free[i]
                    x[i, c] += dt * v[i, c]
            for i in numba.prange(len(x)):
                p = q = r = np.float32(0.0)
                for s in range(starts[i], starts[i + 1]):
                    j = others[s]
                    d, e, f = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
                    length = np.sqrt(d * d + e * e + f * f)
                    pull = stiff[s] * (length - rest[s]) / length
                    p, q, r = p + pull * d, q + pull * e, r + pull * f
                a[i, 0], a[i, 1], a[i, 2] = p / mass[i], q / mass[i] - 9.81, r / mass[i]
                for c in range(3):
                    v[i, c] = (v[i, c] + 0.5 * dt * a[i, c]) * decay * free[i]

    return run


class Explicit:
    """Velocity Verlet at 0.8 of the limit, which bend springs and tension make smaller."""

    def __init__(self, mesh: dict, x: np.ndarray, kind: type):
        pairs, n = mesh["springs"], len(x)
        ends, others = np.concatenate([pairs.T[0], pairs.T[1]]), np.concatenate([pairs.T[1], pairs.T[0]])
        order = np.argsort(ends, kind="stable")
        both = [np.concatenate([mesh[name]] * 2)[order].astype(kind) for name in ("stiffness", "rest")]
        starts = np.searchsorted(ends[order], np.arange(n + 1)).astype(np.int32)
        free = (~mesh["fixed"]).astype(kind)
        self.x, self.v, self.a = x.astype(kind), np.zeros_like(x, kind), np.zeros_like(x, kind)
        self.data = (starts, others[order].astype(np.int32), *both, mesh["mass"].astype(kind), free)
        self.limit = 2.0 / np.sqrt(8.0 * mesh["stiffness"][0] / mesh["mass"][0])

    def advance(self, steps: int) -> None:
        """Take steps."""
        verlet_kernel()(self.x, self.v, self.a, *self.data, 0.8 * self.limit, steps)

    def seconds_per_second(self) -> float:
        """Time some hundred steps, the best of three."""
        self.advance(2)
        times = []
        for _ in range(3):
            start = time.perf_counter()
            self.advance(200)
            times.append(time.perf_counter() - start)
        return min(times) / 200 / self.limit


def stiffness(size: int, seconds: float) -> None:
    """Print seconds per simulated second against S, both ways."""
    columns = (
        "S",
        "solver",
        "Newton iterations a step",
        "not converged",
        "implicit s/s",
        "growth",
        "explicit s/s",
        "ratio",
    )
    table = Table(f"Cloth {size}^2, {seconds:g} s at {FPS} steps a second", columns)
    first = 0.0
    for ratio in (1e4, 1e6, 1e7, 1e8):
        mesh, x = sheet(size, ratio)
        film = Implicit(mesh, x, np.float32)
        steps, start = round(seconds * FPS), time.perf_counter()
        for _ in range(steps):
            film.euler(1 / FPS)
        cost = (time.perf_counter() - start) / seconds
        peer = Explicit(mesh, x, np.float32).seconds_per_second()
        first = first or cost
        counts = (film.method, f"{film.iterations / steps:.2f}", film.failures)
        cells = (f"{cost:.2f}", f"{cost / first:.2f}", f"{peer:.2f}", f"{peer / cost:.1f}")
        table.add(f"{ratio:.0e}", *counts, *cells)
    table.print()


def settled(size: int, seconds: float) -> None:
    """Print how far the settled pictures are apart, of a sheet held along an edge: at two corners it has several."""
    table = Table(
        f"Cloth {size}^2 settled for {seconds:g} s", ("S", f"largest distance, pixels ({PIXELS} to the metre)", "mean")
    )
    for ratio in (1e4, 1e7, 1e8):
        mesh, x = sheet(size, ratio)
        mesh["fixed"] = np.arange(size**2) < size
        film, peer = Implicit(mesh, x, np.float32), Explicit(mesh, x, np.float64)
        for _ in range(round(seconds * FPS)):
            film.euler(1 / FPS)
        peer.advance(round(seconds / (0.8 * peer.limit)))
        apart = np.linalg.norm(film.x - peer.x, axis=1) * PIXELS
        table.add(f"{ratio:.0e}", f"{apart.max():.3f}", f"{apart.mean():.3f}")
    table.print()


def against_scipy(size: int, ratio: float, seconds: float) -> None:
    """Print time and error of the midpoint rule, of SDIRK2 and of scipy's stiff solvers with the sparse Jacobian."""
    from scipy.integrate import solve_ivp

    mesh, x = sheet(size, ratio)
    slope, jacobian = first_order(mesh)
    begin = np.concatenate([x.ravel(), np.zeros(x.size)])
    exact = solve_ivp(slope, (0.0, seconds), begin, "DOP853", rtol=1e-8, atol=1e-10, t_eval=[seconds])
    reference = exact.y[: x.size, -1].reshape(-1, 3)

    def error(end: np.ndarray) -> str:
        return f"{np.abs(end - reference).max() * 1e3:.3g}"

    table = Table(f"Cloth {size}^2, S = {ratio:.0e}, {seconds:g} s", ("method", "error, mm", "seconds"))
    for name, steps in (("midpoint", 128), ("midpoint", 224), ("midpoint", 256), ("sdirk2", 128), ("sdirk2", 256)):
        film, start = Implicit(mesh, x, np.float64, 1e-2), time.perf_counter()
        for _ in range(steps):
            getattr(film, name)(seconds / steps)
        table.add(f"{name}, {steps} steps", error(film.x), f"{time.perf_counter() - start:.2f}")
    for method, tolerance in (("Radau", 1e-1), ("Radau", 1e-2)):  # BDF at 1e-2 takes more than two minutes
        start = time.perf_counter()
        found = solve_ivp(slope, (0.0, seconds), begin, method, rtol=tolerance, atol=tolerance * 1e-2, jac=jacobian)
        end = found.y[: x.size, -1].reshape(-1, 3)
        table.add(f"scipy {method}, rtol {tolerance:g}", error(end), f"{time.perf_counter() - start:.2f}")
    table.print()


def first_order(mesh: dict):
    """Return f(t, z) and its sparse Jacobian for z = (x, v), as scipy wants them."""
    from scipy.sparse import bmat, csr_matrix, diags, identity, kron

    pairs, n, m = mesh["springs"], len(mesh["mass"]), len(mesh["springs"])
    ones, row = np.ones(m), np.arange(m)
    incidence = csr_matrix((np.r_[ones, -ones], (np.r_[row, row], pairs.T.ravel())), (m, n))
    free, k = np.repeat(~mesh["fixed"], 3), mesh["stiffness"]
    scale = diags(free / np.repeat(mesh["mass"], 3))
    wide = kron(incidence, identity(3), "csr")

    def geometry(z):
        d = incidence @ z[: 3 * n].reshape(n, 3)
        length = np.linalg.norm(d, axis=1)
        return d / length[:, None], length

    def slope(_, z):
        u, length = geometry(z)
        force = -(incidence.T @ ((k * (length - mesh["rest"]))[:, None] * u))
        v = z[3 * n :] * free
        return np.concatenate([v, free * (np.tile(GRAVITY, n) - DRAG * v) + scale @ force.ravel()])

    def jacobian(_, z):
        u, length = geometry(z)
        across = k * (1.0 - mesh["rest"] / length)
        blocks = (k - across)[:, None, None] * u[:, :, None] * u[:, None, :] + across[:, None, None] * np.eye(3)
        index = np.arange(3 * m).reshape(m, 3)
        middle = csr_matrix(
            (blocks.ravel(), (np.repeat(index, 3, 1).ravel(), np.tile(index, 3).ravel())), (3 * m, 3 * m)
        )
        return bmat([[None, diags(free * 1.0)], [-scale @ wide.T @ middle @ wide, diags(-DRAG * free)]], "csc")

    return slope, jacobian


def main(size: int = 128, seconds: float = 4.0) -> None:
    """Print the three tables."""
    stiffness(size, seconds)
    settled(16, 10.0)
    against_scipy(32, 1e5, 0.25)


if __name__ == "__main__":
    options = argparse.ArgumentParser()
    options.add_argument("--size", type=int, default=128)
    options.add_argument("--seconds", type=float, default=4.0)
    chosen = options.parse_args()
    main(chosen.size, chosen.seconds)
