"""Colliders: distances against closed forms, normals against differences of the distance, surfaces and refusals. In f64."""

import dataclasses
import pickle
import sys

import numpy as np
import pytest
from collider_cases import CASES, POINTS, SLOPE, Ask
from PIL import Image

import tparticles as tp
from tparticles.errors import InputError
from tparticles.parameter import description
from tparticles.physics.colliders import Surface

pytestmark = pytest.mark.usefixtures("cpu64")
EACH = pytest.mark.parametrize(("collider", "exact"), CASES.values(), ids=CASES)


def gradient(f, x, h=1e-6):
    return np.stack([(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(3)], axis=1)


@EACH
def test_distance_and_normal_are_exact(collider, exact):
    ask = Ask(collider)
    np.testing.assert_allclose(ask.distance(POINTS), exact(POINTS), atol=1e-13)
    n = ask.normal(POINTS)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, rtol=1e-13)
    slope = gradient(exact, POINTS)
    smooth = np.abs(np.linalg.norm(slope, axis=1) - 1) < 1e-8  # away from edges between two walls
    assert smooth.mean() > 0.98
    np.testing.assert_allclose(n[smooth], slope[smooth], atol=1e-8)
    # both signs of the distance are among the points
    assert (exact(POINTS) > 0.1).any() and (exact(POINTS) < -0.1).any()


@EACH
def test_a_step_along_the_normal_leads_to_the_surface(collider, exact):
    ask = Ask(collider)
    d = ask.distance(POINTS)
    near = POINTS[np.abs(d) < 0.2] - (d[:, None] * ask.normal(POINTS))[np.abs(d) < 0.2]
    inside = (np.abs(near) < 2).all(axis=1)
    np.testing.assert_allclose(ask.distance(near)[inside], 0.0, atol=1e-12)


def test_a_bent_landscape_is_right_to_first_order():
    x, y = np.meshgrid(np.linspace(-1, 1, 12), np.linspace(-1, 2, 9), indexing="ij")
    ask = Ask(tp.Heightfield(heights=0.3 * np.sin(2 * x) * np.cos(y), low=(-1, -1), high=(1, 2)))
    rng = np.random.default_rng(5)
    cells = rng.integers(0, (11, 8), (200, 2)) + rng.uniform(0.05, 0.95, (200, 2))  # not at the creases between them
    ground = np.pad(cells * (2 / 11, 3 / 8) - 1, ((0, 0), (0, 1)))
    slopes = ask.normal(ground)
    ground[:, 2] = -ask.distance(ground) / slopes[:, 2]  # down the vertical to z = h
    np.testing.assert_allclose(ask.distance(ground), 0.0, atol=1e-14)
    # bilinear with cells of 0.18 x 0.375: second derivatives times their squares over 8
    np.testing.assert_allclose(ground[:, 2], 0.3 * np.sin(2 * ground[:, 0]) * np.cos(ground[:, 1]), atol=0.012)
    for step in (1e-3, 1e-4):
        np.testing.assert_allclose(ask.distance(ground + step * slopes), step, rtol=0.6 * step + 2e-3)


def test_a_landscape_goes_on_level():
    collider, _ = CASES["heightfield"]
    ask = Ask(collider)
    d = ask.distance([[3.0, 0.0, 5.0], [2.0, 0.0, 5.0], [-9.0, 9.0, 1.0]])
    n = ask.normal([[3.0, 0.0, 5.0], [-9.0, 9.0, 1.0]])
    across = SLOPE[1] / np.hypot(1, SLOPE[1])
    np.testing.assert_allclose(n, [[0.0, -across, 1 / np.hypot(1, SLOPE[1])], [0, 0, 1]], atol=1e-14)
    np.testing.assert_allclose(d[0], (5 - 1.2) / np.hypot(1, SLOPE[1]))
    assert d[2] == pytest.approx(1.0 - (0.2 - 2 * 0.5 - 2 * 0.25))


