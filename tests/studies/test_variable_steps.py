"""Wright's effect: the numbers of the literature, the matrices against the schemes, and the engine."""

import cmath
import math

import numpy as np
import pytest

from tparticles import schemes
from tparticles.schemes import integrate, oscillator_limit
from tparticles.studies import variable_steps
from tparticles.studies.linear_maps import pair_growth, step_matrices

SCHEMES = tuple(schemes.CATALOGUE.values())
VERLET = schemes.get("velocity-verlet")


@pytest.mark.parametrize("zeta", [0.0, 0.2])
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_equal_steps_grow_as_the_characteristic_polynomial_says(scheme, zeta):
    h = np.array([0.1, 0.5, 1.3])
    radius = np.abs(np.linalg.eigvals(step_matrices(scheme, h, np.ones(3), zeta=zeta))).max(axis=1)
    root = complex(-zeta, math.sqrt(1 - zeta**2))
    np.testing.assert_allclose(radius, [scheme.stability.amplification(x * root) for x in h], rtol=1e-6)


@pytest.mark.parametrize("name", ["velocity-verlet", "rk4", "ab2", "abm2", "bdf2", "crenshaw", "ab3"])
def test_unequal_steps_do_what_the_interpreter_does(name):
    scheme, pairs = schemes.get(name), 200

    def f(t, z):
        return np.stack([z[1], -z[0]])

    # ten steps to the turn, where everything is bounded or grows slowly
    first, second = (0.3, 0.5)
    states = integrate(scheme, f, 0.0, np.eye(2)[:, None, :], [first, second] * pairs)[::2]
    sizes = np.array([np.sqrt((z**2).sum()) for z in states])
    growth = (sizes[-1] / sizes[pairs // 2]) ** (2 / pairs)
    computed = pair_growth(scheme, np.array([first]), np.array([second]))[0]
    assert growth == pytest.approx(computed, abs=0.003)


def test_alternating_steps_of_verlet_grow_by_the_known_factor():
    assert pair_growth(VERLET, np.array([1.35]), np.array([1.47]))[0] == pytest.approx(1.087, abs=5e-4)
    assert oscillator_limit(VERLET) == pytest.approx(2)


def test_a_frame_split_60_to_40_blows_verlet_up_between_2_58_and_3_16():
    (clamp,) = variable_steps.study([VERLET], width=4, height=4, engine=False).clamps
    frame, split = np.array(clamp.omega_frame), np.array(clamp.split)
    grows = frame[split > 1 + 1e-6]
    assert grows[0] == pytest.approx(2.58, abs=0.01)
    assert grows[-1] == pytest.approx(3.16, abs=0.01)
    assert max(clamp.halved) <= 1 + 1e-6


# Those with a stable step on the undamped oscillator.
ONE_STEP = [s for s in SCHEMES if s.one_step and 1 in s.system_orders and s.imaginary_limit > 0]


@pytest.mark.parametrize("scheme", ONE_STEP, ids=lambda s: s.name)
def test_one_step_methods_of_one_matrix_function_are_immune(scheme):
    # Their steps commute: R(i h1) R(i h2)
    (found,) = variable_steps.study([scheme], width=12, height=8, engine=False).maps
    assert not found.affected
    h1, h2 = 0.7 * min(found.limit, 3), 0.2 * min(found.limit, 3)
    expected = scheme.stability.amplification(1j * h1) * scheme.stability.amplification(1j * h2)
    assert pair_growth(scheme, np.array([h1]), np.array([h2]))[0] == pytest.approx(expected, rel=1e-9)


def test_splittings_are_affected_and_say_where():
    chosen = [
        schemes.get(name) for name in ("symplectic-euler", "velocity-verlet", "position-verlet", "beeman", "euler")
    ]
    result = variable_steps.study(chosen, width=20, height=12, engine=False)
    assert result.without == ("euler",)
    assert [m.scheme for m in result.maps] == [s.name for s in chosen[:-1]]
    for m in result.maps:
        assert m.affected and m.worst > 1.5
        assert max(m.at) < m.limit and max(m.omega_dt) < m.limit
    # an equal-step method restarts at every change, and is its starter
    assert result.maps[3].restarts and result.maps[3].growth[:-1] == result.maps[1].growth[:-1]
    assert len(result.rows()) == 4 * 20 * 12


@pytest.fixture(scope="module")
def swinging(cpu64):
    return variable_steps.swinging()


@pytest.mark.parametrize("case", variable_steps.CHECKS[:3], ids=lambda c: f"{c[0].name}, {c[3]}, {c[1]:.3g}")
def test_the_engine_grows_as_computed(swinging, case):
    found = variable_steps.check(swinging, *case)
    assert found.measured == pytest.approx(found.computed, rel=1e-4)
    assert (found.measured > 1.08) == (case[0] is VERLET)


def test_damping_ratios_move_the_limit():
    (m,) = variable_steps.study([VERLET], zeta=0.3, width=4, height=4, engine=False).maps
    assert m.limit == oscillator_limit(VERLET, 0.3)
    assert cmath.isfinite(m.worst)
