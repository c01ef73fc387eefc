"""Stable compaction against NumPy, and the books of a population."""

import numpy as np
import pytest

import tparticles as tp
from tparticles import backend
from tparticles.errors import InputError, RunError
from tparticles.systems.attributes import Columns
from tparticles.systems.kernels import FEW, Compaction
from tparticles.systems.mortality import marks
from tparticles.systems.population import Population, schedules

pytestmark = pytest.mark.usefixtures("cpu32")

MOST = 100_000
NAMES = ("x", "id", "birth", "v", "T0")


@pytest.fixture(
    scope="module",
    params=[(MOST, True), (20_000, True), (MOST, False)],
    ids=["in place, many", "in place, few", "prefix sum"],
)
def room(cpu32, request):
    capacity, in_place = request.param
    columns = Columns(NAMES, capacity)
    dead = marks(columns)
    assert (capacity > FEW) == (capacity == MOST)
    return columns, dead, Compaction(columns, dead, in_place=in_place)


def set_marks(dead, slots):
    """Mark the slots where `slots` is true: a bit for each, a number for each block."""
    lanes = backend.current().lanes
    bits = np.zeros(dead.shape[0] * lanes, np.int32)
    bits[: len(slots)] = slots
    dead.from_numpy((bits.reshape(-1, lanes) << np.arange(lanes)).sum(axis=1).astype(np.int32))


def fill(columns, dead, mask, count):
    """Give every field its own values; return them."""
    rng = np.random.default_rng(count)
    before = []
    for field in columns.all():
        values = rng.integers(0, 1 << 20, columns.padded).astype(field.to_numpy().dtype)
        field.from_numpy(values)
        before.append(values)
    padded = np.ones(columns.padded, bool)  # slots beyond the living count for nothing
    padded[:count] = mask
    set_marks(dead, padded)
    return before


@pytest.mark.parametrize("count", [1, 255, 256, 257, 511, 512, 513, 10_000, MOST])
@pytest.mark.parametrize("share", [0.0, 0.03, 0.5, 0.97, 1.0])
def test_survivors_keep_their_order(room, count, share):
    columns, dead, compaction = room
    count = min(count, columns.capacity)
    mask = np.random.default_rng(7).random(count) < share
    before = fill(columns, dead, mask, count)
    survivors = compaction.run(count)
    assert survivors == count - mask.sum()
    for field, values in zip(columns.all(), before, strict=True):
        after = field.to_numpy()
        assert np.array_equal(after[:survivors], values[:count][~mask])
        assert np.array_equal(after[count:], values[count:]), "slots beyond the living were touched"


@pytest.mark.parametrize("mask", ["first", "last", "alternate", "one chunk"])
def test_masks_with_structure(room, mask):
    columns, dead, compaction = room
    count = 1000
    i = np.arange(count)
    chosen = {"first": i == 0, "last": i == count - 1, "alternate": i % 2 == 0, "one chunk": i // 256 == 1}[mask]
    before = fill(columns, dead, chosen, count)
    survivors = compaction.run(count)
    assert np.array_equal(columns["id"][0].to_numpy()[:survivors], before[3][:count][~chosen])


@pytest.mark.parametrize("in_place", [True, False])
def test_a_part_is_compacted_by_itself(cpu32, in_place):
    columns = Columns(("x", "id"), 10_000)
    dead = marks(columns)
    first, count = 64 * backend.current().lanes, 3000
    mask = np.random.default_rng(3).random(columns.padded) < 0.4
    before = fill(columns, dead, mask, columns.padded)
    survivors = Compaction(columns, dead, in_place=in_place, divided=True).run(count, first)
    whole, lives = slice(first, first + count), ~mask[first : first + count]
    assert survivors == lives.sum()
    for field, values in zip(columns.all(), before, strict=True):
        after = field.to_numpy()
        assert np.array_equal(after[whole][:survivors], values[whole][lives])
        assert np.array_equal(after[:first], values[:first]), "the particles before were touched"
        assert np.array_equal(after[first + count :], values[first + count :])


def emitter(name="spring", count=10, **options):
    return tp.Emitter(name=name, births=tp.Burst(count=count), lifetime=1.0, **options)


def population(*emitters, capacity=64, seed=1):
    columns = Columns(("x", "id", "birth"), capacity)
    return Population("drops", emitters, columns=columns, schedules=schedules("drops", emitters, seed=seed, end=1.0))


def test_the_books_balance(cpu32):
    people = population(emitter("a"), emitter("b", count=5))
    assert people.emit(0.0, 0.5) == 15
    assert people.read("id").tolist() == [*range(0, 20, 2), *range(1, 10, 2)]
    assert people.emit(0.5, 1.0) == 0
    dead = marks(people.columns)
    set_marks(dead, np.arange(people.columns.padded) % 4 == 0)
    compaction = Compaction(people.columns, dead)
    assert people.bury(compaction, 4) == 4
    assert (people.alive, people.born, people.died) == (11, 15, 4)
    assert people.read("id").tolist() == [2, 4, 6, 10, 12, 14, 18, 1, 3, 7, 9]
    assert people.bury(compaction, 0) == 0 and people.alive == 11
    with pytest.raises(RunError, match="group 'drops': 8 alive, but 15 born and 6 died"):
        people.bury(compaction, 2)  # three are marked: somebody is lost


def test_overflow_names_the_emitter_and_the_number(cpu32):
    people = population(emitter("a"), emitter("sparks", count=30), capacity=32)
    message = (
        r"group 'drops', emitter 'sparks': 30 births at t = 0 s need room for 40 particles, the capacity is 32; "
        r"raise Group\.capacity or leave it out"
    )
    with pytest.raises(RunError, match=message):
        people.emit(0.0, 0.5)


def test_every_emitter_has_its_own_stream():
    a, b = emitter("a"), emitter("b")
    keys = {s.key for s in schedules("drops", (a, b), seed=1, end=1.0)}
    keys |= {s.key for s in schedules("rain", (a, b), seed=1, end=1.0)}
    keys |= {s.key for s in schedules("drops", (a, b), seed=2, end=1.0)}
    keys |= {schedules("a/b", (emitter("c"),), seed=1, end=1.0)[0].key}
    keys |= {schedules("a", (emitter("b/c"),), seed=1, end=1.0)[0].key}
    assert len(keys) == 8
    assert schedules("drops", (a, b), seed=1, end=1.0)[0].key == schedules("drops", (a,), seed=1, end=9.0)[0].key


def test_schedules_refuse_twins_and_too_many_ids():
    with pytest.raises(InputError, match="group 'drops' has two emitters named 'a'"):
        schedules("drops", (emitter("a"), emitter("a")), seed=1, end=1.0)
    flood = tp.Emitter(name="flood", births=tp.Rate(rate=1.5e9), lifetime=0.1)
    with pytest.raises(InputError, match=r"group 'drops', emitter 'flood': 1499999999 births leave no ids"):
        schedules("drops", (flood, emitter("a")), seed=1, end=1.0)
