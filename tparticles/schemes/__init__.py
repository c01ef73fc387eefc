"""Integration schemes as data: frozen values whose order and stability follow from their coefficients."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from tparticles.errors import InputError, unknown
from tparticles.schemes.analysis import Stability
from tparticles.schemes.catalogue import SCHEMES
from tparticles.schemes.exact import shown
from tparticles.schemes.program import Op, OpKind, Scheme, step
from tparticles.schemes.runge_kutta import runge_kutta

__all__ = ["CATALOGUE", "Op", "OpKind", "Scheme", "Stability", "describe", "get", "runge_kutta", "step"]

CATALOGUE: Mapping[str, Scheme] = MappingProxyType({scheme.name: scheme for scheme in SCHEMES})


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
