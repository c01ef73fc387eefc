"""Contact: event times against the closed form, rest, energy, walls that hold."""

import numpy as np
import pytest
from mesh_bench import FRAME, motion, run

import tparticles as tp
from tparticles import schemes
from tparticles.systems.spring_mesh import energies

pytestmark = pytest.mark.usefixtures("cpu64")
G = 9.81


def ball_height(t, *, height, restitution):
    """Return the height of a ball dropped from rest that bounces on z = 0."""
    fall = np.sqrt(2 * height / G)
    if t < fall:
        return height - 0.5 * G * t * t
    t, v = t - fall, restitution * G * fall
    while v > 1e-12 and t > 2 * v / G:
        t, v = t - 2 * v / G, v * restitution
    return max(0.0, v * t - 0.5 * G * t * t)


@pytest.mark.parametrize("exact", [True, False], ids=["whole mesh", "vertex by vertex"])
@pytest.mark.parametrize("name", ["velocity-verlet", "rk4", "abm4"])
def test_a_ball_bounces_when_it_should_and_comes_to_rest(name, exact):
    # all bounces are over after sqrt(2 h / g) (1 + e) / (1 - e) = 4.06 s
    bench = motion(tp.Mesh(x=[[0, 0, 1.0]]), scheme=name, colliders=tp.Plane(restitution=0.8))
    bench.stepper.stages.exact = exact
    for k in range(24 * 5):
        run(bench, 1, first=k)
        height = bench.system.read()[0][0, 2]
        wanted = ball_height((k + 1) * FRAME, height=1.0, restitution=0.8)
        assert abs(height - wanted) < (1e-12 if k < 72 else 2e-5), k
    assert bench.stepper.contact.touching[0] == 1
    assert np.abs(bench.system.read()).max() < 1e-15


@pytest.mark.parametrize("friction", [0.0, 0.2, 5.0])
def test_a_sliding_mass_is_braked_by_coulombs_law(friction):
    bench = motion(tp.Mesh(x=[[0, 0, 0]], v=[[1, 0, 0]]), colliders=tp.Plane(friction=friction, restitution=0.0))
    run(bench, 12)
    x, v = bench.system.read()
    # the touch-down itself takes nothing: it comes with no normal speed
    t = min(0.5, 1.0 / (friction * G) if friction else 0.5)
    assert v[0, 0] == pytest.approx(max(0.0, 1 - friction * G * 0.5), abs=1e-6)
    assert x[0, 0] == pytest.approx(t - 0.5 * friction * G * t * t, abs=0.02)


def test_a_mass_rests_on_a_slope_that_friction_holds_and_slides_on_a_steeper_one():
    for degrees, holds in ((20.0, True), (40.0, False)):
        a = np.radians(degrees)
        slope = tp.Plane(facing=(np.sin(a), 0.0, np.cos(a)), friction=0.5, restitution=0.0)
        bench = motion(tp.Mesh(x=[[0, 0, 1e-6]]), colliders=slope)
        run(bench, 24)
        x, v = bench.system.read()
        if holds:
            assert np.abs(x).max() < 1e-4
        else:
            speed = G * (np.sin(a) - 0.5 * np.cos(a))
            assert np.linalg.norm(v) == pytest.approx(speed, rel=0.01)


def test_a_box_dropped_on_its_corner_a_thousand_times_stays_inside_and_gains_no_energy():
    # many boxes in one mesh: they do not meet
    count, rng = 1000, np.random.default_rng(5)
    boxes = []
    for _ in range(count):
        axis = rng.normal(size=3)
        box = tp.spring_box(stiffness=1000.0, damping=0.5).turned(
            tuple(axis / np.linalg.norm(axis)), rng.uniform(0, 360)
        )
        boxes.append(box.moved((0, 0, 2.0)).launched(tuple(rng.normal(size=3)), spin=tuple(3 * rng.normal(size=3))))
    parts = {
        name: np.concatenate([getattr(b, name) for b in boxes])
        for name in ("x", "v", "mass", "stiffness", "damping", "rest")
    }
    springs = np.concatenate([b.springs + 8 * k for k, b in enumerate(boxes)])
    room = tp.Room(low=(-3, -3, 0), high=(3, 3, 5), restitution=0.5, friction=0.2)
    bench = motion(tp.Mesh(**parts, springs=springs), colliders=room, dt=1 / 960)

    def energy():
        x, v = bench.system.read()
        i, j = springs.T
        stretch = np.linalg.norm(x[j] - x[i], axis=1) - parts["rest"]
        per_vertex = 0.5 * parts["mass"] * (v**2).sum(axis=1) + G * parts["mass"] * x[:, 2]
        return per_vertex.reshape(count, 8).sum(axis=1) + (0.5 * parts["stiffness"] * stretch**2).reshape(
            count, -1
        ).sum(axis=1)

    before = energy()
    for k in range(36):
        run(bench, 1, first=k)
        x, _ = bench.system.read()
        assert (x >= np.array(room.low) - 1e-9).all()
        assert (x <= np.array(room.high) + 1e-9).all()
        after = energy()
        assert (after - before).max() < 2e-3 * before.max()
        before = np.minimum(before, after)
    assert bench.stepper.contacts > 10 * count


def test_a_moving_floor_carries_what_lies_on_it():
    floor = tp.Plane(friction=1.0, restitution=0.0, velocity=(0.5, 0.0, 0.2))
    bench = motion(tp.Mesh(x=[[0, 0, 0.01]]), colliders=floor)
    run(bench, 24)
    x, v = bench.system.read()
    assert v[0] == pytest.approx([0.5, 0.0, 0.2], abs=1e-6)
    assert x[0, 2] == pytest.approx(0.2, abs=1e-6)


@pytest.mark.parametrize("scheme", [s.name for s in schemes.CATALOGUE.values() if s.implicit and 2 in s.system_orders])
def test_a_stiff_box_lands_without_a_gain_and_comes_to_rest_under_an_implicit_scheme(scheme):
    """Stopped along the normal alone, by backward Euler: a corner that is held in all directions would tear the stiff box apart."""
    mesh = tp.spring_box(stiffness=1e6).turned((1.0, 0.5, 0.2), 35.0).moved((0.0, 0.0, 1.0))
    mesh = mesh.launched((0.3, 0.1, -1.0), spin=(2.0, 1.0, 0.5))
    bench = motion(mesh, scheme=scheme, dt=FRAME / 4, colliders=(tp.Plane(friction=0.3),))
    energy, whole = [], np.ones(mesh.spring_count, bool)
    for k in range(30):
        run(bench, 1, first=k)
        x, v = bench.system.read()
        energy.append(sum(energies(mesh, x, v, whole, np.array([0.0, 0.0, -9.81])).values()))
        assert x[:, 2].min() > -1e-8
    # a box that spins between two steps keeps its energy on average only, under the midpoint rule
    assert max(energy) < energy[0] * (1.003 if scheme == "implicit-midpoint" else 1.0001)
    # it lies on a face; the linearised scheme is still about to
    rest = 1e-2 if scheme == "semi-implicit-euler" else 1e-3
    assert abs(energy[-1] - energy[-2]) < rest * energy[0] and np.sort(x[:, 2])[:4].max() < 20 * rest
