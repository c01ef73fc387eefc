"""Particles that choose their own steps: tolerances, rejected steps, failures by name, and no influence of the neighbours."""

import itertools
import math

import numpy as np
import pytest
import taichi as ti
from fused_bench import Particles
from test_fused_accuracy import COUNT, Swelling

import tparticles as tp
from tparticles import schemes
from tparticles.errors import InputError, RunError
from tparticles.render.project import camera_row
from tparticles.stepping.control import ErrorControl, PixelTolerance, check_fit, check_precision
from tparticles.studies.ensemble import Ensemble
from tparticles.studies.work_problems import Kepler

pytestmark = pytest.mark.usefixtures("cpu64")

NAMES = ("bogacki-shampine", "dormand-prince", "rk4", "euler", "midpoint", "tr-bdf2", "sdirk3", "abm5-pec")


@pytest.fixture(scope="module")
def swelling(cpu64):
    return Particles(tp.Advected(flow=Swelling()), COUNT)


def swell(bench, scheme, tolerance, *, frames=3, lanes=4):
    """Run from t = 0.5 to 2; return the largest error and the steps and rejected tries of all frames."""
    c = np.linspace(0.5, 1.5, COUNT)
    bench.set("x", Swelling.solution(0.5, c))
    bench.set("birth", 0.5)
    reports = [
        bench.run(
            scheme, 0.5 + 1.5 * k / frames, 0.5 + 1.5 * (k + 1) / frames, 1.5 / frames, lanes=lanes, tolerance=tolerance
        )
        for k in range(frames)
    ]
    error = np.abs(bench.get("x") - Swelling.solution(2.0, c)).max()
    return error, sum(r.steps for r in reports), sum(r.rejected for r in reports)


@pytest.mark.parametrize("name", NAMES)
def test_the_error_follows_the_tolerance(swelling, name):
    scheme = schemes.doubled(schemes.get(name))
    lower = min(scheme.order, scheme.error_order)
    tolerances = 10.0 ** -np.arange(*{1: (2, 5), 4: (6, 10)}.get(lower, (4, 8)))
    found = [swell(swelling, name, ErrorControl(rtol=rtol, atol=rtol)) for rtol in tolerances]
    errors, steps = [f[0] for f in found], [f[1] for f in found]
    assert all(b < a / 2 for a, b in itertools.pairwise(errors)), errors
    assert all(b > a for a, b in itertools.pairwise(steps)), steps
    # h^(q+1) ~ tol is the local error of the lower order q; 1/h steps of the higher one p add up to h^p ~ tol^(p/(q+1)).
    expected = scheme.order / (lower + 1)
    fall = math.log(errors[0] / errors[-1]) / math.log(tolerances[0] / tolerances[-1])
    assert fall == pytest.approx(expected, abs=0.2)
    assert 0.01 < errors[-1] / tolerances[-1] ** expected < 30


def test_schemes_without_a_pair_run_by_step_doubling(swelling):
    error, steps, _ = swell(swelling, "rk4", ErrorControl(rtol=1e-8, atol=1e-8))
    assert swelling.stepper("rk4", lanes=4, tolerance=ErrorControl()).table.scheme.name == "rk4-doubled"
    assert error < 1e-6 and steps > 3 * COUNT


@pytest.fixture(scope="module")
def planets(cpu64):
    return Ensemble(Kepler(), Kepler().start(64), lanes=4)


@pytest.mark.parametrize("name", [s.name for s in schemes.CATALOGUE.values() if s.one_step and s.system_orders == {2}])
def test_splittings_run_by_step_doubling(planets, name):
    scheme, turn = schemes.doubled(schemes.get(name)), 2 * math.pi
    exact = Kepler().solution(turn, planets.start)
    tolerances, errors, reports = {1: (1e-5, 1e-7), 2: (1e-6, 1e-9), 4: (1e-7, 1e-11)}[scheme.order], [], []
    for rtol in tolerances:
        run = planets.run(scheme, [turn / 2, turn], turn, tolerance=ErrorControl(rtol=rtol, atol=rtol))
        errors.append(np.abs(run.states[-1] - exact).max())
        reports.append(run.report)
    fall = math.log(errors[0] / errors[1]) / math.log(tolerances[0] / tolerances[1])
    assert fall == pytest.approx(scheme.order / (scheme.order + 1), abs=0.1)
    assert reports[1].steps > reports[0].steps and reports[0].dt_max > 3 * reports[0].dt_min


