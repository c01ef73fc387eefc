"""Multistep schemes: how they start, start again and follow unequal steps; what a reused slope saves and an error estimate sees."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from scheme_samples import BY_NAME, SCHEMES, run, smooth_motion, smooth_rhs, smooth_solution, velocity_free_rhs

from tparticles.errors import InputError, RunError
from tparticles.schemes import CATALOGUE, Op, OpKind, integrate, step

F = Fraction

MULTISTEP = tuple(scheme for scheme in SCHEMES if not scheme.one_step)
UNEQUAL = [0.1, 0.07, 0.1, 0.13, 0.02, 0.04, 0.04, 0.08]

multistep = pytest.mark.parametrize("scheme", MULTISTEP, ids=lambda scheme: scheme.name)


def problem(scheme):
    if 1 in scheme.system_orders:
        return smooth_rhs, smooth_solution(0.0)
    return velocity_free_rhs, smooth_motion(0.0)


class Counted:
    def __init__(self, f):
        self.f, self.calls = f, 0

    def __call__(self, t, z):
        self.calls += 1
        return self.f(t, z)


@multistep
def test_the_first_steps_are_the_starters(scheme):
    f, z0 = problem(scheme)
    states = integrate(scheme, f, 0.0, z0, 0.1, scheme.steps_back + 1)
    alone = integrate(scheme.starter, f, 0.0, z0, 0.1, scheme.steps_back + 1)
    for n in range(scheme.steps_back + 1):
        np.testing.assert_array_equal(states[n], alone[n])
    assert not np.array_equal(states[-1], alone[-1])


@multistep
def test_the_starter_leaves_the_carried_registers_alone(scheme):
    written = {op.slope for op in scheme.starting_ops if op.kind not in (OpKind.COMBINE, OpKind.KICK, OpKind.DRIFT)}
    assert not written & set(scheme.carried)
    assert max(written) < scheme.registers
    assert len(scheme.starting_ops) == len(scheme.starter.ops)


@pytest.mark.parametrize("name", [scheme.name for scheme in MULTISTEP if not scheme.variable_steps])
def test_a_step_of_another_size_starts_equal_step_schemes_again(name):
    scheme = BY_NAME[name]
    f, z0 = problem(scheme)
    n = scheme.steps_back + 2
    states = integrate(scheme, f, 0.0, z0, [0.1] * n + [0.05] * n, velocity_free=True)
    again = integrate(scheme, f, 0.1 * n, states[n], 0.05, n, velocity_free=True)
    np.testing.assert_allclose(states[n:], again, rtol=1e-14)


@pytest.mark.parametrize("name", ["ab2", "abm2", "bdf2"])
def test_variable_weights_are_exact_on_parabolas(name):
    for dts in ([1.0, 0.5, 2.0, 0.3, 0.7], UNEQUAL):
        states = integrate(BY_NAME[name], lambda t, x: 2 * t, 0.0, 0.0, dts)
        np.testing.assert_allclose(states, np.cumsum([0.0, *dts]) ** 2, rtol=1e-12, atol=1e-14)
    if name != "bdf2":
        dts = [F(1), F(1, 3), F(2), F(5, 7)]
        assert integrate(BY_NAME[name], lambda t, x: 2 * t, F(0), F(0), dts)[-1] == sum(dts) ** 2


def test_variable_crenshaw_is_exact_where_the_force_grows_evenly():
    # v' = 2 t: v = t^2 exactly; x is its trapezoidal sum.
    dts = [0.5, 0.25, 0.75]
    states = integrate(BY_NAME["crenshaw"], lambda t, z: np.array([z[1], 2 * t]), 0.0, np.zeros(2), dts)
    t = np.cumsum([0.0, *dts])
    np.testing.assert_allclose([z[1] for z in states], t**2, rtol=1e-13)


@pytest.mark.parametrize("name", ["ab2", "abm2", "bdf2", "crenshaw"])
def test_unequal_steps_keep_the_order(name):
    scheme = BY_NAME[name]
    f, z0 = problem(scheme)
    solution = smooth_solution if 1 in scheme.system_orders else smooth_motion
    errors = []
    for n in (64, 128, 256):
        shape = 1 + 0.5 * np.sin(np.arange(n) * 1.3)
        dts = 2.0 * shape / shape.sum()
        errors.append(np.abs(integrate(scheme, f, 0.0, z0, dts)[-1] - solution(2.0)).max())
    assert math.log2(errors[0] / errors[2]) / 2 == pytest.approx(2, abs=0.2)


def test_steps_are_a_count_or_a_list():
    for dt, steps in ((0.1, None), (0.1, -1), (0.1, True), ([0.1], 1)):
        with pytest.raises(InputError, match="integrate: "):
            integrate(BY_NAME["rk4"], lambda t, z: z, 0.0, 1.0, dt, steps)
    assert integrate(BY_NAME["rk4"], lambda t, z: z, 0.0, 1.0, 0.1, 0) == [1.0]
    with pytest.raises(InputError, match="'ab2' needs 1 previous steps: run it by integrate"):
        step(BY_NAME["ab2"], lambda t, z: z, 0.0, 1.0, 0.1)


@pytest.mark.parametrize(
    "scheme", [scheme for scheme in SCHEMES if not scheme.implicit], ids=lambda scheme: scheme.name
)
def test_evaluations_per_step_are_as_declared(scheme):
    f, z0 = problem(scheme)
    if 1 not in scheme.system_orders:
        z0 = np.array([[1.0], [0.0]])
    counts = []
    for steps in (10, 20):
        asked = Counted(f)
        integrate(scheme, asked, 0.0, z0, 0.01, steps, velocity_free=True)
        counts.append(asked.calls)
    assert counts[1] - counts[0] == 10 * scheme.evaluations


@pytest.mark.parametrize("scheme", [s for s in SCHEMES if s.reuses], ids=lambda scheme: scheme.name)
def test_reuse_changes_nothing_but_rounding(scheme):
    f, z0 = problem(scheme)
    if 1 not in scheme.system_orders:
        reused, fresh = (
            integrate(scheme, f, 0.0, z0, 0.05, 20, velocity_free=velocity_free)[-1] for velocity_free in (True, False)
        )
    else:
        reused, fresh = integrate(scheme, f, 0.0, z0, 0.05, 20)[-1], z0
        for n in range(20):
            fresh = step(scheme, f, n * 0.05, fresh, 0.05)
    np.testing.assert_allclose(reused, fresh, rtol=1e-12)


def test_verlet_with_drag_keeps_order_two():
    # The half-kicked velocity in a drag gives order 1; both schemes predict the velocity instead.
    for name in ("velocity-verlet", "beeman"):
        errors = []
        for n in (100, 200):
            z = run(BY_NAME[name], lambda t, z: np.array([z[1], -z[1]]), np.array([0.0, 1.0]), 1 / n, n)
            errors.append(abs(z[1] - math.exp(-1)))
        assert math.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)
    assert "velocity-free forces" in BY_NAME["classic-verlet"].needs


@pytest.mark.parametrize(("name", "order"), [("bogacki-shampine", 2), ("dormand-prince", 4), ("tr-bdf2", 2)])
def test_error_estimates_fall_with_the_lower_order(name, order):
    scheme = CATALOGUE[name]
    assert scheme.error_order == order
    assert sum(scheme.error_weights) == pytest.approx(0, abs=1e-15)
    estimates = []
    for dt in (0.1, 0.05):
        k: list = [None] * scheme.slopes
        # The program as an executor walks it, with its registers kept.
        from tparticles.schemes.interpreter import _run

        _run(scheme, scheme.ops, smooth_rhs, 0.3, smooth_solution(0.3), dt, k)
        estimates.append(np.abs(dt * sum(e * k_j for e, k_j in zip(scheme.error_weights, k, strict=False))).max())
    assert math.log2(estimates[0] / estimates[1]) == pytest.approx(order + 1, abs=0.35)


def test_the_estimate_is_the_difference_of_the_pair():
    from tparticles.schemes.interpreter import _run

    scheme, b_embedded = CATALOGUE["bogacki-shampine"], [F(7, 24), F(1, 4), F(1, 3), F(1, 8)]
    z0, dt = smooth_solution(0.3), 0.1
    k: list = [None] * 4
    z = _run(scheme, scheme.ops, smooth_rhs, 0.3, z0, dt, k)
    slopes = [k[3], k[1], k[2], k[0]]
    embedded = z0 + dt * sum(float(b) * slope for b, slope in zip(b_embedded, slopes, strict=True))
    estimate = dt * sum(e * k_j for e, k_j in zip(scheme.error_weights, k, strict=True))
    np.testing.assert_allclose(estimate, z - embedded, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(k[0], smooth_rhs(0.4, z), rtol=1e-15)


@pytest.mark.parametrize(
    ("name", "coefficient"),
    [
        ("euler", 1), ("heun", 1), ("tvd-rk3", 1), ("modified-euler", 0.5), ("midpoint", None), ("rk3", None), ("rk4", None),
        ("backward-euler", math.inf), ("implicit-midpoint", 2), ("trapezoidal", 2), ("ab2", None), ("sdirk2", 1 + math.sqrt(2)),
    ],
)  # fmt: skip
def test_ssp_coefficients(name, coefficient):
    # Gottlieb, Ketcheson, Shu 2011, sections 2 and 7.
    assert CATALOGUE[name].ssp == (None if coefficient is None else pytest.approx(coefficient, rel=1e-9))


def test_shu_osher_form_of_tvd_rk3():
    # Slide 27: Euler steps and averages only, with the same steps.
    def euler(z):
        return z + 0.1 * np.cos(z)

    z0 = np.linspace(0, 1, 5)
    z1 = euler(z0)
    z2 = 3 / 4 * z0 + 1 / 4 * euler(z1)
    z = 1 / 3 * z0 + 2 / 3 * euler(z2)
    np.testing.assert_allclose(step(CATALOGUE["tvd-rk3"], lambda t, z: np.cos(z), 0.0, z0, 0.1), z, rtol=1e-15)


def test_semi_implicit_euler_takes_one_newton_step():
    # z0 + dt f / (1 - dt f') at z0 = 2, f = -z^2
    z = step(CATALOGUE["semi-implicit-euler"], lambda t, z: -(z**2), 0.0, 2.0, 0.5)
    assert z == pytest.approx(2 - 0.5 * 4 / (1 + 0.5 * 4), rel=1e-9)


def test_newton_needs_a_solution():
    # z = 1 + z^2 + 1 has no real root.
    with pytest.raises(RunError, match="scheme 'backward-euler', op 0 at t = 0, dt = 1: "):
        step(CATALOGUE["backward-euler"], lambda t, z: z**2 + 1, 0.0, 1.0, 1.0)
    with pytest.raises(RunError, match="singular"):
        step(CATALOGUE["backward-euler"], lambda t, z: z, 0.0, 1.0, 1.0)
    with pytest.raises(RunError, match="not finite"):
        step(CATALOGUE["semi-implicit-euler"], lambda t, z: z * np.nan, 0.0, 1.0, 1.0)


def test_newton_halves_steps_that_overshoot():
    # f = -atan(z): whole Newton steps from far out run away.
    z = step(CATALOGUE["backward-euler"], lambda t, z: -np.arctan(z), 0.0, 30.0, 1e4)
    assert z + 1e4 * math.atan(z) == pytest.approx(30.0, abs=1e-8)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_implicit_steps_keep_dtype_and_shape(dtype):
    z = np.ones((2, 3), dtype)
    out = step(CATALOGUE["sdirk2"], lambda t, z: -z, 0.0, z, 0.1)
    assert out.dtype == dtype
    np.testing.assert_allclose(out, np.full((2, 3), math.exp(-0.1)), rtol=1e-3)


def test_beeman_is_its_formula():
    a = velocity_free_rhs
    dt = 0.05
    states = integrate(CATALOGUE["beeman"], a, 0.0, smooth_motion(0.0), dt, 3)
    (x, v), a0, before, after = states[2], a(0.1, states[2])[1], a(0.05, states[1])[1], a(0.15, states[3])[1]
    np.testing.assert_allclose(states[3][0], x + dt * v + dt**2 / 6 * (4 * a0 - before), rtol=1e-14)
    np.testing.assert_allclose(states[3][1], v + dt / 6 * (2 * after + 5 * a0 - before), rtol=1e-13)


def test_bdf_programs_print_as_the_formulas():
    bdf2 = CATALOGUE["bdf2"]
    assert bdf2.ops == (
        Op(OpKind.ROTATE, slope=0, source=1),
        Op(OpKind.COMBINE, weights=(1 / 3,), variable=((0.0, 1.0, 2.0),)),
        Op(OpKind.SOLVE, weights=(2 / 3,), time=1.0, variable=((1.0, 1.0, 2.0),)),
    )
    # 11/6 z' = 3 z - 3/2 z_1 + 1/3 z_2 + dt f: z' = z + 7/11 dt d_1 - 2/11 dt d_2 + 6/11 dt f
    assert CATALOGUE["bdf3"].ops[1].weights == pytest.approx((7 / 11, 0, -2 / 11))
    assert CATALOGUE["bdf3"].ops[2].weights == pytest.approx((6 / 11,))
