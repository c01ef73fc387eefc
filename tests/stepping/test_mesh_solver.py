"""Implicit stages of spring meshes against dense algebra, closed forms, and what must never happen."""

import builtins

import numpy as np
import pytest

from tparticles.errors import InputError
from tparticles.stepping import mesh_solver_direct as direct
from tparticles.stepping.mesh_solver import MeshSolver
from tparticles.stepping.mesh_solver_matrix import Springs, StepMatrix, UpperPattern, positive_part, steadied

GRAVITY = np.array([0.0, -9.81, 0.0])
H = 1 / 24


def fall(x, v):
    return np.broadcast_to(GRAVITY, x.shape)


def tangle(seed, vertices=8, springs=14, fixed=2):
    """Return a random mesh, doubled springs and all, with its state."""
    rng = np.random.default_rng(seed)
    pairs = np.array([rng.choice(vertices, 2, replace=False) for _ in range(springs)])
    x = rng.standard_normal((vertices, 3))
    rest = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1) * rng.uniform(0.7, 1.2, springs)
    mesh = {
        "springs": pairs,
        "stiffness": rng.uniform(1.0, 500.0, springs),
        "damping": rng.uniform(0.0, 2.0, springs),
        "rest": rest,
        "mass": rng.uniform(0.1, 2.0, vertices),
        "fixed": np.arange(vertices) < fixed,
    }
    return mesh, x, 0.3 * rng.standard_normal((vertices, 3))


def rope(ratio, vertices=30, length=1.0, damping=0.0):
    """Return a level rope held at one end; `ratio` is k L0 / (m g)."""
    size, mass = length / (vertices - 1), 0.01
    first = np.arange(vertices - 1)
    x = np.zeros((vertices, 3))
    x[:, 0] = size * np.arange(vertices)
    mesh = {
        "springs": np.stack([first, first + 1], 1),
        "stiffness": ratio * mass * 9.81 / size,
        "damping": damping,
        "rest": size,
        "mass": mass,
        "fixed": np.arange(vertices) == 0,
    }
    return mesh, x, np.zeros((vertices, 3))


def sheet(count, ratio):
    """Return a square sheet of 1 m with structural, shear and bend springs, held at two corners."""
    size, mass = 1.0 / (count - 1), 0.2 / count**2
    index = np.arange(count**2).reshape(count, count)
    ends = [(index[1:], index[:-1]), (index[:, 1:], index[:, :-1]), (index[1:, 1:], index[:-1, :-1])]
    ends += [(index[1:, :-1], index[:-1, 1:]), (index[2:], index[:-2]), (index[:, 2:], index[:, :-2])]
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], 1) for a, b in ends])
    axis = np.linspace(0.0, 1.0, count)
    x = np.stack([a.ravel() for a in np.meshgrid(axis, [0.0], axis, indexing="ij")], 1)
    mesh = {
        "springs": pairs,
        "stiffness": ratio * mass * 9.81 / size,
        "damping": 0.0,
        "rest": np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1),
        "mass": mass,
        "fixed": np.isin(np.arange(count**2), [0, count - 1]),
    }
    return mesh, x, np.zeros_like(x)


def spring_acceleration(mesh, x, v):
    """Return the springs' acceleration, spring by spring."""
    a = np.zeros_like(x)
    mass = np.broadcast_to(mesh["mass"], len(x))
    values = [np.broadcast_to(mesh[k], len(mesh["springs"])) for k in ("stiffness", "damping", "rest")]
    for (i, j), k, c, rest in zip(mesh["springs"], *values, strict=True):
        d = x[i] - x[j]
        length = np.linalg.norm(d)
        force = -(k * (length - rest) + c * (v[i] - v[j]) @ d / length) * d / length
        a[i] += force / mass[i]
        a[j] -= force / mass[j]
    return np.where(np.asarray(mesh["fixed"])[:, None], 0.0, a)


