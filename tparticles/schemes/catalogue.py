"""The built-in schemes, in the order in which they are listed; each is built when it is first asked for."""

from __future__ import annotations

from fractions import Fraction

from tparticles.schemes.implicit import IMPLICIT
from tparticles.schemes.lazy import Lazy, named
from tparticles.schemes.multistep import adams, bdf, milne
from tparticles.schemes.one_step import EXPLICIT
from tparticles.schemes.splitting import CRENSHAW, SPLITTINGS

F = Fraction

_BASHFORTH = "F. Bashforth, J. C. Adams, An attempt to test the theories of capillary action (1883)"
_MOULTON = f"{_BASHFORTH}; F. R. Moulton, New Methods in Exterior Ballistics (1926)"
_SHAMPINE = f"{_MOULTON}; L. F. Shampine, M. K. Gordon, Computer Solution of Ordinary Differential Equations (1975)"
_GEAR = "C. W. Gear, Numerical Initial Value Problems in Ordinary Differential Equations (1971), section 11.1"
_GRIGORIEFF = f"{_GEAR}; with variable steps: R. D. Grigorieff, Numer. Math. 42 (1983)"
_MILNE = "W. E. Milne, Numerical integration of ordinary differential equations, Amer. Math. Monthly 33 (1926)"

_ab3 = [F(23, 12), F(-16, 12), F(5, 12)]
_ab4 = [F(55, 24), F(-59, 24), F(37, 24), F(-9, 24)]
_am4 = [F(9, 24), F(19, 24), F(-5, 24), F(1, 24)]
_am5 = [F(251, 720), F(646, 720), F(-264, 720), F(106, 720), F(-19, 720)]

MULTISTEP = Lazy(
    named("ab2", adams, [F(3, 2), F(-1, 2)], order=2, reference=_BASHFORTH),
    named("ab3", adams, _ab3, order=3, reference=_BASHFORTH),
    named("ab4", adams, _ab4, order=4, reference=_BASHFORTH),
    named("abm2", adams, [F(3, 2), F(-1, 2)], [F(1, 2), F(1, 2)], order=2, reference=_MOULTON),
    named("abm4", adams, _ab4, _am4, order=4, reference=_MOULTON),
    named("abm5-pec", adams, _ab4, _am5, mode="PEC", order=5, reference=_SHAMPINE),
    CRENSHAW,
    named("milne", milne, reference=_MILNE),
)

GEAR = Lazy(
    named("bdf2", bdf, 2, reference=_GRIGORIEFF),
    named("bdf3", bdf, 3, reference=_GEAR),
    named("bdf4", bdf, 4, reference=_GEAR),
)

# Gear's are listed with the implicit ones, in front of those of several stages.
_SINGLE, _SEVERAL = IMPLICIT.builders[:4], IMPLICIT.builders[4:]

SCHEMES = Lazy(*EXPLICIT.builders, *SPLITTINGS.builders, *MULTISTEP.builders, *_SINGLE, *GEAR.builders, *_SEVERAL)
