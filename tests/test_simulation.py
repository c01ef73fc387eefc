"""A simulation from outside: frames, states, reports; users' laws and schemes; who goes astray."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
import taichi as ti
from small_scenes import CAMERA, group, scene, simulate

import tparticles as tp
from tparticles.errors import InputError, RunError

SPARKS = scene(
    group(
        "sparks",
        system=tp.Newtonian(
            forces=(tp.Gravity(), tp.Drag(time=0.4, flow=tp.CurlNoise(speed=1.0, octaves=2, period=1.0)))
        ),
        appearance=tp.Glow(),
        births=tp.Rate(rate=300.0),
        shape=tp.Disc(radius=0.3),
        velocity=tp.Cone(angle=30.0, speed=(4.0, 1.0)),
        temperature=(1700.0, 200.0),
        size=(0.03, 0.01),
        lifetime=(0.6, 0.2),
        cooling=tp.Exponential(time=1.0),
        preroll=0.5,
    ),
    group(
        "smoke", system=tp.Advected(flow=tp.Vortex(circulation=2.0)), births=tp.Burst(count=50, time=0.11), lifetime=0.4
    ),
    steps=tp.Fixed(dt=1 / 96),
    shutter=0.5,
    duration=0.5,
)


def film(numbers=None, film=SPARKS, **options):
    """Return the frames with copies of their states."""
    return [
        (frame.number, frame.image, frame.state(), frame.linear(), frame.report)
        for frame in simulate(film, **options).frames(numbers)
    ]


def same(first, second):
    """Whether two frames agree to the bit."""
    return np.array_equal(first[1], second[1]) and same_states(first[2], second[2])


def same_states(a, b):
    return a.keys() == b.keys() and all(
        a[g].keys() == b[g].keys() and all(np.array_equal(a[g][k], b[g][k]) for k in a[g]) for g in a
    )


@pytest.fixture(scope="module")
def whole():
    return film()


def test_a_preroll_in_strides_ends_as_frame_by_frame(whole, monkeypatch):
    """The pre-roll takes frames of a sixth of a second together: the same births and deaths, and the same paths up to rounding."""
    assert (SPARKS.first_frame, SPARKS.stride, SPARKS.longest_advance) == (-12, 4, pytest.approx(1 / 6))
    monkeypatch.setattr(tp.Scene, "stride", 1)
    slow = film([1])[0][2]["sparks"]
    quick = whole[0][2]["sparks"]
    np.testing.assert_array_equal(quick["id"], slow["id"])
    np.testing.assert_array_equal(quick["birth"], slow["birth"])
    np.testing.assert_allclose(quick["x"], slow["x"], atol=2e-5)
    np.testing.assert_allclose(quick["T"], slow["T"], rtol=1e-5)


def test_a_stride_takes_the_steps_of_a_frame():
    """dt = 0.04 s cuts a frame of 1/24 s in two; steps of 1/30 s, which a stride of 1/6 s has room for, would be unstable."""
    drag = tp.Drag(time=0.0125)
    dust = group(
        "dust", system=tp.Newtonian(forces=(drag,)), births=tp.Rate(rate=90.0), velocity=tp.Cone(speed=3.0), preroll=3.0
    )
    state = film([1], scene(dust, scheme="euler", steps=tp.Fixed(dt=0.04), duration=0.1))[0][2]["dust"]
    assert len(state["id"]) > 200 and np.abs(state["x"]).max() < 1.0


@pytest.mark.parametrize(
    ("changes", "stride"),
    [
        ({}, 4),
        ({"fps": 25}, 4),
        ({"fps": "30000/1001"}, 4),
        ({"fps": 60}, 10),
        ({"fps": 3}, 1),
        ({"steps": tp.ErrorControl(rtol=1e-3, atol=1e-3), "scheme": "bogacki-shampine"}, 1),
    ],
)
def test_what_a_stride_is(changes, stride):
    """A sixth of a second; one frame where steps are chosen by it."""
    assert dataclasses.replace(SPARKS, **changes).stride == stride


def test_frames_states_and_reports(whole):
    assert [f[0] for f in whole] == list(range(1, 13))
    alive = 0
    for number, image, state, linear, report in whole:
        assert image.shape == (36, 64, 3) and image.dtype == np.uint8
        assert linear.shape == (36, 64, 3) and linear.dtype == np.float64 and np.all(np.isfinite(linear))
        assert report.frame == number and report.time == number / 24
        assert set(state) == {"sparks", "smoke"}
        assert set(state["sparks"]) == {"id", "x", "v", "T", "age", "birth"}
        assert set(state["smoke"]) == {"id", "x", "v", "age", "birth"}, "smoke has streaks but no temperature"
        alive += report.born - report.died
        assert report.alive == alive == sum(len(s["id"]) for s in state.values())
        for s in state.values():
            assert np.all(np.diff(s["birth"][np.argsort(s["id"])]) >= 0)
            assert np.array_equal(s["age"], report.time - s["birth"]) and np.all(s["age"] > 0)
        assert 0 < report.dt_min <= report.dt_max <= 1 / 96 * (1 + 1e-4)
        if number > 1:
            assert 4 * (alive - report.born) <= report.steps <= 4 * (alive + report.died)
        row = report.row()
        assert set(row) == {
            "frame",
            "time",
            "born",
            "died",
            "alive",
            "steps",
            "rejected",
            "starting",
            "dt_min",
            "dt_max",
            "ms",
        }
        assert set(row["ms"]) == {"births", "step", "draw"} and all(v >= 0 for v in row["ms"].values())
    assert whole[0][4].born > 100, "the pre-roll is counted in the first frame"
    assert whole[2][4].born >= 50 and 40 <= len(whole[2][2]["smoke"]["id"]) <= 50
    assert whole[5][1].max() > 100


def test_a_selection_equals_the_whole(whole):
    chosen = film((3, 4, 9))
    assert [f[0] for f in chosen] == [3, 4, 9]
    assert all(same(f, whole[f[0] - 1]) for f in chosen)
    assert chosen[0][4].born == sum(f[4].born for f in whole[:3])
    assert chosen[2][4].steps == sum(f[4].steps for f in whole[4:9])


def test_a_seed_makes_another_film(whole):
    other = film((3,), seed=2)[0]
    assert not np.array_equal(other[1], whole[2][1])


def test_frames_that_cannot_be_asked_for():
    sim = simulate(SPARKS)
    assert list(sim.frames(())) == []
    next(sim.frames((2,)))
    for number, message in ((2, "frame 2 is past: the simulation has reached frame 2"), (1, "frame 1 is past")):
        with pytest.raises(InputError, match=message):
            next(sim.frames((number,)))
    for number in (0, 13, -3):
        with pytest.raises(InputError, match=rf"frame {number} leaves the film, which has frames 1-12"):
            next(sim.frames((number,)))


def test_double_precision(whole):
    alone = dataclasses.replace(SPARKS, groups=SPARKS.groups[:1])
    x32, x64 = whole[2][2]["sparks"], film((3,), alone, precision="f64")[0][2]["sparks"]
    assert x64["x"].dtype == np.float64 and x32["x"].dtype == np.float32
    both, i, j = np.intersect1d(x32["id"], x64["id"], return_indices=True)
    assert len(both) > 0.9 * len(x32["id"])
    np.testing.assert_allclose(x32["x"][i], x64["x"][j], atol=2e-3)
    assert np.array_equal(x32["birth"][i], x64["birth"][j])


class Shear:
    """A user's flow, a plain class."""

    def __init__(self, rate):
        self.rate = rate

    @ti.func
    def velocity(self, t, x):
        return ti.Vector([self.rate * x[2], 0.0, 0.0])


