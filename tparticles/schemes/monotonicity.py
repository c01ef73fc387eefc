"""Strong stability preservation: up to which multiple of Euler's step is a method as well-behaved as Euler's?"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tparticles.schemes.exact import Number

_ROUNDING = 1e-12
_LARGEST = 1e6


def ssp_coefficient(a: Sequence[Sequence[Number]], b: Sequence[Number]) -> float | None:
    """Return the SSP coefficient of the Runge-Kutta method (a, b), None where it has none, infinity where unlimited.

    If Euler's step does not increase a norm (or a total variation, slide 27) for dt <= dt_0, a step of the method does not
    for dt <= C dt_0. C is the largest r with K (I + r K)^-1 >= 0 and (I + r K)^-1 1 >= 0, K = ((A, 0), (b, 0)).
    Source: Kraaijevanger, BIT 31 (1991); Gottlieb, Ketcheson, Shu, Strong Stability Preserving methods (2011), section 3.
    """
    s = len(b)
    K = np.zeros((s + 1, s + 1))
    try:
        for i, row in enumerate([*a, b]):
            K[i, : len(row)] = [float(entry) for entry in row]
    except OverflowError:
        return None
    low, high = 0.0, 2.0**-20
    if not _is_monotonic(K, high):
        return None
    while _is_monotonic(K, high):
        low, high = high, 2 * high
        if high > _LARGEST:
            return math.inf
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if _is_monotonic(K, middle) else (low, middle)
    # Within the rounding of the bisection it is a simple number where it is one.
    simple = round(low * 720) / 720
    return simple if abs(simple - low) < 1e-9 else low


def _is_monotonic(K: np.ndarray, r: float) -> bool:
    with np.errstate(all="ignore"):
        try:
            inverse = np.linalg.inv(np.eye(len(K)) + r * K)
        except np.linalg.LinAlgError:
            return False
        return bool(np.all(K @ inverse >= -_ROUNDING) and np.all(inverse.sum(axis=1) >= -_ROUNDING))
