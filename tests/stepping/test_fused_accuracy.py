"""The fused stepper in f64 against closed forms and against the scheme's plain interpreter."""

import dataclasses
import math

import numpy as np
import pytest
import taichi as ti
from fused_bench import ONE_STEP, Particles

import tparticles as tp
from tparticles import schemes
from tparticles.stepping.control import CLAMPS, equal

pytestmark = pytest.mark.usefixtures("cpu64")

COUNT = 37  # two whole blocks of lanes and a part of one
BY_NAME = pytest.mark.parametrize("scheme", ONE_STEP, ids=lambda scheme: scheme.name)


class Swelling:
    """Nonlinear, with time on the right-hand side: x = 1 / (1 + t^2), y = 2 + sin t, z = c exp(sin t)."""

    @ti.func
    def velocity(self, t, x):
        s = 2.0 + ti.sin(t)
        return ti.Vector([-2.0 * t * x[0] * x[0], ti.cos(t) + 0.25 * (s * s - x[1] * x[1]), x[2] * ti.cos(t)])

    @staticmethod
    def rate(t, x):
        s = 2 + np.sin(t)
        return np.stack([-2 * t * x[0] ** 2, np.cos(t) + 0.25 * (s * s - x[1] ** 2), x[2] * np.cos(t)])

    @staticmethod
    def solution(t, c):
        return np.stack(np.broadcast_arrays(1 / (1 + t**2), 2 + np.sin(t), c * np.exp(np.sin(t))), axis=-1)


@dataclasses.dataclass(frozen=True)
class Oscillator:
    """a = -omega^2 x - 2 zeta omega v + drive cos(t)."""

    omega: float = 3.0
    zeta: float = 0.2
    drive: float = 0.5

    @ti.func
    def acceleration(self, t, x, v):
        return self.drive * ti.cos(t) - self.omega * self.omega * x - 2.0 * self.zeta * self.omega * v

    def rate(self, t, z):
        x, v = z[:3], z[3:]
        return np.concatenate(
            [v, self.drive * np.cos(t) - self.omega * self.omega * x - 2 * self.zeta * self.omega * v]
        )

    def solution(self, t, x0, v0):
        """Return x(t) from x(0) and v(0): the particular solution is p cos t + q sin t."""
        w, damping = self.omega, self.zeta * self.omega
        p, q = self.drive * np.array([w**2 - 1, 2 * damping]) / ((w**2 - 1) ** 2 + 4 * damping**2)
        wd = w * math.sqrt(1 - self.zeta**2)
        a, b = x0 - p, (v0 - q + damping * (x0 - p)) / wd
        return np.exp(-damping * t) * (a * np.cos(wd * t) + b * np.sin(wd * t)) + p * np.cos(t) + q * np.sin(t)


@pytest.fixture(scope="module")
def swelling(cpu64):
    return Particles(tp.Advected(flow=Swelling()), COUNT)


@pytest.fixture(scope="module")
def oscillator(cpu64):
    return Particles(tp.Newtonian(forces=Oscillator()), COUNT)


@pytest.fixture(scope="module")
def falling(cpu64):
    return Particles(tp.Newtonian(forces=(tp.Gravity(), tp.Drag(time=0.3, flow=tp.Uniform(wind=(2.0, 0, -1))))), COUNT)


def slope(errors, steps):
    """Return the order from the finest pair of runs that is well above rounding."""
    pairs = [
        math.log(a / b) / math.log(m / n)
        for a, b, n, m in zip(errors, errors[1:], steps, steps[1:], strict=False)
        if b > 3e-13
    ]
    assert pairs, errors
    return pairs[-1]


STEPS = (16, 32, 64, 128, 256)
_HIGH = 8  # an order whose errors reach rounding before their leading term rules alone: the slope may be steeper


def steps_for(scheme):
    """Return how many steps to try."""
    return STEPS if scheme.order < _HIGH else (2, 3, 4, 6, 8)


def check_order(scheme, errors):
    above = 0.1 if scheme.order < _HIGH else 0.8
    assert scheme.order - 0.1 < slope(errors, steps_for(scheme)) < scheme.order + above, errors


def _lanes(scheme):
    """Return the block in which a second-order system is stepped: single lanes, as on a GPU, compile in half the time."""
    return None if scheme.name == "rk4" else 1


@BY_NAME
def test_order_of_a_first_order_system(swelling, scheme):
    c, errors = np.linspace(0.5, 1.5, COUNT), []
    for n in steps_for(scheme):
        swelling.set("x", Swelling.solution(0.5, c))
        swelling.set("birth", -1.0)
        report = swelling.run(scheme, 0.5, 2.0, 1.5 / n)
        assert report.steps == n * COUNT
        errors.append(np.abs(swelling.get("x") - Swelling.solution(2.0, c)).max())
    check_order(scheme, errors)


