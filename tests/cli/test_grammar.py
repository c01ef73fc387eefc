"""What is typed on the command line, as properties: every text is either understood or refused with a clean InputError."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any, Literal

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tparticles.command_options import settings_option, size_option
from tparticles.errors import InputError
from tparticles.job import _span
from tparticles.parameter import Parameter
from tparticles.scene import frame_numbers, frame_rate

# Texts that nearly are what is wanted, and any text at all.
near = st.text(alphabet="0123456789-x,/.eE+ n a", max_size=20) | st.text(max_size=30)
count = st.integers(1, 500)


def one_line(error: InputError) -> None:
    assert str(error)
    assert error.exit_code == 2


@given(near, count)
@example("1-999999999999", 24)
@example("٣", 24)
@example("1_0", 24)
@example("1-24x999999999", 24)
def test_any_text_is_a_range_or_refused(text: str, n: int) -> None:
    try:
        numbers = frame_numbers(text, n)
    except InputError as error:
        one_line(error)
        return
    assert re.fullmatch(r"[0-9x,\s-]+", text)
    assert numbers
    assert list(numbers) == sorted(set(numbers))
    assert numbers[0] >= 1 and numbers[-1] <= n


@given(st.data(), count)
def test_every_range_is_read(data: st.DataObject, n: int) -> None:
    first = data.draw(st.integers(1, n))
    last = data.draw(st.integers(first, n))
    step = data.draw(st.integers(1, 50))
    assert frame_numbers(f"{first}-{last}x{step}", n) == tuple(range(first, last + 1, step))
    assert frame_numbers(f"{first}-x{step}", n) == tuple(range(first, n + 1, step))
    assert frame_numbers(f" {first}-{last}, {n}", n) == tuple(sorted({*range(first, last + 1), n}))


@given(st.sets(st.integers(1, 300), min_size=1, max_size=12))
def test_the_name_of_a_part_says_its_frames(chosen: set[int]) -> None:
    frames = tuple(sorted(chosen))
    name = _span(frames)
    assert re.fullmatch("[0-9x+-]+", name)
    assert len(name) <= 60
    if re.fullmatch(r"\d+-\d+\+\d{6,}", name) is None:  # not the short form of a long list
        assert frame_numbers(name.replace("+", ","), 300) == frames


def test_a_long_list_of_frames_gets_a_short_name() -> None:
    squares = tuple(n * n for n in range(1, 200))
    names = [_span(squares), _span((*squares[:50], *squares[51:]))]
    assert len(set(names)) == 2
    assert all(len(name) < 40 for name in names)


@given(near | st.floats().map(str) | st.fractions().map(str) | st.integers() | st.floats() | st.none())
@example("1e999999999")
@example("1e-999999999")
@example("1/0")
@example("0.0000000001")
def test_any_value_is_a_frame_rate_or_refused(value: Any) -> None:
    try:
        rate = frame_rate(value)
    except InputError as error:
        one_line(error)
        return
    assert isinstance(rate, Fraction)
    assert 0 < rate <= 1000
    assert max(rate.numerator, rate.denominator) <= 1_001_000


@given(st.fractions(min_value=Fraction(1, 100), max_value=1000, max_denominator=1001))
def test_every_usual_rate_is_read_exactly(rate: Fraction) -> None:
    assert frame_rate(str(rate)) == frame_rate(rate) == rate


@given(st.text(alphabet="0123456789xX- ", max_size=14) | st.text(max_size=20))
@example("٣x٤")
def test_any_text_is_a_size_or_refused(text: str) -> None:
    try:
        size = size_option(None, None, text)
    except InputError as error:
        one_line(error)
        return
    assert size is not None
    assert all(1 <= n <= 16384 for n in size)
    assert text.strip() == f"{text.strip().split('x')[0]}x{text.strip().split('x')[1]}"


@given(st.lists(st.text(max_size=12), max_size=4))
def test_any_settings_are_pairs_or_refused(values: list[str]) -> None:
    try:
        settings = settings_option(None, None, values)
    except InputError as error:
        one_line(error)
        return
    assert len(settings) == len(values)
    assert all(name and "=" not in name for name in settings)


KINDS = (
    float,
    int,
    bool,
    str,
    float | None,
    Literal["calm", "storm"],
    tuple[float, float, float],
    list[int],
    dict[str, float],
    Any,
)
TYPES: dict[Any, tuple[type, ...]] = {float: (float,), int: (int,), bool: (bool,), str: (str,), list[int]: (list,)}


@given(
    st.sampled_from(KINDS),
    near | st.sampled_from(["nan", "NaN", "inf", "1e999", "[1,2,3]", "1,2,3", "true", "null", '{"a": 1}']),
)
@example(Any, "[" * 100_000)
@example(int, "1" * 5000)
def test_any_text_is_a_parameter_or_refused(kind: Any, text: str) -> None:
    parameter = Parameter("wind", kind, None)
    try:
        value = parameter.read(text)
    except InputError as error:
        one_line(error)
        assert "parameter wind = " in str(error) and "http" not in str(error)
        return
    assert isinstance(value, TYPES.get(kind, object))
    assert "nan" not in repr(value).split() or isinstance(value, str)


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (float, ".5", 0.5),
        (float, " 2 ", 2.0),
        (int, "3", 3),
        (bool, "yes", True),
        (bool, "false", False),
        (str, "1e999", "1e999"),
        (str, "", ""),
        (float | None, "null", None),
        (Literal["calm", "storm"], "calm", "calm"),
        (tuple[float, float], "1,2", (1.0, 2.0)),
        (tuple[float, float], "[1, 2]", (1.0, 2.0)),
        (Any, "[1, 2]", [1, 2]),
        (Any, "calm", "calm"),
    ],
)
def test_texts_are_read_as_the_type_says(kind: Any, text: str, value: Any) -> None:
    read = Parameter("p", kind, None).read(text)
    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize(
    ("kind", "value", "said"),
    [
        (float, True, "valid number"),
        (float, "true", "valid number"),
        (float, float("nan"), "must be finite"),
        (tuple[float, float], "1,nan", "Invalid JSON|valid|finite"),
        (tuple[float, float], "[1,NaN]", "must be finite"),
        (dict[str, float], '{"a": 1e999}', "must be finite"),
        (int, 1.5, "valid integer"),
        (int, "1.5", "valid integer"),
        (Literal["calm", "storm"], "windy", "'calm' or 'storm'"),
        (Exception, "x", "cannot be set from outside"),
    ],
)
def test_other_values_are_refused(kind: Any, value: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        Parameter("p", kind, None).read(value)


@pytest.mark.parametrize(
    ("kind", "value", "read"),
    [
        (float, 2, 2.0),
        (tuple[float, float], [1, 2], (1.0, 2.0)),
        (tuple[float, float], (1, 2), (1.0, 2.0)),
        (Any, [1], [1]),
    ],
)
def test_values_of_python_are_taken(kind: Any, value: Any, read: Any) -> None:
    assert Parameter("p", kind, None).read(value) == read
