"""Curl noise: its speed, its statistics, its smoothness, the ground, and how it changes with time. In f64."""

import numpy as np
import pytest
from law_probe import FlowProbe, real

import tparticles as tp

pytestmark = pytest.mark.usefixtures("cpu64")
RNG = np.random.default_rng(0)


class Noise:
    """One compiled kernel for all frozen noises of one octave, and so on: other numbers are other data."""

    def __init__(self):
        self.compiled = {}

    def __call__(self, x, t=0.0, **options):
        flow = tp.CurlNoise(**options)
        kind = (flow.octaves, flow.period > 0, flow.ramp > 0)
        fresh = FlowProbe(flow)
        probe = self.compiled.setdefault(kind, fresh)
        probe.parameters._array = fresh.parameters.array
        return probe(x, t)


@pytest.fixture(scope="module")
def noise(cpu64):
    return Noise()


def points(count=200_000, size=400.0):
    return RNG.uniform(-size, size, (count, 3))


def rms(u):
    return float(np.sqrt((u**2).sum(axis=1).mean()))


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"speed": 0.3, "length": 2.5, "seed": 7},
        {"speed": 5.0, "period": 2.0},
        {"speed": 5.0, "period": 0.3, "drift": (1.0, 2.0, 3.0), "length": 0.2},
    ],
)
@pytest.mark.parametrize("t", [0.0, 12.34])
def test_speed_is_the_root_mean_square_of_the_first_octave(noise, options, t):
    found = rms(noise(points(), t, **options))
    assert found == pytest.approx(options.get("speed", 1.0), rel=0.01)


def test_octaves_add_up_in_power(noise):
    """Independent octaves: rms^2 = speed^2 sum gain^(2 o)."""
    found = rms(noise(points(), octaves=3, gain=0.6, lacunarity=1.9))
    assert found == pytest.approx(np.sqrt(1 + 0.36 + 0.36**2), rel=0.01)


@pytest.mark.parametrize("period", [0.0, 1.0])
def test_no_mean_and_no_preferred_direction(noise, period):
    u = noise(points(400_000), 0.3, period=period)
    # standard error of a mean 0.577 / sqrt(n) = 0.0009, of a correlation 0.0016
    assert np.abs(u.mean(axis=0)).max() < 0.005
    assert np.abs(np.corrcoef(u.T) - np.eye(3)).max() < 0.01
    np.testing.assert_allclose((u**2).mean(axis=0), 1 / 3, rtol=0.02)


def test_lattice_points_are_not_at_rest(noise):
    corners = RNG.integers(-100, 100, (20_000, 3)).astype(float)
    assert 1.4 < rms(noise(corners)) < 1.8  # 2 |a|, against 1 on average
    faces = corners + np.array([0.5, 0.5, 0.0])
    assert 0.6 < rms(noise(faces)) < 1.0


@pytest.mark.parametrize("other", [{"seed": 1}, {"seed": 2**33}])
def test_seeds_and_octaves_decorrelate(noise, other):
    x = points(100_000)
    a, b = noise(x), noise(x, **other)
    for k in range(3):
        assert abs(np.corrcoef(a[:, k], b[:, k])[0, 1]) < 0.015
    both = noise(x, octaves=2, gain=1.0, lacunarity=1.0)
    second = both - a
    assert rms(second) == pytest.approx(1.0, rel=0.02)
    assert abs(np.corrcoef(a[:, 0], second[:, 0])[0, 1]) < 0.015


def test_distant_points_decorrelate(noise):
    x = points(100_000)
    for shift in ((3.0, 0, 0), (0, 17.0, 0), (64.0, 64.0, 64.0), (0, 0, 256.0)):
        a, b = noise(x), noise(x + np.array(shift))
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.01


@pytest.mark.parametrize("options", [{}, {"octaves": 3, "ramp": 0.7, "period": 1.0}])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_velocity_is_continuous_across_cells(noise, options, axis):
    x = points(4000, 5.0)
    x[:, 2] = np.abs(x[:, 2])
    x[:, axis] = np.round(x[:, axis])
    step = 1e-7 * np.eye(3)[axis]
    jump = noise(x + step, 0.2, **options) - noise(x - step, 0.2, **options)
    assert np.abs(jump).max() < 1e-7 * 2 * 200  # as far as a gradient of 200 /s would carry


