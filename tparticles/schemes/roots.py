"""Along a ray in the complex plane, how far do all roots of a characteristic polynomial stay in the unit disc?

A characteristic polynomial along a ray is an array P, shape (m + 1, n + 1): P[j, k] is the coefficient of zeta^j s^k, s >= 0 the
distance along the ray. The root condition: roots in the closed unit disc, those on the circle simple.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

import numpy as np

from tparticles.schemes.exact import Number

# Roots at s = 0 that are nearer than this are one root; double ones come out of an eigenvalue solver 1e-8 apart.
_CLUSTER = 1e-5
# Terms of the series that tell what happens near s = 0: growth like s^k with a larger k is not known in any method.
_TERMS = 24
_ROUNDING = 1e-9
# Where roots leave the circle one by one their modulus is good to rounding; where pairs stay on it up to a double root, to
# the square root of that. There they leave it like a square root too, so that the limit is as good.
_ALLOWED, _ALLOWED_NEUTRAL = 1e-12, 1e-6
_NEAR, _ALLOWED_NEAR = 0.05, 1e-10
# Beyond the largest distance a limit counts as infinite.
_DISTANCES = np.concatenate([np.linspace(0, 20, 4001)[1:], np.geomspace(20, 1e8, 800)[1:]])


def damped_direction(zeta: float) -> complex:
    """Return -zeta + i sqrt(1 - zeta^2), 0 <= zeta <= 1: lambda / omega of an oscillator with that damping ratio."""
    return complex(-zeta, math.sqrt(1 - zeta**2))


def on_ray(P: Sequence[Sequence[Number]], direction: complex) -> np.ndarray:
    """Return P along z = direction s, from rows P[j] of coefficients of zeta^j z^i (rows may differ in length)."""
    array = np.zeros((len(P), max(len(row) for row in P)), complex)
    for j, row in enumerate(P):
        array[j, : len(row)] = [float(coefficient) * direction**i for i, coefficient in enumerate(row)]
    return array


def spectral_radius(P: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return the largest |zeta| at each of the distances `s`, shape (n,)."""
    # Descending powers by Horner, scaled against overflow: only the roots matter.
    scale = np.maximum(s, 1.0)
    values = np.zeros((len(s), len(P)), complex)
    for k in range(P.shape[1]):
        values += (P[:, k][None, :] * (s / scale)[:, None] ** k) * scale[:, None] ** (k + 1.0 - P.shape[1])
    lead = values[:, -1]
    m = len(P) - 1
    with np.errstate(all="ignore"):
        ratios = -values[:, :-1] / lead[:, None]
    finite = np.all(np.isfinite(ratios), axis=1)
    companion = np.zeros((len(s), m, m), complex)
    companion[:, np.arange(1, m), np.arange(m - 1)] = 1
    companion[finite, :, -1] = ratios[finite]
    radius = np.abs(np.linalg.eigvals(companion)).max(axis=1)
    return np.where(finite, radius, np.inf)


def stable_until(P: np.ndarray) -> float:
    """Return the largest s such that the root condition holds on [0, s]: 0 if it fails near 0, infinity if never.

    What happens near 0 is read off the series of the roots, where it may be as little as s^6; farther out, instabilities
    over less than 0.005 (a quarter of a percent beyond 20) could be overlooked.
    """
    start = beginning(P)
    if start > 0:
        return 0.0
    # In units in which the coefficients are about 1 limits are too, however large the weights of the method.
    unit = _unit(P)
    P = P / unit ** np.arange(P.shape[1])
    grows = _grows(P, _DISTANCES, start)
    if not grows.any():
        return math.inf
    first = int(np.argmax(grows))
    low, high = (_DISTANCES[first - 1] if first else 0.0), _DISTANCES[first]
    for _ in range(10):  # 64 parts at a time: many roots cost little more than one
        s = np.linspace(low, high, 65)
        first = int(np.argmax([*_grows(P, s[1:-1], start), True]))
        low, high = s[first], s[first + 1]
    return float(low / unit)


def _grows(P: np.ndarray, s: np.ndarray, start: int) -> np.ndarray:
    """Return whether a root leaves the disc at the distances `s`; near 0 damping may be below rounding."""
    allowed = np.where(s > _NEAR, _ALLOWED, _ALLOWED_NEAR) if start < 0 else _ALLOWED_NEUTRAL
    return spectral_radius(P, s) > 1 + allowed


