"""Step controllers and the frame clamp: exact sequences of steps, on the host and as f32 arithmetic has them."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tparticles import schemes
from tparticles.errors import InputError
from tparticles.physics.law import Bound
from tparticles.stepping.control import CLAMPS, Fixed, StabilityLimit, equal, frame_step, slide32

FRAME = 1 / 24
REALS = (np.float32, np.float64)


def sequence(clamp, frame, dt, real=np.float64, most=5000):
    """Walk one frame as the stepper does; the time left ends at exactly zero."""
    left, dt, steps = real(frame), real(dt), []
    while left > 0:
        h = real(min(left, real(clamp(left, dt, real(frame)))))
        assert h > 0
        steps.append(h)
        left = real(left - h)
        assert len(steps) <= most, "the frame does not end"
    assert left == 0
    return np.array(steps)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize(
    ("parts", "dt"),
    [
        ([1], 10 * FRAME),  # dt > frame
        ([1], FRAME),
        ([1], FRAME * (1 + 1e-6)),
        ([0.5, 0.5], FRAME * (1 - 1e-3)),  # a hair under the frame: two halves, no sliver
        ([0.5, 0.5], FRAME / 1.5),
        ([0.5, 0.5], FRAME / 2),
        ([1 / 3] * 3, FRAME / 2.001),
        ([1 / 3] * 3, FRAME / 3),
        ([1 / 4] * 4, 1 / 96),
        ([1 / 5] * 5, FRAME / 4.1),
    ],
)
def test_equal_takes_the_fewest_equal_steps(real, parts, dt):
    np.testing.assert_allclose(sequence(equal, FRAME, dt, real), np.array(parts) * FRAME, rtol=8 * np.finfo(real).eps)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize(
    ("parts", "dt"),
    [
        ([1], 10 * FRAME),
        ([1], FRAME),
        ([1], FRAME * (1 + 1e-6)),
        ([0.5, 0.5], FRAME * (1 - 1e-3)),
        ([0.5, 0.5], FRAME / 1.49),
        ([0.5, 0.5], FRAME / 1.5),  # a tie: 1.5 dt meets the frame
        ([0.6, 0.4], 0.6 * FRAME),  # the two steps that break velocity Verlet
        ([0.5, 0.5], FRAME / 2),
        ([0.4, 0.3, 0.3], 0.4 * FRAME),
        ([0.3, 0.3, 0.2, 0.2], 0.3 * FRAME),
    ],
)
def test_slide32_takes_the_lectures_steps(real, parts, dt):
    np.testing.assert_allclose(
        sequence(slide32, FRAME, dt, real), np.array(parts) * FRAME, rtol=32 * np.finfo(real).eps
    )


def test_a_hair_under_the_frame_is_the_frame_within_rounding():
    for clamp in CLAMPS.values():
        assert len(sequence(clamp, FRAME, FRAME * (1 - 1e-7))) == 1


@given(
    frame=st.floats(1e-3, 1.0),
    ratio=st.floats(1e-3, 3.0),
    real=st.sampled_from(REALS),
    name=st.sampled_from(sorted(CLAMPS)),
)
@settings(max_examples=300, deadline=None)
def test_every_frame_ends_without_overrun_or_sliver(frame, ratio, real, name):
    dt, eps = frame * ratio, float(np.finfo(real).eps)
    steps = sequence(CLAMPS[name], frame, dt, real)
    total = math.fsum(map(float, steps))
    assert total == pytest.approx(float(real(frame)), rel=2 * eps * len(steps))
    # 1e-4 (equal) or 1e-6 (slide32) of a step is allowed beyond dt, so that rounding does not cost a step
    assert steps.max() <= real(dt) * (1 + 1.1e-4)
    assert steps.min() >= min(real(dt), real(frame)) * (0.5 - 1e-3)
    if name == "equal":
        assert np.ptp(steps) <= 4 * eps * len(steps) * frame
        assert len(steps) == max(1, math.ceil(float(real(frame)) / float(real(dt)) - 1e-4)) or ratio < 0.01


@given(ratio=st.floats(0.01, 2.0), name=st.sampled_from(sorted(CLAMPS)))
@settings(max_examples=100, deadline=None)
def test_the_same_frame_has_the_same_steps(ratio, name):
    first, second = (sequence(CLAMPS[name], FRAME, FRAME * ratio, np.float32) for _ in range(2))
    assert np.array_equal(first, second)


@pytest.mark.parametrize("fps", [Fraction(24), Fraction(30000, 1001)])
@pytest.mark.parametrize("real", REALS)
def test_100_000_frames_do_not_drift(fps, real):
    # Frame times are fractions, rounded once; what a kernel gets is their difference.
    times = np.array([float(Fraction(k) / fps) for k in range(100_001)])
    assert times[-1] == float(Fraction(100_000) / fps)
    spans = np.diff(times)
    assert np.all(spans > 0)
    assert np.abs(spans - float(1 / fps)).max() < 1e-12
    # few spans differ in their last bits: walk each of them once
    distinct = np.unique(spans.astype(real))
    assert len(distinct) < 100
    for clamp in CLAMPS.values():
        for span in distinct:
            assert len(sequence(clamp, span, float(1 / fps) / 3, real)) in (3, 4)


def test_fixed_is_clamped_to_the_frame():
    rk4 = schemes.get("rk4")
    assert frame_step(Fixed(dt=0.01), scheme=rk4, bound=None, frame=FRAME) == 0.01
    assert frame_step(Fixed(dt=1.0), scheme=rk4, bound=None, frame=FRAME) == FRAME


def test_steps_too_small_are_refused():
    with pytest.raises(InputError, match=r"steps of 1e-09 s: a frame of 0\.04167 s would take 4\.17e\+07"):
        frame_step(Fixed(dt=1e-9), scheme=schemes.get("rk4"), bound=None, frame=FRAME)
    with pytest.raises(InputError, match="would take"):
        frame_step(StabilityLimit(), scheme=schemes.get("rk4"), bound=Bound(real=1e9), frame=FRAME)


@pytest.mark.parametrize("name", ["euler", "midpoint", "rk4"])
@pytest.mark.parametrize("safety", [0.9, 0.5, 1.0])
def test_stability_limit_divides_the_limit_by_the_bound(name, safety):
    scheme, rate = schemes.get(name), 250.0
    limit = StabilityLimit(safety=safety)
    assert limit.step(scheme, Bound(real=rate)) == safety * (scheme.real_limit / rate)
    if scheme.imaginary_limit:
        assert limit.step(scheme, Bound(imaginary=rate)) == safety * (scheme.imaginary_limit / rate)
        expected = safety * min(scheme.real_limit / 100.0, scheme.imaginary_limit / rate)
        assert limit.step(scheme, Bound(real=100.0, imaginary=rate)) == expected


def test_nothing_to_limit_means_one_step_a_frame():
    assert StabilityLimit().step(schemes.get("euler"), Bound()) == math.inf
    assert frame_step(StabilityLimit(), scheme=schemes.get("euler"), bound=Bound(), frame=FRAME) == FRAME


@pytest.mark.parametrize("name", ["euler", "midpoint"])
def test_schemes_without_an_imaginary_limit_are_refused_for_rotations(name):
    message = f"scheme '{name}' has no stable step on the imaginary axis, where the laws have rates up to 3"
    with pytest.raises(InputError, match=message):
        StabilityLimit().step(schemes.get(name), Bound(real=1.0, imaginary=3.0))


@pytest.mark.parametrize("bad", [{"dt": 0.0}, {"dt": -1.0}, {"dt": math.nan}, {"dt": math.inf}])
def test_fixed_refuses(bad):
    with pytest.raises(InputError, match=r"Fixed\.dt"):
        Fixed(**bad)


@pytest.mark.parametrize("safety", [0.0, -0.5, 1.5, math.nan])
def test_stability_limit_refuses(safety):
    with pytest.raises(InputError, match=r"StabilityLimit\.safety"):
        StabilityLimit(safety=safety)
