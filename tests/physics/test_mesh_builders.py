"""Spring meshes by formula: how many springs, of which length, with which total mass."""

import numpy as np
import pytest

import tparticles as tp
from tparticles.errors import InputError

BUILDERS = {
    "box": tp.spring_box,
    "rope": tp.rope,
    "cloth": tp.cloth,
    "lattice": tp.lattice,
    "ball": tp.sphere_shell,
}


def volume(mesh):
    return np.linalg.det(mesh.x[mesh.faces]).sum() / 6


def is_closed(mesh):
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]).tolist()
    return sorted(edges) == sorted([b, a] for a, b in edges) and len({tuple(e) for e in edges}) == len(edges)


def test_the_box_is_lander_s():
    box = tp.spring_box()
    lengths, counts = np.unique(box.rest.round(12), return_counts=True)
    np.testing.assert_allclose(lengths, np.sqrt([1, 2, 3]), rtol=1e-11)
    assert counts.tolist() == [12, 12, 4]
    assert (box.mass == 1.0).all() and (box.damping == 0.1).all() and (np.abs(box.x) == 0.5).all()
    assert tp.spring_box(body_diagonal=0).spring_count == 24
    assert sorted(set(tp.spring_box(face_diagonal=10, body_diagonal=20).stiffness)) == [10, 20, 1000]
    assert volume(box) == pytest.approx(1.0) and is_closed(box)


def test_a_rope_goes_from_end_to_end():
    rope = tp.rope(start=(1, 0, 0), end=(1, 3, 4), count=11, mass=0.5)
    np.testing.assert_allclose(rope.rest, 0.5)
    assert rope.x[0].tolist() == [1, 0, 0] and rope.x[-1].tolist() == [1, 3, 4] and rope.spring_count == 10
    np.testing.assert_allclose(tp.rope(count=5, length=2.0).rest, 0.5)
    assert tp.rope(count=5, bend=10).spring_count == 4 + 3
    assert tp.rope(count=2, bend=10).spring_count == 1


@pytest.mark.parametrize(("columns", "rows"), [(2, 2), (5, 3), (7, 4)])
def test_a_cloth_has_three_families(columns, rows):
    cloth = tp.cloth(counts=(columns, rows), size=(columns - 1, rows - 1), stiffness=3, shear=2, bend=1)
    structural = (columns - 1) * rows + columns * (rows - 1)
    shear = 2 * (columns - 1) * (rows - 1)
    bend = (columns - 2) * rows + columns * (rows - 2)
    for stiffness, count, length in ((3, structural, 1), (2, shear, 2**0.5), (1, bend, 2)):
        of_it = cloth.stiffness == stiffness
        assert of_it.sum() == count
        np.testing.assert_allclose(cloth.rest[of_it], length)
    edges = cloth.x[cloth.faces[:, 1:]] - cloth.x[cloth.faces[:, :1]]
    np.testing.assert_allclose(
        np.cross(edges[:, 0], edges[:, 1])[:, 2], 1.0
    )  # twice the area of each triangle, facing up
    assert len(cloth.faces) == 2 * (columns - 1) * (rows - 1)
    i = 1 * columns + 1
    np.testing.assert_allclose(cloth.x[i] - cloth.x[0], [1, 1, 0])


def test_springs_of_no_stiffness_are_left_out():
    assert tp.cloth(counts=(4, 4), shear=0, bend=0).spring_count == 24
    assert tp.cloth(counts=(4, 4), stiffness=0, shear=0, bend=0).spring_count == 0


def test_a_lattice_inside_has_26_springs_a_vertex():
    jelly = tp.lattice(counts=(5, 4, 3), size=(4, 3, 2), mass=6.0)
    degree = np.bincount(jelly.springs.ravel())
    middle = (1 * 4 + 1) * 5 + 1
    assert degree[middle] == 26 and degree.min() == 7
    assert (np.linalg.norm(jelly.x[middle] - jelly.x, axis=1).round(9) <= 1.75).sum() == 27
    lengths, counts = np.unique(jelly.rest.round(9), return_counts=True)
    np.testing.assert_allclose(lengths, np.sqrt([1, 2, 3]), rtol=1e-8)
    assert counts.tolist() == [4 * 4 * 3 + 5 * 3 * 3 + 5 * 4 * 2, 2 * (4 * 3 * 3 + 5 * 3 * 2 + 4 * 4 * 2), 4 * 24]
    assert volume(jelly) == pytest.approx(24.0) and is_closed(jelly)


@pytest.mark.parametrize("subdivisions", [0, 1, 3])
def test_a_ball_is_round_and_braced(subdivisions):
    ball = tp.sphere_shell(radius=2.0, subdivisions=subdivisions, stiffness=3, bend=2, bracing=1)
    n = 10 * 4**subdivisions + 2
    assert ball.vertex_count == n and len(ball.faces) == 2 * n - 4
    np.testing.assert_allclose(np.linalg.norm(ball.x, axis=1), 2.0)
    assert [int((ball.stiffness == k).sum()) for k in (3, 2, 1)] == [3 * n - 6, 3 * n - 6, n // 2]
    opposite = ball.springs[ball.stiffness == 1]
    np.testing.assert_allclose(ball.x[opposite[:, 0]], -ball.x[opposite[:, 1]], atol=1e-12)
    assert is_closed(ball) and volume(ball) > 0


@pytest.mark.parametrize("build", BUILDERS.values(), ids=BUILDERS)
def test_what_all_builders_share(build):
    mesh = build(mass=3.0, stiffness=7.0, damping=0.25, tear=0.5)
    assert mesh.mass.sum() == pytest.approx(3.0) and (mesh.mass == mesh.mass[0]).all()
    assert (mesh.stiffness == 7.0).all() and (mesh.damping == 0.25).all() and (mesh.tear == 0.5).all()
    np.testing.assert_allclose(mesh.rest, mesh.lengths)
    assert not mesh.pinned.any() and build() == build()
    if build is not tp.rope:
        np.testing.assert_allclose(mesh.center, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tp.rope(count=1), r"rope\.count = 1: at least 2"),
        (lambda: tp.rope(end=(0, 0, 0)), r"rope\.start and rope\.end are both"),
        (lambda: tp.rope(length=0), r"rope\.length = 0: must be above 0"),
        (lambda: tp.cloth(counts=(1, 5)), r"cloth\.counts = \(1, 5\): at least 2"),
        (
            lambda: tp.cloth(counts=2_000_000),
            r"cloth\.counts = 2000000: 4000000000000 vertices take at least 1490116 GiB, this machine has \d+ GiB",
        ),
        (lambda: tp.cloth(counts=(5,)), r"cloth\.counts: should have shape \(2\)"),
        (lambda: tp.cloth(counts=(4.5, 4)), r"cloth\.counts: should be whole numbers"),
        (lambda: tp.cloth(size=(1, -1)), r"cloth\.size = -1\.0: must be above 0"),
        (lambda: tp.cloth(mass=0), r"cloth\.mass = 0: must be above 0"),
        (lambda: tp.cloth(stiffness=-3), "stiffness = -3 N/m must be at least 0"),
        (lambda: tp.cloth(shear=np.nan), r"cloth: stiffness = nan: should be finite"),
        (lambda: tp.lattice(counts=(2, 2)), r"lattice\.counts: should have shape \(3\)"),
        (lambda: tp.sphere_shell(radius=0), r"sphere_shell\.radius = 0: must be above 0"),
        (lambda: tp.sphere_shell(subdivisions=10), r"sphere_shell\.subdivisions = 10: at most 9"),
    ],
)
def test_wrong_arguments_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
