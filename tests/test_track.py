"""Tracks as polynomials for kernels, and their rates of change. What they show at each time: see the camera's tests."""

import numpy as np
import pytest

from tparticles.track import Track

KEYS = ((0.5, (0.0, 1.0, 2.0)), (1.0, (1.0, 1.0, 0.0)), (2.5, (3.0, 0.0, -1.0)), (3.0, (3.0, 0.0, 5.0)))
TRACKS = {
    "straight": Track(keys=KEYS),
    "smooth": Track(keys=KEYS, smooth=True),
    "number": Track(keys=((0.0, 1.0), (1.0, 4.0), (3.0, 5.0)), smooth=True),
    "still": Track(keys=((1.0, (1.0, 2.0, 3.0)),)),
}
CASES = pytest.mark.parametrize("track", TRACKS.values(), ids=TRACKS)


@CASES
def test_cubics_are_the_track(track):
    times, c = track.cubics()
    assert c.shape == (len(track.keys), 4, *np.shape(track.keys[0][1]))
    for t in np.linspace(times[0], times[-1] + 1, 57):
        i = np.searchsorted(times, t, side="right") - 1
        s = t - times[i]
        np.testing.assert_allclose(c[i, 0] + s * (c[i, 1] + s * (c[i, 2] + s * c[i, 3])), track.at(t), atol=1e-13)


@CASES
def test_speed_is_the_derivative(track):
    h = 1e-6
    times = np.array([t for t, _ in track.keys])
    for t in np.linspace(-0.513, 4.017, 61):
        if np.abs(times - t).min() > 2 * h:
            np.testing.assert_allclose(track.speed(t), (track.at(t + h) - track.at(t - h)) / (2 * h), atol=1e-8)


def test_at_a_corner_the_speed_is_what_comes_after():
    track = TRACKS["straight"]
    np.testing.assert_allclose(track.speed(1.0), [2 / 1.5, -1 / 1.5, -1 / 1.5])
    np.testing.assert_allclose(track.speed(0.5), [2.0, 0.0, -4.0])
    assert not track.speed(3.0).any() and not track.speed(0.499).any()
    np.testing.assert_allclose(TRACKS["smooth"].speed(0.5), 0.0)