@dataclasses.dataclass(frozen=True)
class Rise:
    """A user's flow, a dataclass."""

    speed: float

    @ti.func
    def velocity(self, t, x):
        return ti.Vector([0.0, 0.0, self.speed * t])


def test_users_flows_and_schemes_run_in_a_scene():
    ralston = tp.runge_kutta([[], [2 / 3]], [1 / 4, 3 / 4], name="ralston")
    film = scene(
        group(system=tp.Advected(flow=tp.Sum(Shear(2.0), Rise(3.0))), births=tp.Burst(count=3)),
        group("b", system=tp.Advected(flow=tp.Uniform(wind=(1.0, 0, 0)) + Rise(1.0)), births=tp.Burst(count=3)),
        scheme=ralston,
        steps=tp.Fixed(dt=1 / 240),
    )
    sim = simulate(film)
    sim.advance_to(24)
    assert sim.scene.scheme is ralston
    a, b = (g.state(1.0)["x"] for g in sim.groups)
    np.testing.assert_allclose(a, [[1.0, 0.0, 1.5]] * 3, atol=1e-4)  # x' = 2 z, z = 1.5 t^2
    np.testing.assert_allclose(b, [[1.0, 0.0, 0.5]] * 3, atol=1e-5)


class Poison:
    """Not a number beyond x = 0.9 once t passes 0.2, in one component only."""

    @ti.func
    def velocity(self, t, x):
        root = ti.select(t > 0.2, 0.9 - x[0], 1.0)
        return ti.Vector([0.0, ti.sqrt(root), 0.0])


