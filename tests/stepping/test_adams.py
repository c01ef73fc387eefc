"""Adams' PEC methods under a tolerance: steps of any sizes, a start from one slope, particles that take turns in a lane."""

import math
from fractions import Fraction

import numpy as np
import pytest
import taichi as ti
from fused_bench import Particles
from test_fused_accuracy import Oscillator, Swelling

import tparticles as tp
from tparticles import schemes
from tparticles.schemes import adams, doubled
from tparticles.stepping.adams import correct, predict
from tparticles.stepping.block import Block
from tparticles.stepping.control import ErrorControl, Fixed, PixelTolerance, check_fit

pytestmark = pytest.mark.usefixtures("cpu64")

F = Fraction
PEC3 = adams([F(3, 2), F(-1, 2)], [F(5, 12), F(8, 12), F(-1, 12)], mode="PEC", name="pec3", order=3)
PEC2 = adams([1], [F(1, 2), F(1, 2)], mode="PEC", name="pec2", order=2)
PECS = pytest.mark.parametrize("scheme", ["abm5-pec", PEC3, PEC2], ids=["abm5-pec", "pec3", "pec2"])


@ti.data_oriented
class Quadrature:
    """One step of four lanes, from slopes that are given."""

    lanes, slopes = 4, 4
    layout = {"z0": 3, "z": 3, "estimate": 3, "h": 1, "filled": 1, "last": 3}  # noqa: RUF012

    def block(self, vectors, slopes):
        return Block(self.layout, vectors, slopes, self.lanes)

    @ti.kernel
    def step(
        self,
        h: ti.types.ndarray(ndim=1),
        lasts: ti.types.ndarray(ndim=2),
        filled: ti.types.ndarray(ndim=1),
        k: ti.types.ndarray(ndim=2),
        out: ti.types.ndarray(ndim=2),
    ):
        vectors = [ti.Vector([0.0] * self.lanes) for _ in range(14)]
        slopes = [ti.Vector([0.0] * ti.static(self.lanes * (self.slopes + 1))) for _ in range(3)]
        b = ti.static([self.block(vectors, slopes)])[0]
        for lane in range(self.lanes):
            b.h[lane], b.filled[lane] = h[lane], filled[lane]
            for n in ti.static(range(self.slopes - 1)):
                b.last[n][lane] = lasts[n, lane]
            for j in ti.static(range(self.slopes + 1)):
                b.k[0][j * self.lanes + lane] = k[j, lane]
        predict(b, ti.static(b.last))
        for lane in range(self.lanes):
            out[0, lane] = b.z[0][lane]
        correct(b, ti.static(b.last))
        for lane in range(self.lanes):
            out[1, lane], out[2, lane] = b.z[0][lane], b.estimate[0][lane]


@pytest.mark.parametrize("degree", range(6))
def test_polynomials_are_integrated_exactly_over_steps_of_any_sizes(degree):
    rng = np.random.default_rng(degree)
    filled, h, lasts = np.array([1.0, 2.0, 3.0, 4.0]), rng.uniform(0.1, 2.0, 4), rng.uniform(0.1, 2.0, (3, 4))
    times = np.concatenate([h[None], np.zeros((1, 4)), -np.cumsum(lasts, axis=0)])
    k, out = times**degree, np.zeros((3, 4))
    for lane, n in enumerate(filled.astype(int)):
        k[1 + n :, lane] = 1e6 * rng.normal(size=4 - n)  # what a lane does not have yet it does not look at
    Quadrature().step(h, lasts, filled, k, out)
    exact = h ** (degree + 1) / (degree + 1)
    np.testing.assert_allclose(out[0] + out[2], out[1], rtol=1e-13)
    for row, needed in ((0, filled), (1, filled + 1)):
        right = degree < needed
        np.testing.assert_allclose(out[row][right], exact[right], rtol=1e-11)
        assert np.all(np.abs(out[row] / exact - 1)[~right] > 1e-4)


def test_equal_steps_have_adams_weights():
    out, scheme = np.zeros((3, 4)), schemes.get("abm5-pec")
    weights = [scheme.ops[0].weights, scheme.ops[2].weights]
    for j in range(5):
        k = np.zeros((5, 4))
        k[j] = 1.0
        Quadrature().step(np.full(4, 0.25), np.full((3, 4), 0.25), np.full(4, 4.0), k, out)
        np.testing.assert_allclose(out[:2, 0], [0.25 * w[j] for w in weights], rtol=1e-13, atol=1e-15)


