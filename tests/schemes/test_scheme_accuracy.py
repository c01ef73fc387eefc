"""Every scheme, built in or not, does what its coefficients promise: order, growth, limits."""

from __future__ import annotations

import cmath
import math
from fractions import Fraction

import numpy as np
import pytest
from scheme_samples import BY_NAME, SCHEMES, modified_euler, run, smooth_rhs, smooth_solution

from tparticles.schemes import step

F = Fraction

all_schemes = pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)


@all_schemes
def test_global_error_falls_with_the_declared_order(scheme):
    # Fine enough for the leading term, coarse enough for errors far above rounding.
    n, T = (256 if scheme.order <= 2 else 64 if scheme.order <= 4 else 32), 2.0
    errors = [
        np.abs(run(scheme, smooth_rhs, smooth_solution(0.0), T / steps, steps) - smooth_solution(T)).max()
        for steps in (n, 2 * n)
    ]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(scheme.order, abs=0.1)


@all_schemes
@pytest.mark.parametrize("z", [-0.5, 0.7j, -1.2 + 0.9j, 0.3 - 2j, -5.0])
def test_a_step_multiplies_by_the_stability_function(scheme, z):
    x = step(scheme, lambda _, x: z * x, 0.0, 1 + 0j, 1.0)
    assert cmath.isclose(x, scheme.stability(z), rel_tol=1e-12, abs_tol=1e-13)


def growth(scheme, direction: complex, reach: float, steps: int = 4000) -> float:
    """Return |x| after steps of x' = direction reach x, dt = 1, from 1; it stops early at 1e200."""
    rate = direction * reach
    x = 1 + 0j
    for _ in range(steps):
        x = step(scheme, lambda _, x: rate * x, 0.0, x, 1.0)
        if abs(x) > 1e200:
            break
    return abs(x)


@all_schemes
@pytest.mark.parametrize(("limit", "direction"), [("real_limit", -1), ("imaginary_limit", 1j)])
def test_its_own_limits_separate_bounded_from_growing(scheme, limit, direction):
    limit = getattr(scheme, limit)
    if limit == 0:
        # Unstable at any step, if only by y^8: measured where float64 can see it.
        for reach in (0.05, 0.3, 1.0):
            assert abs(scheme.stability(direction * reach)) >= 1
            assert_grows_at_the_computed_rate(scheme, direction, reach)
        assert growth(scheme, direction, 1.0) > 1.005
    else:
        assert growth(scheme, direction, 0.99 * limit) <= 1 + 1e-12
        assert growth(scheme, direction, 1.01 * limit) > 1.005
        assert_grows_at_the_computed_rate(scheme, direction, 1.01 * limit)


def assert_grows_at_the_computed_rate(scheme, direction, reach):
    steps = 200
    rate = abs(scheme.stability(direction * reach))
    assert math.log(growth(scheme, direction, reach, steps)) == pytest.approx(
        steps * math.log(rate), rel=1e-9, abs=1e-12
    )


@all_schemes
def test_every_smaller_step_is_stable_too(scheme):
    for limit, direction in ((scheme.real_limit, -1), (scheme.imaginary_limit, 1j)):
        inside = [abs(scheme.stability(direction * limit * k / 500)) for k in range(501)]
        assert max(inside) <= 1 + 1e-12


@pytest.mark.parametrize(
    ("name", "real", "imaginary"),
    [
        ("euler", 2, 0),
        ("midpoint", 2, 0),
        ("heun", 2, 0),
        ("rk4", 2.7852935634052816, 2.8284271247461903),
        ("modified-euler-2/3", 1.5, 0.8660254037844386),
        ("modified-euler-1", 1, 1),
        ("kutta-rk3", 2.5127453266, 1.7320508075688772),
        ("tvd-rk3", 2.5127453266, 1.7320508075688772),
        # Rounding errors in the table must not decide what happens near 0.
        ("irrational-rk2", 2, 0),
        ("ralston-rk4", 2.7852935634052816, 2.8284271247461903),
    ],
)
def test_stability_limits_of_the_literature(name, real, imaginary):
    assert BY_NAME[name].real_limit == pytest.approx(real, abs=1e-9)
    assert BY_NAME[name].imaginary_limit == pytest.approx(imaginary, abs=1e-9)


@pytest.mark.parametrize(("name", "evaluations", "order"), [("euler", 1, 1), ("midpoint", 2, 2), ("rk4", 4, 4)])
def test_built_in_traits(name, evaluations, order):
    scheme = BY_NAME[name]
    assert (scheme.evaluations, scheme.order) == (evaluations, order)
    assert not scheme.a_stable
    assert not scheme.l_stable
    assert scheme.reference


def test_long_euler_steps_on_decay_alternate_and_grow_tenfold():
    x, seen = 1.0, []
    for _ in range(5):
        seen.append(x)
        x = step(BY_NAME["euler"], lambda _, x: -x, 0.0, x, 11)
    assert seen == [1, -10, 100, -1000, 10000]


@pytest.mark.parametrize("w_dt", [1e-3, 0.1, 1.0])
def test_euler_spirals_out_of_a_rotation_at_the_known_rate(w_dt):
    z = run(BY_NAME["euler"], lambda _, z: np.array([-z[1], z[0]]), np.array([1.0, 0.0]), w_dt, 100)
    assert math.hypot(*z) == pytest.approx(math.sqrt(1 + w_dt**2) ** 100, rel=1e-12)


@pytest.mark.parametrize("theta", [F(1, 2), F(3, 5), F(2, 3), F(9, 10), 1])
def test_modified_euler_limits_in_closed_form(theta):
    # R = 1 + z + theta z^2: R(-x) = 1 at x = 1/theta, and |R(iy)|^2 - 1 = y^2 (1 - 2 theta + theta^2 y^2).
    scheme = modified_euler(theta)
    assert scheme.real_limit == pytest.approx(float(1 / F(theta)), abs=1e-12)
    assert scheme.imaginary_limit == pytest.approx(math.sqrt(2 * theta - 1) / theta, abs=1e-12)