@pytest.mark.parametrize("edge", [0.35, 0.85])
def test_velocity_is_continuous_at_both_ends_of_the_ramp(noise, edge):
    x = points(4000, 5.0)
    x[:, 2] = edge
    step = np.array([0.0, 0.0, 1e-7])
    jump = noise(x + step, ramp=0.5, ground=0.35) - noise(x - step, ramp=0.5, ground=0.35)
    assert np.abs(jump).max() < 1e-7 * 2 * 50


def test_nothing_flows_through_the_ground_and_the_ramp_ends(noise):
    x = points(5000, 5.0)
    options = {"octaves": 3, "period": 1.0, "ground": 0.35, "ramp": 0.5}
    x[:, 2] = 0.35
    assert (noise(x, 1.7, **options) == 0).all()
    x[:, 2] = RNG.uniform(-3, 0.35, len(x))
    assert (noise(x, 1.7, **options) == 0).all()
    x[:, 2] = 0.85 + RNG.uniform(0, 3, len(x))
    free = options | {"ramp": 0.0}
    np.testing.assert_allclose(noise(x, 1.7, **options), noise(x, 1.7, **free), atol=1e-12)
    # close to the ground u_z falls off as the cube of the height, the flow along it as its square
    speeds = []
    for height in (0.02, 0.01):
        x[:, 2] = 0.35 + height
        u = noise(x, 1.7, **options)
        speeds.append((rms(u[:, 2:]), rms(u[:, :2])))
    (up, along), (lower_up, lower_along) = speeds
    assert up / lower_up == pytest.approx(8, rel=0.2)
    assert along / lower_along == pytest.approx(4, rel=0.2)


def test_the_pattern_drifts(noise):
    x, v = points(1000, 5.0), np.array([0.5, -1.0, 2.0])
    options = {"octaves": 2, "drift": tuple(v)}
    np.testing.assert_allclose(noise(x + 3.0 * v, 3.0, **options), noise(x, 0.0, **options), atol=1e-10)


def test_a_frozen_pattern_stays(noise):
    x = points(100, 5.0)
    assert (noise(x, 0.0) == noise(x, 1e3)).all()


def test_gradients_swing_with_their_period(noise):
    x = points(3000, 20.0)
    at = [noise(x, t, period=1.6) for t in (0.0, 0.8, 1.6, 16.0)]
    np.testing.assert_allclose(at[1], -at[0], atol=1e-12)  # half a period on, the wave is its own negative
    np.testing.assert_allclose(at[2], at[0], atol=1e-12)
    np.testing.assert_allclose(at[3], at[0], atol=1e-11)
    quarter = noise(x, 0.4, period=1.6)
    assert abs(np.corrcoef(quarter.ravel(), at[0].ravel())[0, 1]) < 0.05


def test_smaller_octaves_swing_faster(noise):
    """By lacunarity^(2/3), Kolmogorov: with 8 that is 4 times."""
    x = points(3000, 20.0)
    options = {"octaves": 2, "lacunarity": 8.0, "gain": 1.0, "period": 1.0}

    def second(t):
        return noise(x, t, **options) - noise(x, t, **(options | {"octaves": 1}))

    np.testing.assert_allclose(second(0.25), second(0.0), atol=1e-10)
    assert np.abs(second(0.125) + second(0.0)).max() < 1e-10


def test_velocity_changes_smoothly_with_time(noise):
    """Also where the phase wraps and where it passes from one of its 1024 levels to the next."""
    x, dt = points(2000, 20.0), 1e-6
    times = np.concatenate([RNG.uniform(0, 2, 20), np.arange(9) / 512 + 1e-9, [1.0, 2.0]])
    rates = []
    for t in times:
        before, now, after = (noise(x, s, period=1.0) for s in (t - dt, t, t + dt))
        first, then = (now - before) / dt, (after - now) / dt
        rates.append(np.abs(then).max())
        assert np.abs(then - first).max() < 1e-3  # the slope itself is continuous: u'' of order 100, times dt
    # |da/dt| <= 8 / period on corners that move with up to 2 |a|
    assert max(rates) < 60


def test_slow_and_far_is_as_smooth(noise):
    x = points(2000, 1e4)
    u, v = noise(x, 1e4, period=1.0), noise(x + 1e-6, 1e4, period=1.0)
    assert real() is np.float64
    assert np.abs(u - v).max() < 1e-4