def test_local_extrapolation_makes_the_next_bashforth_method():
    # The predicted states of P_k E C_(k+1) are those of the Adams-Bashforth method of order k + 1 (Hairer, Norsett, Wanner, III.1).
    for pec, ab in ((PEC3, schemes.get("ab3")), (PEC2, schemes.get("ab2"))):
        assert pec.real_limit == pytest.approx(ab.real_limit, rel=1e-9)
        assert pec.imaginary_limit == pytest.approx(ab.imaginary_limit, rel=1e-9, abs=1e-12)


def test_its_error_estimate_is_the_corrector_less_the_predictor():
    scheme = schemes.get("abm5-pec")
    predictor, _, corrector = scheme.ops
    assert scheme.error_weights == pytest.approx(np.subtract(corrector.weights, predictor.weights))
    assert (scheme.order, scheme.error_order, scheme.evaluations, scheme.starter.name) == (5, 4, 1, "dormand-prince")
    assert doubled(scheme).starts_itself and not scheme.starts_itself


def test_without_a_tolerance_it_needs_its_starter():
    bare = doubled(PEC3)
    with pytest.raises(tp.InputError, match="scheme 'pec3' has no starter, and starts itself only where"):
        check_fit(Fixed(dt=0.1), "equal", bare)
    with pytest.raises(tp.InputError, match="scheme 'pec3' has no starter: integrate makes steps of given sizes"):
        schemes.integrate(bare, lambda t, z: z, 0.0, 1.0, 0.1, 3)


def test_other_correctors_run_with_fixed_steps_only():
    same = adams([F(3, 2), F(-1, 2)], [F(1, 2), F(1, 2)], mode="PEC", name="pec2-2")
    assert not same.interpolates and same.evaluations == 1
    with pytest.raises(tp.InputError, match="its error cannot be estimated by step doubling"):
        doubled(same)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"explicit": [1], "mode": "PEC"}, "mode is 'PEC', allowed are for a method with a corrector PECE or PEC"),
        ({"explicit": [1], "implicit": [0.5, 0.5], "mode": "PECECE"}, "mode is 'PECECE', allowed are"),
        (
            {"explicit": [1.5, -0.5], "implicit": [0.5, 0.5], "mode": "PEC", "starter": schemes.get("rk4")},
            "its history copies slope 0, which its starter 'rk4' must leave as f at time 1",
        ),
    ],
)
def test_modes_that_cannot_be_are_refused(arguments, message):
    with pytest.raises(tp.InputError, match=f"^scheme 'mine': {message}"):
        adams(**arguments, name="mine")


@pytest.fixture(scope="module")
def swelling(cpu64):
    return Particles(tp.Advected(flow=Swelling()), 37)


@pytest.fixture(scope="module")
def oscillator(cpu64):
    return Particles(tp.Newtonian(forces=Oscillator()), 37)


@PECS
def test_errors_of_motions_with_inertia_follow_the_tolerance(oscillator, scheme):
    rng = np.random.default_rng(1)
    x, v = rng.uniform(0.5, 1.5, (2, 37, 3))
    birth = rng.uniform(0.0, 0.9, 37)
    errors, order = [], schemes.get(scheme).order
    for tolerance in (1e-5, 1e-8):
        oscillator.set("x", x)
        oscillator.set("v", v)
        oscillator.set("birth", birth)
        for n in range(3):
            oscillator.run(scheme, n, n + 1, 1.0, lanes=4, tolerance=ErrorControl(rtol=tolerance, atol=tolerance))
        exact = np.array([Oscillator().solution(3.0, *_from_zero(*start)) for start in zip(x, v, birth, strict=True)])
        errors.append(np.abs(oscillator.get("x") - exact).max())
    fall = math.log(errors[0] / errors[1]) / math.log(1e3)
    assert fall == pytest.approx(1.0, abs=0.25), errors
    assert errors[1] < 2e-5 / order


