"""The built-in explicit Runge-Kutta methods: a few lines of numbers each, with their source."""

from __future__ import annotations

from fractions import Fraction

from tparticles.errors import InputError
from tparticles.schemes.exact import Number, shown
from tparticles.schemes.lazy import Lazy, named
from tparticles.schemes.program import Scheme
from tparticles.schemes.runge_kutta import runge_kutta

F = Fraction
_TWO_THIRDS = F(2, 3)


def modified_euler(alpha: Number = _TWO_THIRDS, *, name: str = "modified-euler") -> Scheme:
    """Return Bridson's modified Euler: z = z0 + dt ((1 - alpha) f(z0) + alpha f(z0 + dt f(z0))).

    `alpha` from 1/2 (Heun, order 2) to 1 trades stability on the real axis, 1/alpha, for stability on the imaginary axis,
    sqrt(2 alpha - 1) / alpha.
    Raises InputError if `alpha` is not a number from 0.5 to 1.
    Source: Bridson, CS533D lecture notes (2005), slides 24-25.
    """
    if not isinstance(alpha, int | float | Fraction) or isinstance(alpha, bool) or not 0.5 <= alpha <= 1:
        raise InputError(f"scheme '{name}': alpha must be a number from 0.5 to 1, not {shown(alpha)}")
    reference = "R. Bridson, CS533D Animation Physics, lecture notes (2005), slides 24-25"
    return runge_kutta([[], [1]], [1 - alpha, alpha], name=name, reference=reference)


_dormand_prince = [F(35, 384), 0, F(500, 1113), F(125, 192), F(-2187, 6784), F(11, 84), 0]

EXPLICIT = Lazy(
    named(
        "euler",
        runge_kutta,
        [[]],
        [1],
        order=1,
        reference="L. Euler, Institutionum calculi integralis I (1768), section 650",
    ),
    named(
        "midpoint",
        runge_kutta,
        [[], [F(1, 2)]],
        [0, 1],
        order=2,
        reference="C. Runge, Über die numerische Auflösung von Differentialgleichungen, Math. Ann. 46 (1895)",
    ),
    named(
        "heun",
        runge_kutta,
        [[], [1]],
        [F(1, 2), F(1, 2)],
        order=2,
        reference="K. Heun, Neue Methode zur approximativen Integration der Differentialgleichungen, Z. Math. Phys. 45 (1900)",
    ),
    named("modified-euler", modified_euler),
    named(
        "rk3",
        runge_kutta,
        [[], [F(1, 2)], [-1, 2]],
        [F(1, 6), F(2, 3), F(1, 6)],
        order=3,
        reference="W. Kutta, Beitrag zur näherungsweisen Integration totaler Differentialgleichungen, "
        "Z. Math. Phys. 46 (1901)",
    ),
    named(
        "tvd-rk3",
        runge_kutta,
        [[], [1], [F(1, 4), F(1, 4)]],
        [F(1, 6), F(1, 6), F(2, 3)],
        order=3,
        reference="C.-W. Shu, S. Osher, Efficient implementation of essentially non-oscillatory shock-capturing schemes, "
        "J. Comput. Phys. 77 (1988)",
    ),
    named(
        "rk4",
        runge_kutta,
        [[], [F(1, 2)], [0, F(1, 2)], [0, 0, 1]],
        [F(1, 6), F(1, 3), F(1, 3), F(1, 6)],
        order=4,
        reference="W. Kutta, Beitrag zur näherungsweisen Integration totaler Differentialgleichungen, "
        "Z. Math. Phys. 46 (1901)",
    ),
    named(
        "bogacki-shampine",
        runge_kutta,
        [[], [F(1, 2)], [0, F(3, 4)], [F(2, 9), F(1, 3), F(4, 9), 0]],
        [F(2, 9), F(1, 3), F(4, 9), 0],
        b_embedded=[F(7, 24), F(1, 4), F(1, 3), F(1, 8)],
        order=3,
        reference="P. Bogacki, L. F. Shampine, A 3(2) pair of Runge-Kutta formulas, Appl. Math. Lett. 2 (1989)",
    ),
    named(
        "dormand-prince",
        runge_kutta,
        [
            [],
            [F(1, 5)],
            [F(3, 40), F(9, 40)],
            [F(44, 45), F(-56, 15), F(32, 9)],
            [F(19372, 6561), F(-25360, 2187), F(64448, 6561), F(-212, 729)],
            [F(9017, 3168), F(-355, 33), F(46732, 5247), F(49, 176), F(-5103, 18656)],
            _dormand_prince,
        ],
        _dormand_prince,
        b_embedded=[F(5179, 57600), 0, F(7571, 16695), F(393, 640), F(-92097, 339200), F(187, 2100), F(1, 40)],
        order=5,
        reference="J. R. Dormand, P. J. Prince, A family of embedded Runge-Kutta formulae, J. Comput. Appl. Math. 6 (1980)",
    ),
)
