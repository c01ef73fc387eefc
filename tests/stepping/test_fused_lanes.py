"""Blocks of lanes in f32: a particle never depends on its neighbours, and the clamp is the same on host and device."""

import math

import numpy as np
import pytest
import taichi as ti
from fused_bench import Particles

import tparticles as tp
from tparticles.errors import InputError
from tparticles.stepping.control import CLAMPS

pytestmark = pytest.mark.usefixtures("cpu32")

COUNT = 1000
T0, T1 = 2.0, 2.0 + 1 / 24


@pytest.fixture(scope="module")
def smoke(cpu32):
    flow = tp.Vortex(circulation=3.0) + tp.CurlNoise(speed=1.0, octaves=3, period=1.0, drift=(0.2, 0.0, 1.0))
    return Particles(tp.Advected(flow=flow), COUNT, names=("v",))


@pytest.fixture(scope="module")
def start():
    rng = np.random.default_rng(5)
    birth = np.where(np.arange(COUNT) % 3 == 0, rng.uniform(T0, T1, COUNT), rng.uniform(0, T0, COUNT))
    return rng.uniform(-2, 2, (COUNT, 3)).astype(np.float32), birth


def advance(bench, x, birth, *, count=COUNT, **options):
    bench.set("x", x)
    bench.set("birth", birth)
    bench.count, before = count, bench.count
    report = bench.run(options.pop("scheme", "rk4"), T0, T1, 1 / 100, **options)
    found = bench.get("x"), bench.get("v")
    bench.count = before
    return *found, report


@pytest.mark.parametrize("clamp", ["equal", "slide32"])
def test_a_particle_alone_is_the_particle_in_a_crowd(smoke, start, clamp):
    x, birth = start
    crowd, speed, report = advance(smoke, x, birth, clamp=clamp)
    assert report.steps >= 3 * COUNT
    for i in (0, 3, 17, 500, 999):
        others = np.full((COUNT, 3), np.nan), np.full(COUNT, np.nan)
        others[0][0], others[1][0] = x[i], birth[i]
        alone, own_speed, _ = advance(smoke, *others, count=1, clamp=clamp)
        assert np.array_equal(alone[0], crowd[i]) and np.array_equal(own_speed[0], speed[i]), i
    order = np.random.default_rng(6).permutation(COUNT)
    shuffled, *_ = advance(smoke, x[order], birth[order], clamp=clamp)
    assert np.array_equal(shuffled, crowd[order])


def test_single_lanes_agree_with_blocks(smoke, start):
    # Not to the bit: LLVM contracts and vectorises the two loops differently. A GPU walks single lanes.
    blocks, speed, report = advance(smoke, *start)
    single, own_speed, own_report = advance(smoke, *start, lanes=1)
    assert own_report == report
    np.testing.assert_allclose(single, blocks, atol=3e-6)
    np.testing.assert_allclose(own_speed, speed, atol=3e-5)


def test_two_runs_are_equal_to_the_bit(smoke, start):
    first, second = advance(smoke, *start), advance(smoke, *start)
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_the_velocity_kept_for_streaks_is_the_flow_at_the_end(cpu32):
    bench = Particles(tp.Advected(flow=tp.Vortex(circulation=4.0, core=0.5)), 33, names=("v",))
    bench.set("x", np.linspace(0.1, 2, 99).reshape(33, 3))
    bench.run("euler", 0.0, 1.0, 0.5)
    x = bench.get("x").astype(float)
    s = (x[:, 0] ** 2 + x[:, 1] ** 2) / 0.25
    turn = 4.0 / (2 * math.pi * 0.25) * -np.expm1(-s) / s
    np.testing.assert_allclose(bench.get("v"), np.stack([-turn * x[:, 1], turn * x[:, 0], 0 * s], axis=1), atol=1e-5)
    before = bench.get("v")
    assert bench.run("euler", 1.0, 1.0, 0.5).steps == 0  # nothing to do, and the velocity stands
    assert np.array_equal(bench.get("v"), before)


class Ending:
    """Infinite once t reaches 1, where finished lanes wait for the others."""

    @ti.func
    def velocity(self, t, x):
        return ti.Vector([1.0 / ti.max(0.0, 1.0 - t), 0.0, 0.0])


def test_a_lane_that_has_arrived_waits_unharmed(cpu32):
    bench = Particles(tp.Advected(flow=Ending()), 16)
    bench.set("x", np.zeros((16, 3)))
    bench.set("birth", [0.0] * 8 + [0.9] * 8)  # eight take 4 steps, eight take 1
    bench.run("euler", 0.0, 1.0, 0.25)
    assert np.all(np.isfinite(bench.get("x")))
    expected = sum(0.25 / (1 - k / 4) for k in range(4))
    np.testing.assert_allclose(bench.get("x")[:, 0], [expected] * 8 + [1.0] * 8, rtol=1e-5)


@pytest.mark.parametrize("name", sorted(CLAMPS))
def test_the_clamp_is_the_same_on_host_and_device(cpu32, name):
    clamp = CLAMPS[name]

    @ti.kernel
    def on_device(left: ti.types.ndarray(ndim=1), dt: ti.types.ndarray(ndim=1), out: ti.types.ndarray(ndim=1)):
        for i in range(left.shape[0]):
            out[i] = clamp(left[i], dt[i], 1 / 24)

    rng = np.random.default_rng(4)
    left = np.concatenate([rng.uniform(0.01, 0.05, 2000), np.repeat(1 / 24, 6)]).astype(np.float32)
    ties = np.array([1, 1.5, 2, 3, 4, 1 + 1e-7]) * 24
    dt = np.concatenate([left[:2000] * rng.uniform(0.05, 1.5, 2000), 1 / ties]).astype(np.float32)
    out = np.empty_like(left)
    on_device(left, dt, out)
    host = np.array([clamp(a, b, 1 / 24) for a, b in zip(left, dt, strict=True)], np.float32)
    np.testing.assert_allclose(out, host, rtol=3e-7)


def test_an_empty_group_takes_no_step(smoke):
    assert smoke.stepper("rk4").advance(0, 0.0, 1.0, 0.1).steps == 0


def test_blocks_must_fit_the_columns(smoke):
    with pytest.raises(InputError, match="blocks of 11 lanes do not fit columns that are padded to 1008"):
        smoke.run("rk4", 0.0, 1.0, 0.1, lanes=11)