def dense(mesh, x, v, h):
    """Return A and K over all vertices, (3n, 3n), and the springs' force; compressed springs do nothing across themselves."""
    n = len(x)
    A, K, force = np.zeros((n, 3, n, 3)), np.zeros((n, 3, n, 3)), np.zeros((n, 3))
    for i in range(n):
        A[i, :, i, :] += mesh["mass"][i] * np.eye(3)
    for (i, j), k, c, rest in zip(mesh["springs"], mesh["stiffness"], mesh["damping"], mesh["rest"], strict=True):
        d = x[i] - x[j]
        length = np.linalg.norm(d)
        u = d / length
        tension = k * (length - rest) + c * u @ (v[i] - v[j])
        stiff = k * np.outer(u, u) + max(tension, 0.0) / length * (np.eye(3) - np.outer(u, u))
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            A[p, :, q, :] += sign * (h * h * stiff + h * c * np.outer(u, u))
            K[p, :, q, :] -= sign * stiff
        force[i] -= tension * u
        force[j] += tension * u
    return A.reshape(3 * n, 3 * n), K.reshape(3 * n, 3 * n), force


def methods():
    return ["cg"] + (["direct"] if direct.available() else [])


@pytest.mark.parametrize("method", methods())
@pytest.mark.parametrize("seed", range(4))
def test_a_linear_stage_is_one_dense_newton_step(method, seed):
    mesh, x, v = tangle(seed)
    result = MeshSolver(**mesh, method=method).solve(x, v, H, fall, linear=True)
    A, K, force = dense(mesh, x, v, H)
    free = np.repeat(~mesh["fixed"], 3)
    b = (H * (force + mesh["mass"][:, None] * GRAVITY)).ravel() + H * H * K @ v.ravel()
    dv = np.zeros(3 * len(x))
    dv[free] = np.linalg.solve(A[np.ix_(free, free)], b[free])
    np.testing.assert_allclose(result.v.ravel(), v.ravel() + dv, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(result.x, x + H * result.v, rtol=1e-14)
    assert result.converged and result.iterations == 1 and result.residual < 1e-8


@pytest.mark.parametrize("method", methods())
@pytest.mark.parametrize("seed", range(4))
def test_a_stage_solves_its_equation(method, seed):
    mesh, x, v = tangle(seed)

    def wind(x, v):
        return GRAVITY + 3.0 * (np.sin(x) - v)

    result = MeshSolver(**mesh, method=method, tolerance=1e-10).solve(x, v, H, wind)
    a = np.where(mesh["fixed"][:, None], 0.0, spring_acceleration(mesh, result.x, result.v) + wind(result.x, result.v))
    assert result.converged and result.residual <= 1e-10 and result.method == method
    np.testing.assert_allclose(result.v, v + H * a, atol=1e-6)
    np.testing.assert_allclose(result.x, x + H * result.v, atol=1e-14)
    assert (result.linear_iterations > 0) == (method == "cg")


@pytest.mark.parametrize("stiffness", [1.0, 1e4, 1e10])
def test_one_spring_on_a_wall(stiffness):
    # Along its line the spring is linear: v = (vbar - h k / m (xbar - rest)) / (1 + h c / m + h^2 k / m).
    mass, damping, rest = 0.5, 2.0, 1.0
    solver = MeshSolver([[0, 1]], stiffness, damping, rest, mass, [True, False])
    x, v = np.array([[0.0, 0, 0], [1.2, 0, 0]]), np.array([[0.0, 0, 0], [-0.7, 0, 0]])
    result = solver.solve(x, v, H)
    expected = (-0.7 - H * stiffness / mass * 0.2) / (1 + H * damping / mass + H * H * stiffness / mass)
    assert result.v[1] == pytest.approx([expected, 0, 0], rel=1e-9)


def test_two_free_masses_keep_their_momentum():
    solver = MeshSolver([[0, 1]], 1e7, 0.0, 1.0, [0.2, 3.0], [False, False])
    x, v = np.array([[0.0, 0, 0], [1.1, 0, 0]]), np.array([[0.0, 5, 1], [2, 0, 0]])
    result = solver.solve(x, v, H)
    np.testing.assert_allclose([0.2, 3.0] @ result.v, [0.2, 3.0] @ v, rtol=1e-6)


@pytest.mark.parametrize("ratio", [1e5, 1e9])
@pytest.mark.parametrize("method", methods())
def test_a_stiff_rope_swings_and_stays_whole(ratio, method):
    mesh, x, v = rope(ratio)
    solver = MeshSolver(**mesh, method=method, tolerance=0.01)
    counts = []
    for _ in range(36):
        result = solver.solve(x, v, H, fall)
        assert result.converged
        x, v = result.x, result.v
        counts.append(result.iterations)
        lengths = np.linalg.norm(np.diff(x, axis=0), axis=1) * 29
        assert np.abs(lengths - 1.0).max() < 0.05
    assert x[:, 1].min() < -0.5 and np.abs(x).max() < 1.1
    assert np.mean(counts) < 12


def test_the_number_of_iterations_hardly_depends_on_the_stiffness():
    counts = []
    for ratio in (1e4, 1e8):
        mesh, x, v = rope(ratio)
        solver, total = MeshSolver(**mesh, tolerance=0.1), 0
        for _ in range(24):
            result = solver.solve(x, v, H, fall)
            x, v, total = result.x, result.v, total + result.iterations
        counts.append(total)
    assert counts[1] <= 3 * counts[0]


def test_a_rope_hangs_as_its_springs_say():
    # Spring i from the top carries the weight below it: it is longer than at rest by that over k.
    mesh, x, v = rope(1e3, vertices=10, damping=2.0)
    x = x[:, [1, 0, 2]] * [1, -1, 1]
    solver = MeshSolver(**mesh)
    for _ in range(60):
        result = solver.solve(x, v, 1.0, fall)
        x, v = result.x, result.v
    below = 9 - np.arange(9)
    expected = mesh["rest"] + below * mesh["mass"] * 9.81 / mesh["stiffness"]
    np.testing.assert_allclose(-np.diff(x[:, 1]), expected, rtol=1e-8)


@pytest.mark.parametrize("squeeze", [0.9, 0.1, 1e-6])
def test_compressed_springs_leave_the_matrix_positive_definite(squeeze):
    mesh, x, v = tangle(0)
    full = Springs(
        *mesh["springs"].T,
        mesh["stiffness"] * 1e6,
        mesh["damping"],
        mesh["rest"] / squeeze,
        mesh["mass"],
        ~mesh["fixed"],
    )
    tension, length, u = full.stretched(x.T.copy(), v.T.copy())
    assert (tension < 0).sum() > 5
    matrix = StepMatrix.assemble(full, H, tension, length, u, None)
    upper = UpperPattern(full)
    a = np.zeros((18, 18))
    a[np.repeat(np.arange(18), np.diff(upper.starts)), upper.columns] = upper.values(matrix)
    a += np.triu(a, 1).T
    assert np.linalg.eigvalsh(a).min() > 0.0
    y = np.random.default_rng(1).standard_normal(18)
    np.testing.assert_allclose(upper.pack(matrix @ upper.unpack(y, 8)), a @ y, rtol=1e-9)


def test_blocks_without_their_negative_eigenvalues_are_what_lapack_finds():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(400, 3)) * 10.0 ** rng.uniform(-3, 6, (400, 1))
    values[:80, 1] = values[:80, 0]  # double ones
    values[80:100] = values[80:100, :1]  # triple ones
    values[100:140, 2] = 0.0
    values[140] = 0.0
    axes = np.linalg.qr(rng.normal(size=(400, 3, 3)))[0]
    blocks = np.einsum("nak,nk,nbk->abn", axes, values, axes)
    wanted = np.einsum("nak,nk,nbk->abn", axes, np.maximum(values, 0.0), axes)
    six = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
    error = np.abs(positive_part(blocks[six]) - wanted[six]).max(axis=0)
    assert (error <= 1e-7 * np.abs(values).max(axis=1)).all()


