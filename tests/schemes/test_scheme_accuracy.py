"""Every scheme, built in or not, does what its coefficients promise: order, growth, limits."""

from __future__ import annotations

import cmath
import math
from fractions import Fraction

import numpy as np
import pytest
from scheme_samples import (
    BY_NAME,
    FIRST_ORDER,
    ONE_STEP_EXPLICIT,
    SCHEMES,
    growth,
    run,
    smooth_motion,
    smooth_rhs,
    smooth_solution,
    velocity_free_rhs,
    velocity_rhs,
)

from tparticles.errors import InputError
from tparticles.schemes import CATALOGUE, Stability, integrate, modified_euler, oscillator_limit, step
from tparticles.schemes.series import SECOND_ORDER as SECOND_ORDER_SYSTEM
from tparticles.schemes.series import VELOCITY_FREE as VELOCITY_FREE_SYSTEM
from tparticles.schemes.series import order_of

F = Fraction

all_schemes = pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)


def slope(scheme, f, solution, *, whole: bool) -> float:
    """Return by which power of dt the error falls: its largest on [0, 2] if `whole`, else its mean square on [1.5, 3]."""
    # Fine enough for the leading term, coarse enough for errors far above rounding.
    one_step, multistep = {1: 256, 2: 128, 3: 128, 4: 64, 8: 10}, {2: 128, 3: 256, 4: 256, 5: 256}
    n, T = (one_step if scheme.one_step else multistep).get(scheme.order, 96), (2.0 if whole else 3.0)
    n *= 1 + (scheme.name == "milne")
    errors = []
    for steps in (n, 2 * n):
        states = integrate(scheme, f, 0.0, solution(0.0), T / steps, steps)
        squares = [np.square(z - solution(T / steps * m)).sum() for m, z in enumerate(states)]
        errors.append(math.sqrt(max(squares) if whole else np.mean(squares[steps // 2 :])))
    return math.log2(errors[0] / errors[1])


@pytest.mark.parametrize("scheme", FIRST_ORDER, ids=lambda scheme: scheme.name)
def test_global_error_falls_with_the_declared_order(scheme):
    assert slope(scheme, smooth_rhs, smooth_solution, whole=not scheme.one_step) == pytest.approx(scheme.order, abs=0.1)


@all_schemes
def test_global_error_of_second_order_systems_falls_with_the_declared_order(scheme):
    # Damping excites Milne's root at -1, from starting errors of order 5 that hide the leading term for long.
    undamped = "velocity-free forces" in scheme.needs or scheme.name == "milne"
    f = velocity_free_rhs if undamped else velocity_rhs
    measured = slope(scheme, f, smooth_motion, whole=scheme.name == "milne")
    # an error of order 8 is down to rounding before its leading term rules alone
    assert measured == pytest.approx(scheme.order, abs=0.1 if scheme.order < 8 else 0.4)


@all_schemes
def test_order_by_trees_is_the_declared_one(scheme):
    if scheme.system_orders == {2}:
        needs = "velocity-free forces" in scheme.needs
        assert order_of(scheme, VELOCITY_FREE_SYSTEM) >= order_of(scheme, SECOND_ORDER_SYSTEM)
        assert order_of(scheme, VELOCITY_FREE_SYSTEM if needs else SECOND_ORDER_SYSTEM) == scheme.order
        assert needs == (order_of(scheme, SECOND_ORDER_SYSTEM) < scheme.order)
    else:
        assert order_of(scheme) == scheme.order
        assert order_of(scheme, SECOND_ORDER_SYSTEM) >= scheme.order


@pytest.mark.parametrize(
    "scheme", [scheme for scheme in FIRST_ORDER if scheme.one_step], ids=lambda scheme: scheme.name
)
@pytest.mark.parametrize("z", [-0.5, 0.7j, -1.2 + 0.9j, 0.3 - 2j, -5.0])
def test_a_step_multiplies_by_the_stability_function(scheme, z):
    x = step(scheme, lambda _, x: z * x, 0.0, 1 + 0j, 1.0)
    # Newton's Jacobians are differenced: good to 1e-10.
    accuracy = 1e-9 if scheme.implicit else 1e-12
    assert cmath.isclose(x, scheme.stability(z), rel_tol=accuracy, abs_tol=accuracy / 10)
    assert scheme.stability.amplification(z) == abs(scheme.stability(z))


@all_schemes
@pytest.mark.parametrize(("limit", "direction"), [("real_limit", -1), ("imaginary_limit", 1j)])
def test_its_own_limits_separate_bounded_from_growing(scheme, limit, direction):
    limit = getattr(scheme, limit)
    if limit == 0:
        # Unstable at any step, if only by y^8: measured where float64 can see it.
        # (Milne's is stable again from 0.3 to 0.8 on the real axis: Chase, J. ACM 9, 1962.)
        for reach in (0.05, 0.2, 1.0):
            assert scheme.stability.amplification(direction * reach) >= 1
        assert_grows_at_the_computed_rate(scheme, direction, 1.0)
    elif limit == math.inf:
        for reach in (0.3, 10.0, 1e4):
            assert growth(scheme, direction, reach, 100)[20:].max() <= 1 + 1e-6
    else:
        inside = growth(scheme, direction, 0.99 * limit)
        # Bounded: what the second half reaches the first has reached.
        assert inside[1000:].max() <= 1.01 * inside[:1000].max()
        assert inside.max() <= (1 + 1e-12 if scheme in ONE_STEP_EXPLICIT else 100)
        assert_grows_at_the_computed_rate(scheme, direction, 1.01 * limit)


def assert_grows_at_the_computed_rate(scheme, direction, reach):
    # Over whole swings of pairs of complex roots, from where the largest root rules.
    sizes = growth(scheme, direction, reach)
    rate = math.log(scheme.stability.amplification(direction * reach))
    start, end = len(sizes) // 2, len(sizes) - 1
    envelope = [math.log(sizes[n - 20 : n + 1].max()) for n in (start, end)]
    assert envelope[1] - envelope[0] > 0.005
    assert (envelope[1] - envelope[0]) / (end - start) == pytest.approx(rate, rel=0.05, abs=1e-5)


@all_schemes
def test_every_smaller_step_is_stable_too(scheme):
    for limit, direction in ((scheme.real_limit, -1), (scheme.imaginary_limit, 1j)):
        end = min(limit, 1e3)
        inside = [scheme.stability.amplification(direction * end * k / 500) for k in range(1, 501)]
        # Up to a double root on the circle, whose modulus is good to the square root of rounding; the terms of R(z) of
        # order 8 are as large as 6^8 / 8! at its limit.
        polynomial = 1e-12 if scheme.order < 8 else 2e-12
        assert max(inside, default=0) <= 1 + (polynomial if isinstance(scheme.stability, Stability) else 2e-6)


@pytest.mark.parametrize(
    ("name", "order", "evaluations", "real", "imaginary", "a_stable", "l_stable"),
    [
        # An independent float64 oracle: limits by bisection of spectral radii.
        ("ab2", 2, 1, 1.0, 0.0, False, False),
        ("ab4", 4, 1, 0.3, 0.42998707991612034, False, False),
        ("abm2", 2, 2, 2.0, 1.2871885058153256, False, False),
        ("abm4", 4, 2, 1.2848162631229154, 0.0, False, False),
        ("backward-euler", 1, 1, math.inf, math.inf, True, True),
        ("bdf2", 2, 1, math.inf, math.inf, True, True),
        ("beeman", 2, 1, 3.0, 2.0, False, False),
        ("crenshaw", 2, 1, 1.0, 0.0, False, False),
        ("euler", 1, 1, 2.0, 0.0, False, False),
        ("heun", 2, 2, 2.0, 0.0, False, False),
        ("midpoint", 2, 2, 2.0, 0.0, False, False),
        ("milne", 4, 2, 0.0, 0.0, False, False),
        ("modified-euler", 1, 2, 1.5, 0.8660254038, False, False),
        ("rk3", 3, 3, 2.5127453266244104, 1.7320508075688772, False, False),
        ("rk4", 4, 4, 2.7852935634119143, 2.8284271247461903, False, False),
        ("symplectic-euler", 1, 1, 2.0, 2.0, False, False),
        ("trapezoidal", 2, 1, math.inf, math.inf, True, False),
        ("tvd-rk3", 3, 3, 2.5127453266244104, 1.7320508075688772, False, False),
        ("velocity-verlet", 2, 1, 2.0, 2.0, False, False),
        # Hairer and Wanner, table V.1.1 and figure V.1.1: A(alpha)-stable, not on the imaginary axis.
        ("ab3", 3, 1, 6 / 11, 0.7236272270, False, False),
        ("bdf3", 3, 1, math.inf, 0.0, False, False),
        ("bdf4", 4, 1, math.inf, 0.0, False, False),
        ("bogacki-shampine", 3, 3, 2.5127453266244104, 1.7320508075688772, False, False),
        ("dormand-prince", 5, 6, 3.3065678927, 0.9971890086, False, False),
        ("implicit-midpoint", 2, 1, math.inf, math.inf, True, False),
        ("semi-implicit-euler", 1, 1, math.inf, math.inf, True, True),
        ("sdirk2", 2, 2, math.inf, math.inf, True, True),
        ("sdirk3", 3, 3, math.inf, math.inf, True, True),
        ("tr-bdf2", 2, 2, math.inf, math.inf, True, True),
        ("position-verlet", 2, 1, 2.0, 2.0, False, False),
        ("yoshida4", 4, 3, None, 1.5734019475, False, False),
    ],
)
def test_traits_of_the_catalogue(name, order, evaluations, real, imaginary, a_stable, l_stable):
    scheme = CATALOGUE[name]
    assert (scheme.order, scheme.evaluations) == (order, evaluations)
    assert (scheme.a_stable, scheme.l_stable) == (a_stable, l_stable)
    assert real is None or scheme.real_limit == pytest.approx(real, rel=1e-8)
    assert scheme.imaginary_limit == pytest.approx(imaginary, rel=1e-8)


def test_the_catalogue_is_complete_and_cited():
    assert all(scheme.reference for scheme in CATALOGUE.values())
    for need, names in {
        "equal steps": {"ab3", "ab4", "abm4", "abm5-pec", "milne", "bdf3", "bdf4", "beeman"},
        "second-order system": {
            "symplectic-euler",
            "velocity-verlet",
            "position-verlet",
            "beeman",
            "yoshida4",
            "crenshaw",
        },
        "velocity-free forces": {"position-verlet", "yoshida4"},
    }.items():
        assert {name for name, scheme in CATALOGUE.items() if need in scheme.needs} == names


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


def test_long_euler_steps_on_decay_alternate_and_grow_tenfold():
    x, seen = 1.0, []
    for _ in range(5):
        seen.append(x)
        x = step(BY_NAME["euler"], lambda _, x: -x, 0.0, x, 11)
    assert seen == [1, -10, 100, -1000, 10000]


def test_long_implicit_steps_on_decay_stay_positive_or_die_out():
    # Slide 15's dt = 11: backward Euler gives 12^-n; the L-stable ones decay.
    decay = integrate(BY_NAME["backward-euler"], lambda _, x: -x, 0.0, 1.0, 11.0, 5)
    assert decay == pytest.approx([12.0**-n for n in range(6)], rel=1e-9)
    for scheme in SCHEMES:
        if scheme.l_stable:
            assert abs(integrate(scheme, lambda _, x: -x, 0.0, 1.0, 11.0, 20)[-1]) < 1e-6


@pytest.mark.parametrize("name", ["trapezoidal", "implicit-midpoint"])
def test_neutral_methods_keep_the_radius_of_a_rotation(name):
    z = run(BY_NAME[name], lambda _, z: np.array([-z[1], z[0]]), np.array([1.0, 0.0]), 0.7, 1000)
    assert math.hypot(*z) == pytest.approx(1, abs=1e-12)


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
    assert oscillator_limit(scheme) == scheme.imaginary_limit


@pytest.mark.parametrize(
    ("name", "k"),
    [
        ("euler", 10.5),
        ("midpoint", 239),
        ("crenshaw", 235),
        ("abm4", 488),
        ("abm2", 2080),
        ("beeman", 4967),
        ("velocity-verlet", 4979),
        ("rk4", 10024),
    ],
)
def test_stiffest_spring_of_the_damped_box(name, k):
    # Scott's box by linear theory: mass 1, m w^2 = 8 k, damping 8 * 0.1 + 0.04, dt = 0.01.
    dt, damping = 0.01, 0.84

    def amplification(k):
        # The root in the upper half-plane; a splitting takes its conjugate along.
        root = cmath.sqrt(damping**2 / 4 - 8 * k) - damping / 2
        return CATALOGUE[name].stability.amplification(dt * root)

    assert amplification(0.995 * k) <= 1 + 1e-12
    assert amplification(1.005 * k) > 1
    omega = math.sqrt(8 * k)
    assert oscillator_limit(CATALOGUE[name], damping / (2 * omega)) == pytest.approx(dt * omega, rel=0.005)


@pytest.mark.parametrize(
    ("name", "zeta", "limit"),
    [
        # |1 + z|^2 = 1 at omega dt = 2 zeta; overdamped, the faster of the two rates counts.
        ("euler", 0.25, 0.5),
        ("euler", 1.0, 2.0),
        ("euler", 1.25, 1.0),
        ("rk4", 0.0, math.sqrt(8)),
        ("ab2", 1.25, 0.5),
        # v' = v - p x - q v, x' = x + v': zeta = -1 at p + 2 q = 4.
        ("symplectic-euler", 0.5, math.sqrt(5) - 1),
        ("symplectic-euler", 2.0, 2 * math.sqrt(5) - 4),
        ("bdf2", 0.3, math.inf),
        ("milne", 0.3, 0.0),
    ],
)
def test_oscillator_limits_in_closed_form(name, zeta, limit):
    assert oscillator_limit(CATALOGUE[name], zeta) == pytest.approx(limit, rel=1e-9)


@pytest.mark.parametrize("zeta", [-0.1, math.nan, math.inf, "1", True])
def test_a_damping_ratio_is_a_finite_number(zeta):
    with pytest.raises(InputError, match="scheme 'rk4': zeta must be a finite number >= 0"):
        oscillator_limit(CATALOGUE["rk4"], zeta)
