"""The test problems: their solutions solve their equations, kernels compute what NumPy computes, elliptic functions are right."""

import math

import numpy as np
import pytest

from tparticles.errors import RunError
from tparticles.studies import elliptic
from tparticles.studies.ensemble import Ensemble
from tparticles.studies.order import PROBLEMS
from tparticles.studies.periodic import Damped, Kepler, Oscillator, Swings, pendulum_period
from tparticles.studies.problems import ProtheroRobinson, StiffDrag, Tracers, reference, spread

SWINGS = Swings.of_period_1(1.0, 2.0)
EXACT = (
    *PROBLEMS,
    Oscillator(omega=1.3),
    Damped(omega=1.3, zeta=0.2),
    SWINGS,
    Kepler(),
    Kepler(eccentricity=0.9),
    ProtheroRobinson(stiffness=3.0),
    StiffDrag(time=0.2),
)
by_problem = pytest.mark.parametrize("problem", EXACT, ids=repr)


@by_problem
def test_the_solution_starts_where_it_should_and_solves_the_equation(problem):
    z0 = problem.start(7)
    np.testing.assert_allclose(problem.solution(0.0, z0), z0, rtol=1e-12, atol=1e-12)
    h = 1e-3
    for t in (0.3, 1.1, 2.0):
        # a central difference of order 6
        z = {k: problem.solution(t + k * h, z0) for k in (-3, -2, -1, 1, 2, 3)}
        slope = (45 * (z[1] - z[-1]) - 9 * (z[2] - z[-2]) + (z[3] - z[-3])) / (60 * h)
        expected = problem.rate(t, problem.solution(t, z0))
        # Kepler's pericentre at e = 0.9 is sharp
        np.testing.assert_allclose(slope, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("problem", [*PROBLEMS, Kepler()], ids=repr)
def test_an_independent_integration_agrees(problem):
    z0 = problem.start(4)
    np.testing.assert_allclose(reference(problem, 2.0, z0), problem.solution(2.0, z0), rtol=1e-10, atol=1e-11)


def test_a_reference_that_does_not_settle_says_so():
    with pytest.raises(RunError, match="'abc' at t = 9 does not settle to 1e-12"):
        reference(Tracers(), 9.0, Tracers().start(1), most_steps=256)


@pytest.mark.parametrize(
    "problem", [PROBLEMS[0], PROBLEMS[2], SWINGS, Kepler(), StiffDrag(), Tracers()], ids=lambda p: p.name
)
def test_the_kernel_computes_the_same_right_hand_side(cpu64, problem):
    # One step of Euler is the right-hand side.
    from tparticles import schemes

    start, h = problem.start(5), 1e-3
    run = Ensemble(problem, start, lanes=1).run(schemes.get("euler"), [0.4 + h], h, t0=0.4)
    np.testing.assert_allclose((run.states[0] - start) / h, problem.rate(0.4, start), rtol=1e-9, atol=1e-10)
    assert run.report.steps == 5


def test_swings_have_period_1_and_their_phases_are_spread_over_it():
    z = SWINGS.at_phases((1.0, 1.0, 2.0), 8)
    phase, frequency = SWINGS.swing(z)
    np.testing.assert_allclose(frequency, 1, rtol=1e-12)
    # they start at rest, a quarter of a turn after the middle
    np.testing.assert_allclose((phase - 0.25) % 1 % 1, np.tile(np.arange(8) / 8, (3, 1)), atol=1e-9)
    np.testing.assert_allclose(SWINGS.energy(z), SWINGS.energy(z[:, :1]).repeat(8, axis=1), rtol=1e-12)
    np.testing.assert_allclose(SWINGS.solution(1.0, z), z, atol=1e-11)


def test_a_pendulum_over_the_top_has_no_phase():
    z = np.array([[0.0], [0.0], [0.0], [1.0], [20.0], [20.0]])
    phase, _ = SWINGS.swing(z)
    assert np.isfinite(phase[0]).all()
    assert np.isnan(phase[1:]).all()


def test_elliptic_integrals_of_the_handbook():
    # Abramowitz and Stegun, tables 17.1 and 17.5
    assert elliptic.complete(0.5) == pytest.approx(1.854074677301372, rel=1e-15)
    assert elliptic.complete(0.99) == pytest.approx(3.695637362989875, rel=1e-15)
    assert elliptic.incomplete(math.radians(30), math.sin(math.radians(60)) ** 2) == pytest.approx(0.54222911, abs=1e-8)
    assert pendulum_period(math.pi / 2) == pytest.approx(4 * 1.854074677301372, rel=1e-15)


@pytest.mark.parametrize("m", [0.0, 0.3, 0.9, 0.9999])
def test_elliptic_functions_undo_the_integral(m):
    u = np.linspace(-9, 9, 181)
    sn, cn, dn = elliptic.jacobi(u, m)
    np.testing.assert_allclose(sn**2 + cn**2, 1, atol=1e-14)
    np.testing.assert_allclose(m * sn**2 + dn**2, 1, atol=1e-14)
    phi = np.unwrap(np.arctan2(sn, cn))
    phi -= phi[90] - math.atan2(sn[90], cn[90])
    np.testing.assert_allclose(elliptic.incomplete(phi, m), u, rtol=1e-9, atol=1e-9)


def test_spread_points_fill_their_box():
    points = spread(500, (0, -1, 2), (1, 1, 3))
    assert points.shape == (3, 500)
    np.testing.assert_allclose(points.mean(axis=1), (0.5, 0, 2.5), atol=0.02)
    assert (points.min(axis=1) >= (0, -1, 2)).all() and (points.max(axis=1) <= (1, 1, 3)).all()
