"""Births do not depend on frame rate, step or scheme, and there is always room for them."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_scenes import group, scene, simulate

import tparticles as tp
from tparticles import backend
from tparticles.errors import InputError
from tparticles.physics.emitters import Schedule
from tparticles.stepping.control import StabilityLimit
from tparticles.systems.population import schedules

EMITTERS = (
    tp.Emitter(
        name="frames",
        births=tp.PerFrame(mean=2.5, variance=0.5),
        shape=tp.Sphere(radius=0.5),
        temperature=(1500.0, 200.0),
        size=(0.02, 0.01),
        lifetime=tp.Spread(mean=9.0, variance=1.0, distribution="normal"),
        preroll=0.33,
    ),
    tp.Emitter(
        name="rate",
        births=tp.Rate(rate=((0.0, 0.0), (0.5, 200.0))),
        shape=tp.Box(low=(-1, -1, -1), high=(1, 1, 1)),
        temperature=1200.0,
        size=0.01,
        lifetime=7.0,
        start=0.1,
    ),
    tp.Emitter(name="burst", births=tp.Burst(count=7, time=0.51), temperature=1300.0, size=0.03, lifetime=8.0),
)
FILM = scene(group(appearance=tp.Glow(), emitters=EMITTERS))
RUNS = [
    ({"fps": 24}, tp.Fixed(dt=1 / 96), "equal"),
    ({"fps": 25, "scheme": "euler"}, tp.Fixed(dt=1 / 1000), "slide32"),
    ({"fps": "30000/1001", "scheme": "midpoint"}, tp.Fixed(dt=1.0), "equal"),
    ({"fps": 60}, StabilityLimit(), "slide32"),
]
COMMON = 0.96  # [s]; the last frame of the shortest film shows 29 * 1001 / 30000 s


def collect(options, steps, clamp):
    """Return everybody who was ever seen: id -> (birth, T0, size, lifetime, x)."""
    sim = simulate(dataclasses.replace(FILM, steps=steps, clamp=clamp), **options)
    seen: dict[int, tuple] = {}
    people = sim.groups[0].population
    for number in range(1, sim.scene.frame_count + 1):
        before = people.born
        report = sim.advance_to(number)
        assert report.born == people.born - before
        columns = [people.read(name) for name in ("birth", "T0", "size", "lifetime", "x")]
        assert np.all(columns[0] < report.time)
        for i, *values in zip(people.read("id").tolist(), *columns, strict=True):
            record = tuple(np.asarray(v).tobytes() for v in values)
            assert seen.setdefault(i, record) == record
    return {i: r for i, r in seen.items() if np.frombuffer(r[0])[0] < COMMON}


@pytest.fixture(scope="module")
def reference():
    return collect(*RUNS[0])


def test_the_reference_has_everybody(reference):
    births = {i: np.frombuffer(r[0])[0] for i, r in reference.items()}
    of = [[b for i, b in births.items() if i % 3 == e] for e in range(3)]
    assert min(of[0]) < -0.3 and len(of[0]) == pytest.approx(2.5 * 24 * (0.33 + COMMON), abs=4)
    assert min(of[1]) >= 0.1 and len(of[1]) > 100
    assert of[2] == [0.51] * 7
    for e in range(3):
        assert sorted(i for i in births if i % 3 == e) == list(range(e, 3 * len(of[e]), 3)), "ids have no gaps"
        assert np.all(np.diff([births[i] for i in sorted(births) if i % 3 == e]) >= 0), "ids rise with the birth times"


@pytest.mark.parametrize("run", RUNS[1:], ids=lambda run: str(run[0]["fps"]))
def test_births_are_the_same_for_any_rate_step_and_scheme(reference, run):
    assert collect(*run) == reference


RATES = st.sampled_from([Fraction(24), Fraction(25), Fraction(30000, 1001), Fraction(60), Fraction(7)])
KEYS = st.lists(st.floats(0, 400), min_size=1, max_size=4).map(
    lambda values: tuple((0.4 * k, v) for k, v in enumerate(values))
)
BIRTHS = st.one_of(
    st.builds(tp.PerFrame, mean=KEYS, variance=st.floats(0.1, 5), frame=st.sampled_from([1 / 24, 1 / 30, 0.11, 0.001])),
    st.builds(lambda rate: tp.Rate(rate=((-1.0, 1.0), *rate)), KEYS),
    st.lists(st.tuples(st.integers(1, 50), st.floats(0, 2)), min_size=1, max_size=5).map(
        lambda bursts: tuple(tp.Burst(count=n, time=t) for n, t in bursts)
    ),
)


@given(births=BIRTHS, life=st.floats(0.01, 1.5), fps=RATES, preroll=st.sampled_from([0.0, 0.77]))
@settings(max_examples=80, deadline=None)
def test_derived_capacity_is_enough(births, life, fps, preroll):
    emitter = tp.Emitter(births=births, lifetime=life, preroll=preroll)
    schedule = Schedule(emitter, key=12345, end=2.0)
    times = schedule.births(-10.0, 10.0).times
    assert len(times) == schedule.total
    room = schedule.most_alive(life, float(1 / fps))
    first = int(-10 * fps)
    most = 0
    for k in range(first, int(2 * fps) + 1):
        t0, t1 = float(k / fps), float((k + 1) / fps)
        # whoever is younger than `life` at t0 is still there when those of [t0, t1) are added
        most = max(most, np.count_nonzero((times > t0 - life) & (times < t1)))
    assert most <= room <= schedule.total
    assert schedule.most_alive(np.inf, 0.04) == schedule.total


def test_more_than_memory_is_refused_before_it_is_allocated(monkeypatch):
    monkeypatch.setattr(backend, "memory", lambda: 2**30)
    film = scene(group("rain", births=tp.Burst(count=20_000_000)), group("hail", births=tp.Burst(count=10_000_000)))
    message = (
        r"group 'rain': room for 20000000 particles takes 0\.8 GiB \(1\.2 GiB with all groups\), .* has 1\.0 GiB; give"
    )
    with pytest.raises(InputError, match=message):
        simulate(film)


@pytest.mark.parametrize(
    "births", [tp.Rate(rate=((-1.0, 7.0), (1.0, 9e4))), tp.PerFrame(mean=3.7, variance=2.0, frame=0.007)]
)
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_kernels_work_out_the_times_that_the_schedule_has(births, precision):
    emitter = tp.Emitter(name="fountain", births=births, temperature=1500.0, preroll=0.9)
    sim = simulate(scene(group(appearance=tp.Glow(), emitters=emitter)), precision=precision)
    people = sim.groups[0].population
    sim.advance_to(20)
    schedule = schedules("dots", (emitter,), seed=0, end=1.0)[0]
    born = schedule.births(-1.0, sim.time(20))
    assert born.count == people.born == len(born.times) > 300
    assert np.array_equal(people.read("birth"), born.times) and people.read("birth").dtype == np.float64
    assert np.array_equal(people.read("id"), np.arange(born.count))


def test_a_time_is_found_among_births_that_are_closer_than_its_digits():
    schedule = Schedule(tp.Emitter(births=tp.Rate(rate=1e8), start=1e7), key=3, end=1e7 + 1.0)
    t = 1e7 + 0.0123
    before, after = (schedule.births(*span) for span in ((0.0, t), (t, t + 1e-5)))
    assert after.first == before.count and before.times[-1] < t <= after.times[0]
    assert np.count_nonzero(np.diff(before.times) == 0.0) > 0
