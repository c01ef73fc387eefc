"""Step doubling: the same result as two half steps, and an estimate that is right as steps get small."""

from __future__ import annotations

import math
import re
from fractions import Fraction

import numpy as np
import pytest
from scheme_samples import SCHEMES, make, smooth_rhs, smooth_solution, velocity_rhs

from tparticles.errors import InputError
from tparticles.schemes import CATALOGUE, Op, OpKind, adams, doubled, integrate, runge_kutta, step
from tparticles.schemes.construct import Draft, stability
from tparticles.schemes.interpreter import _run
from tparticles.schemes.series import SECOND_ORDER, order_of

E, C, S, R = OpKind.EVALUATE, OpKind.COMBINE, OpKind.SOLVE, OpKind.ROTATE

PLAIN = tuple(s for s in SCHEMES if s.one_step and s.system_orders == {1, 2} and not s.error_weights)
SPLIT = tuple(s for s in SCHEMES if s.one_step and s.system_orders == {2})
REFUSED = tuple(s for s in SCHEMES if not s.one_step and not s.error_weights)

plain = pytest.mark.parametrize("scheme", PLAIN, ids=lambda scheme: scheme.name)
split = pytest.mark.parametrize("scheme", SPLIT, ids=lambda scheme: scheme.name)


def test_the_samples_hold_every_kind():
    assert {"rk4", "tvd-rk3", "trapezoidal", "sdirk3", "semi-implicit-euler", "implicit-midpoint"} <= {
        s.name for s in PLAIN
    }
    assert {"symplectic-euler", "velocity-verlet", "position-verlet", "yoshida4"} <= {s.name for s in SPLIT}
    assert {"ab2", "milne", "bdf2", "beeman", "crenshaw"} <= {s.name for s in REFUSED}


def estimated(scheme, f, t, z, dt):
    """Return the result of a step and its error estimate."""
    k: list = [None] * scheme.slopes
    end = _run(scheme, scheme.ops, f, t, z, dt, k)
    return end, dt * sum(e * k_j for e, k_j in zip(scheme.error_weights, k, strict=False) if e)


@plain
@pytest.mark.parametrize("dt", [0.3, 0.02])
def test_result_and_estimate_are_those_of_one_step_and_two_halves(scheme, dt):
    for f, z in ((smooth_rhs, smooth_solution(0.3)), (velocity_rhs, np.array([[1.2], [0.4]]))):
        one, half = step(scheme, f, 0.3, z, dt), step(scheme, f, 0.3, z, dt / 2)
        two = step(scheme, f, 0.3 + dt / 2, half, dt / 2)
        end, estimate = estimated(doubled(scheme), f, 0.3, z, dt)
        # Implicit stages are solved to rounding, over differenced Jacobians.
        rounding = 1e-12 if scheme.implicit else 1e-14
        np.testing.assert_allclose(end, two, rtol=rounding)
        np.testing.assert_allclose(estimate, (two - one) / (2**scheme.order - 1), atol=10 * rounding)


def test_it_is_exact_on_fractions():
    rk4, z = CATALOGUE["rk4"], Fraction(-3, 7)
    two = integrate(rk4, lambda t, x: z * x + t, Fraction(0), Fraction(1), Fraction(1, 2), 2)[-1]
    assert step(doubled(rk4), lambda t, x: z * x + t, Fraction(0), Fraction(1), Fraction(1)) == two


@plain
def test_order_and_stability_are_those_of_two_half_steps(scheme):
    twice = doubled(scheme)
    assert order_of(twice) == twice.order == twice.error_order == scheme.order
    assert order_of(twice, SECOND_ORDER) >= scheme.order
    assert (twice.real_limit, twice.imaginary_limit) == pytest.approx(
        (2 * scheme.real_limit, 2 * scheme.imaginary_limit), rel=1e-9
    )
    assert (twice.a_stable, twice.l_stable) == (scheme.a_stable, scheme.l_stable)
    assert twice.ssp == (None if scheme.ssp is None else 2 * scheme.ssp)
    # R(z/2)^2 is what the program does.
    worked_out = stability(Draft(ops=twice.ops, slopes=twice.slopes), "trial")
    for z in (-0.7, 0.4 + 1.1j, -3.0 - 2j):
        assert twice.stability(z) == pytest.approx(scheme.stability(z / 2) ** 2, rel=1e-12)
        assert worked_out(z) == pytest.approx(twice.stability(z), rel=1e-9)


@plain
def test_the_estimate_falls_by_one_order_more_and_is_right_in_the_end(scheme):
    twice, t, dt = doubled(scheme), 0.3, {1: 0.01, 2: 0.02, 3: 0.03}.get(scheme.order, 0.1)
    sizes, misses = [], []
    for h in (dt, dt / 2):
        end, estimate = estimated(twice, smooth_rhs, t, smooth_solution(t), h)
        # (z_two - z_one) / (2^p - 1): what is left to the true solution.
        true = smooth_solution(t + h) - end
        sizes.append(np.linalg.norm(estimate))
        misses.append(np.linalg.norm(estimate - true) / np.linalg.norm(true))
    assert math.log2(sizes[0] / sizes[1]) == pytest.approx(scheme.order + 1, abs=0.2)
    # The ratio of estimate and error goes to 1, like dt or faster.
    assert misses[1] < 0.11
    assert misses[1] < max(0.6 * misses[0], 0.03)


