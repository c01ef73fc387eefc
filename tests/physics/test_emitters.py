"""Births: how many, when, the same however time is cut, and never more alive than was promised."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tparticles as tp
from tparticles import rng
from tparticles.errors import InputError
from tparticles.physics.emitters import Schedule

KEY = rng.stream_key(1, "group/emitter")
END = 10.0


def schedule(births, *, end=END, key=KEY, **options):
    return Schedule(tp.Emitter(births=births, **options), key=key, end=end)


def everybody(plan, end=END):
    """Return the first id and the times [s] of all births before `end`."""
    return plan.births(-math.inf, end)


def by_frame(times, frame, count, start=0.0):
    return np.histogram(times, bins=start + frame * np.arange(count + 1))[0]


def test_reeves_rule_has_its_mean_and_its_range():
    times = everybody(schedule(tp.PerFrame(mean=20.0, variance=8.0), end=500.0), 500.0).times
    counts = by_frame(times, 1 / 24, 12_000)
    # rand(-1, 1) has the standard deviation 1 / sqrt(3); the mean of n of them is known to 1 / sqrt(n) of it
    assert counts.mean() == pytest.approx(20.0, abs=4 * 8 / math.sqrt(3 * 12_000))
    assert counts.std() == pytest.approx(8 / math.sqrt(3), rel=0.03)
    assert 11 <= counts.min() <= 13 and 27 <= counts.max() <= 29


def test_counts_follow_rand_exactly_and_carry_fractions():
    plan = schedule(tp.PerFrame(mean=2.5, variance=0.5))
    u = rng.uniform(KEY ^ 0xA5A5A5A5, np.arange(240), 0)
    wanted = 2.5 + 0.5 * (2 * u - 1)
    assert (np.cumsum(plan.counts) == np.floor(np.cumsum(wanted) + 1e-9)).all()
    assert set(plan.counts) == {2, 3}


def test_two_or_three_sparks_a_frame():
    counts = by_frame(everybody(schedule(tp.PerFrame(mean=2.5, variance=0.5))).times, 1 / 24, 240)
    assert set(counts) == {2, 3}


def test_fractional_rates_are_carried_exactly():
    plan = schedule(tp.PerFrame(mean=0.3, frame=0.04), end=40.0)
    assert plan.total == 300
    assert (np.cumsum(plan.counts) == [int((k * 3 + 3) // 10) for k in range(1000)]).all()
    assert schedule(tp.Rate(rate=0.7), end=100.0).total == 70


def test_a_mean_below_the_variance_never_counts_backwards():
    plan = schedule(tp.PerFrame(mean=1.0, variance=5.0))
    assert (plan.counts >= 0).all() and plan.counts.max() >= 5


def test_a_keyed_rate_integrates_to_its_area():
    keys = ((1.0, 0.0), (2.003, 100.0), (3.0, 100.0), (3.5, 0.0))
    plan = schedule(tp.Rate(rate=keys))
    area = 0.5 * 1.003 * 100 + 0.997 * 100 + 0.5 * 0.5 * 100
    assert plan.total == math.floor(area)
    times = everybody(plan).times
    assert times.min() > 1.0 and times.max() < 3.5
    # births up to t follow the integral up to t, to one particle of the interval that t lies in
    for t in (1.5, 2.0, 2.5, 3.2):
        inside = np.interp(np.linspace(0, t, 20_001), *zip(*keys, strict=True)) * (np.linspace(0, t, 20_001) >= 1.0)
        assert (times < t).sum() == pytest.approx(np.trapezoid(inside, dx=t / 20_000), abs=100 / 24 + 1)


def test_a_rate_is_constant_outside_its_keys():
    assert schedule(tp.Rate(rate=((4.0, 10.0), (5.0, 20.0)))).total == 40 + 15 + 100
    assert schedule(tp.Rate(rate=((20.0, 10.0), (30.0, 20.0)))).total == 100
    assert schedule(tp.Rate(rate=((-5.0, 10.0), (-2.0, 30.0)))).total == 300


def test_a_keyed_mean():
    plan = schedule(tp.PerFrame(mean=((0.0, 0.0), (10.0, 24.0)), frame=0.5))
    assert plan.counts.tolist() == [
        math.floor(1e-9 + sum(1.2 * j for j in range(k + 1))) - math.floor(1e-9 + sum(1.2 * j for j in range(k)))
        for k in range(20)
    ]


def test_bursts():
    plan = schedule((tp.Burst(count=5, time=2.0), tp.Burst(count=3, time=1.0), tp.Burst(count=1, time=2.0)))
    born = everybody(plan)
    assert born.first == 0 and born.times.tolist() == [1.0] * 3 + [2.0] * 6
    assert len(plan.births(1.0, 2.0).times) == 3 and plan.births(1.0, 2.0).first == 0
    assert len(plan.births(2.0, 2.0 + 1e-9).times) == 6 and plan.births(2.0, 3.0).first == 3
    assert len(plan.births(0.0, 1.0).times) == 0 and len(plan.births(2.1, 10.0).times) == 0
    assert plan.total == 9
    assert schedule(tp.Burst(count=7)).total == 7


def test_the_window_and_the_preroll_bound_the_births():
    plan = schedule(tp.Rate(rate=100.0), start=1.0, stop=3.01, preroll=0.5)
    times = everybody(plan).times
    assert plan.total == 251
    assert 0.5 <= times.min() < 0.52 and 2.98 < times.max() < 3.01
    assert tp.Emitter(births=tp.Rate(rate=1.0), start=1.0, preroll=0.5).first_time == 0.5
    early = schedule(tp.PerFrame(mean=2.0), preroll=2.0)
    assert len(early.births(-2.0, 0.0).times) == 96
    assert early.total == 96 + 480
    bursts = schedule((tp.Burst(count=1, time=0.0), tp.Burst(count=2, time=1.0), tp.Burst(count=4, time=3.0)), stop=3.0)
    assert bursts.total == 3


def test_ids_are_consecutive_and_births_rise_in_time():
    plan = schedule(tp.PerFrame(mean=37.3, variance=30.0))
    ids, times = [], []
    for k in range(240):
        born = plan.births(k / 24, (k + 1) / 24)
        ids += range(born.first, born.first + len(born.times))
        times += born.times.tolist()
        assert all(k / 24 <= t < (k + 1) / 24 for t in born.times)
    assert ids == list(range(plan.total)) and (np.diff(times) > 0).all()


def test_times_are_spread_evenly_inside_an_interval():
    times = everybody(schedule(tp.PerFrame(mean=3.0, variance=1.0), end=400.0), 400.0).times
    phase = np.sort((times * 24) % 1.0)
    n = len(phase)
    assert np.abs(phase - (np.arange(n) + 0.5) / n).max() * math.sqrt(n) < 2.2


EMITTERS = {
    "per frame": tp.Emitter(births=tp.PerFrame(mean=2.5, variance=2.0)),
    "own clock": tp.Emitter(births=tp.PerFrame(mean=7.3, variance=1.0, frame=0.031), start=0.5, stop=6.123),
    "rate": tp.Emitter(births=tp.Rate(rate=((0.0, 3.0), (5.0, 80.0))), preroll=1.7),
    "bursts": tp.Emitter(births=tuple(tp.Burst(count=k + 1, time=k / 3) for k in range(20))),
}


def union(plan, cuts):
    """Return ids and times of all births, asked for span by span."""
    ids, times = [], []
    for a, b in itertools.pairwise(cuts):
        born = plan.births(a, b)
        ids.append(born.first + np.arange(len(born.times)))
        times.append(born.times)
    return np.concatenate(ids), np.concatenate(times)


def assert_same_births(name, cuts):
    ids, times = union(Schedule(EMITTERS[name], key=KEY, end=END), [-3.0, END])
    found_ids, found_times = union(Schedule(EMITTERS[name], key=KEY, end=END), [-3.0, *sorted(cuts), END])
    assert len(ids) > 50 and (found_ids == ids).all() and (found_times == times).all()


@pytest.mark.parametrize("name", EMITTERS)
@pytest.mark.parametrize("fps", ["24", "25", "30000/1001", "60", "7/3", "500"])
def test_the_set_of_births_does_not_depend_on_the_frame_rate(name, fps):
    rate = Fraction(fps)
    assert_same_births(name, [float(k / rate) for k in range(math.ceil(-2 * rate), math.ceil(END * rate))])


@pytest.mark.parametrize("name", EMITTERS)
def test_nor_on_cuts_at_the_births_themselves_or_at_the_intervals(name):
    plan = Schedule(EMITTERS[name], key=KEY, end=END)
    times = everybody(plan).times
    assert_same_births(name, times.tolist())
    assert_same_births(name, np.nextafter(times, math.inf).tolist())
    assert_same_births(name, [*plan.starts[plan.starts < END], *np.minimum(plan.starts + plan.lengths, END)])


@pytest.mark.parametrize("name", EMITTERS)
@settings(max_examples=40, deadline=None)
@given(cuts=st.lists(st.floats(-2.0, END), max_size=30))
def test_nor_on_any_cuts(name, cuts):
    assert_same_births(name, cuts)


@pytest.mark.parametrize("name", EMITTERS)
@settings(max_examples=20, deadline=None)
@given(end=st.floats(0.1, END))
def test_births_do_not_depend_on_where_the_film_ends(name, end):
    """29.97 frames a second end a film a little before 24 do."""
    whole, shorter = (Schedule(EMITTERS[name], key=KEY, end=e) for e in (END, end))
    expected, found = whole.births(-3.0, end), shorter.births(-3.0, end)
    assert found.first == expected.first == 0 and (found.times == expected.times).all()
    assert len(found.times) <= shorter.total <= whole.total


def test_emitters_with_other_keys_differ():
    a, b = (schedule(tp.PerFrame(mean=5.0, variance=5.0), key=k) for k in (KEY, rng.stream_key(2, "group/emitter")))
    assert (a.counts != b.counts).any()
    both = np.minimum(a.total, b.total)
    assert not set(everybody(a).times[:both]) & set(everybody(b).times[:both])


def most_at_once(plan, lifetime, frame):
    """Play the film: births of a frame first, then its dead leave at its end; return the most slots in use."""
    times = everybody(plan, plan_end(plan)).times
    alive, most = np.empty(0), 0
    first = math.floor(min(0.0, float(np.min(plan.starts, initial=0.0))) / frame)
    for k in range(first, math.ceil(END / frame)):
        t0, t1 = k * frame, (k + 1) * frame
        alive = np.concatenate([alive, times[(times >= t0) & (times < t1)]])
        most = max(most, len(alive))
        alive = alive[t1 - alive < lifetime]
    return most


def plan_end(plan):
    return float(np.max(plan.starts + plan.lengths, initial=0.0)) + 1.0


@pytest.mark.parametrize("frame", [1 / 24, 1 / 60, 0.5])
@pytest.mark.parametrize("lifetime", [0.001, 0.3, 2.0, 50.0])
@pytest.mark.parametrize("name", EMITTERS)
def test_most_alive_is_a_bound_and_a_close_one(name, lifetime, frame):
    plan = Schedule(EMITTERS[name], key=KEY, end=END)
    most = most_at_once(plan, lifetime, frame)
    bound = plan.most_alive(lifetime, frame)
    assert most <= bound <= plan.total
    if lifetime >= 6 * frame:
        assert bound <= 2 * most


def test_most_alive_without_deaths_is_everybody():
    plan = schedule(tp.Rate(rate=10.0))
    assert plan.most_alive(math.inf, 1 / 24) == plan.total == 100


def test_an_emitter_that_starts_after_the_film_bears_nobody():
    plan = schedule(tp.Rate(rate=10.0), start=20.0)
    assert plan.total == 0 and plan.most_alive(1.0, 0.1) == 0 and len(plan.births(0.0, END).times) == 0
    late = schedule(tp.Burst(count=3, time=20.0))
    assert late.total == 0 and len(late.births(0.0, END).times) == 0


RATE = tp.Rate(rate=1.0)
WRONG = {
    "nothing, frame": (lambda: tp.Emitter(births=tp.PerFrame(mean=0)), "nothing to emit"),
    "nothing, rate": (lambda: tp.Emitter(births=tp.Rate(rate=((0, 0), (1, 0)))), "nothing to emit"),
    "no bursts": (lambda: tp.Emitter(births=()), "nothing to emit"),
    "bursts outside": (lambda: tp.Emitter(name="e", births=tp.Burst(count=1, time=-1)), "'e' has nothing to emit"),
    "no keys": (lambda: tp.Rate(rate=()), r"Rate\.rate = \(\)"),
    "burst of none": (lambda: tp.Burst(count=0), r"Burst\.count = 0: should be greater than or equal to 1"),
    "half a particle": (lambda: tp.Burst(count=0.5), r"Burst\.count = 0\.5: should be a valid integer"),
    "negative rate": (lambda: tp.Rate(rate=-2), r"Rate\.rate = -2: should be greater than or equal to 0"),
    "NaN": (lambda: tp.PerFrame(mean=math.nan), r"PerFrame\.mean = nan: should be a finite number"),
    "no interval": (lambda: tp.PerFrame(mean=1, frame=0), r"PerFrame\.frame = 0"),
    "falling keys": (lambda: tp.Emitter(births=tp.Rate(rate=((1, 1), (0, 1)))), r"times of births\.rate must increase"),
    "empty window": (lambda: tp.Emitter(births=RATE, start=2, stop=1), r"stop = 1 s must be after start = 2 s"),
    "negative preroll": (lambda: tp.Emitter(births=RATE, preroll=-1), r"Emitter\.preroll = -1"),
    "negative lifetime": (lambda: tp.Emitter(births=RATE, lifetime=-1), r"\.lifetime can be -1"),
    "lifetime near 0": (lambda: tp.Emitter(births=RATE, lifetime=(1, 1)), r"\.lifetime can be 0 "),
    "size": (lambda: tp.Emitter(births=RATE, size=tp.Spread(mean=1, variance=0.5, distribution="normal")), r"\.size"),
    "births": (lambda: tp.Emitter(births=3), r"Emitter\.births = 3: should be a PerFrame or a Rate or a Burst"),
    "one of the bursts": (lambda: tp.Emitter(births=(tp.Burst(count=1), 3)), r"Emitter\.births\[1\] = 3.* a Burst"),
    "shape": (
        lambda: tp.Emitter(births=RATE, shape="disc"),
        r"Emitter\.shape = 'disc': should be a Point or a Line or",
    ),
    "too many": (lambda: schedule(tp.Rate(rate=1e300)), r"emitter 'emitter': its births make 1e\+301 particles"),
    "too many bursts": (lambda: schedule((tp.Burst(count=2**31),) * 3), r"its bursts make 6.44e\+09 particles"),
    "too often": (lambda: schedule(tp.PerFrame(mean=1, frame=1e-310)), r"intervals of 1e-310 s make inf intervals"),
    "keyed overflow": (lambda: schedule(tp.Rate(rate=((0, 1.7e308), (9, 1.7e308)))), r"its births make (inf|nan) part"),
    "frame overflow": (lambda: schedule(tp.PerFrame(mean=1.7e308, variance=1.7e308)), r"its births make inf part"),
    "too long": (lambda: schedule(RATE, preroll=1e300), r"make 2.4e\+301 intervals"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_emitters_are_refused(name):
    make, message = WRONG[name]
    with pytest.raises(InputError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


GARBAGE = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.tuples(st.floats(), st.floats()),
    st.lists(st.tuples(st.floats(0, 1e6), st.floats(0, 1e6)), max_size=3).map(tuple),
    st.floats(0, 100),
    st.just(object()),
)


@settings(max_examples=300, deadline=None)
@given(
    kind=st.sampled_from([(tp.PerFrame, "mean"), (tp.Rate, "rate"), (tp.Burst, "count")]),
    amount=GARBAGE,
    extra=st.dictionaries(st.sampled_from(["variance", "frame", "time"]), GARBAGE, max_size=2),
    options=st.dictionaries(
        st.sampled_from(["name", "size", "lifetime", "temperature", "start", "stop", "preroll", "shape", "velocity"]),
        GARBAGE,
        max_size=3,
    ),
)
def test_garbage_raises_input_errors_and_nothing_else(kind, amount, extra, options):
    cls, name = kind
    try:
        emitter = tp.Emitter(births=cls(**{name: amount}, **extra), **options)
        if abs(emitter.first_time) < 1e5:  # longer ones are lawful, and long
            Schedule(emitter, key=KEY, end=1.0)
    except InputError as error:
        assert "\n" not in str(error)
