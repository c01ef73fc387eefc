"""Specs: frozen, validated, and wrong values explained in one line."""

import dataclasses
import math
import pickle
from typing import Annotated, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from tparticles.errors import InputError
from tparticles.spec import Count, Finite, NonNegative, Positive, Seed, Vec3, spec, unit


@spec
class Wheel:
    """A part."""

    radius: Positive = 0.3


@spec
class Wing:
    """Another part."""

    span: Positive = 10.0


@spec
class Vehicle:
    """Something with all kinds of parameters."""

    speed: Finite
    mass: Positive = 1.0
    friction: NonNegative = 0.0
    heading: Vec3 = (1.0, 0.0, 0.0)
    seats: Count = 4
    seed: Seed = 0
    kind: Literal["car", "boat"] = "car"
    part: Wheel | Wing = Wheel()
    parts: tuple[Wheel, ...] = ()
    keys: tuple[tuple[Finite, NonNegative], ...] = ()
    level: Annotated[NonNegative, Field(le=1)] = 0.5
    open: bool = False


def test_a_spec_is_a_frozen_dataclass_with_defaults():
    vehicle = Vehicle(speed=3)
    assert vehicle.speed == 3.0 and isinstance(vehicle.speed, float) and vehicle.mass == 1.0
    assert vehicle == Vehicle(speed=3.0) and hash(vehicle) == hash(Vehicle(speed=3.0))
    assert dataclasses.replace(vehicle, mass=2).mass == 2.0
    assert pickle.loads(pickle.dumps(vehicle)) == vehicle
    assert vehicle != Vehicle(speed=4.0) and vehicle != Wheel()
    assert repr(Wheel(radius=2)) == "Wheel(radius=2.0)"
    with pytest.raises(dataclasses.FrozenInstanceError, match="cannot assign to field 'speed'"):
        vehicle.speed = 4.0
    with pytest.raises(dataclasses.FrozenInstanceError, match="cannot delete field 'speed'"):
        del vehicle.speed


@pytest.mark.parametrize("value", [2, 2.0, np.float64(2), np.float32(2), np.int32(2)])
def test_numbers_of_every_kind_are_numbers(value):
    assert Vehicle(speed=value).speed == 2.0 and type(Vehicle(speed=value).speed) is float


@pytest.mark.parametrize("value", [(1, 2, 3), [1, 2, 3], np.array([1.0, 2.0, 3.0])])
def test_vectors_of_every_kind_are_tuples(value):
    assert Vehicle(speed=1, heading=value).heading == (1.0, 2.0, 3.0)


