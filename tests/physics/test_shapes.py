"""Where and how particles are born: inside their shape, uniform, and with the distributions named. In f32, as films run."""

import itertools
import math
from statistics import NormalDist

import numpy as np
import pytest
import taichi as ti
from law_probe import Probe, SampleProbe

import tparticles as tp
from tparticles.errors import InputError

pytestmark = pytest.mark.usefixtures("cpu32")
COUNT = 200_000


def uniform_error(u):
    """Return the Kolmogorov distance of `u` from uniform on (0, 1), times sqrt(n): above 2.2 with p = 1e-4."""
    u = np.sort(np.asarray(u, np.float64))
    return float(np.abs(u - (np.arange(len(u)) + 0.5) / len(u)).max() * math.sqrt(len(u)))


def sample(law, width=3, count=COUNT):
    return SampleProbe(law, width)(count).astype(np.float64)


def assert_uncorrelated(*columns):
    assert np.abs(np.corrcoef(columns) - np.eye(len(columns))).max() < 4.5 / math.sqrt(COUNT)


def test_point():
    assert (sample(tp.Point(position=(1.0, -2.0, 0.5)), count=100) == [1.0, -2.0, 0.5]).all()


def test_line():
    start, end = np.array([1.0, 2.0, 3.0]), np.array([-1.0, 2.0, 7.0])
    x = sample(tp.Line(start=tuple(start), end=tuple(end)))
    u = (x - start) @ (end - start) / 20.0
    assert uniform_error(u) < 2.2 and u.min() >= 0 and u.max() <= 1
    np.testing.assert_allclose(x, start + np.outer(u, end - start), atol=2e-6)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 2, -2), (1e-25, 0, 0), (1e20, 1e20, 0)])
def test_disc(normal):
    x = sample(tp.Disc(center=(1.0, 2.0, 3.0), radius=0.5, normal=normal)) - [1.0, 2.0, 3.0]
    n = np.array(normal, float) / max(map(abs, normal))
    n /= np.linalg.norm(n)
    assert np.abs(x @ n).max() < 1e-6
    r = np.linalg.norm(x, axis=1)
    assert r.max() <= 0.5 * (1 + 1e-5)
    across = np.cross(n, [0.3, -0.5, 0.7])
    across /= np.linalg.norm(across)
    angle = np.arctan2(x @ np.cross(n, across), x @ across) / (2 * math.pi) + 0.5
    assert uniform_error((r / 0.5) ** 2) < 2.2 and uniform_error(angle) < 2.2
    assert_uncorrelated(r, angle, np.abs(angle - 0.5))


@pytest.mark.parametrize("surface", [False, True])
def test_sphere(surface):
    x = sample(tp.Sphere(center=(1.0, 0.0, -1.0), radius=2.0, surface=surface)) - [1.0, 0.0, -1.0]
    r = np.linalg.norm(x, axis=1)
    if surface:
        np.testing.assert_allclose(r, 2.0, rtol=1e-6)
    else:
        assert r.max() <= 2.0 * (1 + 1e-6)
        assert uniform_error((r / 2) ** 3) < 2.2
    # by Archimedes, every coordinate of a point on a sphere is uniform
    for k in range(3):
        assert uniform_error(x[:, k] / r / 2 + 0.5) < 2.2
    assert_uncorrelated(*x.T)


def test_box():
    low, high = np.array([-1.0, 0.0, 2.0]), np.array([1.0, 0.5, 2.0])
    x = sample(tp.Box(low=tuple(low), high=tuple(high)))
    assert (x >= low).all() and (x <= high).all()
    assert (x[:, 2] == 2.0).all()
    for k in (0, 1):
        assert uniform_error((x[:, k] - low[k]) / (high[k] - low[k])) < 2.2
    assert_uncorrelated(x[:, 0], x[:, 1])


@ti.func
def inside(law: ti.template(), row):
    return ti.Vector([ti.cast(law.contains(ti.Vector([row[0], row[1], row[2]])), float)])


def test_regions_contain_what_is_inside():
    x = np.random.default_rng(0).uniform(-2, 2, (20_000, 3)).astype(np.float32)
    ball = Probe(tp.Sphere(center=(0.5, 0.0, 0.0), radius=1.0), inside, arguments=3)(*x.T)
    assert (ball == (((x - np.float32([0.5, 0, 0])) ** 2).sum(axis=1) <= 1.0)).mean() > 0.9999
    box = Probe(tp.Box(low=(-1.0, -2.0, 0.0), high=(1.0, 0.5, 1.5)), inside, arguments=3)(*x.T)
    assert (box == ((x >= [-1, -2, 0]) & (x <= [1, 0.5, 1.5])).all(axis=1)).all()


