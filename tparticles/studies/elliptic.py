"""Elliptic integrals and functions of real arguments, by the arithmetic-geometric mean; arrays broadcast.

m = k^2 in [0, 1). Source: Abramowitz and Stegun, Handbook of Mathematical Functions, sections 16.4, 17.3 and 17.6.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

_MOST_TURNS = 12  # each doubles the digits


def complete(m: Any) -> np.ndarray:
    """Return K(m), a quarter of the period of sn and cn."""
    *_, (a, _, _) = _means(m)
    return math.pi / (2 * a)


def incomplete(phi: Any, m: Any) -> np.ndarray:
    """Return F(phi | m), the argument u whose amplitude is `phi` [rad], any real number."""
    phi, doublings, last = np.asarray(phi, float), 0, None
    for a, b, _ in _means(m):
        if last is not None:
            # tan(phi' - phi) = (b / a) tan(phi), on the branch that keeps phi' continuous
            a_before, b_before = last
            turns = math.pi * np.round(phi / math.pi)
            rest = phi - turns
            phi = phi + np.arctan2(b_before * np.sin(rest), a_before * np.cos(rest)) + turns
            doublings += 1
        last = a, b
    assert last is not None
    return phi / (2.0**doublings * last[0])


def jacobi(u: Any, m: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return sn(u | m), cn(u | m), dn(u | m)."""
    means = list(_means(m))
    phi = 2.0 ** (len(means) - 1) * means[-1][0] * np.asarray(u, float)
    for a, _, c in reversed(means[1:]):
        # sin(2 phi' - phi) = (c / a) sin(phi)
        phi = (phi + np.arcsin(np.clip(c / a * np.sin(phi), -1, 1))) / 2
    sn = np.sin(phi)
    return sn, np.cos(phi), np.sqrt(1 - np.asarray(m) * sn**2)


def _means(m: Any) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield a, b and c = (a - b) / 2 of the turn before, from a = 1, b = sqrt(1 - m) until the two means meet."""
    m = np.asarray(m, float)
    a, b, c = np.ones_like(m), np.sqrt(1 - m), np.sqrt(m)
    for _ in range(_MOST_TURNS):
        yield a, b, c
        if np.all(np.abs(c) <= 1e-17 * a):
            return
        a, b, c = (a + b) / 2, np.sqrt(a * b), (a - b) / 2
