"""What a sweep's options say: every text is understood or refused with a clean InputError."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tparticles.batch import grammar
from tparticles.errors import InputError

near = st.text(alphabet='0123456789-x:,.eE+[]"= na', max_size=24) | st.text(max_size=30)
number = st.integers(-(10**6), 10**6) | st.decimals(-1000, 1000, places=3)


@settings(deadline=None)  # the machine may be busy
@given(near)
@example("a=0:1:999999999999")
@example("a=0:1e999999999:3")
@example("a=1e308:-1e308:3")
@example("a=0:nan:3")
@example("a=٠:٢:٣")
@example("a=0:1:0")
@example("a=::")
@example("a=" + ":".join("9" * 400 for _ in range(3)))
@example("a=" + ",".join(["0:1:10000"] * 3))
def test_any_text_is_values_or_refused(text: str) -> None:
    try:
        name, values = grammar.axis(text)
    except InputError as error:
        assert str(error) and len(str(error)) < 400
        assert error.exit_code == 2
        return
    assert name == name.strip() != ""
    assert values and len(set(values)) == len(values)
    assert all(value == value.strip() != "" for value in values)


@settings(deadline=None)  # the machine may be busy
@given(number, number, st.integers(2, 50))
def test_spaced_values_begin_and_end_where_they_should(low, high, n: int) -> None:
    if Fraction(low) == Fraction(high):
        return
    _, values = grammar.axis(f"wind={low}:{high}:{n}")
    assert len(values) == n
    assert (float(values[0]), float(values[-1])) == (float(low), float(high))
    steps = [float(b) - float(a) for a, b in itertools.pairwise(values)]
    assert all(math.isclose(step, (float(high) - float(low)) / (n - 1), rel_tol=1e-6) for step in steps)


def test_the_grammar_as_the_help_says_it() -> None:
    assert grammar.axis("wind=0:2:5") == ("wind", ("0", "0.5", "1", "1.5", "2"))
    assert grammar.axis("n=1:9:5")[1] == ("1", "3", "5", "7", "9")
    assert grammar.axis("x=0:0.3:4")[1] == ("0", "0.1", "0.2", "0.3")
    assert grammar.axis("power= 20, 50 ,100")[1] == ("20", "50", "100")
    assert grammar.axis("at=[0,1],[2,3]")[1] == ("[0,1]", "[2,3]")
    assert grammar.axis("mixed=0:1:2,7")[1] == ("0", "1", "7")
    assert grammar.axis("url=http://a:b/c")[1] == ("http://a:b/c",)
    assert list(grammar.seeds("1-3, 7,10-20x5")) == [1, 2, 3, 7, 10, 15, 20]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("wind", "name=values is needed"),
        ("=1", "name=values is needed"),
        ("wind=", "wind: an empty value"),
        ("wind=1,,2", "wind: an empty value"),
        ("wind=1,1", "wind: 1 is given twice"),
        ("wind=0:2:x", "n values from a to b"),
        ("wind=0:2:2.5", "n values from a to b"),
        ("wind=0:2:1", "one value needs equal ends"),
        ("wind=2:2:3", "one value needs equal ends"),
        ("wind=0:2:9999999", "1 to 10000 values"),
    ],
)
def test_refusals(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        grammar.axis(text)


@settings(deadline=None)  # the machine may be busy
@given(near)
@example("1-999999999")
@example("1-2147483648x2147483647")
@example("5-1")
@example("1-9x0")
def test_any_text_is_seeds_or_refused(text: str) -> None:
    try:
        found = grammar.seeds(text)
    except InputError as error:
        assert str(error)
        return
    assert found and len(set(found)) == len(found)
    assert all(0 <= seed <= 2**31 for seed in found)


axes = st.dictionaries(
    st.text("abc", min_size=1), st.lists(st.integers(0, 9), min_size=1, max_size=4, unique=True), max_size=3
)


@settings(deadline=None)  # the machine may be busy
@given(axes, st.booleans())
def test_as_many_combinations_as_were_counted_all_different(axes: dict[str, list[int]], paired: bool) -> None:
    lengths = {len(values) for values in axes.values()}
    if paired and len(lengths) > 1:
        with pytest.raises(InputError, match="--zip pairs values"):
            grammar.count(axes, paired=True)
        return
    found = [tuple(chosen.items()) for chosen in grammar.combinations(axes, paired=paired)]
    assert len(found) == len(set(found)) == grammar.count(axes, paired=paired)
    assert len(found) == (max(lengths, default=1) if paired else math.prod(map(len, axes.values())))


def test_a_million_million_jobs_are_refused_before_they_are_made() -> None:
    with pytest.raises(InputError, match="1000000000000 jobs: at most 1000000"):
        grammar.count({"a": range(10**6), "b": range(10**6)}, paired=False)