def test_beyond_a_distance_grid_its_distance_is_added():
    g = np.stack(np.meshgrid(*[np.linspace(-1, 1, 21)] * 3, indexing="ij"), axis=-1)
    ask = Ask(tp.DistanceGrid(distances=np.linalg.norm(g, axis=-1) - 0.5, low=(-1, -1, -1), high=(1, 1, 1)))
    np.testing.assert_allclose(ask.distance([[3.0, 0, 0], [0, 0, -2.0]]), [2.5, 1.5], atol=1e-12)
    x = np.random.default_rng(6).uniform(-3, 3, (200, 3))
    x = x[(np.abs(x) > 1).any(axis=1)]
    np.testing.assert_allclose(np.linalg.norm(ask.normal(x), axis=1), 1.0)
    # the true distance is at most what is told, which is at most sqrt(3) times it
    true = np.linalg.norm(x, axis=1) - 0.5
    assert (ask.distance(x) > true - 0.01).all() and (ask.distance(x) < 3**0.5 * true).all()
    slope = gradient(ask.distance, x)
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    np.testing.assert_allclose(ask.normal(x), slope, atol=1e-7)


def test_a_grid_around_a_mesh_is_its_distance():
    pytest.importorskip("igl")
    ball = tp.sphere_shell(radius=0.5, subdivisions=4).moved((0.1, 0.2, 0.3))
    collider = tp.DistanceGrid.around(ball, cell=0.05, restitution=0.2, friction=0.7)
    assert (collider.restitution, collider.friction) == (0.2, 0.7)
    x = np.random.default_rng(7).uniform(-0.6, 0.6, (300, 3)) + np.array([0.1, 0.2, 0.3])
    exact = np.linalg.norm(x - [0.1, 0.2, 0.3], axis=1) - 0.5
    near = np.abs(exact) < 0.2
    # the triangles miss the sphere by 0.5 mm, the cells bend by cell^2 / (4 r)
    np.testing.assert_allclose(Ask(collider).distance(x)[near], exact[near], atol=0.003)
    inward = tp.Mesh(x=ball.x, faces=ball.faces[:, ::-1])
    assert tp.DistanceGrid.around(inward, cell=0.05).distances == tp.DistanceGrid.around(ball, cell=0.05).distances


def test_only_closed_surfaces_have_a_distance(monkeypatch):
    ball = tp.sphere_shell(subdivisions=1)
    with pytest.raises(InputError, match="is not closed: 3 edges have no face on the other side"):
        tp.DistanceGrid.around(tp.Mesh(x=ball.x, faces=ball.faces[1:]), cell=0.1)
    with pytest.raises(InputError, match="has no faces"):
        tp.DistanceGrid.around(tp.rope(), cell=0.1)
    with pytest.raises(InputError, match=r"cell = 0: must be above 0"):
        tp.DistanceGrid.around(ball, cell=0)
    with pytest.raises(InputError, match=r"cell = 0\.001 m makes \d+x\d+x\d+ samples, at most"):
        tp.DistanceGrid.around(ball, cell=0.001)
    monkeypatch.setitem(sys.modules, "igl", None)
    with pytest.raises(InputError, match=r"need libigl: pip install 'tparticles\[mesh\]'"):
        tp.DistanceGrid.around(ball, cell=0.1)