@BY_NAME
def test_order_of_a_second_order_system(oscillator, scheme):
    rng = np.random.default_rng(1)
    x0, v0 = rng.uniform(-1, 1, (2, COUNT, 3))
    exact, errors = oscillator.system.forces[0].solution(1.5, x0, v0), []
    for n in steps_for(scheme):
        oscillator.set("x", x0)
        oscillator.set("v", v0)
        oscillator.run(scheme, 0.0, 1.5, 1.5 / n, lanes=_lanes(scheme))
        errors.append(np.abs(oscillator.get("x") - exact).max())
    check_order(scheme, errors)


@pytest.mark.parametrize("scheme", [schemes.get("rk4")], ids=lambda scheme: scheme.name)
def test_gravity_and_drag_against_the_closed_form(falling, scheme):
    rng = np.random.default_rng(2)
    x0, v0 = rng.uniform(-5, 5, (2, COUNT, 3))
    tau, end = 0.3, np.array([2.0, 0, -1]) + 0.3 * np.array([0, 0, -9.81])  # terminal velocity: wind + g tau
    exact, errors = x0 + end * 0.9 + (v0 - end) * tau * (1 - math.exp(-0.9 / tau)), []
    for n in STEPS:
        falling.set("x", x0)
        falling.set("v", v0)
        falling.run(scheme, 10.0, 10.9, 0.9 / n)
        errors.append(np.abs(falling.get("x") - exact).max())
    assert slope(errors, STEPS) == pytest.approx(scheme.order, abs=0.1), errors


@pytest.mark.parametrize(
    ("scheme", "clamp"),
    [*((scheme, "equal") for scheme in ONE_STEP), (schemes.get("rk4"), "slide32")],
    ids=lambda value: getattr(value, "name", value),
)
def test_agrees_with_the_plain_interpreter(swelling, oscillator, scheme, clamp):
    rng = np.random.default_rng(3)
    benches = [(swelling, Swelling.rate, ["x"]), (oscillator, Oscillator().rate, ["x", "v"])]
    for bench, rate, names in benches[: 2 if clamp == "equal" else 1]:
        z = rng.uniform(0.5, 1.0, (3 * len(names), COUNT))
        for k, name in enumerate(names):
            bench.set(name, z[3 * k : 3 * k + 3].T)
        t, left, dt = 0.25, 1 / 24, 1 / 24 / 7.3
        bench.run(scheme, t, t + left, dt, clamp=clamp, lanes=None if bench is swelling else _lanes(scheme))
        left = (t + left) - t
        while left > 0:
            h = min(left, CLAMPS[clamp](left, dt, 1.5))
            z = schemes.step(scheme, rate, t + (1 / 24 - left), z, h)
            left -= h
        for k, name in enumerate(names):
            np.testing.assert_allclose(bench.get(name), z[3 * k : 3 * k + 3].T, rtol=1e-14, atol=1e-14)


def test_a_vortex_turns_particles_on_circles(cpu64):
    bench = Particles(tp.Advected(flow=tp.Vortex(center=(1.0, 0, 0), circulation=5.0, core=0.7)), COUNT)
    r, angle = np.linspace(0.01, 3.0, COUNT), np.linspace(0, 6, COUNT)
    bench.set("x", np.stack([1 + r * np.cos(angle), r * np.sin(angle), r], axis=1))
    for frame in range(24):
        bench.run("rk4", frame / 24, (frame + 1) / 24, 1 / 480)
    turned = angle + 5.0 / (2 * np.pi * r**2) * -np.expm1(-((r / 0.7) ** 2))
    exact = np.stack([1 + r * np.cos(turned), r * np.sin(turned), r], axis=1)
    np.testing.assert_allclose(bench.get("x"), exact, atol=2e-9)


@BY_NAME
def test_births_inside_a_frame_keep_the_order(swelling, scheme):
    # Born anywhere in the frame, from the state of the closed form at birth: at its end as accurate as all others.
    birth, c, errors = np.linspace(0.5, 1.99, COUNT), np.linspace(0.5, 1.5, COUNT), []
    born = Swelling.solution(birth, c)
    for n in steps_for(scheme):
        swelling.set("x", born)
        swelling.set("birth", birth)
        report = swelling.run(scheme, 0.5, 2.0, 1.5 / n)
        spans = 2.0 - birth
        assert report.steps == sum(math.ceil(span / (1.5 / n) - 1e-4) for span in spans)
        assert report.dt_max == pytest.approx(max(equal(s, 1.5 / n, 1.5) for s in spans), rel=1e-6)
        assert report.dt_min == pytest.approx(min(equal(s, 1.5 / n, 1.5) for s in spans), rel=1e-6)
        errors.append(np.abs(swelling.get("x") - Swelling.solution(2.0, c)).max())
    swelling.set("birth", 0.0)
    check_order(scheme, errors)


def test_a_birth_at_the_end_of_a_frame_changes_nothing(swelling):
    swelling.set("x", (1.0, 1.0, 1.0))
    swelling.set("birth", 2.0)
    assert swelling.run("rk4", 0.5, 2.0, 0.1).steps == 0
    assert np.all(swelling.get("x") == 1.0)
    swelling.set("birth", 0.0)