@pytest.mark.parametrize("angle", [0.01, 15.0, 90.0, 180.0])
def test_cone_is_uniform_in_its_solid_angle(angle):
    axis = np.array([1.0, -2.0, 2.0]) / 3
    v = sample(tp.Cone(axis=(3.0, -6.0, 6.0), angle=angle, speed=2.0))
    np.testing.assert_allclose(np.linalg.norm(v, axis=1), 2.0, rtol=1e-6)
    # the height of the cap, 2 sin^2(a / 2), is uniform; atan2 keeps narrow cones exact
    across = v - np.outer(v @ axis, axis)
    polar = np.arctan2(np.linalg.norm(across, axis=1), v @ axis)
    assert polar.max() <= math.radians(angle) * (1 + 1e-4) + 1e-6
    if angle > 1:
        assert uniform_error(np.sin(polar / 2) ** 2 / math.sin(math.radians(angle) / 2) ** 2) < 2.2
    else:
        assert polar.mean() == pytest.approx(2 / 3 * math.radians(angle), rel=0.01)


def test_a_cone_of_no_angle_is_its_axis():
    v = sample(tp.Cone(axis=(0.0, 0.0, -5.0), speed=(3.0, 1.0)), count=1000)
    assert (v[:, :2] == 0).all() and v[:, 2].max() <= -2.0 and v[:, 2].min() >= -4.0
    assert v[:, 2].std() == pytest.approx(1 / math.sqrt(3), rel=0.1)


def test_uniform_spread_is_reeves_rule():
    spread = tp.Spread(mean=10.0, variance=2.0)
    v = sample(spread, width=1)
    assert (spread.low, spread.high, spread.varies) == (8.0, 12.0, True)
    assert v.min() >= 8.0 and v.max() <= 12.0
    assert uniform_error((v - 8) / 4) < 2.2


def test_normal_spread_is_truncated_at_three():
    spread = tp.Spread(mean=1.0, variance=0.1, distribution="normal")
    z = (sample(spread, width=1) - 1.0) / 0.1
    assert spread.low == pytest.approx(0.7) and spread.high == pytest.approx(1.3)
    assert np.abs(z).max() <= 3.0 + 1e-5
    # the distribution between -3 and 3, without heaps at the ends
    cut = math.erf(3 / math.sqrt(2))
    grid = np.linspace(-3, 3, 61)
    share = np.array([(2 * NormalDist().cdf(g) - 1) / cut for g in grid]) / 2 + 0.5
    found = np.searchsorted(np.sort(z), grid) / len(z)
    assert np.abs(found - share).max() < 2.2 / math.sqrt(COUNT)
    assert (np.abs(z) > 2.99).mean() < 3e-4
    assert z.std() == pytest.approx(0.9866, abs=0.006)


def test_a_constant_spread_is_constant():
    assert (sample(tp.Spread(mean=0.25), width=1, count=100) == 0.25).all()
    assert not tp.Spread(mean=0.25).varies


def test_streams_and_draws_differ():
    probe = SampleProbe(tp.Spread(mean=0.0, variance=1.0), 1)
    kinds = [probe(1000, key=key, draw=draw) for key, draw in itertools.product((1, 2), (0, 1))]
    for a, b in itertools.combinations(kinds, 2):
        assert abs(np.corrcoef(a, b)[0, 1]) < 0.15
    assert (probe(1000, key=1) == kinds[0]).all()


def test_numbers_and_pairs_make_spreads():
    births = tp.Rate(rate=1.0)
    assert tp.Emitter(births=births, size=2).size == tp.Spread(mean=2.0)
    assert tp.Emitter(births=births, size=(2, 1)).size == tp.Spread(mean=2.0, variance=1.0)
    assert tp.Emitter(births=births, size=[2, 1]).size == tp.Spread(mean=2.0, variance=1.0)
    assert tp.Cone(speed=tp.Spread(mean=1.0)).speed == tp.Spread(mean=1.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tp.Disc(radius=1.0, normal=(0, 0, 0)), r"Disc\.normal = .*must not be zero"),
        (lambda: tp.Cone(axis=(0, 0, 0)), r"Cone\.axis = .*must not be zero"),
        (lambda: tp.Disc(radius=0.0), r"Disc\.radius = 0\.0: should be greater than 0"),
        (lambda: tp.Box(low=(0, 0, 1), high=(1, 1, 0)), r"Box\.low = .* must not exceed Box\.high"),
        (lambda: tp.Cone(angle=181), r"Cone\.angle = 181: should be less than or equal to 180"),
        (lambda: tp.Cone(angle=math.nan), r"Cone\.angle = nan: should be a finite number"),
        (lambda: tp.Cone(speed=True), r"Cone\.speed = True: should be a Spread"),
        (lambda: tp.Line(start=(0, 0, 0)), r"Line\.end is missing"),
        (lambda: tp.Spread(mean=1.0, variance=-1.0), r"Spread\.variance = -1\.0"),
        (lambda: tp.Spread(mean=1.0, distribution="gauss"), r"Spread\.distribution = 'gauss'.*'uniform' or 'normal'"),
    ],
)
def test_wrong_shapes_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