@pytest.mark.parametrize(("kind", "white"), [(np.uint8, 255), (np.uint16, 65535)])
def test_a_landscape_of_a_picture(tmp_path, kind, white):
    picture = (np.array([[0.0, 0.2, 0.4], [0.6, 0.8, 1.0]]) * white).astype(kind)  # the top row first
    Image.fromarray(picture).save(tmp_path / "hills.png")
    hills = tp.Heightfield.from_image(tmp_path / "hills.png", bottom=-1, top=4, low=(0, 0), high=(2, 1), friction=0.5)
    np.testing.assert_allclose(hills.heights.values, [[2, -1], [3, 0], [4, 1]], atol=1e-3)
    assert hills.friction == 0.5
    Image.fromarray((picture.astype(int) // 300).astype(kind)).save(tmp_path / "dark.png")  # below 255, at 16 bits too
    dark = tp.Heightfield.from_image(tmp_path / "dark.png")
    assert dark.heights.values.max() == pytest.approx(int(white) // 300 / white)
    with pytest.raises(InputError, match=r"height picture '.*none\.png' cannot be read"):
        tp.Heightfield.from_image(tmp_path / "none.png")


def test_a_room_is_its_six_walls():
    room, exact = CASES["room"]
    walls = dataclasses.replace(room, restitution=0.1, friction=0.3, velocity=(1, 0, 0)).walls
    assert all((w.restitution, w.friction, w.velocity) == (0.1, 0.3, (1.0, 0.0, 0.0)) for w in walls)
    inside = exact(POINTS) > 0
    nearest = np.min([Ask(wall).distance(POINTS[inside]) for wall in walls], axis=0)
    np.testing.assert_allclose(nearest, exact(POINTS)[inside], atol=1e-14)


def test_where_no_direction_is_best_one_is_chosen():
    middle = [[0.3, -0.2, 0.1]]
    assert Ask(CASES["ball"][0]).normal(middle).tolist() == [[0.0, 0.0, 1.0]]
    cube = tp.Room(low=(-1, -1, -1), high=(1, 1, 1))
    for point in ([0.0, 0, 0], [0.5, 0.5, 0.5], [0.5, -0.5, 0], [1, 1, 1], [0, 2, 2]):
        n = Ask(cube).normal([point])
        assert np.linalg.norm(n) == pytest.approx(1.0)
        assert (n * point).sum() <= 0  # inward


def test_the_surface_of_any_collider():
    assert Surface.of(CASES["own class"][0]) == Surface()
    plane = tp.Plane(restitution=1.0, friction=2, velocity=(0, 0, 1))
    assert Surface.of(plane) == Surface(restitution=1.0, friction=2.0, velocity=(0.0, 0.0, 1.0))

    class Ice(type(CASES["own class"][0])):
        friction = -0.1

    with pytest.raises(InputError, match=r"Surface\.friction = -0\.1"):
        Surface.of(Ice(1))
    for wrong in (3, tp.Gravity(), tp.Plane, None):
        with pytest.raises(InputError, match="is no collider: it needs signed_distance"):
            Surface.of(wrong)


def test_sampled_colliders_are_values():
    heights = np.random.default_rng(8).normal(size=(4, 5))
    a, b = tp.Heightfield(heights=heights), tp.Heightfield(heights=heights.copy())
    assert a == b and hash(a) == hash(b) and description(a) == description(b) and pickle.loads(pickle.dumps(a)) == a
    heights[2, 3] += 1e-12
    other = tp.Heightfield(heights=heights)
    assert a != other and description(a) != description(other)
    with pytest.raises(ValueError, match="read-only"):
        a.heights.values[0, 0] = 1


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tp.Plane(facing=(0, 0, 0)), r"Plane\.facing = .*must not be zero"),
        (lambda: tp.Plane(restitution=1.1), r"Plane\.restitution = 1\.1: should be less than or equal to 1"),
        (lambda: tp.Plane(friction=-1), r"Plane\.friction = -1"),
        (lambda: tp.Plane(normal=(0, 0, 1)), r"Plane has no parameter 'normal'"),
        (lambda: tp.Room(low=(0, 0, 0), high=(1, 0, 1)), r"Room\.low = .* must be below Room\.high"),
        (lambda: tp.Ball(radius=0), r"Ball\.radius = 0"),
        (lambda: tp.Capsule(start=(0, 0, 0), radius=1), r"Capsule\.end is missing"),
        (lambda: tp.Heightfield(heights=[1, 2]), r"Heightfield\.heights = .*should have shape \(nx, ny\).* not \(2,\)"),
        (lambda: tp.Heightfield(heights=[[1, 2]]), r"at least 2 each, not \(1, 2\)"),
        (lambda: tp.Heightfield(heights=[[1, 2], [3, np.nan]]), r"value \[1, 1\] is not finite"),
        (lambda: tp.Heightfield(heights=[[1, 2], [3]]), "its rows differ in length"),
        (lambda: tp.Heightfield(heights=[["a", "b"]] * 2), "should be numbers"),
        (lambda: tp.Heightfield(heights=np.eye(2), low=(0, 0), high=(0, 1)), r"Heightfield\.low"),
        (lambda: tp.DistanceGrid(distances=np.eye(2), low=(0,) * 3, high=(1,) * 3), r"shape \(nx, ny, nz\)"),
    ],
)
def test_wrong_colliders_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
