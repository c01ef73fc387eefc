"""Hard problems in the fused stepper: stiff forcing, an eccentric orbit, chaos."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tparticles import schemes
from tparticles.stepping.control import ErrorControl
from tparticles.studies.ensemble import Ensemble
from tparticles.studies.periodic import Kepler
from tparticles.studies.problems import ProtheroRobinson, Tracers

pytestmark = pytest.mark.usefixtures("cpu64")

STIFFNESS = 1e6
TURNS = 100


@pytest.fixture(scope="module")
def forced(cpu64):
    """A stiff decay that starts on the slow solution, and one that starts 1 away from it."""
    return Ensemble(
        ProtheroRobinson(stiffness=STIFFNESS), ProtheroRobinson().start(2) + np.arange(2.0), share=False, lanes=1
    )


SLOW, TRANSIENT = 0, 1


def errors(bench, name, which, steps, end=1.0):
    exact = bench.problem.solution(end, bench.start)
    found = [bench.run(schemes.get(name), [end], end / n).states[0] for n in steps]
    return [np.abs(z - exact)[:, which].max() for z in found]


def orders(found, steps):
    return np.log(np.array(found[:-1]) / found[1:]) / np.log(np.array(steps[1:]) / steps[:-1])


def test_the_trapezoidal_rule_loses_its_order_to_a_fast_transient(forced):
    # R = (1 - z/2) / (1 + z/2) = -1 + 4/z of a step with z = 1e6 dt >> 1: after n steps |R|^n of the transient is left.
    steps = (20, 40, 80, 160)
    found = errors(forced, "trapezoidal", TRANSIENT, steps)
    left = [abs((1 - STIFFNESS / n / 2) / (1 + STIFFNESS / n / 2)) ** n for n in steps]
    np.testing.assert_allclose(found, left, rtol=1e-3)
    assert orders(found, steps).max() < 0.2
    # where the transient is resolved, dt = 1e-7, the order is there
    found = errors(forced, "trapezoidal", TRANSIENT, (20, 40, 80), end=1e-5)
    assert orders(found, (20, 40, 80))[-1] == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("name", ["backward-euler", "bdf2", "sdirk2", "sdirk3", "tr-bdf2"])
def test_l_stable_schemes_damp_the_transient(forced, name):
    assert errors(forced, name, TRANSIENT, (20,))[0] < 1e-6


@pytest.mark.parametrize(
    ("name", "stage_order"), [("backward-euler", 1), ("sdirk2", 1), ("sdirk3", 1), ("tr-bdf2", 2), ("bdf2", 2)]
)
def test_stage_order_rules_on_the_slow_solution(forced, name, stage_order):
    # Hairer and Wanner II, IV.15: the error of stiffly accurate schemes is dt^q / stiffness, q the stage order, not the order.
    steps = (10, 20, 40, 80)
    found = errors(forced, name, SLOW, steps)
    assert orders(found, steps)[-1] == pytest.approx(stage_order, abs=0.2), found
    assert found[0] < 10 / STIFFNESS


@pytest.fixture(scope="module")
def orbit(cpu64):
    return Ensemble(Kepler(eccentricity=0.9), Kepler(eccentricity=0.9).start(1), share=False, lanes=1)


def test_error_control_beats_fixed_steps_on_an_eccentric_orbit(orbit):
    scheme, times = schemes.get("dormand-prince"), 2 * math.pi * np.arange(1, TURNS + 1)
    chosen = orbit.run(scheme, times, times[0], tolerance=ErrorControl(rtol=1e-11, atol=1e-11))
    tries = chosen.report.steps + chosen.report.rejected
    fixed = orbit.run(scheme, times, times[-1] / tries)
    assert fixed.report.steps >= tries
    exact = orbit.problem.solution(times[-1], orbit.start)
    np.testing.assert_allclose(exact, orbit.start, atol=1e-9)  # whole turns
    off = [np.abs(run.states[-1] - exact).max() for run in (chosen, fixed)]
    assert off[0] < 1e-3 and off[1] > 30 * off[0], off
    # at the pericentre r^1.5 is 83 times smaller than at the apocentre
    assert chosen.report.dt_max > 20 * chosen.report.dt_min


def energy_errors(orbit, name, steps_a_turn):
    # 7 states a turn, not always the same ones
    times = 2 * math.pi / 7.5 * np.arange(1, int(TURNS * 7.5) + 1)
    run = orbit.run(schemes.get(name), times, 2 * math.pi / steps_a_turn)
    start = orbit.problem.energy(orbit.start)[0]
    return np.abs([orbit.problem.energy(z)[0] / start - 1 for z in run.states])


@pytest.mark.parametrize("name", ["symplectic-euler", "velocity-verlet", "position-verlet", "yoshida4"])
def test_symplectic_schemes_keep_the_energy_of_an_eccentric_orbit_bounded(orbit, name):
    found = energy_errors(orbit, name, 2400)
    half = len(found) // 2
    assert found.max() < (0.6 if name == "symplectic-euler" else 0.03)
    assert found[half:].max() < 2 * found[:half].max()


@pytest.mark.parametrize("name", ["rk4", "rk3"])
def test_other_schemes_lose_energy_turn_by_turn(orbit, name):
    found = energy_errors(orbit, name, 1200)
    quarter = len(found) // 4
    assert found[-1] > 1.8 * found[quarter] > 0


@pytest.fixture(scope="module")
def tracers(cpu64):
    return Ensemble(Tracers(), Tracers().start(1024), share=False)


LYAPUNOV = 15.0  # [s], of the ABC flow's stock coefficients


@pytest.mark.parametrize("name", ["rk4", "dormand-prince"])
def test_abc_tracers_converge_over_the_first_lyapunov_time(tracers, name):
    few = tracers.start[:, :6]
    rate = lambda t, z: Tracers().rate(t, z.reshape(3, -1)).ravel()  # noqa: E731
    found = solve_ivp(rate, (0, LYAPUNOV), few.ravel(), method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1].reshape(3, -1)
    scheme, steps = schemes.get(name), (240, 480, 960)
    off = [np.abs(tracers.run(scheme, [LYAPUNOV], LYAPUNOV / n).states[0][:, :6] - found).max() for n in steps]
    assert scheme.order - 0.3 < orders(off, steps)[-1] < scheme.order + 0.6, off


def test_abc_tracers_keep_their_statistics_and_not_their_paths_later(tracers):
    end, scheme = 20 * LYAPUNOV, schemes.get("rk4")
    flow = tracers.problem.flow
    first, second = (tracers.run(scheme, [end], dt).states[0] for dt in (0.05, 0.04))
    # paths part
    apart = np.sqrt(((first - second) ** 2).sum(axis=0))
    assert (apart > 1.0).mean() > 0.2
    for z in (first, second):
        # A flow without divergence keeps a uniform crowd uniform: <u^2> = A^2 + B^2 + C^2, and all octants are alike.
        u2 = (tracers.problem.rate(end, z) ** 2).sum(axis=0)
        assert u2.mean() == pytest.approx(flow.A**2 + flow.B**2 + flow.C**2, abs=5 * u2.std() / 32)
        octant = ((z / flow.length) % 1 > 0.5).T @ [1, 2, 4]
        counts = np.bincount(octant, minlength=8)
        assert np.abs(counts - 128).max() < 5 * math.sqrt(128)
    # and both spread alike
    spreads = [np.mean((z - tracers.start) ** 2) for z in (first, second)]
    assert spreads[0] == pytest.approx(spreads[1], rel=0.2)
