"""Implicit stages of the reference interpreter: dense Newton with differenced Jacobians, in float64."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tparticles.errors import RunError

_ITERATIONS = 50
_HALVINGS = 30
# Central differences are best near the cube root of the rounding error.
_STEP = 2.0**-17
_ROUNDING = 2.0**-52


def newton(f: Callable[[Any, Any], Any], t: Any, zbar: Any, h: float, where: str) -> tuple[Any, Any]:
    """Solve z = zbar + h f(t, z) and return z and its slope (z - zbar) / h.

    `zbar`: number or array of any shape, real or complex. Newton's method from zbar, with halved updates where a whole
    one does not bring the residual down (slides 38-39), until the updates are down to rounding.
    Raises RunError, beginning with `where`, if it does not get there.
    """
    flat, g = _flattened(f, t, zbar)
    z, last = flat.copy(), np.inf
    with np.errstate(all="ignore"):
        residual = z - flat - h * g(z)
        for _ in range(_ITERATIONS):
            dz = _solve(np.eye(len(flat)) - h * _jacobian(g, z), -residual, where)
            z, residual = _line_search(lambda y: y - flat - h * g(y), z, dz, residual, where)
            # Differenced Jacobians converge linearly, but by 1e-8 a turn: it ends where updates stop to shrink.
            size, scale = np.abs(dz).max(), np.abs(z).max() + np.abs(flat).max()
            if size <= 2 * _ROUNDING * scale or (size <= 1e-10 * scale and size >= last / 2):
                return _shaped(z, zbar), _shaped((z - flat) / h, zbar)
            last = size
    raise RunError(f"{where}: Newton's method did not converge in {_ITERATIONS} turns; residual {_norm(residual):.3g}")


def linearised(f: Callable[[Any, Any], Any], t: Any, zbar: Any, h: float, where: str) -> tuple[Any, Any]:
    """Take one Newton step: k = (I - h df/dz(t, zbar))^-1 f(t, zbar); return zbar + h k and k (slide 37)."""
    flat, g = _flattened(f, t, zbar)
    k = _solve(np.eye(len(flat)) - h * _jacobian(g, flat), g(flat), where)
    return _shaped(flat + h * k, zbar), _shaped(k, zbar)


def _flattened(f: Callable[[Any, Any], Any], t: Any, zbar: Any) -> tuple[np.ndarray, Callable[[Any], np.ndarray]]:
    shape = np.shape(zbar)
    wide = np.complex128 if np.iscomplexobj(zbar) else np.float64
    flat = np.asarray(zbar, dtype=wide).reshape(-1)
    return flat, lambda z: np.asarray(f(t, z.reshape(shape) if shape else z[0])).astype(wide).reshape(-1)


def _shaped(z: np.ndarray, like: Any) -> Any:
    if not np.shape(like):
        return z[0]
    kept = like.dtype if isinstance(like, np.ndarray) and like.dtype.kind in "fc" else z.dtype
    return z.reshape(np.shape(like)).astype(kept)


def _jacobian(g: Callable[[Any], np.ndarray], z: np.ndarray) -> np.ndarray:
    columns = []
    for i in range(len(z)):
        # A power of two: the differences of a linear g lose nothing to it.
        d = _STEP * 2.0 ** np.ceil(np.log2(max(abs(z[i]), 1e-3)))
        change = np.zeros_like(z)
        change[i] = d
        columns.append((g(z + change) - g(z - change)) / (2 * d))
    return np.array(columns).T


def _solve(A: np.ndarray, b: np.ndarray, where: str) -> np.ndarray:
    try:
        x = np.linalg.solve(A, b)
    except np.linalg.LinAlgError:
        x = np.full_like(b, np.nan)
    if not np.all(np.isfinite(x)):
        raise RunError(f"{where}: the linear system of the implicit stage is singular or not finite")
    return x


def _line_search(
    F: Callable[[np.ndarray], np.ndarray], z: np.ndarray, dz: np.ndarray, residual: np.ndarray, where: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return z + s dz and its residual for the first s = 1, 1/2, 1/4 ... that brings it down, or cannot any more."""
    floor = 16 * _ROUNDING * (_norm(z) + _norm(dz))
    for halving in range(_HALVINGS):
        trial = z + dz * 0.5**halving
        new = F(trial)
        if np.all(np.isfinite(new)) and (_norm(new) < _norm(residual) or _norm(dz) <= 1e-8 * _norm(z) + floor):
            return trial, new
    raise RunError(f"{where}: Newton's method found no descent; residual {_norm(residual):.3g}")


def _norm(x: np.ndarray) -> float:
    return float(np.abs(x).max(initial=0.0))
