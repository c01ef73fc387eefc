"""What a black body of temperature T looks like: luminance and linear sRGB, exact and as a table.

Nothing here is clipped. Below 1900 K a black body lies outside the sRGB gamut and its blue is negative; the film is
linear, so clamping is left to the look, which comes last.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tparticles.errors import InputError

Array = NDArray[np.float64]

# Exact SI values (CODATA 2018): h [J s], c [m/s] and k_B [J/K].
PLANCK = 6.62607015e-34
LIGHT_SPEED = 299792458.0
BOLTZMANN = 1.380649e-23
C1L = 2.0 * PLANCK * LIGHT_SPEED**2
"""First radiation constant for spectral radiance, 2 h c^2 [W m^2 / sr]."""
C2 = PLANCK * LIGHT_SPEED / BOLTZMANN
"""Second radiation constant, h c / k_B = 0.01438776877503933 [m K]."""
K_M = 683.0
"""Luminous efficacy at 555 nm [lm/W] (CIE 018:2019)."""

XYZ_FROM_SRGB: Array = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
"""Linear sRGB to CIE XYZ with Y in 0..1, as printed in IEC 61966-2-1:1999; (1, 1, 1) is the D65 white."""
SRGB_FROM_XYZ: Array = np.linalg.inv(XYZ_FROM_SRGB).astype(np.float64)
"""CIE XYZ to linear sRGB: the inverse in full precision, as the standard's rounded one misses (1, 1, 1) for white."""
LUMINANCE: Array = XYZ_FROM_SRGB[1]
"""Luminance of each linear sRGB primary: Y = LUMINANCE @ rgb."""

WHITE_RANGE = (1000.0, 25000.0)
"""Temperatures that `chromatic_adaptation` accepts [K]."""

# CAT16: XYZ to sharpened cone responses (Li et al. 2017).
_CAT16: Array = np.array(
    [[0.401288, 0.650173, -0.051461], [-0.250268, 1.204414, 0.045854], [-0.002079, 0.048952, 0.953127]]
)


@cache
def _observer() -> tuple[Array, Array]:
    """Return the wavelengths [m], shape (m,), and, shape (m, 3), what turns 1 / (exp(x) - 1) into XYZ [cd/m^2].

    That is K_m * c1L lambda^-5 * cmf * d lambda, with the trapezoidal rule's half weight at both ends.
    """
    rows = np.loadtxt(Path(__file__).with_name("cie1931.csv"), delimiter=",", comments="#")
    wavelength = rows[:, 0] * 1e-9
    weight = np.gradient(wavelength)
    weight[[0, -1]] *= 0.5
    return wavelength, (K_M * C1L * wavelength**-5 * weight)[:, None] * rows[:, 1:]


def _temperatures(T: ArrayLike, *, low: float = 0.0, high: float = np.inf, inclusive: bool = True) -> Array:
    """Return `T` as float64, or raise `InputError` naming the first value that is not finite and in range."""
    T = np.asarray(T, dtype=np.float64)
    above = low <= T if inclusive else low < T
    bad = ~(np.isfinite(T) & above & (high >= T))
    if np.any(bad):
        floor = f"{'at least' if inclusive else 'above'} {low:g} K"
        ceiling = "" if np.isinf(high) else f" and at most {high:g} K"
        raise InputError(f"temperature T = {T[bad].flat[0]:g} K is not allowed (finite, {floor}{ceiling})")
    return T


def radiance_to_xyz(T: ArrayLike) -> Array:
    """Return the absolute CIE 1931 XYZ of a black body [cd/m^2]; Y is its luminance.

    `T` [K], shape (...), any finite T > 0; the result has shape (..., 3). It is 0 where the radiance underflows.
    Planck's law L(lambda) = c1L lambda^-5 / (exp(c2 / (lambda T)) - 1) is integrated with the colour matching
    functions (XYZ = 683 lm/W * integral of L * cmf, CIE 015:2018) by the trapezoidal rule at 5 nm. Against
    1 nm that is 1e-6 in Y above 1000 K and 1e-4 at 500 K. One call costs 95 exponentials per temperature: particles
    use `BlackbodyTable`.

    Raises `InputError` for a T that is not finite or not positive.
    """
    T = _temperatures(T, inclusive=False)
    wavelength, response = _observer()
    with np.errstate(all="ignore"):  # over- and underflow at the extremes end in the right 0 or inf
        x = C2 / (wavelength * T[..., None])
        # 1 / (exp(x) - 1) = exp(-x) / (1 - exp(-x)), which cannot overflow for a cold body.
        return (np.exp(-x) / -np.expm1(-x)) @ response


def linear_srgb(T: ArrayLike, *, white: float | None = None) -> Array:
    """Return a black body's colour in linear sRGB primaries [cd/m^2], not clipped: blue is negative below 1900 K.

    `T` [K], shape (...), gives shape (..., 3); `LUMINANCE @ rgb` is the luminance. `white` [K] adapts the colour by
    `chromatic_adaptation(white)`; None leaves it relative to D65. Matrix: IEC 61966-2-1.

    Raises `InputError` for a T that is not finite or not positive, or a `white` outside 1000..25000 K.
    """
    rgb = radiance_to_xyz(T) @ SRGB_FROM_XYZ.T
    return rgb if white is None else rgb @ chromatic_adaptation(white).T