@pytest.mark.parametrize("name", ["ab2", "abm4", "milne", "bdf2", "beeman", "crenshaw"])
@pytest.mark.parametrize("controller", [ErrorControl(), PixelTolerance()], ids=lambda c: type(c).__name__)
def test_schemes_that_cannot_be_doubled_are_refused(name, controller):
    with pytest.raises(InputError, match=f"scheme '{name}': its error cannot be estimated by step doubling"):
        check_fit(controller, "equal", schemes.get(name))


class Gust:
    """Still air, and a short gust about t = 1."""

    @ti.func
    def velocity(self, t, x):
        return ti.Vector([1e3 * ti.exp(-((t - 1.0) ** 2) * 1e4), 0.0, 0.0])


def test_steps_that_meet_a_gust_are_rejected_and_counted(cpu64):
    bench = Particles(tp.Advected(flow=Gust()), 5)
    bench.set("x", (0.0, 0.0, 0.0))
    options = {"lanes": 1, "tolerance": ErrorControl(rtol=1e-8, atol=1e-8)}
    # up to the gust with long steps, into it
    reports = [bench.run("dormand-prince", a, b, 1.0, **options) for a, b in ((0.0, 0.9), (0.9, 1.1), (1.1, 2.0))]
    assert [r.rejected > 0 for r in reports] == [False, True, False]
    assert reports[1].rejected % 5 == 0 and reports[1].steps > 10 * 5
    assert reports[1].dt_min < 0.01 < 0.3 < reports[0].dt_max
    # the integral of a Gaussian
    np.testing.assert_allclose(bench.get("x")[:, 0], 1e3 * math.sqrt(math.pi) / 100, rtol=1e-6)


@pytest.mark.parametrize("name", ["dormand-prince", "rk4", "tr-bdf2", "abm5-pec"])
def test_a_path_does_not_depend_on_the_neighbours(swelling, name):
    tolerance = ErrorControl(rtol=1e-6, atol=1e-6)
    rng = np.random.default_rng(7)
    x, birth = rng.uniform(0.5, 3.0, (COUNT, 3)), np.maximum(0.5, rng.uniform(0.0, 1.4, COUNT))

    def advance(x, birth):
        swelling.set("x", x)
        swelling.set("birth", birth)
        for k in range(2):
            swelling.run(name, k + 0.5, k + 1.5, 1.0, lanes=4, tolerance=tolerance)
        return swelling.get("x")

    crowd = advance(x, birth)
    order = rng.permutation(COUNT)
    assert np.array_equal(advance(x[order], birth[order]), crowd[order])
    for i in (0, 20, COUNT - 1):
        others = rng.uniform(0.1, 9.0, (COUNT, 3)), rng.uniform(0.5, 1.4, COUNT)
        others[0][i], others[1][i] = x[i], birth[i]
        assert np.array_equal(advance(*others)[i], crowd[i])


class Ending:
    """No number after t = 0.5 where x > 0."""

    @ti.func
    def velocity(self, t, x):
        return ti.Vector([ti.sqrt(ti.select(x[0] > 0.0, 0.5 - t, 0.25)), 0.0, 0.0])


