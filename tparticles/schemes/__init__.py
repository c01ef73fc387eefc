"""Integration schemes as data: frozen values whose order and stability follow from their coefficients."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from tparticles.errors import InputError, unknown
from tparticles.schemes.catalogue import SCHEMES
from tparticles.schemes.characteristic import AnyStability, MultistepStability, SplittingStability
from tparticles.schemes.doubling import doubled
from tparticles.schemes.exact import shown
from tparticles.schemes.interpreter import integrate, step
from tparticles.schemes.multistep import adams, bdf
from tparticles.schemes.one_step import modified_euler
from tparticles.schemes.program import Op, OpKind, Scheme
from tparticles.schemes.runge_kutta import runge_kutta
from tparticles.schemes.splitting import splitting
from tparticles.schemes.stability import Stability

__all__ = [
    "CATALOGUE",
    "AnyStability",
    "MultistepStability",
    "Op",
    "OpKind",
    "Scheme",
    "SplittingStability",
    "Stability",
    "adams",
    "bdf",
    "describe",
    "doubled",
    "get",
    "integrate",
    "modified_euler",
    "oscillator_limit",
    "runge_kutta",
    "splitting",
    "step",
]

CATALOGUE: Mapping[str, Scheme] = SCHEMES


def get(scheme: str | Scheme) -> Scheme:
    """Return the built-in scheme of that name; a Scheme is returned as it is.

    Raises InputError for an unknown name, with the known ones, and for anything that is neither.
    """
    if isinstance(scheme, Scheme):
        return scheme
    if not isinstance(scheme, str):
        raise InputError(f"a scheme is given by its name or as a Scheme, not {shown(scheme)}")
    if scheme not in CATALOGUE:
        raise unknown("scheme", scheme, CATALOGUE)
    return CATALOGUE[scheme]


def oscillator_limit(scheme: Scheme, zeta: float = 0.0) -> float:
    """Return the largest omega dt up to which x'' = -omega^2 x - 2 zeta omega x' stays bounded, infinity if it always does.

    `zeta`: damping ratio, 0 for an undamped oscillator, 1 for critical damping, larger beyond. 0.0 if every step grows.
    Raises InputError if `zeta` is not a finite number >= 0.
    """
    if not isinstance(zeta, int | float) or isinstance(zeta, bool) or not (math.isfinite(zeta) and zeta >= 0):
        raise InputError(f"scheme '{scheme.name}': zeta must be a finite number >= 0, not {shown(zeta)}")
    return scheme.stability.oscillator_limit(zeta)


def describe(scheme: Scheme) -> dict[str, Any]:
    """Return what is known about `scheme` in plain types: the fields of the machine-readable scheme list.

    Limits are in units of dt |lambda|; an unbounded one is `inf`.
    """
    return {
        "name": scheme.name,
        "order": scheme.order,
        "evaluations": scheme.evaluations,
        "real_limit": scheme.real_limit,
        "imaginary_limit": scheme.imaginary_limit,
        "a_stable": scheme.a_stable,
        "l_stable": scheme.l_stable,
        "needs": list(scheme.needs),
    }