def chromatic_adaptation(source_white_K: float) -> Array:
    """Return the matrix, shape (3, 3), on linear sRGB that makes a black body at `source_white_K` [K] look white.

    Its chromaticity becomes that of D65 and its luminance stays. Full von Kries adaptation in CAT16 (Li, Li, Wang, Xu,
    Luo, Cui, Melgosa, Brill, Pointer 2017, "Comprehensive color solutions: CAM16, CAT16, and CAM16-UCS"). CAT16 and
    not Bradford: an ember's short-wave response nearly vanishes in Bradford, which makes its gains extreme.

    The white lies on the Planckian locus at every temperature, never on the CIE daylight locus. A black body of
    6504 K is therefore not quite D65, which lies 0.003 above the locus in CIE 1960 uv: its matrix differs from the
    identity by at most 0.029 in any entry and moves no channel of the D65 white by more than 0.043.

    Raises `InputError` outside 1000..25000 K.
    """
    low, high = WHITE_RANGE
    T = _temperatures(source_white_K, low=low, high=high)
    if T.ndim != 0:
        raise InputError(f"source_white_K must be one temperature [K], not an array of shape {T.shape}")
    xyz = radiance_to_xyz(T)
    source = _CAT16 @ (xyz / xyz[1])
    target = _CAT16 @ XYZ_FROM_SRGB.sum(axis=1)
    adapt_xyz = np.linalg.solve(_CAT16, (target / source)[:, None] * _CAT16)
    return SRGB_FROM_XYZ @ adapt_xyz @ XYZ_FROM_SRGB


@dataclass(frozen=True, eq=False)
class BlackbodyTable:
    """Colour of a black body over temperature, small and smooth enough to interpolate in float32 in a kernel.

    `values`, shape (n, 4), is read-only and uniform in u = 1/T: row 0 is `T_MAX`, row n-1 is `T_MIN`. Column 0 is
    ln Y [ln cd/m^2], nearly a straight line in 1/T (Wien); columns 1..3 are linear sRGB / Y, adapted if asked for;
    Y is the luminance before adaptation. At n = 512 linear interpolation is off by less than 2e-4 in luminance
    and 2.1e-5 in chromaticity (6e-5 under a white of 1000 K).

    A kernel does: s = (1/T - `u_min`) * `steps_per_u`; i = min(int(s), n-2); w = s - i; row = mix(values[i],
    values[i+1], w); rgb = exp(row[0]) * row[1:4].
    """

    values: Array

    T_MIN: ClassVar[float] = 500.0
    """Coldest temperature in the table [K]. Its luminance is 5e-10 cd/m^2; a colder body is taken as black."""
    T_MAX: ClassVar[float] = 12000.0
    """Hottest temperature in the table [K]; hotter bodies look like this one."""

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=np.float64)
        if values.ndim != 2 or values.shape[0] < 2 or values.shape[1] != 4 or not np.all(np.isfinite(values)):
            raise InputError(f"values must be finite with shape (n >= 2, 4), not {values.shape}")
        values.flags.writeable = False
        object.__setattr__(self, "values", values)

    @classmethod
    def build(cls, *, n: int = 512, adaptation: ArrayLike | None = None) -> BlackbodyTable:
        """Tabulate `n` temperatures; `adaptation`, shape (3, 3), is applied to the linear sRGB.

        Raises `InputError` if n < 2 or `adaptation` is not a finite 3 x 3 matrix.
        """
        if n < 2:
            raise InputError(f"n = {n} is not allowed (at least 2 table rows)")
        matrix = np.eye(3) if adaptation is None else np.asarray(adaptation, dtype=np.float64)
        if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
            raise InputError(f"adaptation must be a finite matrix of shape (3, 3), not of shape {matrix.shape}")
        T = 1.0 / np.linspace(1.0 / cls.T_MAX, 1.0 / cls.T_MIN, n)
        xyz = radiance_to_xyz(T)
        Y = xyz[:, 1:2]
        rgb = (xyz / Y) @ (matrix @ SRGB_FROM_XYZ).T
        return cls(np.hstack([np.log(Y), rgb]))

    @property
    def n(self) -> int:
        """Number of rows."""
        return self.values.shape[0]

    @property
    def u_min(self) -> float:
        """Reciprocal temperature of row 0, 1 / T_MAX [1/K]."""
        return 1.0 / self.T_MAX

    @property
    def steps_per_u(self) -> float:
        """Rows per unit of reciprocal temperature [K]."""
        return (self.n - 1) / (1.0 / self.T_MIN - 1.0 / self.T_MAX)

    def lookup(self, T: ArrayLike, *, dtype: type[np.floating[Any]] = np.float64) -> NDArray[np.floating[Any]]:
        """Return linear sRGB [cd/m^2], shape (..., 3), for `T` [K], shape (...), as a kernel does it in `dtype`.

        Below `T_MIN` it is 0; above `T_MAX` it stays at the colour of `T_MAX`.
        Raises `InputError` for a T that is not finite or negative.
        """
        T = _temperatures(T)
        values = self.values.astype(dtype)
        clamped = np.clip(T, self.T_MIN, self.T_MAX).astype(dtype)
        s = np.maximum((dtype(1) / clamped - dtype(self.u_min)) * dtype(self.steps_per_u), dtype(0))
        i = np.minimum(s.astype(np.int64), self.n - 2)
        w = (s - i.astype(dtype))[..., None]
        row = values[i] + w * (values[i + 1] - values[i])
        rgb = np.exp(row[..., :1]) * row[..., 1:]
        return np.where((T >= self.T_MIN)[..., None], rgb, dtype(0))
