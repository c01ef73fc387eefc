"""The description of a spring mesh: what it refuses, what is equal, how it is moved, held and joined."""

import dataclasses
import pickle
import subprocess
import sys

import numpy as np
import pytest

import tparticles as tp
from tparticles.errors import InputError
from tparticles.parameter import description

PAIR = {"x": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], "springs": [[0, 1]]}
TRIO = {"x": [[0, 0, 0], [1, 0, 0], [0, 2, 0]], "springs": [[0, 1], [1, 2]]}


def test_what_is_left_out_has_a_default():
    mesh = tp.Mesh(**PAIR)
    assert (mesh.vertex_count, mesh.spring_count) == (2, 1)
    assert mesh.rest.tolist() == [1.0] and mesh.mass.tolist() == [1.0, 1.0] and np.isinf(mesh.tear).all()
    assert not mesh.v.any() and not mesh.pinned.any() and mesh.faces.shape == (0, 3)
    kinds = {"x": "f8", "springs": "i4", "pinned": "?", "stiffness": "f8", "driver": "i4", "faces": "i4"}
    assert all(getattr(mesh, name).dtype == kind for name, kind in kinds.items())


def test_arrays_are_copies_that_cannot_be_written():
    x = np.array(PAIR["x"])
    mesh = tp.Mesh(x=x)
    x[0] = 7.0
    assert mesh.x[0, 0] == 0.0
    for name in ("x", "v", "mass", "springs", "pinned"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(mesh, name)[...] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        mesh.x = x  # type: ignore[misc]


def test_equal_content_is_equal_and_hashes_alike_in_any_process():
    a, b = tp.Mesh(**PAIR), tp.Mesh(**PAIR, v=-0.0 * np.ones((2, 3)))
    assert a == b and hash(a) == hash(b) and description(a) == description(b) and len(repr(a)) < 80
    assert pickle.loads(pickle.dumps(a)) == a and not pickle.loads(pickle.dumps(a)).x.flags.writeable
    code = f"import tparticles as tp; print(tp.Mesh(**{PAIR!r}))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == repr(a)


@pytest.mark.parametrize(
    "change",
    [
        {"x": [[0, 0, 0], [1, 0, 1e-15]]},
        {"v": [[0, 0, 0], [0, 0, 1]]},
        {"mass": 2.0},
        {"stiffness": 999.0},
        {"damping": 0.1},
        {"rest": 0.5},
        {"tear": 0.5},
        {"pinned": [True, False]},
        {"springs": [[1, 0]]},
        {"pinned": [True, False], "driver": [0, -1], "paths": (tp.Track(keys=((0.0, (0, 0, 1)),)),)},
    ],
    ids=lambda change: "+".join(change),
)
def test_another_content_is_another_mesh(change):
    assert tp.Mesh(**(PAIR | change)) != tp.Mesh(**PAIR)
    assert description(tp.Mesh(**(PAIR | change))) != description(tp.Mesh(**PAIR))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": []}, "a mesh needs at least one vertex"),
        ({"x": np.zeros((0, 3)), "springs": ()}, "a mesh needs at least one vertex"),
        ({"x": [[0, 0], [1, 0]]}, r"mesh\.x: should have shape \(any, 3\), not \(2, 2\)"),
        ({"x": [[0, 0, 0], [1, 0]]}, r"mesh\.x: .* its rows differ in length"),
        ({"x": [[0, 0, 0], [np.nan, 0, 0]]}, r"mesh, vertex 1: x = \(nan, 0, 0\) is not finite"),
        ({"v": [[0, 0, np.inf]] * 2}, r"mesh, vertex 0: v = \(0, 0, inf\) is not finite \(and 1 more\)"),
        ({"mass": 0.0}, r"mesh, vertex 0: mass = 0 kg must be above 0"),
        ({"mass": [1.0, -2.0]}, r"mesh, vertex 1: mass = -2 kg must be above 0"),
        ({"mass": [1.0, np.nan], "pinned": [False, True]}, r"mesh, vertex 1: mass = nan kg"),
        ({"mass": [1.0, 1.0, 1.0]}, r"mesh\.mass: should have shape \(2\), not \(3,\)"),
        ({"mass": "heavy"}, r"mesh\.mass: should be numbers"),
        ({"springs": [[0, 2]]}, r"mesh, spring 0: vertices \(0, 2\), the mesh has 0 to 1"),
        ({"springs": [[-1, 1]]}, r"mesh, spring 0: vertices \(-1, 1\), the mesh has 0 to 1"),
        ({"springs": [[0, 3_000_000_000]]}, r"mesh\.springs: 3000000000 is out of range"),
        ({"springs": [[0.0, 1.0]]}, r"mesh\.springs: should be whole numbers, not float64"),
        ({"springs": [0, 1]}, r"mesh\.springs: should have shape \(any, 2\), not \(2,\)"),
        ({"springs": [[1, 1]]}, "mesh, spring 0: it joins vertex 1 to itself"),
        ({"springs": [[0, 1], [1, 0]]}, "springs 0 and 1 both join vertices 0 and 1: give each pair once"),
        ({"x": [[1, 2, 3], [1, 2, 3]]}, r"mesh, spring 0: it joins vertices \(0, 1\) at the same place"),
        ({"rest": 0.0}, "mesh, spring 0: rest = 0 m must be above 0"),
        ({"rest": [np.inf]}, "mesh, spring 0: rest = inf m"),
        ({"stiffness": -1.0}, "mesh, spring 0: stiffness = -1 N/m must be at least 0"),
        ({"stiffness": np.nan}, "mesh, spring 0: stiffness = nan N/m"),
        ({"damping": [-0.5]}, "mesh, spring 0: damping = -0.5 N s/m must be at least 0"),
        ({"tear": 0.0}, "mesh, spring 0: tear = 0 must be above 0"),
        ({"pinned": [0, 1]}, r"mesh\.pinned: should be true or false, not int64"),
        ({"pinned": True, "v": [[0, 0, 0], [1, 0, 0]]}, r"mesh, vertex 1: it is pinned and cannot have a velocity"),
        ({"driver": [0, -1]}, "mesh, vertex 0: driver = 0: there are 0 paths"),
        ({"driver": [0, -1], "paths": (tp.Track(keys=((0, (0, 0, 1)),)),)}, "driver = 0, but it is not pinned"),
        ({"paths": (tp.Track(keys=((0, 1.0),)),)}, "is no Track of vectors"),
        ({"faces": [[0, 1, 2]]}, r"mesh, face 0: vertices \(0, 1, 2\), the mesh has 0 to 1"),
    ],
)
def test_what_cannot_be_moved_is_refused_in_one_line(change, message):
    with pytest.raises(InputError, match=message) as error:
        tp.Mesh(**(PAIR | change))
    assert "\n" not in str(error.value)