def _unit(P: np.ndarray) -> float:
    """Return the largest |coefficient of s^k|^(1/k), up to which the powers of s are below 1, of a polynomial with some."""
    with np.errstate(divide="ignore"):
        logs = np.log(np.abs(P[:, 1:]).max(axis=0) / np.abs(P[:, 0]).max()) / np.arange(1, P.shape[1])
    return float(np.exp(logs.max(initial=-np.inf))) or 1.0


def beginning(P: np.ndarray) -> int:
    """Return what the roots do just beyond s = 0: 1 if one leaves the unit disc, -1 if all are in it, 0 if some stay on it."""
    P = P / _unit(P) ** np.arange(P.shape[1])
    roots = np.roots(P[::-1, 0])
    signs = [-1]
    while len(roots):
        near = np.abs(roots - roots[0]) < _CLUSTER
        root, count, roots = complex(roots[near].mean()), int(near.sum()), roots[~near]
        if abs(root) > 1 - _CLUSTER:
            signs.append(1 if abs(root) > 1 + _CLUSTER else _sign_near(P, root, count))
    return max(signs)


def _sign_near(P: np.ndarray, root: complex, count: int) -> int:
    """Return the sign of |zeta(s)|^2 - 1 for small s > 0, for the roots that are `root` at s = 0."""
    if count == 1:
        return _sign_of_excess(_series(_padded(P), root))
    if count > 2:
        return 1
    # A double root, as of x'' = 0: zeta = root + s xi, with P = sum_m T_m(s) s^m xi^m by Taylor.
    T = np.zeros((len(P), _TERMS), complex)
    padded = _padded(P)
    for m in range(len(P)):
        for j in range(m, len(P)):
            T[m] += math.comb(j, m) * root ** (j - m) * padded[j]
    if max(abs(T[0, 0]), abs(T[0, 1]), abs(T[1, 0])) > _ROUNDING * np.abs(P).max():
        # zeta = root + c sqrt(s): one of the two goes out.
        return 1
    Q = np.zeros_like(T)
    for m in range(len(P)):
        shift = m - 2
        if shift < 0:
            Q[m, :shift] = T[m, -shift:]
        else:
            Q[m, shift:] = T[m, : _TERMS - shift]
    xi = np.roots(Q[2::-1, 0])
    if len(xi) < 2 or abs(xi[0] - xi[1]) < _CLUSTER:
        return 1
    # Two terms at the end are lost to the shift.
    return max(_sign_of_excess(np.concatenate([[root], _series(Q, start)[:-3]])) for start in xi)


def _padded(P: np.ndarray) -> np.ndarray:
    out = np.zeros((len(P), _TERMS), complex)
    width = min(P.shape[1], _TERMS)
    out[:, :width] = P[:, :width]
    return out


def _series(P: np.ndarray, root: complex) -> np.ndarray:
    """Return the power series of the simple root that is `root` at s = 0, by Newton's method."""
    zeta = np.zeros(P.shape[1], complex)
    zeta[0] = root
    dP = P[1:] * np.arange(1, len(P))[:, None]
    for _ in range(3 + math.ceil(math.log2(P.shape[1]))):
        zeta = zeta - _truncated_product(_horner(P, zeta), _inverse(_horner(dP, zeta)))
    return zeta


def _horner(P: np.ndarray, zeta: np.ndarray) -> np.ndarray:
    value = np.zeros_like(zeta)
    for row in P[::-1]:
        value = _truncated_product(value, zeta) + row
    return value


def _truncated_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.convolve(a, b)[: len(a)]


def _inverse(a: np.ndarray) -> np.ndarray:
    inverse = np.zeros_like(a)
    inverse[0] = 1 / a[0]
    for k in range(1, len(a)):
        inverse[k] = -np.dot(a[1 : k + 1], inverse[k - 1 :: -1][:k]) / a[0]
    return inverse


def _sign_of_excess(zeta: np.ndarray) -> int:
    """Return the sign of the first coefficient of |zeta(s)|^2 - 1 that is not 0, and 0 if there is none."""
    excess = np.real(np.convolve(zeta, zeta.conj())[: len(zeta)])
    sizes = np.convolve(np.abs(zeta), np.abs(zeta))[: len(zeta)]
    excess[0] -= 1
    for value, size in zip(excess, sizes, strict=True):
        if abs(value) > _ROUNDING * max(1.0, size):
            return 1 if value > 0 else -1
    return 0


def largest_root(coefficients: Sequence[complex]) -> float:
    """Return the largest |root| of a polynomial in ascending powers; infinity where its leading coefficient is 0."""
    if coefficients[-1] == 0 or not all(map(cmath.isfinite, coefficients)):
        return math.inf
    return float(np.abs(np.roots(list(reversed(coefficients)))).max(initial=0.0))
