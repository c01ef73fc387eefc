"""The built-in implicit one-step methods, for stiff problems: one to three stages to solve for."""

from __future__ import annotations

import math
from fractions import Fraction

from tparticles.schemes.construct import Draft, scheme
from tparticles.schemes.lazy import Lazy, named
from tparticles.schemes.program import Op, OpKind, Scheme
from tparticles.schemes.runge_kutta import runge_kutta


def _semi_implicit_euler(*, name: str) -> Scheme:
    """z = z0 + (I - dt df/dz)^-1 dt f(t + dt, z0): one Newton step of backward Euler."""
    return scheme(
        Draft(ops=(Op(OpKind.SOLVE, weights=(1.0,), time=1.0, linear=True),), slopes=1),
        name=name,
        order=1,
        reference="R. Bridson, CS533D Animation Physics, lecture notes (2005), slide 37; "
        "D. Baraff, A. Witkin, Large Steps in Cloth Simulation, SIGGRAPH (1998), equation 5",
    )


_half = Fraction(1, 2)

_gamma2 = 1 - 1 / math.sqrt(2)

# The root of g^3 - 3 g^2 + 3/2 g - 1/6 between 1/6 and 1/2, for which R vanishes at infinity.
_gamma3 = 1 + math.sqrt(2) * math.cos(math.acos(2 * math.sqrt(2) / 3) / 3 - 2 * math.pi / 3)
_b1 = -(6 * _gamma3**2 - 16 * _gamma3 + 1) / 4
_b2 = (6 * _gamma3**2 - 20 * _gamma3 + 5) / 4

_d = 1 - 1 / math.sqrt(2)
_w = math.sqrt(2) / 4

IMPLICIT = Lazy(
    named(
        "backward-euler",
        runge_kutta,
        [[1]],
        [1],
        order=1,
        reference="E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.3",
    ),
    named("semi-implicit-euler", _semi_implicit_euler),
    named(
        "trapezoidal",
        runge_kutta,
        [[], [_half, _half]],
        [_half, _half],
        order=2,
        reference="G. Dahlquist, A special stability problem for linear multistep methods, BIT 3 (1963)",
    ),
    named(
        "implicit-midpoint",
        runge_kutta,
        [[_half]],
        [1],
        order=2,
        reference="E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section II.1",
    ),
    named(
        "sdirk2",
        runge_kutta,
        [[_gamma2], [1 - _gamma2, _gamma2]],
        [1 - _gamma2, _gamma2],
        order=2,
        reference="R. Alexander, Diagonally implicit Runge-Kutta methods for stiff ODEs, SIAM J. Numer. Anal. 14 (1977)",
    ),
    named(
        "sdirk3",
        runge_kutta,
        [[_gamma3], [(1 - _gamma3) / 2, _gamma3], [_b1, _b2, _gamma3]],
        [_b1, _b2, _gamma3],
        order=3,
        reference="R. Alexander, Diagonally implicit Runge-Kutta methods for stiff ODEs, SIAM J. Numer. Anal. 14 (1977)",
    ),
    named(
        "tr-bdf2",
        runge_kutta,
        [[], [_d, _d], [_w, _w, _d]],
        [_w, _w, _d],
        b_embedded=[(1 - _w) / 3, (3 * _w + 1) / 3, _d / 3],
        order=2,
        reference="R. E. Bank et al., IEEE Trans. Electron Devices 32 (1985); M. E. Hosea, L. F. Shampine, "
        "Analysis and implementation of TR-BDF2, Appl. Numer. Math. 20 (1996)",
    ),
)
