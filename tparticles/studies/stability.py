"""The stability study: which steps keep a decaying or swinging mode bounded, for every scheme.

On x' = lambda x by z = dt lambda in the complex plane; on x'' = -omega^2 x - 2 zeta omega x' by omega dt against zeta. A
scheme for second-order systems alone has its plane too: z and its conjugate are the roots of an oscillator.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..schemes import MultistepStability, Scheme, SplittingStability, oscillator_limit
from ..schemes.exact import Number

ZETAS = (
    0.0,
    0.005,
    0.01,
    0.02,
    0.03,
    *(round(0.05 * k, 2) for k in range(1, 25)),
    1.3,
    1.4,
    1.5,
    1.6,
    1.7,
    1.8,
    1.9,
    2.0,
)
RAYS = (*range(0, 88, 4), *range(88, 181, 2))  # degrees from the positive real axis
REACH = 60.0  # boundaries farther out are left away
_ALONG = 400  # points on a ray
_BEGINS = 5e-3
_ALLOWED = 1e-9


@dataclass(frozen=True)
class Region:
    """What is known of one scheme: limits (infinite where there is none), and the border of its region in the upper half-plane.

    `border`: (angle [degrees], |z|) of all places where the growth of one step passes 1, islands included, on each of the study's
    rays, |z| <= REACH. `oscillator`: the limits of omega dt, for each of the study's damping ratios.
    """

    scheme: str
    order: int
    systems: tuple[int, ...]
    real_limit: float
    imaginary_limit: float
    a_stable: bool
    l_stable: bool
    border: tuple[tuple[float, float], ...]
    oscillator: tuple[float, ...]


@dataclass(frozen=True)
class StabilityStudy:
    """The result: one region for each scheme."""

    zetas: tuple[float, ...]
    rays: tuple[float, ...]
    regions: tuple[Region, ...]

    def rows(self) -> list[dict[str, object]]:
        """Return a row for each limit: of the axes, of the damping ratios, and of the border."""
        rows: list[dict[str, object]] = []
        for r in self.regions:
            rows.append(_row(r, "real limit", "", r.real_limit))
            rows.append(_row(r, "imaginary limit", "", r.imaginary_limit))
            rows += [_row(r, "omega dt", zeta, limit) for zeta, limit in zip(self.zetas, r.oscillator, strict=True)]
            rows += [_row(r, "border |z|", angle, size) for angle, size in r.border]
        return rows


def _row(region: Region, what: str, at: object, value: float) -> dict[str, object]:
    return {"scheme": region.scheme, "what": what, "at": at, "value": value}


def study(
    chosen: Sequence[Scheme],
    *,
    zetas: Sequence[float] = ZETAS,
    rays: Sequence[float] = RAYS,
    tell: Callable[[str], None] = lambda _: None,
) -> StabilityStudy:
    """Find the limits and the border of each scheme: damping ratios `zetas` >= 0, `rays` in degrees, 0 to 180."""
    regions = []
    for scheme in chosen:
        tell(f"stability: {scheme.name}")
        regions.append(
            Region(
                scheme=scheme.name,
                order=scheme.order,
                systems=tuple(sorted(scheme.system_orders)),
                real_limit=scheme.real_limit,
                imaginary_limit=scheme.imaginary_limit,
                a_stable=scheme.a_stable,
                l_stable=scheme.l_stable,
                border=tuple(crossing for angle in rays for crossing in _crossings(scheme, angle)),
                oscillator=tuple(oscillator_limit(scheme, zeta) for zeta in zetas),
            )
        )
    return StabilityStudy(zetas=tuple(zetas), rays=tuple(rays), regions=tuple(regions))


def _crossings(scheme: Scheme, angle: float) -> list[tuple[float, float]]:
    """Return (angle, |z|) of each place on a ray where the amplification passes 1, by bisection between grid points."""
    if angle in (0, 180) and scheme.system_orders == {2}:
        return []  # oscillators have complex roots
    direction = complex(math.cos(math.radians(angle)), math.sin(math.radians(angle)))
    s = np.geomspace(_BEGINS, REACH, _ALONG)
    grows = amplification(scheme, s * direction) > 1 + _ALLOWED
    if angle == 90 and scheme.imaginary_limit == 0:
        grows[: np.argmax(grows)] = True  # it grows from the start, at first by less than rounding
    at = np.flatnonzero(grows[1:] != grows[:-1])
    found = _bisected(scheme, direction, s[at], s[at + 1], grows[at])
    return [(float(angle), float(f"{x:.10g}")) for x in found]


def _bisected(scheme: Scheme, direction: complex, low: np.ndarray, high: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return where between `low` and `high` the amplification passes 1; `before`: whether it is above 1 at `low`."""
    for _ in range(40):
        middle = (low + high) / 2
        same = (amplification(scheme, middle * direction) > 1 + _ALLOWED) == before
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return low


def amplification(scheme: Scheme, z: np.ndarray) -> np.ndarray:
    """Return `scheme.stability.amplification` of an array of z, of the same shape; infinite at poles."""
    stability, flat = scheme.stability, np.asarray(z, complex).ravel()
    with np.errstate(all="ignore"):
        if isinstance(stability, MultistepStability):
            found = _largest_roots([_values(row, flat) for row in stability.characteristic])
        elif isinstance(stability, SplittingStability):
            p, q = np.abs(flat) ** 2, -2 * np.real(flat)
            found = _largest_roots([_values([_values(row, q) for row in rows], p) for rows in stability.oscillator])
        else:
            found = np.abs(_values(stability.numerator, flat) / _values(stability.denominator, flat))
    return np.where(np.isfinite(found), found, np.inf).reshape(np.shape(z))


def _values(row: Sequence[Number | np.ndarray], z: np.ndarray) -> np.ndarray:
    value = np.zeros(len(z), complex)
    for coefficient in reversed(row):
        value = value * z + (coefficient if isinstance(coefficient, np.ndarray) else float(coefficient))
    return value


def _largest_roots(coefficients: Sequence[np.ndarray]) -> np.ndarray:
    """Return the largest |root| of many polynomials, ascending coefficients, each an array over the polynomials."""
    *lower, lead = coefficients
    n, m = len(lead), len(lower)
    companion = np.zeros((n, m, m), complex)
    companion[:, np.arange(1, m), np.arange(m - 1)] = 1
    companion[:, :, -1] = -np.stack(lower, axis=1) / lead[:, None]
    bad = ~np.isfinite(companion).all(axis=(1, 2))
    companion[bad] = 0
    return np.where(bad, np.inf, np.abs(np.linalg.eigvals(companion)).max(axis=1))