def test_a_pull_that_compressed_springs_cancel_does_not_hold_a_strip():
    # Structural springs pull with 1 N, bend springs over two of them push with as much: no stress along the strip.
    n = np.arange(9)
    pairs = np.concatenate([np.stack([n[:-1], n[1:]], 1), np.stack([n[:-2], n[2:]], 1)])
    springs = Springs(*pairs.T, np.ones(15), np.zeros(15), np.ones(15), np.ones(9), np.ones(9, bool))
    length = np.repeat([1.0, 2.0], [8, 7])
    u = np.array([[1.0], [0.0], [0.0]]) * np.ones(15)
    found = steadied(springs, np.repeat([2.0, -1.0], [8, 7]), length, u)
    np.testing.assert_allclose(found[2:6], 0.0, atol=1e-12)
    pulled = np.repeat([3.0, 1.0], [8, 7])
    np.testing.assert_array_equal(steadied(springs, pulled, length, u), pulled)
    half = np.repeat([3.0, -1.0], [8, 7])  # 2 N are left over
    through = steadied(springs, half, length, u)
    assert through[3] + 2 * through[11] == pytest.approx(3.0 - 2.0, rel=0.3)
    assert (through >= 0.0).all()


@pytest.mark.skipif(not direct.available(), reason="neither MKL nor scipy is installed")
def test_both_methods_give_the_same_cloth():
    mesh, x, v = sheet(8, 1e5)
    x[:, 1] += 0.01 * np.sin(5 * x[:, 0])
    a, b = (MeshSolver(**mesh, method=m, tolerance=1e-9).solve(x, v, H, fall) for m in ("cg", "direct"))
    assert a.converged and b.converged
    np.testing.assert_allclose(a.x, b.x, atol=1e-7)


