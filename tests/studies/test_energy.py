"""The energy study on the engine: what keeps the energy, what loses it and how fast, what blows up."""

import math

import numpy as np
import pytest

from tparticles import schemes
from tparticles.studies import energy

pytestmark = pytest.mark.usefixtures("cpu64")
PERIODS, STEPS = 2000, 40
NAMES = ("euler", "rk4", "tvd-rk3", "symplectic-euler", "velocity-verlet", "position-verlet", "yoshida4")
SYMPLECTIC = NAMES[3:]


@pytest.fixture(scope="module")
def result(cpu64):
    return energy.study([schemes.get(name) for name in NAMES], periods=PERIODS, steps=STEPS, samples=100)


def drift(result, name, problem=0):
    return next(d for d in result.drifts if (d.scheme, d.problem) == (name, energy.PROBLEMS[problem]))


@pytest.mark.parametrize("problem", range(3))
@pytest.mark.parametrize("name", SYMPLECTIC)
def test_symplectic_schemes_keep_the_energy_bounded(result, name, problem):
    found = drift(result, name, problem)
    assert found.verdict == "bounded"
    assert found.largest < {"symplectic-euler": 0.25, "yoshida4": 5e-4}.get(name, 0.02)
    assert len(found.periods) == len(found.energy) == len(found.spread) == len(found.phase)
    assert found.periods[-1] == PERIODS


@pytest.mark.parametrize("name", ["rk4", "tvd-rk3", "euler"])
def test_the_oscillator_s_energy_changes_at_the_theoretical_rate(result, name):
    y = 2 * math.pi / STEPS
    # |R(iy)|^2: Euler 1 + y^2; RK3 1 - y^4/12 + y^6/36; RK4 1 - y^6/72 + y^8/576
    expected = {"euler": y**2, "tvd-rk3": -(y**4) / 12 + y**6 / 36, "rk4": -(y**6) / 72 + y**8 / 576}[name]
    found = drift(result, name)
    assert found.factor - 1 == pytest.approx(expected, rel=1e-6)
    assert found.theory - 1 == pytest.approx(expected, rel=1e-6)
    assert found.verdict == ("blows up" if name == "euler" else "decays")


def test_euler_grows_exactly_until_it_has_blown_up(result):
    found = drift(result, "euler")
    y = 2 * math.pi / STEPS
    np.testing.assert_allclose(found.energy, (1 + y**2) ** (STEPS * np.array(found.periods)), rtol=1e-9)
    assert found.energy[-1] > 1e6 > found.energy[-2]


@pytest.mark.parametrize(
    ("name", "per_radian"),
    # The leading term of the phase error: Verlet's frequency is omega (1 + y^2/24), RK4's omega (1 - y^4/120)
    [("velocity-verlet", 1 / 24), ("position-verlet", 1 / 24), ("rk4", -1 / 120)],
)
def test_the_phase_of_the_oscillator_runs_at_the_theoretical_rate(result, name, per_radian):
    y = 2 * math.pi / STEPS
    power = 4 if name == "rk4" else 2
    assert drift(result, name).phase[-1] == pytest.approx(PERIODS * per_radian * y**power, rel=0.02)


def test_a_pendulum_that_loses_energy_swings_faster(result):
    assert drift(result, "rk4", 1).verdict == "decays"
    assert drift(result, "rk4", 1).phase[-1] > 0


def test_rows_are_the_samples(result):
    rows = result.rows()
    assert len(rows) == sum(len(d.periods) for d in result.drifts)
    assert set(rows[0]) == {"problem", "scheme", "verdict", "period", "energy", "spread", "phase"}


def test_long_intervals_do_not_hide_whole_turns():
    t = np.array([0.0, 1.0, 5.0, 50.0])
    turns = np.array([0.0, 1.004, 5.02, 50.2])
    lead = energy._lead(t, (turns % 1)[:, None], np.full((4, 1), 1.003))
    np.testing.assert_allclose(lead, turns - t, atol=1e-12)
