"""Spring meshes from files: every format gives the same mesh; solids have springs inside; what cannot be read says so."""

import sys

import numpy as np
import pytest

import tparticles as tp
from tparticles.errors import InputError

meshio = pytest.importorskip("meshio")
trimesh = pytest.importorskip("trimesh")

BALL = tp.sphere_shell(radius=0.5, subdivisions=1, bracing=0)
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
# a cube of 5 tetrahedra, the middle one twice the volume of a corner's; some turn right, some left
TETS = np.array([[0, 1, 2, 4], [3, 1, 2, 7], [5, 4, 7, 1], [6, 7, 4, 2], [1, 2, 4, 7]])


def assert_same_springs(mesh, other):
    """Compare springs by their middles and lengths, whatever the order of vertices and springs."""
    a, b = (np.column_stack([m.x[m.springs].mean(axis=1), m.rest]) for m in (mesh, other))
    apart = np.abs(a[:, None] - b).max(axis=2)
    assert apart.shape[0] == apart.shape[1] and apart.min(axis=0).max() < 1e-5 and apart.min(axis=1).max() < 1e-5


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "off", "glb", "vtk", "vtu", "msh", "mesh", "inp"])
def test_a_surface_is_the_same_in_every_format(suffix, tmp_path):
    path = tmp_path / f"ball.{suffix}"
    if suffix in ("stl", "obj", "ply", "off", "glb"):
        trimesh.Trimesh(BALL.x, BALL.faces, process=False).export(path)
    else:
        meshio.write(path, meshio.Mesh(BALL.x, [("triangle", BALL.faces)]))
    mesh = tp.read_mesh(path, mass=2.0, stiffness=50.0, bend=5.0, damping=0.1, tear=0.5)
    assert mesh.vertex_count == BALL.vertex_count and len(mesh.faces) == len(BALL.faces)
    assert [int((mesh.stiffness == k).sum()) for k in (50, 5)] == [120, 120]
    assert_same_springs(mesh, BALL)
    assert mesh.mass.sum() == pytest.approx(2.0) and (mesh.damping == 0.1).all() and (mesh.tear == 0.5).all()
    assert tp.read_mesh(path, bend=0).spring_count == 120
    volume = np.linalg.det(mesh.x[mesh.faces]).sum() / 6
    assert volume == pytest.approx(np.linalg.det(BALL.x[BALL.faces]).sum() / 6, rel=1e-5)


@pytest.mark.parametrize("suffix", ["vtk", "vtu", "msh", "mesh"])
def test_a_solid_has_springs_inside_and_faces_outside(suffix, tmp_path):
    path = tmp_path / f"cube.{suffix}"
    skin = np.array([[0, 1, 2]])  # beside tetrahedra, triangles are their skin
    meshio.write(path, meshio.Mesh(CUBE, [("triangle", skin), ("tetra", TETS)]))
    cube = tp.read_mesh(path, mass=6.0)
    assert (cube.vertex_count, cube.spring_count, len(cube.faces)) == (8, 18, 12)
    # a corner's tetrahedron is 1/6 of the cube: corners get a quarter of it, the others three and a part of the middle
    np.testing.assert_allclose(cube.mass, [0.25, 1.25, 1.25, 0.25, 1.25, 0.25, 0.25, 1.25])
    edges = cube.x[cube.faces[:, 1:]] - cube.x[cube.faces[:, :1]]
    outward = np.cross(edges[:, 0], edges[:, 1])
    assert (np.einsum("ij,ij->i", outward, cube.x[cube.faces].mean(axis=1) - 0.5) > 0).all()


def test_vertices_at_one_place_become_one_and_lone_ones_are_left_out(tmp_path):
    x = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [9, 9, 9], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, 0]]
    triangles = [[0, 1, 2], [4, 5, 6], [1, 7, 2]]  # the last one has two corners in one place
    meshio.write(tmp_path / "two.vtu", meshio.Mesh(x, [("triangle", np.array(triangles))]))
    sheet = tp.read_mesh(tmp_path / "two.vtu", mass=3.0)
    assert sheet.x.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    assert sheet.springs.tolist() == [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3], [0, 3]]  # the last bends across 1-2
    np.testing.assert_allclose(sheet.mass, [0.5, 1.0, 1.0, 0.5])


def test_quadrangles_are_cut_in_two(tmp_path):
    meshio.write(tmp_path / "sheet.vtk", meshio.Mesh(CUBE, [("quad", np.array([[0, 1, 3, 2]]))]))
    assert tp.read_mesh(tmp_path / "sheet.vtk").faces.tolist() == [[0, 1, 3], [0, 3, 2]]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("none.stl", None, r"mesh '.*none\.stl': there is no such file"),
        ("mesh.what", "rubbish", r"cannot be read: Could not deduce file format"),
        ("mesh.obj", "rubbish", "neither triangles nor tetrahedra"),
        ("mesh.ply", "rubbish", "cannot be read"),
        ("mesh.glb", "rubbish", "cannot be read"),
        ("mesh.vtk", "rubbish", "cannot be read"),
        ("mesh.vtu", "rubbish", r"cannot be read: it is no \.vtu file, or a damaged one"),
        ("mesh.off", "OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "cannot be read|neither triangles nor tetrahedra"),
        ("mesh.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "a vertex that is not finite"),
    ],
)
def test_what_cannot_be_read_says_so_in_one_line(name, text, message, tmp_path, capfd):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        tp.read_mesh(path)
    assert "\n" not in str(error.value) and capfd.readouterr() == ("", "")


def test_a_missing_library_is_named(tmp_path, monkeypatch):
    for suffix, library in (("stl", "trimesh"), ("vtu", "meshio")):
        (tmp_path / f"mesh.{suffix}").write_text("rubbish")
        monkeypatch.setitem(sys.modules, library, None)
        with pytest.raises(InputError, match=rf"needs {library}: pip install 'tparticles\[mesh\]'"):
            tp.read_mesh(tmp_path / f"mesh.{suffix}")