def test_a_vertex_alone_and_vertices_at_one_place_without_a_spring_are_allowed():
    mesh = tp.Mesh(x=np.zeros((3, 3)))
    assert mesh.spring_count == 0 and mesh.springs.shape == (0, 2)
    assert tp.Mesh(**(PAIR | {"stiffness": 0.0})).stiffness.tolist() == [0.0]


def test_a_million_springs_on_a_vertex():
    n = 1_000_000
    x = np.random.default_rng(0).normal(size=(n + 1, 3))
    spokes = np.stack([np.zeros(n, int), np.arange(1, n + 1)], axis=1)
    mesh = tp.Mesh(x=x, springs=spokes)
    assert mesh.spring_count == n
    np.testing.assert_allclose(mesh.rest, np.linalg.norm(x[1:] - x[0], axis=1), rtol=1e-14)
    with pytest.raises(InputError, match="springs 499999 and 1000000 both join"):
        tp.Mesh(x=x, springs=np.concatenate([spokes, [[500_000, 0]]]))


def test_moved_turned_and_scaled():
    mesh = tp.Mesh(**TRIO, v=[[1, 0, 0], [0, 1, 0], [0, 0, 1]], mass=[1.0, 2.0, 3.0])
    np.testing.assert_allclose(mesh.center, [2 / 6, 1.0, 0.0])
    assert (mesh.moved((1, 2, 3)).x == mesh.x + np.array([1, 2, 3])).all()
    turned = mesh.turned((0, 0, 2), 90, about=(0, 0, 0))
    np.testing.assert_allclose(turned.x, [[0, 0, 0], [0, 1, 0], [-2, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(turned.v, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15)
    np.testing.assert_allclose(mesh.turned((1, 2, -3), 75).center, mesh.center, atol=1e-15)
    np.testing.assert_allclose(mesh.turned((1, 2, -3), 75).lengths, mesh.rest)
    grown = mesh.scaled(2)
    np.testing.assert_allclose(grown.rest, 2 * mesh.rest)
    np.testing.assert_allclose(grown.lengths, grown.rest)
    np.testing.assert_allclose(grown.center, mesh.center, atol=1e-15)


def test_launched_turns_about_the_centre_of_mass():
    mesh = tp.Mesh(**TRIO, mass=[1.0, 2.0, 3.0]).launched((1, 0, 0), spin=(0, 0, 2))
    np.testing.assert_allclose(mesh.mass @ mesh.v / mesh.mass.sum(), [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(mesh.v[1] - mesh.v[0], [0, 2, 0], atol=1e-15)
    held = tp.Mesh(**TRIO).pin(0).launched((1, 0, 0))
    assert not held.v[0].any() and held.v[1].tolist() == [1, 0, 0]


@pytest.mark.parametrize(
    "choice",
    [
        {"vertices": [0, 2]},
        {"where": tp.Box(low=(-0.5, -0.5, -0.5), high=(0.5, 2.5, 0.5))},
        {"where": tp.Sphere(center=(0, 1, 0), radius=1.0)},
        {"where": lambda x: x[:, 0] < 0.5},
    ],
    ids=["indices", "box", "sphere", "function"],
)
def test_pinned_vertices_are_chosen_by_index_or_place(choice):
    mesh = tp.Mesh(**TRIO).launched((0, 0, 1)).pin(**choice)
    assert mesh.pinned.tolist() == [True, False, True]
    assert not mesh.v[mesh.pinned].any() and mesh.v[1].any() and (mesh.driver == -1).all()


def test_driven_vertices_have_paths_that_turn_and_join():
    up = tp.Track(keys=((0.0, (0, 0, 0)), (1.0, (0, 0, 1))))
    aside = tp.Track(keys=((0.0, (0, 0, 0)), (2.0, (1, 0, 0))), smooth=True)
    mesh = tp.Mesh(**TRIO).driven(up, 0).driven(aside, where=lambda x: x[:, 1] > 1)
    assert mesh.driver.tolist() == [0, -1, 1] and mesh.pinned.tolist() == [True, False, True]
    both = mesh.joined(mesh.turned((0, 0, 1), 90))
    assert both.driver.tolist() == [0, -1, 1, 2, -1, 3]
    np.testing.assert_allclose(both.paths[3].at(2.0), [0, 1, 0], atol=1e-15)
    assert mesh.pin(0).driver.tolist() == [-1, -1, 1]


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda m: m.pin(), "pin: give either vertices"),
        (lambda m: m.pin([0], where=lambda x: x[:, 0] > 0), "pin: give either vertices"),
        (lambda m: m.pin([3]), r"pin: there is no vertex 3 \(the mesh has 0 to 2\)"),
        (lambda m: m.pin([]), "pin: no vertex is chosen"),
        (lambda m: m.pin(where=tp.Box(low=(5, 5, 5), high=(6, 6, 6))), r"pin: no vertex is chosen by Box\("),
        (lambda m: m.pin(where=lambda x: x[:, 0]), r"pin\.where: should be true or false, not float64"),
        (lambda m: m.pin(where=3), "where = 3: a Box, a Sphere or a function"),
        (lambda m: m.driven(tp.Track(keys=((0, 1.0),)), 0), "is no Track of vectors"),
        (lambda m: m.turned((0, 0, 0), 90), r"turned\.axis = \(0\.0, 0\.0, 0\.0\): a direction must not be zero"),
        (lambda m: m.moved(1.0), r"moved\.offset = 1\.0: should be three finite numbers"),
        (lambda m: m.moved((0, 0, np.inf)), r"moved\.offset"),
        (lambda m: m.scaled(0), r"scaled\.factor = 0: must be above 0"),
        (lambda m: m.with_springs([[0, 3]]), r"vertices \(0, 3\)"),
        (lambda m: m.with_springs([[1, 0]]), "springs 0 and 2 both join vertices 0 and 1"),
    ],
)
def test_wrong_changes_are_refused(act, message):
    with pytest.raises(InputError, match=message):
        act(tp.Mesh(**TRIO))


def test_joined_meshes_are_tied_by_springs():
    one = tp.Mesh(**TRIO, mass=2.0, faces=[[0, 1, 2]])
    both = one.joined(one.moved((5, 0, 0)))
    assert both.springs.tolist() == [[0, 1], [1, 2], [3, 4], [4, 5]] and both.faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    tied = both.with_springs([[1, 3]], stiffness=5.0, damping=0.5, tear=0.1)
    assert tied.springs[4].tolist() == [1, 3] and tied.rest[4] == 4.0
    assert (tied.stiffness[4], tied.damping[4], tied.tear[4]) == (5.0, 0.5, 0.1)
    assert (tied.mass == 2.0).all() and len(tied.rest) == 5
