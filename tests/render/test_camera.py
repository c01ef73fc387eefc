"""The camera: projections worked out by hand, poses, key frames, and cameras that cannot look."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tparticles.errors import InputError
from tparticles.render.camera import Camera, Track

coordinate = st.floats(-50.0, 50.0)
vector = st.tuples(coordinate, coordinate, coordinate)


def seen_from(position, target, up=(0, 0, 1), **options) -> Camera:
    """Return a camera; the arguments that each has come by position here."""
    return Camera(position=position, target=target, up=up, **options)


def looking_along_y(fov: float = 90.0) -> Camera:
    return seen_from(position=(0, -10, 0), target=(0, 0, 0), fov=fov)


def test_pose_of_a_camera_that_looks_along_y() -> None:
    pose = looking_along_y().pose(0.0)
    assert_allclose(pose.forward, [0, 1, 0])
    assert_allclose(pose.right, [1, 0, 0])
    assert_allclose(pose.up, [0, 0, 1])
    assert pose.tan_half == pytest.approx(1.0)
    assert pose.focal(1080) == pytest.approx(540.0)


@pytest.mark.parametrize(
    ("point", "pixel"),
    [
        ((0, 0, 0), (960, 540)),
        ((10, 0, 0), (1500, 540)),  # 45 degrees to the right: half the height from the middle
        ((0, 0, 10), (960, 0)),  # the top edge
        ((0, 0, -10), (960, 1080)),
        ((-2, 10, 4), (960 - 54, 540 - 108)),  # depth 20: 540 / 20 = 27 px per metre
    ],
)
def test_projection_by_hand(point: tuple, pixel: tuple) -> None:
    u, v, depth = looking_along_y().pose(0.0).project(point, 1920, 1080)
    assert (u, v) == (pytest.approx(pixel[0]), pytest.approx(pixel[1]))
    assert depth == pytest.approx(point[1] + 10)


def test_points_behind_have_no_pixel() -> None:
    u, v, depth = looking_along_y().pose(0.0).project([(0, -10, 0), (0, -11, 1), (0, 0, 0)], 64, 64)
    assert_allclose(depth, [0, -1, 10])
    assert np.isnan(u[:2]).all() and np.isnan(v[:2]).all() and np.isfinite([u[2], v[2]]).all()


@given(
    position=vector, target=vector, up=vector, fov=st.floats(1.0, 170.0), pixel=st.tuples(*[st.floats(-99, 999)] * 2)
)
def test_a_ray_through_a_pixel_comes_back_to_it(
    position: tuple, target: tuple, up: tuple, fov: float, pixel: tuple
) -> None:
    sine = np.linalg.norm(np.cross(np.subtract(target, position), up))
    if sine < 1e-3 * max(1.0, math.dist(target, position)) * max(1e-3, float(np.linalg.norm(up))):
        return  # no direction or no upright
    pose = seen_from(position, target, up, fov=fov).pose(1.0)
    axes = np.array([pose.right, pose.up, -pose.forward])
    assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert_allclose(np.cross(pose.right, pose.up), -pose.forward, atol=1e-9)
    x, y = (np.array(pixel) - (960, 540)) / pose.focal(1080)
    depth = 7.5
    point = pose.position + depth * (pose.forward + x * pose.right - y * pose.up)
    assert_allclose(pose.project(point, 1920, 1080), (*pixel, depth), rtol=1e-6, atol=1e-6 * pose.focal(1080))


@given(position=vector, shift=vector, point=vector)
def test_moving_camera_and_world_together_changes_nothing(position: tuple, shift: tuple, point: tuple) -> None:
    def pixel(offset: np.ndarray) -> tuple:
        camera = seen_from(tuple(position + offset), tuple(np.add(position, (1, 2, 0.5)) + offset))
        return camera.pose(0.0).project(point + offset, 640, 480)

    depth = pixel(np.zeros(3))[2]
    if depth > 0.1:
        assert_allclose(pixel(np.array(shift)), pixel(np.zeros(3)), rtol=1e-6, atol=1e-5)


def test_linear_track_and_its_ends() -> None:
    track = Track(keys=((1.0, (0, 0, 0)), (3.0, (4, 0, 2))))
    assert_allclose(track.at(0.0), [0, 0, 0])
    assert_allclose(track.at(1.5), [1, 0, 0.5])
    assert_allclose(track.at(3.0), [4, 0, 2])
    assert_allclose(track.at(9.0), [4, 0, 2])
    assert Track(keys=((5.0, 30.0),)).at(0.0) == 30.0


def test_smooth_track_between_two_keys_is_the_smoothstep() -> None:
    track = Track(keys=((0.0, 10.0), (2.0, 20.0)), smooth=True)
    for s in (0.0, 0.1, 0.5, 0.8, 1.0):
        assert track.at(2.0 * s) == pytest.approx(10.0 + 10.0 * s * s * (3.0 - 2.0 * s))


@given(
    gaps=st.lists(st.floats(0.05, 5.0), min_size=2, max_size=6),
    data=st.data(),
)
def test_smooth_track_passes_its_keys_without_overshoot_or_kink(gaps: list, data: st.DataObject) -> None:
    times = np.concatenate([[0.0], np.cumsum(gaps)])
    values = data.draw(st.lists(coordinate, min_size=len(times), max_size=len(times)))
    track = Track(keys=tuple(zip(times.tolist(), values, strict=True)), smooth=True)
    for i, (t, value) in enumerate(zip(times, values, strict=True)):
        assert track.at(t) == pytest.approx(value, abs=1e-9)
        if 0 < i < len(times) - 1:
            e = 1e-6
            before, after = (track.at(t) - track.at(t - e)) / e, (track.at(t + e) - track.at(t)) / e
            assert before == pytest.approx(after, rel=1e-2, abs=0.5)
    for i in range(len(times) - 1):
        inside = [float(track.at(t)) for t in np.linspace(times[i], times[i + 1], 9)]
        low, high = sorted(values[i : i + 2])
        assert low - 1e-9 <= min(inside) and max(inside) <= high + 1e-9


def test_keyed_camera_moves() -> None:
    camera = seen_from(Track(keys=((0.0, (0, -10, 0)), (2.0, (0, -20, 0)))), (0, 0, 0), fov=Track(keys=((0.0, 90.0),)))
    assert camera.moves and not looking_along_y().moves
    assert camera.pose(1.0).project((0, 0, 0), 100, 100)[2] == pytest.approx(15.0)


def test_camera_that_looks_at_itself() -> None:
    with pytest.raises(InputError, match=r"looks at itself: position and target are both \(1, 2, 3\)"):
        seen_from((1, 2, 3), (1, 2, 3))
    camera = seen_from(Track(keys=((0.0, (-1, 0, 0)), (2.0, (1, 0, 0)))), (0, 0, 0))
    camera.pose(0.5)
    with pytest.raises(InputError, match="at t = 1 s"):
        camera.pose(1.0)


@pytest.mark.parametrize("up", [(0, 5, 0), (0, -1, 0), (0, 0, 0)])
def test_up_along_the_view(up: tuple) -> None:
    with pytest.raises(InputError, match="parallel to the view direction"):
        seen_from((0, 0, 0), (0, 3, 0), up)


@pytest.mark.parametrize("fov", [0.0, 180.0, -5.0, Track(keys=((0.0, 40.0), (1.0, 200.0)))])
def test_impossible_field_of_view(fov: float | Track) -> None:
    with pytest.raises(InputError, match=r"fov = .* \(above 0 and below 180\)"):
        looking_along_y(fov)  # pyright: ignore[reportArgumentType]


def test_bad_tracks() -> None:
    with pytest.raises(InputError, match="at least one key"):
        Track(keys=())
    with pytest.raises(InputError, match="must increase: 1 s comes after 1 s"):
        Track(keys=((1.0, 0.0), (1.0, 2.0)))
    with pytest.raises(InputError, match="mixes numbers and vectors"):
        Track(keys=((0.0, 0.0), (1.0, (0, 0, 0))))
    with pytest.raises(InputError, match="camera fov: a Track of numbers"):
        seen_from((0, 0, 0), (1, 0, 0), fov=Track(keys=((0.0, (1, 2, 3)),)))
    with pytest.raises(InputError, match="camera target: a Track of vectors"):
        seen_from((0, 0, 0), Track(keys=((0.0, 1.0),)))


def test_values_that_are_not_numbers() -> None:
    for bad in [(0, 0), (0, 0, math.nan), "here"]:
        with pytest.raises(InputError):
            seen_from(bad, (1, 0, 0))  # pyright: ignore[reportArgumentType]
