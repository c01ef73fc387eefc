"""What one step of a scheme does to the damped oscillator, as a matrix: for many step sizes at once, and for unequal ones.

In units of time in which omega = 1 the state is (x, v) followed by the registers that the scheme carries from step to step, each
of two components; slopes are kept as they are, so that they mean the same after a change of the step.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..schemes import Op, OpKind, Scheme

# Beyond this ratio the engine starts BDF2 again (stepping.fused): it is zero-stable up to 1 + sqrt 2.
LARGEST_RATIO = 2.4


def restarts(scheme: Scheme) -> bool:
    """Whether every change of the step sends the scheme back to its starter."""
    return not scheme.variable_steps


def step_matrices(scheme: Scheme, h: np.ndarray, ratio: np.ndarray, *, zeta: float = 0.0) -> np.ndarray:
    """Return the matrices of steps h = omega dt, each after a step of h / ratio; shape (n, d, d), d = 2 (1 + carried registers).

    A scheme that needs equal steps does its starter's step where the ratio is not 1, and so does one whose ratio is too large.
    The past is taken to be long enough everywhere else.
    """
    h, ratio = np.broadcast_arrays(np.asarray(h, float), np.asarray(ratio, float))
    if scheme.one_step:
        return _matrices(scheme, scheme.ops, h, ratio, zeta)
    anew = ratio > LARGEST_RATIO if scheme.variable_steps else np.abs(ratio - 1) > 1e-9
    matrices = _matrices(scheme, scheme.ops, h, ratio, zeta)
    if anew.any():
        matrices[anew] = _matrices(scheme, scheme.starting_ops, h[anew], ratio[anew], zeta)
    return matrices


def pair_growth(scheme: Scheme, first: np.ndarray, second: np.ndarray, *, zeta: float = 0.0) -> np.ndarray:
    """Return by how much a pair of steps omega dt = first, second multiplies the solution in the long run, shape (n,).

    The spectral radius of M(second) M(first), where the pairs follow one another.
    """
    first, second = np.broadcast_arrays(np.asarray(first, float), np.asarray(second, float))
    pair = step_matrices(scheme, second, second / first, zeta=zeta) @ step_matrices(
        scheme, first, first / second, zeta=zeta
    )
    bad = ~np.isfinite(pair).all(axis=(1, 2))
    pair[bad] = 0
    radius = np.abs(np.linalg.eigvals(pair)).max(axis=1)
    return np.where(bad, np.inf, radius)


def _matrices(scheme: Scheme, ops: Sequence[Op], h: np.ndarray, ratio: np.ndarray, zeta: float) -> np.ndarray:
    """Run a program and the history on the unit vectors: registers are arrays of shape (n, 2, d)."""
    kept = scheme.carried
    size, n = 2 * (1 + len(kept)), len(h)
    unit = np.broadcast_to(np.eye(size), (n, size, size))
    k: list[np.ndarray] = [np.zeros((n, 2, size)) for _ in range(scheme.registers)]
    for position, register in enumerate(kept, start=1):
        k[register] = unit[:, 2 * position : 2 * position + 2]
    run = _Run(z0=unit[:, :2], k=k, h=h[:, None, None], ratio=ratio[:, None, None], zeta=zeta)
    for op in (*ops, *scheme.history):
        run.do(op)
    return np.concatenate([run.z, *(run.k[register] for register in kept)], axis=1)


class _Run:
    def __init__(self, *, z0: np.ndarray, k: list[np.ndarray], h: np.ndarray, ratio: np.ndarray, zeta: float):
        self.z0, self.z, self.k, self.h, self.ratio = z0, z0, k, h, ratio
        self.A = np.array([[0.0, 1.0], [-1.0, -2 * zeta]])

    def do(self, op: Op) -> None:
        if op.kind is OpKind.COMBINE:
            self.z = self.z0 + self._sum(op)
        elif op.kind is OpKind.EVALUATE:
            self.k[op.slope] = self.A @ self.z
        elif op.kind is OpKind.KICK:
            self.z = self.z + self._sum(op) * [[0.0], [1.0]]
        elif op.kind is OpKind.DRIFT:
            x, v = self.z[:, :1], self.z[:, 1:]
            self.z = np.concatenate([x + self._weight(op, 0) * self.h * v, v], axis=1)
        elif op.kind is OpKind.SOLVE:
            # z = (I - w A)^-1 zbar
            self.z = np.linalg.solve(np.eye(2) - self._weight(op, 0) * self.h * self.A, self.z)
            self.k[op.slope] = self.A @ self.z
        elif op.kind is OpKind.ROTATE:
            self.k[op.slope] = self.k[op.source]
        else:
            self.k[op.slope] = (self.z - self.z0) / self.h

    def _sum(self, op: Op) -> np.ndarray:
        used = [j for j, weight in enumerate(op.weights) if weight]
        return sum((self._weight(op, j) * self.h * self.k[j] for j in used), start=np.zeros_like(self.z))

    def _weight(self, op: Op, j: int) -> np.ndarray | float:
        if not op.variable:
            return op.weights[j]
        # (n0 + n1 r) / (1 + d r)
        n0, n1, d = op.variable[j]
        return (n0 + n1 * self.ratio) / (1 + d * self.ratio)