@pytest.mark.parametrize("kind", ["pardiso", "superlu"])
def test_direct_solvers_agree_with_dense_algebra(kind):
    if kind == "pardiso" and direct.available() != "pardiso":
        pytest.skip(f"MKL is missing: {direct.INSTALL}")
    pytest.importorskip("scipy")
    mesh, x, v = tangle(3)
    springs = MeshSolver(**mesh, method="cg").springs
    upper = UpperPattern(springs)
    solver = (direct.Pardiso if kind == "pardiso" else direct.SuperLU)(upper.starts, upper.columns)
    for squeeze in (1.0, 0.5):  # the ordering is used again
        tension, length, u = springs.stretched(np.ascontiguousarray(squeeze * x.T), np.ascontiguousarray(v.T))
        matrix = StepMatrix.assemble(springs, H, tension, length, u, None)
        assert solver.factor(upper.values(matrix))
        b = np.arange(18.0)
        np.testing.assert_allclose(upper.pack(matrix @ upper.unpack(solver.solve(b), 8)), b, atol=1e-9)
    assert not solver.factor(np.full(len(upper.columns), np.nan))


@pytest.mark.skipif(direct.available() != "pardiso", reason=f"MKL is missing: {direct.INSTALL}")
def test_pardiso_gives_the_same_bits_with_one_thread_and_two():
    mesh, x, v = sheet(40, 1e6)
    library = direct._mkl()
    before = library.MKL_Get_Max_Threads()
    found = []
    try:
        for threads in (1, 2):
            library.MKL_Set_Num_Threads(threads)
            found.append(MeshSolver(**mesh, method="direct").solve(x, v, H, fall, linear=True).v)
    finally:
        library.MKL_Set_Num_Threads(before)
    np.testing.assert_array_equal(*found)


def test_fixed_vertices_go_where_they_are_told():
    mesh, x, v = tangle(1)
    v[0] = [1.0, 2.0, 3.0]
    for linear in (True, False):
        result = MeshSolver(**mesh).solve(x, v, H, fall, linear=linear)
        np.testing.assert_array_equal(result.v[:2], v[:2])
        np.testing.assert_allclose(result.x[:2], x[:2] + H * v[:2], rtol=1e-15)
    everything = {**mesh, "fixed": np.ones(8, bool)}
    for method in methods():
        np.testing.assert_array_equal(MeshSolver(**everything, method=method).solve(x, v, H, fall).v, v)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_not_a_number_is_not_a_solution(bad):
    mesh, x, v = tangle(1)
    broken = x.copy()
    broken[3, 1] = bad
    assert not MeshSolver(**mesh).solve(broken, v, H, fall).converged
    for linear in (True, False):
        assert not MeshSolver(**mesh).solve(x, v, H, lambda x, v: np.full_like(x, bad), linear=linear).converged


