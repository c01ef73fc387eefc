"""The built-in schemes: a few lines of numbers each, with their source."""

from __future__ import annotations

from fractions import Fraction

from tparticles.schemes.runge_kutta import runge_kutta

_half, _third, _sixth = Fraction(1, 2), Fraction(1, 3), Fraction(1, 6)

EULER = runge_kutta(
    [[]],
    [1],
    name="euler",
    order=1,
    reference="L. Euler, Institutionum calculi integralis I (1768), section 650",
)

MIDPOINT = runge_kutta(
    [[], [_half]],
    [0, 1],
    name="midpoint",
    order=2,
    reference="C. Runge, Über die numerische Auflösung von Differentialgleichungen, Math. Ann. 46 (1895)",
)

RK4 = runge_kutta(
    [[], [_half], [0, _half], [0, 0, 1]],
    [_sixth, _third, _third, _sixth],
    name="rk4",
    order=4,
    reference="W. Kutta, Beitrag zur näherungsweisen Integration totaler Differentialgleichungen, "
    "Z. Math. Phys. 46 (1901)",
)

SCHEMES = (EULER, MIDPOINT, RK4)