@pytest.mark.parametrize("name", ["dormand-prince", "sdirk3", "abm5-pec"])
def test_a_law_that_ends_in_nan_leaves_nan_for_the_guard(cpu64, name):
    # No endless loop, and the particle that did not go there is unharmed.
    bench = Particles(tp.Advected(flow=Ending()), 2)
    bench.set("x", [(0.5, 0.0, 0.0), (-50.0, 0.0, 0.0)])
    report = bench.run(name, 0.0, 1.0, 1.0, lanes=2 if name == "sdirk3" else 1, tolerance=ErrorControl())
    x = bench.get("x")
    assert np.isnan(x[0]).any()
    np.testing.assert_allclose(x[1], (-49.5, 0.0, 0.0), rtol=1e-12)
    assert report.rejected > 10


class Emptying:
    """x' = 1 - 10 sqrt(x): no number below 0, where long steps go and the solution does not."""

    @ti.func
    def velocity(self, t, x):
        return ti.Vector([1.0 - 10.0 * ti.sqrt(x[0]), 0.0, 0.0])


@pytest.mark.parametrize("name", ["dormand-prince", "rk4", "abm5-pec"])
def test_a_step_that_ends_in_nan_is_rejected(cpu64, name):
    bench = Particles(tp.Advected(flow=Emptying()), 2)
    bench.set("x", (1.0, 0.0, 0.0))
    report = bench.run(name, 0.0, 2.0, 2.0, lanes=1, tolerance=ErrorControl())
    assert report.rejected > 0
    np.testing.assert_allclose(bench.get("x")[:, 0], 0.01, rtol=1e-3)  # its rest


class Roughness:
    """A rate that is no function of the state: every estimate is large."""

    @ti.func
    def velocity(self, t, x):
        wild = ti.sin(t * 1e15) * 1e6
        return ti.Vector([wild, 0.0, 0.0])


@pytest.mark.parametrize(("name", "lanes"), [("dormand-prince", 1), ("abm5-pec", 1), ("abm5-pec", 4)])
def test_a_tolerance_that_no_step_meets_ends_in_a_named_error(cpu64, name, lanes):
    bench = Particles(tp.Advected(flow=Roughness()), 3)
    bench.set("x", (0.0, 0.0, 0.0))
    bench.set("id", np.zeros(3))
    bench.columns["id"][0].from_numpy(np.arange(7, 7 + bench.columns.padded, dtype=np.int32))
    message = "particle 7: the tolerance asks for steps below 9.1e-13 of a frame, where rounding rules; loosen it"
    with pytest.raises(RunError, match=message):
        bench.run(name, 0.0, 1.0, 1.0, lanes=lanes, tolerance=ErrorControl(rtol=1e-13, atol=1e-13))


class NoRoot:
    """x' = x^2 + 1: backward Euler's x = x0 + h (x^2 + 1) has no root for long steps (h > 1/2 from x0 = 0)."""

    @ti.func
    def velocity(self, t, x):
        return ti.Vector([x[0] * x[0] + 1.0, 0.0, 0.0])


def test_where_newton_fails_steps_are_halved(cpu64):
    # from 0: tan t
    bench = Particles(tp.Advected(flow=NoRoot()), 3)
    bench.set("x", (0.0, 0.0, 0.0))
    report = bench.run("backward-euler", 0.0, 1.0, 1.0, lanes=1)
    assert report.rejected > 0 and report.dt_min <= 0.25
    x = bench.get("x")[:, 0]
    assert np.all((x > math.tan(1.0)) & (x < 50))
    # halving goes on where it has to: the solution ends at pi / 2
    with pytest.raises(
        RunError, match=r"particle 0: Newton's method finds no solution of scheme 'backward-euler', not even"
    ):
        bench.run("backward-euler", 1.0, 2.0, 1.0, lanes=1)


