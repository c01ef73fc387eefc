"""Spring meshes in a scene: beside particles, in pictures and states, blown up, and put together wrongly."""

import dataclasses

import numpy as np
import pytest
from small_scenes import group, scene, simulate

import tparticles as tp
from tparticles import schemes
from tparticles.errors import InputError, RunError

SHEET = tp.cloth(counts=(6, 5), size=(1.0, 0.8), mass=0.1, stiffness=40.0).turned((1, 0, 0), 90)
WIRES = tp.Wires(colors=((1.0, 0.5, 0.25),), width=0.05, dot=0.1)


def mesh(**options):
    return tp.MeshGroup(
        **{
            "name": "cloth",
            "mesh": SHEET,
            "appearance": WIRES,
            "scheme": "velocity-verlet",
            "steps": tp.StabilityLimit(),
        }
        | options
    )


def film(*groups, **options):
    return scene(*groups, scheme="rk4", steps=tp.Fixed(dt=1 / 48), **options)


def test_meshes_and_particles_share_a_film():
    simulation = simulate(film(group(), mesh()))
    frames = [(f.report, f.state(), f.image.copy(), f.linear()) for f in simulation.frames((1, 3))]
    report, state, image, _ = frames[0]
    assert report.born == report.alive == 10 + 30
    assert set(state) == {"dots", "cloth"}
    assert state["cloth"]["x"].shape == state["cloth"]["v"].shape == (30, 3)
    assert image.max() > 50
    fallen = frames[1][1]["cloth"]["x"] - SHEET.x
    assert fallen[:, 2].mean() == pytest.approx(-0.5 * 9.81 * (3 / 24) ** 2, rel=1e-3)


def test_a_line_adds_the_energy_of_its_area_wherever_it_lies():
    sums = []
    for angle, offset in ((0.0, 0.0), (31.0, 0.0), (90.0, 0.013), (77.0, 0.031)):
        line = tp.rope(start=(-0.5, 0, 0), end=(0.5, 0, 0), count=2).turned((0, 1, 0), angle).moved((offset, 0, offset))
        still = mesh(mesh=line.pin([0, 1]), appearance=tp.Wires(colors=((1.0, 1.0, 1.0),), width=0.004))
        frame = next(simulate(film(still)).frames((1,)))
        sums.append(frame.linear().sum(axis=(0, 1))[0])
    # 1 m by 4 mm at 5 m; the film is 36 px high
    focal = 18 / np.tan(np.radians(tp.Camera(position=(0, -5, 0), target=(0, 0, 0)).fov) / 2)
    assert sums == pytest.approx([0.004 * (focal / 5) ** 2] * 4, rel=2e-3)


@pytest.mark.parametrize("by", ["constant", "strain", "speed", "temperature"])
def test_every_kind_of_colour_draws(by):
    look = tp.Wires(by=by, colors=((0.2, 0.2, 1.0), (1.0, 0.2, 0.2)), low=-0.1, high=0.1, width=0.03, dot=0.05)
    glowing = mesh(appearance=look, temperature=tp.Track(keys=((0.0, 1500.0), (1.0, 1200.0))))
    frames = [f.linear().sum(axis=(0, 1)) for f in simulate(film(glowing)).frames((1, 12))]
    assert all(frame[0] > 0 for frame in frames)  # a black body's blue may be negative, out of gamut
    if by == "temperature":
        assert frames[0][0] > 1.5 * frames[1][0]
    if by == "speed":
        assert frames[1][0] > frames[1][2]  # fast: the last colour


def test_the_film_does_not_depend_on_how_often_it_is_drawn():
    pictures = [list(simulate(film(mesh())).frames(numbers))[-1].linear().copy() for numbers in ((12,), range(1, 13))]
    assert np.array_equal(*pictures)


STIFF = SHEET.launched(spin=(3.0, 0.0, 1.0))


def test_a_blow_up_is_named_with_the_stable_step():
    wild = mesh(mesh=STIFF, steps=tp.Fixed(dt=1 / 24), scheme="rk4")
    limit = wild.stable_step(schemes.get("rk4"))
    with pytest.raises(RunError) as error:
        list(simulate(film(wild)).frames((24,)))
    for part in (
        "frame ",
        "group 'cloth'",
        "vertex",
        "'rk4'",
        f"stable step on these springs is {limit:.3g} s",
        "t = ",
    ):
        assert part in str(error.value)


def test_a_guard_may_halve_the_step_or_give_the_mesh_up():
    halved = simulate(film(mesh(mesh=STIFF, steps=tp.Fixed(dt=1 / 24), scheme="rk4", guard="halve")))
    reports = [f.report for f in halved.frames((1, 6, 12))]
    assert all(report.alive == 30 for report in reports)
    assert min(report.dt_min for report in reports) < 1 / 40
    killed = simulate(film(group(), mesh(mesh=STIFF, steps=tp.Fixed(dt=1 / 24), scheme="rk4", guard="kill")))
    (last,) = killed.frames((24,))
    assert (last.report.alive, last.report.died) == (10, 30)
    assert len(last.state()["cloth"]["x"]) == 0


def test_an_overstretched_spring_is_named():
    weight = tp.Mesh(x=[[0, 0, 0], [0, 0, -0.1]], springs=[[0, 1]], stiffness=0.1, mass=1.0).pin([0])
    with pytest.raises(RunError, match=r"spring 0 \(vertices 0 and 1\) is .* times as long as at rest \(at most 3\)"):
        list(simulate(film(mesh(mesh=weight, longest=3.0))).frames((24,)))


