"""The order study: slopes near the declared order, of the interpreter for every scheme and of the engine for two kernels."""

import math

import numpy as np
import pytest

from tparticles import schemes
from tparticles.studies import order
from tparticles.studies.ensemble import applicable, interpreted
from tparticles.studies.order import PROBLEMS
from tparticles.studies.problems import Shaken

SCHEMES = tuple(schemes.CATALOGUE.values())
# Implicit ones cost the interpreter milliseconds a step: few particles, and no more steps than the fit needs.
_LONG = {1: 6, 2: 7, 3: 8, 4: 9, 5: 6, 8: 4}


def check(curve):
    assert curve.slope == pytest.approx(curve.declared, abs=0.1), curve


EXPLICIT = [(s, p) for s in SCHEMES for p in PROBLEMS if not s.implicit and applicable(p, s)]


@pytest.mark.parametrize(("scheme", "problem"), EXPLICIT, ids=[f"{s.name}, {p.name}" for s, p in EXPLICIT])
def test_every_explicit_scheme_has_its_order(scheme, problem):
    last = _LONG[scheme.order]
    first = 2 if scheme.order < 8 else 0
    found = order.study(
        [scheme], problems=[problem], steps=[2**k for k in range(first, last + 1)], count=2, engine=False
    )
    check(found.curves[0])


@pytest.mark.parametrize("scheme", [s for s in SCHEMES if s.implicit], ids=lambda s: s.name)
def test_every_implicit_scheme_has_its_order(scheme):
    steps = [8, 16, 32] if scheme.order > 1 else [16, 32, 64]
    found = order.study([scheme], problems=[PROBLEMS[0]], steps=steps, count=1, engine=False)
    check(found.curves[0])


def test_the_engine_has_the_same_errors(cpu64):
    # One kernel for Runge-Kutta methods, one for splittings.
    chosen = [
        schemes.get(name) for name in ("euler", "midpoint", "rk3", "tvd-rk3", "rk4", "velocity-verlet", "yoshida4")
    ]
    settings = {"problems": [Shaken()], "steps": [4, 8, 16, 32, 64], "count": 4}
    found = order.study(chosen, **settings)
    assert [c.scheme for c in found.curves] == [s.name for s in chosen]
    for curve, other in zip(found.curves, order.study(chosen, **settings, engine=False).curves, strict=True):
        check(curve)
        np.testing.assert_allclose(curve.error, other.error, rtol=1e-3)
    rows = found.rows()
    assert len(rows) == 5 * len(chosen)
    assert set(rows[0]) == {"problem", "scheme", "declared", "slope", "dt", "error", "evaluations"}
    assert rows[4]["evaluations"] == 8 * 64


def test_applicable_is_what_keeps_the_declared_order():
    flow, free, rubbing = PROBLEMS
    verlet, yoshida, rk4 = (schemes.get(name) for name in ("velocity-verlet", "yoshida4", "rk4"))
    assert [applicable(p, rk4) for p in PROBLEMS] == [True, True, True]
    assert [applicable(p, verlet) for p in PROBLEMS] == [False, True, True]
    assert [applicable(p, yoshida) for p in (flow, free, rubbing)] == [False, True, False]


def test_the_interpreter_starts_from_the_given_states():
    problem = Shaken()
    start = problem.start(3)
    states = interpreted(problem, start, schemes.get("rk4"), [0.0, 0.1, 0.2], 0.01)
    np.testing.assert_array_equal(states[0], start)
    np.testing.assert_allclose(states[2], problem.solution(0.2, start), atol=1e-9)


def test_fits_use_the_finest_points_above_rounding():
    dt = [2.0**-k for k in range(8)]
    errors = [math.inf, 1.0, *(0.02 * h**3 for h in dt[2:6]), 1e-14, 3e-14]
    slope, used = order.fit(dt, errors, 1e-12)
    assert slope == pytest.approx(3)
    assert used == (3, 5)
    assert order.fit(dt, [math.nan] * 8, 1e-12)[1] == (-1, -1)
    assert math.isnan(order.fit(dt, [1.0] * 8, 1e-12)[0])
