"""The staged executor: every scheme on a mesh against the plain interpreter, closed forms, conservation, one thread or many."""

import dataclasses

import numpy as np
import pytest
from mesh_bench import FRAME, motion, right_hand_side, run

import tparticles as tp
from tparticles import backend, schemes
from tparticles.stepping import staged

pytestmark = pytest.mark.usefixtures("cpu64")

SCHEMES = [s for s in schemes.CATALOGUE.values() if 2 in s.system_orders]
EXPLICIT = [s for s in SCHEMES if not s.implicit]
FAMILIES = ("rk4", "velocity-verlet", "beeman", "abm4")


def triangle(damping=0.2):
    """Return three masses, the first pinned, on two springs."""
    x = [[0.0, 0.0, 0.0], [1.3, 0.1, 0.0], [0.2, 1.0, 0.4]]
    v = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.5]]
    springs = [[0, 1], [1, 2]]
    return tp.Mesh(x=x, v=v, mass=[1, 2, 0.5], springs=springs, stiffness=[50, 30], damping=damping, rest=1.0).pin([0])


def interpreted(mesh, scheme, dt, steps):
    free = mesh.damping.max() == 0
    z0 = np.stack([mesh.x, mesh.v])
    return schemes.integrate(scheme, right_hand_side(mesh), 0.0, z0, dt, steps, velocity_free=free)[-1]


@pytest.mark.parametrize("scheme", EXPLICIT, ids=lambda s: s.name)
def test_a_scheme_does_what_its_program_says(scheme):
    mesh = triangle(0.0 if "velocity-free forces" in scheme.needs else 0.2)
    bench = motion(mesh, scheme=scheme, dt=FRAME / 8)
    run(bench, 2)
    assert np.allclose(bench.system.read(), interpreted(mesh, scheme, FRAME / 8, 16), rtol=0, atol=1e-12)


GRIDS = {
    "cloth": lambda **more: tp.cloth(counts=(19, 9), stiffness=2.0, **more).pin([0, 18]),
    "jelly": lambda **more: tp.lattice(counts=(3, 4, 5), stiffness=2.0, **more),
    "rope": lambda **more: tp.rope(count=40, stiffness=2.0, **more).pin([0]),
}


def crumpled(mesh):
    """Return a mesh whose vertices are out of place and move; springs that should be of one length are, to the last bit."""
    rng = np.random.default_rng(7)
    noise = rng.normal(0.0, 0.1 * mesh.rest.min(), (2, *mesh.x.shape)) * ~mesh.pinned[:, None]
    return dataclasses.replace(mesh, x=mesh.x + noise[0], v=mesh.v + noise[1], rest=np.round(mesh.rest, 9))


@pytest.mark.parametrize("damping", [0.0, 0.01])
@pytest.mark.parametrize("name", GRIDS)
def test_rows_of_a_grid_pull_as_springs_one_by_one(name, damping):
    """Springs that may tear are kept one by one; the rows of other grids are kept as one each."""
    mesh = crumpled(GRIDS[name](damping=damping))
    one_by_one = crumpled(GRIDS[name](damping=damping, tear=1e9))
    rows, entries = (motion(m, scheme="rk4", dt=FRAME / 30) for m in (mesh, one_by_one))
    assert rows.system.straight and (rows.system.row_first.to_numpy() >= 0).mean() > 0.4 and not entries.system.straight
    for bench in (rows, entries):
        bench.advance(0.0, FRAME / 15, np.zeros(15, np.float32))
    assert np.allclose(rows.system.read(), entries.system.read(), rtol=0, atol=1e-14)
    assert np.allclose(rows.system.read(), interpreted(mesh, schemes.get("rk4"), FRAME / 30, 2), rtol=0, atol=1e-13)


def test_a_mesh_may_be_stiffened():
    soft, stiff = (
        motion(crumpled(tp.cloth(counts=20, stiffness=k, damping=0.01)), scheme="rk4", dt=FRAME / 30)
        for k in (1.0, 2.0)
    )
    soft.system.stiffen(2.0)
    for bench in (soft, stiff):
        run(bench, 1)
    assert np.array_equal(soft.system.read(), stiff.system.read())


@pytest.mark.parametrize("name", FAMILIES)
def test_a_launch_for_every_evaluation_gives_the_same_as_one_for_all_steps(name):
    states = []
    for serial in (True, False):
        bench = motion(triangle(0.0), scheme=name)
        bench.stepper.serial = serial
        run(bench, 2)
        states.append(bench.system.read())
    assert np.array_equal(*states)