def test_not_a_number_is_named():
    film = scene(
        group("good"),
        group(
            "bad",
            system=tp.Advected(flow=Poison()),
            births=tp.Burst(count=100),
            shape=tp.Box(low=(0, 0, 0), high=(1, 0, 0)),
        ),
    )
    sim = simulate(film)
    x = None
    with pytest.raises(RunError) as caught:
        for number in range(1, 25):
            sim.advance_to(number)
            x = dict(zip(sim.groups[1].state(0.0)["id"].tolist(), sim.groups[1].state(0.0)["x"][:, 0], strict=True))
    first = min(i for i, value in x.items() if value > 0.9)
    assert str(caught.value).startswith(
        f"frame 5, group 'bad': particle {first}: its state is not finite or more than 1e+18 m"
    )
    assert "t = 0.208333 s, scheme rk4, dt <= 0.0104 s" in str(caught.value)


@dataclasses.dataclass(frozen=True)
class Thrust:
    """Negative drag: v grows by exp(rate t)."""

    rate: float

    @ti.func
    def acceleration(self, t, x, v):
        return self.rate * v


EMBERS = {
    "appearance": tp.Glow(fade_in=0.3, fade_out=0.3),
    "births": tp.Rate(rate=200.0),
    "shape": tp.Disc(radius=0.3),
    "temperature": (1500.0, 300.0),
    "size": (0.05, 0.02),
    "lifetime": (0.3, 0.1),
}


@pytest.mark.parametrize(
    "cooling", [None, tp.Exponential(time=0.4), tp.Char()], ids=["no", "closed form", "integrated"]
)
def test_still_particles_are_those_of_a_flow_at_rest(cooling):
    """The same births, deaths and pixels; they carry no velocity, and nothing is stepped unless the cooling is integrated."""
    still, carried = (
        film(film=scene(group("embers", system=system, cooling=cooling, **EMBERS), shutter=0.5, duration=0.3))
        for system in (tp.Still(), tp.Advected(flow=tp.Uniform()))
    )
    for (_, image, state, _, report), (_, expected, there, _, moved) in zip(still, carried, strict=True):
        np.testing.assert_array_equal(image, expected)
        assert "v" not in state["embers"] and not there["embers"].pop("v").any()
        assert same_states(state, there)
        assert (report.born, report.died, report.alive) == (moved.born, moved.died, moved.alive)
        assert report.steps == (moved.steps if cooling is not None and cooling.integrated else 0)