@plain
def test_the_first_slope_serves_both_sizes_of_step(scheme):
    twice, begins = doubled(scheme), scheme.ops[0] == Op(E)
    kept = [op for op in scheme.ops if op.kind in (E, S)]
    # What `reuses` evaluates for the next step is left out.
    kept = kept[:-1] if scheme.reuses and kept[-1].kind is E else kept
    assert twice.evaluations == 3 * len(kept) - begins
    assert not twice.reuses
    assert all(op.kind is not R for op in twice.ops)
    assert twice.needs == scheme.needs


def test_the_program_of_euler_reads_as_it_should():
    assert doubled(CATALOGUE["euler"]).ops == (
        Op(E),
        Op(C, weights=(0.5,)),
        Op(E, slope=1, time=0.5),
        Op(C, weights=(0.5, 0.5)),
    )
    assert doubled(CATALOGUE["euler"]).error_weights == (-0.5, 0.5)
    backward = doubled(CATALOGUE["backward-euler"])
    assert backward.ops == (
        Op(S, weights=(1.0,), time=1.0),
        Op(C),
        Op(S, slope=1, weights=(0.5,), time=0.5),
        Op(S, slope=2, weights=(0.5,), time=1.0),
    )
    assert backward.error_weights == (-1.0, 0.5, 0.5)


def test_slopes_that_a_program_writes_over_are_kept():
    # Two Euler steps of dt/2 in one register, with a copy of the first slope.
    ops = (Op(E), Op(C, weights=(0.5,)), Op(R, slope=1, source=0), Op(E, time=0.5), Op(C, weights=(0.5, 0.5)))
    twice = doubled(make(ops=ops, slopes=2))
    four = integrate(CATALOGUE["euler"], smooth_rhs, 0.0, smooth_solution(0.0), 0.05, 4)[-1]
    np.testing.assert_allclose(step(twice, smooth_rhs, 0.0, smooth_solution(0.0), 0.2), four, rtol=1e-15)


def test_a_scheme_with_an_estimate_stays_as_it_is():
    for name in ("bogacki-shampine", "dormand-prince", "tr-bdf2"):
        assert doubled(CATALOGUE[name]) is CATALOGUE[name]
    twice = doubled(CATALOGUE["rk4"])
    assert doubled(twice) is twice


def test_first_same_as_last_without_a_pair():
    b = [Fraction(2, 9), Fraction(1, 3), Fraction(4, 9), 0]
    plain_fsal = runge_kutta([[], [0.5], [0, 0.75], b], b, name="fsal", order=3)
    assert plain_fsal.reuses
    assert doubled(plain_fsal).evaluations == 8


@pytest.mark.parametrize("scheme", REFUSED, ids=lambda scheme: scheme.name)
def test_histories_are_refused(scheme):
    message = (
        rf"^scheme '{scheme.name}': its error cannot be estimated by step doubling, it looks back at earlier steps.*; "
        r"take (abm5-pec) or a one-step scheme \(([^)]*)\)$"
    )
    with pytest.raises(InputError, match=message) as refused:
        doubled(scheme)
    proposed = re.search(message, str(refused.value))
    assert proposed
    for name in (proposed[1], *proposed[2].split(", ")):
        assert doubled(CATALOGUE[name]).error_weights


def pendulum(t, z):
    x, v = z
    return np.stack([v, -np.sin(x) + 0.3 * math.cos(2 * t)])


@split
def test_of_a_splitting_too(scheme):
    """x'' = -sin x + 0.3 cos 2 t: result, order, limits, and an estimate that falls by one order more."""
    twice, z = doubled(scheme), np.array([[0.9], [0.4]])
    assert twice.order == twice.error_order == scheme.order and twice.needs == scheme.needs
    assert (twice.real_limit, twice.imaginary_limit) == pytest.approx(
        (2 * scheme.real_limit, 2 * scheme.imaginary_limit), rel=1e-6
    )
    sizes, misses = [], []
    for dt in (0.2, 0.1):
        one, half = step(scheme, pendulum, 0.3, z, dt), step(scheme, pendulum, 0.3, z, dt / 2)
        two = step(scheme, pendulum, 0.3 + dt / 2, half, dt / 2)
        end, estimate = estimated(twice, pendulum, 0.3, z, dt)
        np.testing.assert_allclose(end, two, rtol=1e-14)
        np.testing.assert_allclose(estimate, (two - one) / (2**scheme.order - 1), atol=1e-14)
        true = integrate(CATALOGUE["dop853"], pendulum, 0.3, z, dt / 20, 20)[-1] - end
        sizes.append(np.linalg.norm(estimate))
        misses.append(np.linalg.norm(estimate - true) / np.linalg.norm(true))
    assert math.log2(sizes[0] / sizes[1]) == pytest.approx(scheme.order + 1, abs=0.3)
    assert misses[1] < 0.2


@split
def test_the_first_slope_of_a_splitting_serves_both_sizes_of_step(scheme):
    looks = [op for op in scheme.ops if op.kind is E]
    kept = scheme.ops[0] == Op(E) and [op.slope for op in looks].count(0) == 1
    assert doubled(scheme).evaluations == 3 * len(looks) - kept


def test_a_method_of_one_step_by_adams_serves():
    twice = doubled(adams([1], [0.5, 0.5], name="euler-trapezoidal"))
    assert (twice.name, twice.order, math.isfinite(twice.real_limit)) == ("euler-trapezoidal-doubled", 2, True)
