"""Malformed programs and tableaus are refused at construction, by an error that names the scheme and the value."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scheme_samples import make

from tparticles.errors import InputError
from tparticles.schemes import Op, OpKind, describe, runge_kutta

F = Fraction

E, C = OpKind.EVALUATE, OpKind.COMBINE


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"order": 0}, "order must be an integer >= 1, not 0"),
        ({"order": 1.0}, r"order must be an integer >= 1, not 1\.0"),
        ({"slopes": True}, "slopes must be an integer >= 1, not True"),
        ({"system_orders": frozenset({3})}, "system_orders"),
        ({"system_orders": {1}}, "system_orders"),
        ({"needs": ["equal steps"]}, "needs must be a tuple of strings"),
        ({"reference": None}, "reference must be a string"),
        ({"stability": (1, 1)}, "stability must be a Stability"),
        ({"ops": [Op(E), Op(C)]}, "ops must be a tuple of Op"),
        ({"ops": ()}, "the last op must be a COMBINE.* not nothing"),
        ({"ops": (Op(E),)}, "the last op must be a COMBINE.* not EVALUATE"),
        ({"ops": (Op(2), Op(C))}, "op 0: kind must be an OpKind, not 2"),
        ({"ops": (Op(E, slope=1), Op(C))}, r"op 0: EVALUATE writes slope 1, but the registers are 0\.\.0"),
        ({"ops": (Op(E, slope=-1), Op(C))}, "op 0: EVALUATE writes slope -1"),
        ({"ops": (Op(E, time=math.inf), Op(C))}, "op 0: time must be a finite float, not inf"),
        ({"ops": (Op(E, weights=(1.0,)), Op(C))}, "op 0: EVALUATE takes no weights"),
        ({"ops": (Op(C, weights=(1.0,)),)}, "op 0: weight 0 .* not evaluated yet"),
        ({"ops": (Op(E), Op(C, weights=(1.0, 1.0)))}, "op 1: weight 1 .* not evaluated yet"),
        ({"ops": (Op(C, weights=(0.0,)),)}, "op 0: weight 0 .* not evaluated yet"),
        ({"ops": (Op(E), Op(C, weights=(math.nan,)))}, "op 1: .* weight 0 is nan"),
        ({"ops": (Op(E), Op(C, weights=(F(1),)))}, "op 1: .* weight 0 is 1"),
        ({"ops": (Op(E), Op(C, weights=[1.0]))}, "op 1: weights must be a tuple"),
    ],
)
def test_malformed_programs(changes, message):
    with pytest.raises(InputError, match=f"scheme 'trial'.*{message}"):
        make(**changes)


HEUN = {"a": [[], [1]], "b": [0.5, 0.5]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"b": [0.5, 0.4]}, "b must sum to 1, not 9/10"),
        ({"b": [math.pi, 1]}, r"b must sum to 1, not 4\.14159"),
        ({"b": []}, "b is empty"),
        ({"b": [0.5, math.nan]}, r"b\[1\] must be finite in float64, not nan"),
        ({"b": [0.5, 10**400]}, r"b\[1\] must be finite"),
        ({"b": [0.5, F(10) ** 400]}, r"b\[1\] must be finite"),
        ({"b": [True, 0]}, r"b\[0\] must be a number, not True"),
        ({"b": "ab"}, "b must be a sequence of numbers, not 'ab'"),
        ({"b": {0.5, 1.5}}, "b must be a sequence of numbers"),
        ({"b": 10**5000}, "b must be a sequence of numbers, not a int too large to print"),
        ({"b": np.array(1.0)}, "b must be a sequence of numbers"),
        ({"a": None}, "a must be a sequence of rows, not None"),
        ({"a": [[], 1]}, r"a\[1\] must be a sequence of numbers, not 1"),
        ({"a": [[], [[1]]]}, r"a\[1\]\[0\] must be a number, not \[1\]"),
        ({"a": [[], ["1"]]}, r"a\[1\]\[0\] must be a number, not '1'"),
        ({"a": [[], [math.inf]]}, r"a\[1\]\[0\] must be finite in float64, not inf"),
        ({"a": [[]]}, "a has 1 rows, but b has 2 weights"),
        ({"a": [[], [1, 0, 0]]}, r"a\[1\] has 3 entries, allowed are up to 2, or all 2"),
        ({"a": [[0.5, 0.5], [0.5]]}, r"a\[0\]\[1\] is 1/2, but .* fully implicit methods are not supported"),
        ({"b_embedded": [1]}, "b_embedded has 1 weights, but b has 2"),
        ({"b_embedded": [1, 1]}, "b_embedded must sum to 1, not 2"),
        ({"b_embedded": [1, math.nan]}, r"b_embedded\[1\] must be finite"),
        ({"a": [[0, 1], [1, 0]]}, r"a\[0\]\[1\] is 1, but"),
        ({"c": [0, 0.5]}, r"c\[1\] is 1/2, but row 1 of a sums to 1"),
        ({"c": [0]}, "c has 1 entries, but b has 2 weights"),
        ({"c": [0, math.nan]}, r"c\[1\] must be finite"),
        ({"order": 1}, "claimed order 1, but the order conditions hold up to order 2$"),
        ({"order": 3}, r"claimed order 3, but .* up to order 2; the first that fails, at order 3, is b·\(.*\) = 1/"),
        ({"order": 10**5000}, "claimed order a int too large"),
        ({"order": 2.0}, r"order must be an integer, not 2\.0"),
        ({"order": "2"}, "order must be an integer, not '2'"),
        ({"reference": 1}, "reference must be a string"),
        ({"a": [[], [1e200], [0, 1e200]], "b": [0, 0, 1]}, "overflows float64"),
    ],
)
def test_malformed_tableaus(changes, message):
    with pytest.raises(InputError, match=f"scheme 'trial'.*{message}"):
        runge_kutta(**{**HEUN, "name": "trial", **changes})


def test_the_failed_condition_shows_its_value_and_what_is_needed():
    # The classical slip: Kutta's weights with the stages of Heun's third-order method.
    with pytest.raises(InputError) as caught:
        runge_kutta([[], [F(1, 2)], [0, F(3, 4)]], [F(1, 6), F(2, 3), F(1, 6)], name="slip", order=3)
    assert str(caught.value) == (
        "scheme 'slip': claimed order 3, but the order conditions hold up to order 1; "
        "the first that fails, at order 2, is b·(c) = 1/2: it is 11/24"
    )


@pytest.mark.parametrize("name", ["", None, 3])
def test_a_scheme_needs_a_name(name):
    with pytest.raises(InputError, match="name must be a non-empty string"):
        runge_kutta([[]], [1], name=name)
    with pytest.raises(InputError, match="name must be a non-empty string"):
        make(name=name)


scalars = st.one_of(
    st.integers(-3, 3), st.floats(), st.fractions(), st.integers(), st.none(), st.booleans(), st.text(max_size=2)
)
rows = st.one_of(st.lists(scalars, max_size=4), scalars)
tableaus = st.one_of(st.lists(rows, max_size=4), scalars)


@settings(max_examples=200, deadline=None)
@given(a=tableaus, b=rows, c=rows, order=scalars, name=scalars)
def test_any_input_makes_a_scheme_or_an_input_error(a, b, c, order, name):
    try:
        scheme = runge_kutta(a, b, c=c, order=order, name=name)
    except InputError as error:
        assert not isinstance(name, str) or not name or f"scheme '{name}'" in str(error)
    else:
        describe(scheme)


@st.composite
def well_shaped(draw):
    """Lower triangles of any finite size, with weights that sum to 1: only their numbers may be refused."""
    s = draw(st.integers(1, 4))
    entries = st.one_of(st.floats(allow_nan=False, allow_infinity=False), st.floats(-3, 3), st.fractions())
    a = [draw(st.lists(entries, min_size=i, max_size=i)) for i in range(s)]
    b = [F(entry) for entry in draw(st.lists(entries, min_size=s - 1, max_size=s - 1))]
    return a, [*b, 1 - sum(b, start=F(0))]


@settings(max_examples=80, deadline=None)
@given(tableau=well_shaped())
def test_any_explicit_tableau_can_be_analysed(tableau):
    try:
        scheme = runge_kutta(*tableau, name="any")
    except InputError as error:
        assert "scheme 'any'" in str(error)
        return
    assert 1 <= scheme.order <= scheme.slopes
    # No explicit method of s stages is stable beyond 2 s^2 or s (Hairer and Wanner; van der Houwen).
    assert 0 <= scheme.real_limit <= 2 * scheme.slopes**2 * (1 + 1e-6)
    assert 0 <= scheme.imaginary_limit <= scheme.slopes * (1 + 1e-6)
    for limit, direction in ((scheme.real_limit, -1), (scheme.imaginary_limit, 1j)):
        assert abs(scheme.stability(direction * limit / 2)) <= 1 + 1e-9