BALL = tp.Ball(center=(0, 0, 0.5), radius=0.5)
UNDAMPED = {
    "rope": tp.rope(start=(-1, 0, 1.01), end=(1, 0, 1.01), count=32, length=2.2, stiffness=100).pin([0, 31]),
    "falling rope": tp.rope(start=(-1, 0, 0.9), end=(1, 0, 1.2), count=40, stiffness=300),
    "cloth": tp.cloth(counts=(14, 14), size=(1.0, 1.0), mass=0.2, stiffness=200).moved((0, 0, 1.2)),
    "box": tp.spring_box(stiffness=500, damping=0).moved((0, 0, 2)).launched((0.5, 0.1, 0), spin=(3, 2, 1)),
    "lattice": tp.lattice(counts=(5, 5, 5), size=0.8, stiffness=500).moved((0, 0, 1.6)),
}


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("name", UNDAMPED)
def test_steps_at_the_limit_bear_contacts(name, restitution):
    """Undamped springs bounce, velocity Verlet takes the steps that StabilityLimit() gives, and the guard sees no energy come up.

    By steps that are cut at every contact it did, within a second."""
    surface = {"restitution": restitution, "friction": 0.4}
    floor = () if name == "falling rope" else (dataclasses.replace(BALL, **surface),)
    bouncing = mesh(mesh=UNDAMPED[name], colliders=(*floor, tp.Plane(**surface)))
    simulation = simulate(film(bouncing, duration=3.0), precision="f64")
    energies = [sum(simulation.groups[0].energies().values()) for _ in simulation.frames(range(1, 73))]
    assert simulation.groups[0].stepper.contacts > 10
    assert max(energies) < energies[0] * 1.1 and energies[-1] < energies[0]


@pytest.mark.parametrize("scheme", [s.name for s in schemes.CATALOGUE.values() if s.implicit])
def test_stiff_cloth_meets_a_ball_at_the_frame_s_own_step(scheme):
    """Schemes that begin with a slope looked at one that the stop had left swinging, and halved their steps without end."""
    sheet = tp.cloth(counts=(14, 14), size=(1.0, 1.0), mass=0.2, stiffness=1e6, damping=0.01).moved((0.03, 0.02, 1.1))
    stiff = mesh(mesh=sheet, colliders=BALL, scheme=scheme, steps=tp.Fixed(dt=1 / 24))
    simulation = simulate(film(stiff, duration=0.75))
    reports = [frame.report for frame in simulation.frames()]
    assert simulation.groups[0].stepper.contacts > 0
    assert sum(report.rejected for report in reports) <= 12
    assert sum(report.solves["cloth"]["newton"] for report in reports) < 1500
    assert reports[-1].solves["cloth"]["residual"] < 0.1


def test_what_begins_inside_a_collider_is_refused():
    sunk = mesh(mesh=UNDAMPED["rope"].moved((0, 0, -0.1)), colliders=BALL)
    with pytest.raises(InputError, match=r"group 'cloth': vertex 1[56] begins 0\.0887 m inside a collider; move"):
        simulate(film(sunk))
    inside = mesh(
        mesh=UNDAMPED["rope"].pin(where=tp.Sphere(center=(0, 0, 1.01), radius=0.3)).moved((0, 0, -0.02)), colliders=BALL
    )
    next(simulate(film(inside)).frames((1,)))  # what is pinned may


def test_the_limit_of_stability_is_one():
    box = tp.spring_box(stiffness=1000.0, damping=0.0)
    # m w^2 = 8 k, and velocity Verlet is stable up to w dt = 2
    assert mesh(mesh=box).stable_step(schemes.get("velocity-verlet")) == pytest.approx(2 / np.sqrt(8000), rel=1e-6)
    assert mesh(mesh=box).stable_step(schemes.get("backward-euler")) == np.inf


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        ({"mesh": 3}, ("mesh = 3", "Mesh")),
        ({"forces": (tp.Uniform(),)}, ("cloth", "acceleration")),
        ({"colliders": (3,)}, ("3 is no collider", "signed_distance")),
        ({"radius": -1.0}, ("radius", "-1")),
        ({"scheme": "velocity-verle"}, ("velocity-verlet",)),
        ({"steps": tp.ErrorControl()}, ("steps", "Fixed")),
        ({"guard": "halv"}, ("guard", "halve")),
        ({"appearance": tp.Wires(by="temperature")}, ("temperature",)),
        ({"scheme": "yoshida4", "forces": (tp.Drag(time=1.0),)}, ("yoshida4", "velocity")),
        ({"longest": 0.5}, ("longest", "1")),
        ({"wires": WIRES}, ("wires", "appearance")),
    ],
)
def test_what_does_not_fit_is_one_clear_line(options, parts):
    with pytest.raises(InputError) as error:
        mesh(**options)
    assert "\n" not in str(error.value)
    for part in parts:
        assert part in str(error.value)


def test_a_scheme_that_springs_break_is_refused_before_any_kernel():
    with pytest.raises(InputError, match="no stable step on undamped springs"):
        simulate(film(mesh(scheme="euler")))
    with pytest.raises(InputError, match="a mesh steps as a whole"):
        simulate(scene(mesh(steps=None), steps=tp.ErrorControl(), scheme="rk4"))
