"""Rooted trees, order conditions, and stability limits of functions chosen to be difficult."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest

from tparticles.errors import InputError
from tparticles.schemes import Stability
from tparticles.schemes.analysis import (
    check_order_conditions,
    condition_formula,
    density,
    elementary_weight,
    rooted_trees,
    runge_kutta_order,
    stability_function,
    tree_order,
)
from tparticles.schemes.polynomial import first_sign_change
from tparticles.schemes.stability import imaginary_limit, real_limit

F = Fraction

RK4 = ([[], [F(1, 2)], [0, F(1, 2)], [0, 0, 1]], [F(1, 6), F(1, 3), F(1, 3), F(1, 6)])


@pytest.mark.parametrize(("order", "count"), [(1, 1), (2, 1), (3, 2), (4, 4), (5, 9), (6, 20), (7, 48), (8, 115)])
def test_number_of_rooted_trees(order, count):
    trees = rooted_trees(order)
    assert len(trees) == len(set(trees)) == count
    assert all(tree_order(tree) == order for tree in trees)


def test_densities_and_formulas_up_to_order_four():
    known = {
        "b·1": 1,
        "b·(c)": 2,
        "b·(c²)": 3,
        "b·(A(c))": 6,
        "b·(c³)": 4,
        "b·(c A(c))": 8,
        "b·(A(c²))": 12,
        "b·(A(A(c)))": 24,
    }
    trees = [tree for order in range(1, 5) for tree in rooted_trees(order)]
    assert {condition_formula(tree): density(tree) for tree in trees} == known


def test_rk4_satisfies_its_conditions_exactly_and_no_more():
    for order in range(1, 5):
        for tree in rooted_trees(order):
            assert elementary_weight(tree, *RK4) == F(1, density(tree))
    order, failed = check_order_conditions(*RK4)
    assert order == 4
    assert elementary_weight(failed.tree, *RK4) == failed.value != failed.needed == F(1, density(failed.tree))


def test_order_of_implicit_tableaus():
    r = math.sqrt(3)
    assert runge_kutta_order([[1]], [1]) == 1
    assert runge_kutta_order([[F(1, 2)]], [1]) == 2
    assert runge_kutta_order([[1 / 4, 1 / 4 - r / 6], [1 / 4 + r / 6, 1 / 4]], [0.5, 0.5]) == 4
    assert runge_kutta_order([[0]], [F(1, 2)]) == 0


def test_stability_function_is_exact_for_exact_coefficients():
    assert stability_function(*RK4) == ((1, 1, F(1, 2), F(1, 6), F(1, 24)), (1,))


def test_stability_function_drops_what_cancels_in_floats():
    g = math.pi / 10
    # b^T A 1 = g b_1 - g b_1 would leave rounding errors.
    R, _ = stability_function([[], [g], [g, 0]], [1, 3 * g, -3 * g])
    assert R == (1.0, 1.0)


@pytest.mark.parametrize(
    ("R", "real", "imaginary"),
    [
        # Chebyshev, first order: R(-x) touches -1 at 4 on its way to 8; a grid or a rounded root may stop there.
        ((1, 1, F(1, 8)), 8, 0),
        ((1, 1, F(4, 27), F(4, 729)), 18, 0),
        # Kinnmark and Gray, second order: optimal on the imaginary axis, s - 1.
        ((1, 1, F(1, 2), F(1, 4)), 2, 2),
        # Leaves the disc before the far, larger stable part: the limit is where it leaves first.
        ((1, 1, F(1, 2)), 2, 0),
        # All orders up to 5 by Taylor: unstable at once on the imaginary axis, by y^6 / 72 / 10.
        ((1, 1, F(1, 2), F(1, 6), F(1, 24), F(1, 120)), 3.2170478666, 0),
    ],
)
def test_limits_of_difficult_polynomials(R, real, imaginary):
    assert real_limit(R) == pytest.approx(real, abs=1e-9)
    assert imaginary_limit(R) == pytest.approx(imaginary, abs=1e-9)
    floats = [float(r) for r in R]
    assert real_limit(floats) == real_limit(R)
    assert imaginary_limit(floats) == imaginary_limit(R)


def test_limits_do_not_depend_on_rounding_in_the_last_place():
    for wobble in (-1, 1):
        R = [1.0, 1.0, 0.5, math.nextafter(1 / 6, wobble), math.nextafter(1 / 24, wobble)]
        assert imaginary_limit(R) == pytest.approx(math.sqrt(8), abs=1e-9)
        assert real_limit(R) == pytest.approx(2.7852935634052816, abs=1e-9)


def test_limits_survive_coefficients_of_every_size():
    # R(-x) = 1 - x + q x^2 is 1 again at x = 1/q.
    assert real_limit((1, 1, 10**300)) == pytest.approx(1e-300, rel=1e-9)
    assert real_limit((1, F(1, 10**300))) == pytest.approx(2e300, rel=1e-9)


@pytest.mark.parametrize(
    ("numerator", "denominator", "real", "imaginary", "a_stable", "l_stable"),
    [
        ((1,), (1, -1), math.inf, math.inf, True, True),  # backward Euler
        ((1, F(1, 2)), (1, -F(1, 2)), math.inf, math.inf, True, False),  # trapezoidal rule
        ((1, F(1, 4)), (1, -F(3, 4)), math.inf, math.inf, True, False),  # theta method, implicit side
        ((1, F(3, 4)), (1, -F(1, 4)), 4, 0, False, False),  # theta method, explicit side
        ((1,), (1, 1), 0, math.inf, False, False),  # bounded on the axis, but its pole is on the left
    ],
)
def test_rational_stability_functions(numerator, denominator, real, imaginary, a_stable, l_stable):
    R = Stability(numerator=numerator, denominator=denominator)
    assert R.real_limit == real
    assert R.imaginary_limit == imaginary
    assert (R.a_stable, R.l_stable) == (a_stable, l_stable)
    assert R(0) == 1


@pytest.mark.parametrize("bad", [(), (1, 0), (1, math.nan), (1, 10**400), [1, 1], ("1",)])
def test_malformed_stability_functions(bad):
    with pytest.raises(InputError, match="stability function"):
        Stability(numerator=bad)


def test_first_sign_change_skips_touching_roots():
    # (x - 1)^2 (x - 2)^3 = x^5 - 8 x^4 + 25 x^3 - 38 x^2 + 28 x - 8
    assert first_sign_change([F(c) for c in (-8, 28, -38, 25, -8, 1)]) == 2
    assert first_sign_change([F(c) for c in (1, -2, 1)]) == math.inf
    assert first_sign_change([]) == math.inf
    # A root at 0 does not count, negative ones neither: x (x + 1) (x - 1/3).
    assert first_sign_change([F(0), F(-1, 3), F(2, 3), F(1)]) == pytest.approx(1 / 3, abs=1e-16)