def test_coincident_vertices_and_lone_ones():
    solver = MeshSolver([[0, 1], [0, 1]], 100.0, 1.0, 0.5, 1.0, [False, False, False])
    result = solver.solve(np.zeros((3, 3)), np.zeros((3, 3)), H, fall)
    assert result.converged
    np.testing.assert_allclose(result.v, H * np.broadcast_to(GRAVITY, (3, 3)), atol=1e-12)
    no_springs = MeshSolver(np.zeros((0, 2), int), 1.0, 0.0, 1.0, 1.0, [False])
    np.testing.assert_allclose(no_springs.solve(np.zeros((1, 3)), np.zeros((1, 3)), H, fall).v[0], H * GRAVITY)


def test_strong_drag_is_part_of_the_matrix():
    # v = vbar - h c v: a fixed-point iteration would diverge at h c = 400.
    solver = MeshSolver([[0, 1]], 10.0, 0.0, 1.0, 1.0, [True, False])
    x, v = np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.array([[0.0, 0, 0], [0.0, 3.0, 0.0]])
    result = solver.solve(x, v, 1.0, lambda x, v: -400.0 * v)
    assert result.converged and result.iterations < 6
    assert result.v[1, 1] == pytest.approx(3.0 / 401.0, rel=1e-3)


def test_single_precision_stays_single():
    mesh, x, v = sheet(6, 1e4)
    solver = MeshSolver(**mesh)
    rough = solver.solve(x.astype(np.float32), v.astype(np.float32), H, fall)
    assert rough.x.dtype == rough.v.dtype == np.float32 and rough.converged and rough.residual <= 0.1
    assert solver.solve(x, v, H, fall).residual <= 1e-8


def test_the_choice_is_told():
    mesh, x, v = sheet(24, 1e1)
    soft = MeshSolver(**mesh)
    assert soft.solve(x, v, 1e-4, fall).method == "cg"
    assert "about 3 CG iterations" in soft.reason
    if direct.available():
        mesh["stiffness"] *= 1e6
        stiff = MeshSolver(**mesh)
        assert stiff.solve(x, v, H, fall, linear=True).method == "direct"
        assert f"one factorisation ({direct.available()})" in stiff.reason


def test_without_a_direct_solver_cg_serves_and_says_what_is_missing(monkeypatch):
    mesh, x, v = sheet(6, 1e7)
    load = builtins.__import__

    def no_scipy(name, *args, **kwargs):
        if name.startswith("scipy"):
            raise ImportError(name)
        return load(name, *args, **kwargs)

    monkeypatch.setattr(direct, "_mkl", lambda: None)
    monkeypatch.setattr(builtins, "__import__", no_scipy)
    solver = MeshSolver(**mesh, tolerance=0.1)
    assert solver.solve(x, v, H, fall).method == "cg"
    assert "pip install 'tparticles[implicit]'" in solver.reason
    with pytest.raises(InputError, match="pip install"):
        MeshSolver(**mesh, method="direct")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"method": "direkt"}, "did you mean 'direct'"),
        ({"springs": [[0, 9]]}, "spring 0 joins vertices 0 and 9"),
        ({"springs": [[1, 1]]}, "two different ones"),
        ({"mass": 0.0}, "vertex 0 has mass 0"),
    ],
)
def test_bad_meshes_are_named(change, words):
    good = {"springs": [[0, 1]], "stiffness": 1.0, "damping": 0.0, "rest": 1.0, "mass": 1.0, "fixed": [False, False]}
    with pytest.raises(InputError, match=words):
        MeshSolver(**{**good, **change})