def test_any_scheme_runs_beside_still_particles():
    """A splitting scheme needs velocities, but still particles are not stepped; with a cooling to integrate they are."""
    jets = group("jets", system=tp.Newtonian(forces=(tp.Gravity(),)), births=tp.Burst(count=5))
    embers = group("embers", system=tp.Still(), **EMBERS)
    assert simulate(scene(jets, embers, scheme="velocity-verlet")).advance_to(1).steps > 0
    with pytest.raises(InputError, match=r"cannot run group 'embers': it kicks and drifts.*Still particles of order 1"):
        scene(jets, group("embers", system=tp.Still(), cooling=tp.Char(), **EMBERS), scheme="velocity-verlet")
    with pytest.raises(InputError, match=r"still particles do not move and have no velocity.*Newtonian"):
        group("embers", system=tp.Still(), velocity=tp.Cone(speed=1.0), **EMBERS)


def test_a_blow_up_is_caught():
    system = tp.Newtonian(forces=Thrust(200.0))
    film = scene(group("jets", system=system, births=tp.Burst(count=5), velocity=tp.Cone(speed=1.0)))
    with pytest.raises(RunError, match=r"frame \d+, group 'jets': particle 0: its state is not finite or more than"):
        simulate(film).advance_to(24)


def test_stability_limit_sets_the_step():
    vortex = tp.Advected(flow=tp.Vortex(circulation=1000.0))
    spin = 1000.0 / (2 * np.pi)
    sim = simulate(scene(group(system=vortex), steps=tp.StabilityLimit(safety=0.5)))
    rk4 = sim.scene.scheme
    assert sim.groups[0].dt == 0.5 * min(rk4.real_limit / spin, rk4.imaginary_limit / spin)
    with pytest.raises(InputError, match="scheme 'midpoint' has no stable step on the imaginary axis"):
        simulate(scene(group(system=vortex), steps=tp.StabilityLimit(), scheme="midpoint"))
    with pytest.raises(InputError, match="Rise has no jacobian_bound"):
        simulate(scene(group(system=tp.Advected(flow=Rise(1.0))), steps=tp.StabilityLimit()))
    with pytest.raises(InputError, match="at most 1000000"):
        simulate(scene(group(system=vortex), steps=tp.Fixed(dt=1e-9)))


def test_unknown_options_are_refused():
    for options, message in (
        ({"quality": "finl"}, "unknown quality 'finl'; did you mean 'final'"),
        ({"scheme": "rk5"}, "unknown scheme 'rk5'; did you mean 'rk4'"),
        ({"arch": "gpu"}, "unknown arch 'gpu'"),
        ({"precision": "f16"}, "unknown precision 'f16'"),
        ({"fps": 0}, "fps = 0: must be above 0"),
        ({"threads": 0}, "threads = 0: at least 1"),
    ):
        with pytest.raises(InputError, match=message):
            tp.Simulation(SPARKS, **{"arch": "cpu", **options})


def test_only_a_scene_is_simulated():
    for other, kind in ((None, "NoneType"), ("campfire", "str")):
        with pytest.raises(InputError, match=f"Simulation takes a Scene, not {kind}"):
            tp.Simulation(other)


def test_frame_times_are_fractions():
    sim = simulate(scene(group(lifetime=0.5), fps="30000/1001", duration=10.0))
    assert sim.scene.frame_count == 299, "frame 300 would show 10.01 s"
    assert sim.time(100_000) == 100_000 * 1001 / 30000
    assert simulate(scene(group(), fps=25, duration=0.04)).scene.frame_count == 1


@pytest.mark.parametrize(
    ("duration", "fps", "count"),
    [
        (10.0, 24, 240),
        (10.01, "30000/1001", 300),
        (1 / 24, 24, 1),
        (3600.0, "24000/1001", 86313),
        (0.1, 30, 3),
        (1 / 3, 60, 20),
    ],
)
def test_frame_counts(duration, fps, count):
    assert tp.Scene(groups=group(), camera=CAMERA, duration=duration, fps=fps).frame_count == count


def test_importing_the_package_does_not_import_taichi():
    code = (
        "import sys, tparticles; assert 'taichi' not in sys.modules; tparticles.Scene; assert 'taichi' in sys.modules"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout) == (0, ""), run.stderr
