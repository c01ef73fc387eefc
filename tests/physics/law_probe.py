"""Evaluates laws on arrays of points: one small kernel each, parameters as run-time data."""

from typing import Any

import numpy as np
import taichi as ti

from tparticles import backend
from tparticles.binding import Parameters
from tparticles.physics.law import flow_terms
from tparticles.rng import device_stream


def real() -> type[np.floating[Any]]:
    """Return the NumPy type of the running backend's reals."""
    return np.float64 if backend.current().precision == "f64" else np.float32


@ti.data_oriented
class FlowProbe:
    """The velocity of a flow, or of a sum of flows, at arrays of points."""

    def __init__(self, flow: Any):
        self.parameters = Parameters()
        self.terms = [(self.parameters.bind(term), hasattr(term, "velocity_pass")) for term in flow_terms(flow)]

    def __call__(self, x: np.ndarray, t: float = 0.0) -> np.ndarray:
        """Return u [m/s] at the points `x` (n, 3) [m], in the precision of the run."""
        points = np.ascontiguousarray(np.atleast_2d(x), real())
        out = np.empty_like(points)
        self._evaluate(points, float(t), out, self.parameters.array)
        return out

    @ti.kernel
    def _evaluate(
        self,
        x: ti.types.ndarray(ndim=2),
        t: float,
        out: ti.types.ndarray(ndim=2),
        values: ti.types.ndarray(ndim=1),
    ):
        ti.static(self.parameters.read_from(values))
        for i in range(x.shape[0]):
            p = ti.Vector([x[i, 0], x[i, 1], x[i, 2]])
            u = p * 0.0
            for law, in_passes in ti.static(self.terms):
                if ti.static(in_passes):
                    for o in range(ti.cast(law.passes, ti.i32)):
                        u += law.velocity_pass(o, t, p)
                else:
                    u += law.velocity(t, p)
            for d in ti.static(range(3)):
                out[i, d] = u[d]


@ti.data_oriented
class Probe:
    """Calls one method of a law per row: the columns of the row are its arguments, the result is a number or a vector.

    `formula(law, row)` is a `@ti.func` of the bound law and the row, a vector; it returns a vector of `width` components.
    """

    def __init__(self, law: Any, formula: Any, *, arguments: int, width: int = 1):
        self.parameters = Parameters()
        self.law = None if law is None else self.parameters.bind(law)
        self.formula, self.arguments, self.width = formula, arguments, width

    def __call__(self, *columns: Any) -> np.ndarray:
        """Return the results, shape (n,) or (n, width); the arguments broadcast."""
        arrays = np.broadcast_arrays(*(np.atleast_1d(c) for c in columns))
        rows = np.ascontiguousarray(np.stack(arrays, axis=1), real())
        out = np.empty((len(rows), self.width), rows.dtype)
        self._evaluate(rows, out, self.parameters.array)
        return out[:, 0] if self.width == 1 else out

    @ti.kernel
    def _evaluate(
        self, rows: ti.types.ndarray(ndim=2), out: ti.types.ndarray(ndim=2), values: ti.types.ndarray(ndim=1)
    ):
        ti.static(self.parameters.read_from(values))
        for i in range(rows.shape[0]):
            row = ti.Vector([rows[i, j] for j in ti.static(range(self.arguments))])
            value = self.formula(self.law, row)
            for d in ti.static(range(self.width)):
                out[i, d] = value[d]


@ti.data_oriented
class SampleProbe:
    """Samples a shape, a cone or a spread for particles 0..n-1 of a stream."""

    def __init__(self, law: Any, width: int):
        self.parameters = Parameters()
        self.law, self.width = self.parameters.bind(law), width

    def __call__(self, count: int, *, key: int = 12345, draw: int = 0) -> np.ndarray:
        """Return the samples, shape (count,) or (count, width)."""
        out = np.empty((count, self.width), real())
        self._sample(key, draw, out, self.parameters.array)
        return out[:, 0] if self.width == 1 else out

    @ti.kernel
    def _sample(self, key: ti.u32, draw: ti.i32, out: ti.types.ndarray(ndim=2), values: ti.types.ndarray(ndim=1)):
        ti.static(self.parameters.read_from(values))
        for i in range(out.shape[0]):
            if ti.static(self.width == 1):
                out[i, 0] = self.law.sample(device_stream(key, i), draw)
            else:
                value = self.law.sample(device_stream(key, i), draw)
                for d in ti.static(range(self.width)):
                    out[i, d] = value[d]


def jacobian(flow: FlowProbe, x: np.ndarray, h: float, t: float = 0.0) -> np.ndarray:
    """Return du_i/dx_j at the points `x`, shape (n, 3, 3), by central differences of order six with step `h`."""
    columns = []
    for axis in np.eye(3):
        step = h * axis
        first, second, third = (flow(x + k * step, t) - flow(x - k * step, t) for k in (1, 2, 3))
        columns.append((45 * first - 9 * second + third) / (60 * h))
    return np.stack(columns, axis=2)