@pytest.mark.parametrize("name", FAMILIES)
def test_steps_that_something_may_come_between_give_the_same_as_steps_on_end(name):
    states = []
    for colliders in ((), (tp.Plane(point=(0.0, 0.0, -1e3)),)):
        bench = motion(triangle(0.0), scheme=name, colliders=colliders)
        run(bench, 2)
        states.append(bench.system.read())
    assert np.array_equal(*states)


@pytest.mark.parametrize("scheme", [s for s in SCHEMES if s.implicit], ids=lambda s: s.name)
def test_an_implicit_scheme_does_what_its_program_says(scheme):
    mesh = triangle()
    bench = motion(mesh, scheme=scheme, dt=FRAME / 4)
    run(bench, 2)
    # one linear solve leaves compressed springs' sideways push out of its matrix; here none is compressed much
    close = 2e-3 if any(op.linear for op in scheme.ops) else 1e-6
    assert np.allclose(bench.system.read(), interpreted(mesh, scheme, FRAME / 4, 8), rtol=0, atol=close)


@pytest.mark.parametrize("zeta", [0.0, 0.1, 1.0, 10.0])
@pytest.mark.parametrize("name", ["rk4", "velocity-verlet", "backward-euler", "trapezoidal"])
def test_two_masses_on_a_spring_follow_the_closed_form(name, zeta):
    # the distance obeys l'' = -w^2 (l - l0) - 2 zeta w l', w^2 = k (1/m1 + 1/m2)
    k, masses = 40.0, np.array([1.0, 3.0])
    w = np.sqrt(k * np.sum(1 / masses))
    damping = 2 * zeta * w / np.sum(1 / masses)
    mesh = tp.Mesh(x=[[0, 0, 0], [1.2, 0, 0]], mass=masses, springs=[[0, 1]], stiffness=k, damping=damping, rest=1.0)
    steps = 400
    bench = motion(mesh, scheme=name, dt=FRAME / steps, forces=())
    run(bench, 3)
    t, d = 3 * FRAME, np.emath.sqrt(zeta**2 - 1 + 0j)
    if zeta == 1.0:
        wanted = 1 + 0.2 * np.exp(-w * t) * (1 + w * t)
    else:
        a, b = w * (-zeta + d), w * (-zeta - d)
        wanted = 1 + (0.2 * (b * np.exp(a * t) - a * np.exp(b * t)) / (b - a)).real
    x, _ = bench.system.read()
    order = schemes.get(name).order
    allowed = {1: 2e-3, 2: 2e-5, 4: 1e-9}[order] * max(1.0, zeta)
    assert abs(np.linalg.norm(x[1] - x[0]) - wanted) < allowed


def test_a_free_mesh_keeps_its_momentum_to_rounding():
    mesh = tp.lattice(counts=(4, 4, 4), mass=2.0, stiffness=300.0, damping=0.1).launched(
        (0.3, 0.1, -0.2), spin=(2, 1, 3)
    )
    bench = motion(mesh, forces=())
    m = mesh.mass[:, None]

    def momenta(x, v):
        return np.sum(m * v, axis=0), np.sum(m * np.cross(x, v), axis=0)

    before = momenta(mesh.x, mesh.v)
    run(bench, 24)
    after = momenta(*bench.system.read())
    assert np.allclose(after, before, rtol=0, atol=1e-12)


def test_a_vertex_with_many_springs_keeps_momentum_too():
    n = 200
    angle = 2 * np.pi * np.arange(n) / n
    rim = np.stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(3 * angle)], axis=1)
    spokes = np.stack([np.zeros(n, int), 1 + np.arange(n)], axis=1)
    mesh = tp.Mesh(x=np.vstack([[0, 0, 0], rim]), springs=spokes, stiffness=100.0, rest=0.8)
    bench = motion(mesh, forces=())
    run(bench, 3)
    _, v = bench.system.read()
    assert np.abs(v).max() > 0.5
    assert np.allclose(v.sum(axis=0), 0.0, atol=1e-11)