@pytest.mark.parametrize(
    ("controller", "precision", "least"),
    [
        (
            ErrorControl(rtol=1e-7),
            "f32",
            "ErrorControl.rtol = 1e-07: rounding in f32 allows at least 2e-06; --precision f64",
        ),
        (ErrorControl(rtol=1e-15), "f64", "ErrorControl.rtol = 1e-15: rounding in f64 allows at least 1e-14$"),
        (
            PixelTolerance(px=1e-3),
            "f32",
            "PixelTolerance.px = 0.001: rounding in f32 allows at least 0.01; --precision f64",
        ),
        (PixelTolerance(px=1e-10), "f64", "PixelTolerance.px = 1e-10: rounding in f64 allows at least 1e-09$"),
    ],
    ids=lambda v: str(v)[:30],
)
def test_tolerances_below_the_floor_are_refused(controller, precision, least):
    with pytest.raises(InputError, match=least):
        check_precision(controller, precision)


@pytest.mark.parametrize("controller", [ErrorControl(rtol=1e-14), PixelTolerance(px=1e-9), tp.Fixed(dt=1e-9)])
def test_the_floor_itself_is_allowed(controller):
    check_precision(controller, "f64")


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_tolerances_are_positive_numbers(bad):
    for make in (lambda: ErrorControl(rtol=bad), lambda: ErrorControl(atol=bad), lambda: PixelTolerance(px=bad)):
        with pytest.raises(InputError, match=r"(ErrorControl|PixelTolerance)\.(rtol|atol|px)"):
            make()


@pytest.fixture(scope="module")
def spinning(cpu64):
    return Particles(tp.Advected(flow=tp.Vortex(circulation=40.0, core=0.5)), 4)


def spin(bench, x, px, *, frame=1 / 24):
    """Run a frame in front of a camera at (0, -10, 0) that looks along y; return the report, positions, and the camera row."""
    pose = tp.Camera(position=(0.0, -10.0, 0.0), target=(0.0, 0.0, 0.0)).pose(0.0)
    row = camera_row(pose, 1280, 720)
    bench.set("x", x)
    bench.set("birth", 0.0)
    report = bench.run("bogacki-shampine", 0.0, frame, frame, lanes=1, tolerance=PixelTolerance(px=px), camera=row)
    return report, bench.get("x"), row


def test_a_dot_far_from_the_camera_takes_fewer_steps():
    near, far = (camera_steps(distance) for distance in (10.0, 1000.0))
    assert near > 2 * far


def camera_steps(distance):
    bench = Particles(tp.Advected(flow=tp.Vortex(circulation=40.0, core=0.5)), 1)
    row = camera_row(tp.Camera(position=(0.0, -distance, 0.0), target=(0.0, 0.0, 0.0)).pose(0.0), 1280, 720)
    bench.set("x", (0.4, 0.0, 0.3))
    return sum(
        bench.run(
            "bogacki-shampine", k, k + 1, 1.0, lanes=1, tolerance=PixelTolerance(px=0.5, growth=1), camera=row
        ).steps
        for k in range(3)
    )


@pytest.mark.parametrize("px", [1.0, 0.1, 0.01])
def test_a_dot_ends_a_frame_within_its_pixels(spinning, px):
    start = np.array([(0.3, 0.0, 0.2), (1.0, 0.0, 0.0), (0.0, 2.0, -1.0), (0.6, -7.0, 0.0)])
    report, x, row = spin(spinning, start, px, frame=0.25)
    r = np.hypot(start[:, 0], start[:, 1])
    turn = np.arctan2(start[:, 1], start[:, 0]) + 0.25 * 40.0 / (2 * np.pi * r**2) * -np.expm1(-((r / 0.5) ** 2))
    exact = np.stack([r * np.cos(turn), r * np.sin(turn), start[:, 2]], axis=1)

    def film(x):
        d = x - row[:3]
        return row[12] * np.stack([d @ row[3:6], d @ row[6:9]]) / (d @ row[9:12])

    off = np.linalg.norm(film(x.astype(float)) - film(exact), axis=0)
    assert off.max() < 2 * px
    assert report.steps > 4


def test_smaller_pixels_take_more_steps(spinning):
    steps = [spin(spinning, (0.3, 0.0, 0.2), px, frame=0.25)[0].steps for px in (1.0, 0.1, 0.01)]
    assert steps[0] < steps[1] < steps[2]
