"""The dyadic clamp's exact sequences, and the end of the frame to the bit, on the host and in the stepper."""

from fractions import Fraction

import numpy as np
import pytest
import taichi as ti
from fused_bench import Particles
from test_control import FRAME, REALS, sequence

import tparticles as tp
from tparticles.stepping.control import CLAMPS, dyadic

pytestmark = pytest.mark.usefixtures("cpu64")


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize(
    ("parts", "dt"),
    [
        ([1], 10 * FRAME),  # dt > frame
        ([1], FRAME),
        ([1], FRAME * (1 - 1e-6)),  # rounding does not cost a step
        ([1 / 2] * 2, FRAME * (1 - 1e-3)),  # a hair under the frame
        ([1 / 2] * 2, FRAME / 1.5),
        ([1 / 2] * 2, FRAME / 2),
        ([1 / 4] * 4, FRAME / 2.001),
        ([1 / 4] * 4, FRAME / 3),
        ([1 / 8] * 8, FRAME / 4.1),
        ([1 / 64] * 64, FRAME / 50),
        ([1 / 1024] * 1024, FRAME / 600),
    ],
)
def test_dyadic_takes_powers_of_two(real, parts, dt):
    # What is left is rounded once a step; `sequence` ends at 0 to the bit.
    steps = sequence(dyadic, FRAME, dt, real)
    np.testing.assert_allclose(steps, np.array(parts) * FRAME, rtol=2 * len(parts) * np.finfo(real).eps)


@pytest.mark.parametrize("real", REALS)
def test_dyadic_leads_a_birth_to_the_grid(real):
    # Born 0.7 of a frame before its end, dt = 0.3 frame: h = 1/4; first the 0.2 that is over, then two quarters.
    left, steps = real(0.7 * FRAME), []
    while left > 0:
        h = real(min(left, real(dyadic(left, real(0.3 * FRAME), real(FRAME)))))
        steps.append(h / FRAME)
        left = real(left - h)
    np.testing.assert_allclose(steps, [0.2, 0.25, 0.25], rtol=1e-5)


@pytest.mark.parametrize("ratio", [0.9, 0.55, 0.3, 0.11, 0.013])
def test_dyadic_steps_do_not_change_with_the_last_bits_of_dt(ratio):
    dt = ratio * FRAME
    first, second = (sequence(dyadic, FRAME, d) for d in (dt, dt * (1 + 1e-12)))
    assert np.array_equal(first, second)


class Clock:
    """x' = 1: where it is is how long it has gone."""

    @ti.func
    def velocity(self, t, x):
        return ti.Vector([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def clock(cpu64):
    return Particles(tp.Advected(flow=Clock()), 64)


@pytest.mark.parametrize("fps", [Fraction(24), Fraction(30000, 1001)])
@pytest.mark.parametrize("name", sorted(CLAMPS))
def test_the_stepper_takes_the_hosts_steps_and_no_more(clock, name, fps):
    for dt_in_frames in (3.0, 1 - 1e-3, 1 / 1.5, 0.6, 1 / 3, 0.11):
        for k in (0, 7, 100_000):
            t0, t1 = (float(Fraction(n) / fps) for n in (k, k + 1))
            clock.set("x", (0.0, 0.0, 0.0))
            clock.set("birth", -1.0)
            dt = dt_in_frames * (t1 - t0)
            report = clock.run("ab2", t0, t1, dt, clamp=name, lanes=1)
            steps = sequence(CLAMPS[name], t1 - t0, dt)
            assert report.steps == 64 * len(steps)
            assert report.dt_min == pytest.approx(steps.min(), rel=1e-6)
            assert report.dt_max == pytest.approx(steps.max(), rel=1e-6)
            np.testing.assert_allclose(clock.get("x")[:, 0], t1 - t0, rtol=1e-14)


@pytest.mark.parametrize("name", sorted(CLAMPS))
def test_births_end_on_the_frame_too(clock, name):
    birth = np.linspace(0.0, 1.0, 64) * FRAME
    clock.set("x", (0.0, 0.0, 0.0))
    clock.set("birth", birth)
    clock.run("ab2", 0.0, FRAME, 0.3 * FRAME, clamp=name, lanes=1)
    np.testing.assert_allclose(clock.get("x")[:, 0], FRAME - birth, rtol=1e-13, atol=1e-18)
    before = clock.get("x")
    assert clock.run("ab2", FRAME, FRAME, 0.3 * FRAME, clamp=name, lanes=1).steps == 0  # nothing is left
    assert np.array_equal(clock.get("x"), before)