def test_a_hanging_chain_settles_on_the_catenary_of_its_springs():
    count, mass, stiffness, g = 9, 0.8, 200.0, 9.81
    chain = tp.rope(start=(0, 0, 0), end=(1, 0, 0), count=count, mass=mass, stiffness=stiffness).pin([0, count - 1])
    bench = motion(chain, forces=(tp.Gravity(), tp.Drag(time=0.2)), dt=1 / 960)
    run(bench, 24 * 6)
    x, v = bench.system.read()
    assert np.abs(v).max() < 1e-6
    # in equilibrium the horizontal tension is the same everywhere, the vertical one grows by a vertex's weight
    d = np.diff(x, axis=0)
    length = np.linalg.norm(d, axis=1)
    pull = (chain.stiffness * (length - chain.rest))[:, None] * d / length[:, None]
    assert np.allclose(pull[:, 0], pull[0, 0], rtol=1e-5)
    assert np.allclose(np.diff(pull[:, 2]), mass / count * g, rtol=1e-4)


def test_a_driven_vertex_ends_each_step_on_its_path():
    path = tp.Track(keys=((0.0, (0.0, 0.0, 0.0)), (0.1, (0.0, 0.0, 0.3)), (0.2, (0.4, 0.0, 0.3))))
    mesh = tp.rope(count=4, stiffness=500.0).driven(path, [0])
    for name in ("rk4", "velocity-verlet", "backward-euler"):
        bench = motion(mesh, scheme=name)
        for k in range(4):
            run(bench, 1, first=k)
            x, v = bench.system.read()
            assert np.allclose(x[0], mesh.x[0] + path.at((k + 1) * FRAME), atol=1e-12)
            assert np.isfinite(v).all()


def test_a_torn_spring_pulls_no_more():
    mesh = tp.Mesh(
        x=[[0, 0, 0], [0, 0, -1]], springs=[[0, 1]], stiffness=20.0, mass=1.0, tear=0.2, v=[[0, 0, 0], [0, 0, -2]]
    ).pin([0])
    for name in ("velocity-verlet", "backward-euler"):
        bench = motion(mesh, scheme=name)
        run(bench, 12)
        assert not bench.system.whole().any()
        _, v = bench.system.read()
        run(bench, 12, first=12)
        _, later = bench.system.read()
        assert later[1, 2] - v[1, 2] == pytest.approx(-9.81 / 2)


def test_stiff_springs_stay_bounded_and_settle_under_backward_euler():
    chain = tp.rope(start=(0, 0, 0), end=(1, 0, 0), count=12, mass=0.1, stiffness=1e9).pin([0])
    bench = motion(chain, scheme="backward-euler", dt=FRAME)
    run(bench, 24)
    x, _ = bench.system.read()
    assert np.abs(x).max() < 1.01
    run(bench, 24 * 20, first=24)
    x, v = bench.system.read()
    assert np.allclose(x[-1], (0.0, 0.0, -1.0), atol=0.02)
    assert np.abs(v).max() < 0.1


def test_what_was_saved_goes_on_with_the_same_bits():
    mesh = tp.cloth(counts=(5, 5), stiffness=100.0, tear=0.5).moved((0, 0, 0.3))
    for name in ("abm4", "bdf2"):
        bench = motion(mesh, scheme=name, colliders=tp.Plane())
        run(bench, 3)
        saved = {key: np.copy(value) for key, value in bench.snapshot().items()}
        run(bench, 4, first=3)
        wanted = bench.system.read()
        again = motion(mesh, scheme=name, colliders=tp.Plane())
        again.restore(saved)
        run(again, 4, first=3)
        assert np.array_equal(again.system.read(), wanted)


@pytest.mark.parametrize("colliders", [(), tp.Ball(radius=0.5)], ids=["free", "ball"])
def test_threads_do_not_change_a_bit(monkeypatch, colliders):
    # one launch for all steps, and one for every pass
    states = []
    monkeypatch.setattr(staged, "_WAKE", 0)
    gusts = tp.CurlNoise(speed=2.0, length=1.0, drift=(3.0, 0.0, 0.0), period=1.0)
    for threads in (1, 2):
        backend.stop()
        backend.start(arch="cpu", threads=threads, precision="f32")
        mesh = tp.cloth(counts=(160, 140), stiffness=1.0).turned((1, 1, 0), 30).moved((0, 0, 1))
        bench = motion(mesh, colliders=colliders, forces=(tp.Gravity(), tp.Drag(time=0.1, flow=gusts)), dt=1 / 960)
        assert bench.stepper.serial is (threads == 1)
        run(bench, 2)
        states.append(bench.system.read())
    backend.stop()
    backend.start(arch="cpu", threads=2, precision="f64")
    assert np.array_equal(*states)