def _from_zero(x, v, birth):
    """Return the state at t = 0 that leads to (x, v) at `birth`, by the interpreter and backwards."""
    z = np.concatenate([x, v])
    states = schemes.integrate(
        schemes.get("dop853"), lambda t, z: -Oscillator().rate(birth - t, z), 0.0, z, birth / 64, 64
    )
    return states[-1][:3], states[-1][3:]


@PECS
def test_a_newborn_is_at_the_same_place_whatever_the_others_do(swelling, scheme):
    rng, tolerance = np.random.default_rng(5), ErrorControl(rtol=1e-6, atol=1e-6)
    x, birth = rng.uniform(0.5, 2.0, (37, 3)), rng.uniform(0.0, 2.0, 37)

    def run(x, birth, lanes=4):
        swelling.set("x", x)
        swelling.set("birth", birth)
        swelling.set("history", np.full(len(swelling.columns["history"]), 1e9))  # of whoever died in the slot
        for n in range(2):
            swelling.run(scheme, n, n + 1, 1.0, lanes=lanes, tolerance=tolerance)
        return swelling.get("x")

    crowd, order = run(x, birth), rng.permutation(37)
    assert np.isfinite(crowd).all()
    assert np.array_equal(run(x[order], birth[order]), crowd[order])
    for i in (0, 20, 36):
        others, times = rng.uniform(0.5, 9.0, (37, 3)), rng.uniform(0.0, 2.0, 37)
        others[i], times[i] = x[i], birth[i]
        assert np.array_equal(run(others, times)[i], crowd[i])
    for lanes in (1, 16):  # which are vectorised differently
        np.testing.assert_allclose(run(x, birth, lanes), crowd, rtol=1e-14)


def test_starts_and_steps_are_counted_and_a_start_takes_no_time(swelling):
    scheme = doubled(schemes.get("abm5-pec"))
    swelling.set("x", (1.0, 2.0, 1.0))
    swelling.set("birth", 0.0)
    first, second = (
        swelling.run("abm5-pec", n, n + 1, 1.0, tolerance=ErrorControl(rtol=1e-6, atol=1e-6)) for n in range(2)
    )
    assert (first.starting, second.starting) == (37, 0)
    for report in (first, second):
        assert report.evaluations(scheme) == report.steps + report.rejected + report.starting
        assert 1e-6 < report.dt_min <= report.dt_max < 0.5 and report.steps % 37 == 0


def test_the_velocity_kept_for_streaks_is_the_flow_at_the_end(cpu64):
    bench = Particles(tp.Advected(flow=Swelling()), 21, names=("v",))
    bench.set("x", (1.0, 2.0, 1.0))
    bench.set("birth", np.linspace(0.0, 0.9, 21))
    bench.run("abm5-pec", 0.0, 1.0, 1.0, tolerance=ErrorControl(rtol=1e-9, atol=1e-9))
    np.testing.assert_allclose(bench.get("v"), Swelling.rate(1.0, bench.get("x").T).T, rtol=1e-6, atol=1e-7)


def test_a_scene_of_short_lives_in_still_air_allows_more_than_one_of_long_ones_in_turbulence():
    sheltered, gusty = PixelTolerance().fitted(0.0, 1.0), PixelTolerance().fitted(100.0, 3.0)
    assert sheltered.growth == 4
    assert gusty.growth == pytest.approx(4 * math.exp(300 / 60))
    assert PixelTolerance().fitted(1e4, 1e4).growth == 1000
    assert PixelTolerance(growth=3.0).fitted(100.0, 3.0).growth == 3
    camera = np.zeros(15)
    allowed = [tolerance.numbers(1 / 24, camera)[0] for tolerance in (sheltered, PixelTolerance().fitted(None, 1.0))]
    assert allowed == pytest.approx([0.5 / 4, 0.5 / 64])


def test_fixed_steps_of_a_pec_method_agree_with_the_interpreter(swelling):
    start = np.broadcast_to([1.0, 2.0, 0.7], (37, 3))
    swelling.set("x", start)
    swelling.set("birth", 0.0)
    for n in range(2):
        swelling.run("abm5-pec", 0.5 * n, 0.5 * (n + 1), Fixed(dt=1 / 32).dt)
    states = schemes.integrate(schemes.get("abm5-pec"), Swelling.rate, 0.0, start.T, 1 / 32, 32)
    np.testing.assert_allclose(swelling.get("x"), states[-1].T, rtol=1e-13)