WRONG = {
    "unknown": ({"sped": 1}, "Vehicle has no parameter 'sped'; did you mean 'speed'? (known: speed, mass, "),
    "far": ({"speed": 1, "qqqq": 1}, "Vehicle has no parameter 'qqqq' (known: speed, mass, "),
    "missing": ({}, "Vehicle.speed is missing"),
    "text": ({"speed": "fast"}, "Vehicle.speed = 'fast': should be a number"),
    "text of a number": ({"speed": "3"}, "Vehicle.speed = '3': should be a number"),
    "truth": ({"speed": True}, "Vehicle.speed = True: should be a number"),
    "none": ({"speed": None}, "Vehicle.speed = None: should be a valid number"),
    "nan": ({"speed": math.nan}, "Vehicle.speed = nan: should be a finite number"),
    "inf": ({"speed": -math.inf}, "Vehicle.speed = -inf: should be a finite number"),
    "nan, positive": ({"speed": 1, "mass": math.nan}, "Vehicle.mass = nan: should be a finite number"),
    "zero": ({"speed": 1, "mass": 0}, "Vehicle.mass = 0: should be greater than 0"),
    "negative": ({"speed": 1, "friction": -0.1}, "Vehicle.friction = -0.1: should be greater than or equal to 0"),
    "too large": ({"speed": 1, "level": 1.5}, "Vehicle.level = 1.5: should be less than or equal to 1"),
    "short vector": ({"speed": 1, "heading": (1, 2)}, "Vehicle.heading[2] is missing"),
    "long vector": (
        {"speed": 1, "heading": (1, 2, 3, 4)},
        "Vehicle.heading = (1, 2, 3, 4): Tuple should have at most 3",
    ),
    "vector of text": ({"speed": 1, "heading": "abc"}, "Vehicle.heading[0] = 'a': should be a number"),
    "no vector": ({"speed": 1, "heading": 5}, "Vehicle.heading = 5: should be a valid tuple"),
    "nan inside": ({"speed": 1, "heading": (0, math.nan, 0)}, "Vehicle.heading[1] = nan: should be a finite number"),
    "half": ({"speed": 1, "seats": 2.5}, "Vehicle.seats = 2.5: should be a valid integer"),
    "no seats": ({"speed": 1, "seats": 0}, "Vehicle.seats = 0: should be greater than or equal to 1"),
    "true seats": ({"speed": 1, "seats": True}, "Vehicle.seats = True: should be a number"),
    "seed": ({"speed": 1, "seed": -1}, "Vehicle.seed = -1: should be greater than or equal to 0"),
    "choice": ({"speed": 1, "kind": "plane"}, "Vehicle.kind = 'plane': should be 'car' or 'boat'"),
    "union": ({"speed": 1, "part": 3}, "Vehicle.part = 3: should be a Wheel or a Wing"),
    "part": ({"speed": 1, "parts": (Wheel(), 3)}, "Vehicle.parts[1] = 3: should be a Wheel"),
    "key": ({"speed": 1, "keys": ((0, 1), (1, -1))}, "Vehicle.keys[1][1] = -1: should be greater than or equal to 0"),
    "long value": ({"speed": "x" * 500}, "Vehicle.speed = 'xxxx"),
    "two at once": ({"speed": "a", "mass": 0}, "Vehicle.speed = 'a': should be a number (and 1 more)"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_values_are_explained_in_one_line(name):
    options, message = WRONG[name]
    with pytest.raises(InputError) as caught:
        Vehicle(**options)
    text = str(caught.value)
    assert text.startswith(message)
    assert "\n" not in text and len(text) < 250 and "pydantic" not in text
    assert caught.value.exit_code == 2
    assert caught.value.__cause__ is None and caught.value.__suppress_context__


def test_a_single_wrong_value_counts_no_others():
    with pytest.raises(InputError) as caught:
        Vehicle(speed=1, heading="abc")
    assert "more" not in str(caught.value)


def test_positional_arguments_are_refused_with_the_names():
    with pytest.raises(InputError, match=r"Vehicle takes keyword arguments only \(speed, mass, friction, heading,"):
        Vehicle(3.0)


def test_an_error_of_the_spec_itself_passes_through():
    @spec
    class Ordered:
        """Two numbers."""

        low: Finite = 0.0
        high: Finite = 1.0

        def __post_init__(self):
            if self.low > self.high:
                raise InputError("low must not exceed high")

    with pytest.raises(InputError, match=r"^low must not exceed high$"):
        Ordered(low=2)


@settings(max_examples=200, deadline=None)
@given(
    st.dictionaries(
        st.sampled_from([f.name for f in dataclasses.fields(Vehicle)] + ["sped", "x"]),
        st.recursive(
            st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4) | st.binary(max_size=3),
            lambda inner: (
                st.lists(inner, max_size=3) | st.tuples(inner, inner, inner) | st.dictionaries(st.text(), inner)
            ),
            max_leaves=6,
        ),
        max_size=4,
    )
)
def test_garbage_raises_input_errors_and_nothing_else(options):
    try:
        Vehicle(**{"speed": 1.0} | options)
    except InputError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("v", [(0, 3, 4), (0, 3e-300, 4e-300), (0, 3e300, 4e300), (0.0, 3e-310, 4e-310)])
def test_unit_directions(v):
    assert unit("axis", v) == pytest.approx((0.0, 0.6, 0.8), rel=1e-12)


def test_no_direction():
    with pytest.raises(InputError, match=r"axis = \(0\.0, 0\.0, 0\.0\): a direction must not be zero"):
        unit("axis", (0.0, 0.0, 0.0))
