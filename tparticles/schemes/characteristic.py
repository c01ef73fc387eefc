"""Stability of methods whose step multiplies the state by a matrix: multistep methods, and second-order splittings.

They answer as `Stability` does for one-step methods: real_limit, imaginary_limit, a_stable, l_stable, oscillator_limit(zeta),
amplification(z). Data are exact characteristic polynomials, made by `linear`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from tparticles.errors import InputError
from tparticles.schemes.exact import Number, is_finite, shown
from tparticles.schemes.roots import damped_direction, largest_root, on_ray, stable_until
from tparticles.schemes.stability import Stability

# Along the imaginary axis the factor of an A-stable method is 1 at most; deviations below this are rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class MultistepStability:
    """The characteristic polynomial of a multistep method on x' = lambda x, with z = dt lambda.

    `characteristic[j][i]`: coefficient of zeta^j z^i; solutions behave like zeta(z)^n.
    Raises InputError if that is not a tuple of at least 2 tuples of finite numbers.
    """

    characteristic: tuple[tuple[Number, ...], ...]

    def __post_init__(self) -> None:
        _check_rows(self.characteristic)

    def __call__(self, z: complex) -> float:
        """Return the largest |zeta|: the factor by which a step of dt multiplies solutions of x' = (z / dt) x in the end."""
        return largest_root([_value(row, z) for row in self.characteristic])

    def amplification(self, z: complex) -> float:
        """Return the largest |zeta(z)|."""
        return self(z)

    def oscillator_limit(self, zeta: float = 0.0) -> float:
        """Largest omega dt up to which x'' = -omega^2 x - 2 zeta omega x' stays bounded, zeta >= 0."""
        if zeta >= 1:
            return self.real_limit / (zeta + math.sqrt(zeta**2 - 1))
        return stable_until(on_ray(self.characteristic, damped_direction(zeta)))

    @cached_property
    def real_limit(self) -> float:
        """Largest r such that the root condition holds at z = -x for x on [0, r]."""
        return stable_until(on_ray(self.characteristic, -1))

    @cached_property
    def imaginary_limit(self) -> float:
        """Largest r such that the root condition holds at z = iy for y on [0, r]."""
        return stable_until(on_ray(self.characteristic, 1j))

    @cached_property
    def a_stable(self) -> bool:
        """Whether all solutions are bounded in the whole left half-plane.

        The largest |zeta| is subharmonic where the leading coefficient has no zero, so that the border decides.
        """
        lead = self.characteristic[-1]
        poles = np.roots([float(coefficient) for coefficient in reversed(lead)])
        widest = max(len(row) for row in self.characteristic)
        return bool(np.all(poles.real > 0)) and len(lead) == widest and self.imaginary_limit == math.inf

    @property
    def l_stable(self) -> bool:
        """Whether it is A-stable and every root vanishes at infinity."""
        *lower, lead = self.characteristic
        return all(len(row) < len(lead) for row in lower) and self.a_stable


@dataclass(frozen=True, kw_only=True)
class SplittingStability:
    """The characteristic polynomials of a method for x'' = a(x, v).

    `velocity[j][i]`: coefficient of zeta^j z^i on v' = z v / dt. `oscillator[j][i][l]`: coefficient of zeta^j p^i q^l on
    x'' = -omega^2 x - 2 zeta omega x', with p = (omega dt)^2 and q = 2 zeta omega dt.
    Raises InputError if they are not tuples of at least 2 rows of finite numbers.
    """

    velocity: tuple[tuple[Number, ...], ...]
    oscillator: tuple[tuple[tuple[Number, ...], ...], ...]

    def __post_init__(self) -> None:
        _check_rows(self.velocity)
        for rows in self.oscillator if isinstance(self.oscillator, tuple) else ((),):
            _check_rows(rows, least=1)

    def __call__(self, z: complex) -> float:
        """Return the largest factor of a step for real z on v' = (z / dt) v, else on the oscillator with z and its conjugate."""
        z = complex(z)
        if z.imag == 0:
            return largest_root([_value(row, z.real) for row in self.velocity])
        p, q = abs(z) ** 2, -2 * z.real
        return largest_root([_value([_value(row, q) for row in rows], p) for rows in self.oscillator])

    def amplification(self, z: complex) -> float:
        """Return the largest |zeta(z)|; z as for a call."""
        return self(z)

    def oscillator_limit(self, zeta: float = 0.0) -> float:
        """Largest omega dt up to which x'' = -omega^2 x - 2 zeta omega x' stays bounded, zeta >= 0."""
        if zeta == 1:
            zeta += 1e-9  # where the two roots are one the root condition, which asks for simple ones, says nothing
        size = max(2 * i + k for rows in self.oscillator for i, row in enumerate(rows) for k in range(len(row))) + 1
        P = np.zeros((len(self.oscillator), size), complex)
        for j, rows in enumerate(self.oscillator):
            for i, row in enumerate(rows):
                for k, coefficient in enumerate(row):
                    # p^i q^l = s^(2 i + l) (2 zeta)^l at s = omega dt
                    P[j, 2 * i + k] += float(coefficient) * (2 * zeta) ** k
        return stable_until(P)

    @cached_property
    def real_limit(self) -> float:
        """Largest r such that v' = -lambda v stays bounded for dt lambda on [0, r]."""
        return stable_until(on_ray(self.velocity, -1))

    @cached_property
    def imaginary_limit(self) -> float:
        """Largest r such that x'' = -omega^2 x stays bounded for omega dt on [0, r]."""
        return self.oscillator_limit()

    @cached_property
    def a_stable(self) -> bool:
        """Whether damped oscillators stay bounded at any step: on both axes and on a fan of directions between."""
        limits = (self.real_limit, *(self.oscillator_limit(zeta) for zeta in (0, 0.01, 0.1, 0.5, 0.9, 1, 2)))
        return all(limit == math.inf for limit in limits)

    @property
    def l_stable(self) -> bool:
        """Whether it is A-stable and its roots vanish at infinity."""
        return self.a_stable and self(-1e12) < _ROUNDING and self(1e12j) < _ROUNDING


AnyStability: TypeAlias = Stability | MultistepStability | SplittingStability


def _value(row: tuple[Number, ...] | list[complex], z: complex) -> complex:
    value = 0j
    for coefficient in reversed(row):
        value = value * z + (coefficient if isinstance(coefficient, complex) else float(coefficient))
    return value


def _check_rows(rows: object, least: int = 2) -> None:
    fits = isinstance(rows, tuple) and len(rows) >= least and all(isinstance(row, tuple) for row in rows)
    if not fits or not all(is_finite(entry) for row in rows for entry in row):  # type: ignore[union-attr]
        raise InputError(f"a characteristic polynomial needs tuples of finite coefficients, not {shown(rows)}")
