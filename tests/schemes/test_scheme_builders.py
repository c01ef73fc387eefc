"""Schemes from a user's numbers (adams, bdf, splitting, tableaus), and what is refused at construction."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scheme_samples import make

from tparticles.errors import InputError
from tparticles.schemes import (
    CATALOGUE,
    MultistepStability,
    Op,
    OpKind,
    SplittingStability,
    adams,
    bdf,
    describe,
    modified_euler,
    runge_kutta,
    splitting,
)

F = Fraction
E, C, K, D, S, R, DIFF = (
    OpKind.EVALUATE, OpKind.COMBINE, OpKind.KICK, OpKind.DRIFT, OpKind.SOLVE, OpKind.ROTATE, OpKind.DIFFERENCE
)  # fmt: skip

EULER = CATALOGUE["euler"]
AB2 = {
    "ops": (Op(E), Op(C, weights=(1.5, -0.5))),
    "slopes": 2,
    "history": (Op(R, slope=1, source=0),),
    "carried": (1,),
    "steps_back": 1,
    "starter": EULER,
    "needs": ("equal steps",),
    "order": 2,
}
KICKED = {"needs": ("second-order system",), "system_orders": frozenset({2})}


def test_the_trials_are_well_formed():
    assert make(**AB2).registers == 2
    assert make(ops=(Op(E), Op(K, weights=(1.0,)), Op(D, weights=(1.0,))), **KICKED).evaluations == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"needs": ("luck",)}, "needs 'luck', but allowed are equal steps"),
        ({"ssp": 0.0}, "ssp must be a float > 0 or None, not 0.0"),
        ({"reuses": 1}, "reuses must be True or False"),
        ({"reuses": True}, "reuses needs slope 0 to end as f at time 1"),
        ({"error_weights": (1.0,)}, "error_weights and error_order go together"),
        ({"error_weights": (1.0, 2.0), "error_order": 1}, "error_weights must be a tuple of up to 1 floats"),
        ({"carried": (1,)}, r"carried must be a tuple of registers 1\.\.0"),
        ({"steps_back": -1}, "steps_back must be an integer >= 0"),
        ({"starter": EULER}, "for schemes with steps_back > 0"),
        ({"ops": (Op(E), Op(D, weights=(1.0,)))}, r"system_orders must be \{2\}"),
        ({"needs": ("second-order system",)}, "needs must hold 'second-order system' where"),
        ({"ops": (Op(E), Op(D, weights=(1.0, 0.0))), **KICKED}, "op 1: DRIFT takes one weight"),
        ({"ops": (Op(S),)}, "op 0: SOLVE takes one weight"),
        ({"ops": (Op(S, weights=(0.0,)),)}, "op 0: SOLVE needs a weight other than 0"),
        ({"ops": (Op(E, linear=True), Op(C, weights=(1.0,)))}, "op 0: EVALUATE has no linear"),
        ({"ops": (Op(E), Op(C, weights=(1.0,), time=1.0))}, "op 1: COMBINE has no time"),
        ({"ops": (Op(E, source=3), Op(C, weights=(1.0,)))}, "op 0: EVALUATE reads slope 3"),
        ({"ops": (Op(R), Op(C, weights=(1.0,)))}, "op 0: ROTATE reads slope 0, which is not evaluated yet"),
        (
            {"ops": (Op(E), Op(C, weights=(1.0,), variable=((1, 1, 0),)))},
            "variable 0 is 2.0 at r = 1, but weight 0 is 1",
        ),
        ({"ops": (Op(E), Op(C, weights=(1.0,), variable=((1, 0, 0),) * 2))}, "variable has 2 entries"),
        ({"ops": (Op(E), Op(C, weights=(1.0,), variable=((1, 0, -1),)))}, r"variable 0 must be finite \(n0, n1, d\)"),
        ({**AB2, "needs": ()}, "needs must hold 'equal steps'"),
        ({**AB2, "starter": None}, "steps_back is 1, so starter must be a Scheme"),
        ({**AB2, "order": 3}, "its starter 'euler' is of order 1, needed is at least 2"),
        ({**AB2, "starter": CATALOGUE["ab2"]}, "its starter 'ab2' must be a one-step scheme"),
        ({**AB2, "starter": CATALOGUE["velocity-verlet"]}, "cannot run systems of order"),
        ({**AB2, "starter": CATALOGUE["bogacki-shampine"]}, "must leave as f at time 0.0, not 1.0"),
        ({**AB2, "starter": CATALOGUE["sdirk2"]}, "must leave as f at time 0.0, not None"),
        ({**AB2, "history": ()}, r"history must fill the carried registers \[1\], it fills \[\]"),
        ({**AB2, "history": (Op(E, slope=1),)}, "history consists of ROTATE and DIFFERENCE, not EVALUATE"),
        ({**AB2, "history": (Op(R, slope=1, source=1),)}, r"then slopes \[1\] are not filled yet"),
    ],
)
def test_malformed_programs_of_every_family(changes, message):
    with pytest.raises(InputError, match=f"scheme 'trial'.*{message}"):
        make(**changes)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: adams([1, 1], name="x"), "explicit must sum to 1, not 2"),
        (lambda: adams([], name="x"), "explicit has 0 weights, allowed are 1 to 8"),
        (lambda: adams([math.nan], name="x"), r"explicit\[0\] must be finite"),
        (lambda: adams([1.5, -0.5], [0.5, 0.6], name="x"), "implicit must sum to 1"),
        (lambda: adams([1.5, -0.5], name="x", order=3), "claimed order 3, but the order conditions hold up to order 2"),
        (lambda: adams([1.5, -0.5], name="x", order="2"), "order must be an integer, not '2'"),
        (lambda: adams([1], name="x", starter=EULER), "it is a one-step method, so it takes no starter"),
        (lambda: adams([1.5, -0.5], name="x", starter="euler"), "starter must be a Scheme, not 'euler'"),
        (lambda: bdf(7, name="x"), "steps must be an integer from 1 to 6, not 7"),
        (lambda: bdf(2.0, name="x"), "steps must be an integer"),
        (lambda: bdf(5, name="x"), "its starter 'sdirk3' is of order 3, needed is at least 4"),
        (lambda: splitting([1], [0.5, 0.4], name="x"), "drifts must sum to 1"),
        (lambda: splitting([0.5] * 2, [0.25] * 4, name="x"), "2 kicks and 4 drifts cannot take turns"),
        (lambda: splitting([1], [1], name="x"), "first must be 'kick' or 'drift' with 1 kicks and 1 drifts, not ''"),
        (lambda: splitting([0.5, 0.5], [1], first="drift", name="x"), "first must be 'kick' with 2 kicks and 1 drifts"),
        (lambda: splitting([0.5, 0.5], [1], name="x", order=4), "claimed order 4, but .* up to order 2"),
        (lambda: splitting(None, [1], name="x"), "kicks must be a sequence of numbers, not None"),
        (lambda: modified_euler(0.4, name="x"), "alpha must be a number from 0.5 to 1, not 0.4"),
        (lambda: modified_euler(math.nan, name="x"), "alpha must be a number"),
    ],
)
def test_malformed_tables(build, message):
    with pytest.raises(InputError, match=f"scheme 'x'.*{message}"):
        build()


def test_order_needs_and_starters_follow_from_the_numbers():
    ab2 = adams([1.5, -0.5], name="ab2")
    assert (ab2.order, ab2.needs, ab2.starter.name) == (2, (), "midpoint")
    # Consistent, but not Adams-Bashforth: order 1, and its weights say nothing about unequal steps.
    odd = adams([1.25, -0.25], name="odd")
    assert (odd.order, odd.needs, odd.starter.name) == (1, ("equal steps",), "euler")
    assert adams([1], name="one").one_step
    assert bdf(1, name="one").l_stable
    assert bdf(2, name="two") != CATALOGUE["bdf2"]
    verlet = splitting([0.5, 0.5], [1], name="v")
    assert (verlet.order, verlet.evaluations, verlet.needs) == (2, 1, ("second-order system", "velocity-free forces"))
    assert splitting([1], [1], first="drift", name="other-euler").order == 1
    assert runge_kutta([[], [0.5, 0.5]], [0.5, 0.5], name="t").ops == CATALOGUE["trapezoidal"].ops
    assert modified_euler(0.5).order == 2


@pytest.mark.parametrize("bad", [(), ((1,),), [(1,), (1,)], ((1,), (math.nan,)), ((1,), (10**400,)), ((1,), ("1",))])
def test_malformed_characteristic_polynomials(bad):
    with pytest.raises(InputError, match="characteristic polynomial"):
        MultistepStability(characteristic=bad)
    with pytest.raises(InputError, match="characteristic polynomial"):
        SplittingStability(velocity=bad, oscillator=(((1,),),) * 2)


weights = st.lists(st.one_of(st.floats(-3, 3), st.floats(), st.fractions(-3, 3), st.integers(), st.none()), max_size=4)


def completed(values):
    """Return `values` with a last one that makes their sum 1, where they are numbers."""
    try:
        return [*values, 1 - sum(map(F, values), start=F(0))]
    except (TypeError, ValueError, OverflowError):
        return values


@settings(max_examples=60, deadline=None)
@given(explicit=weights, implicit=st.one_of(st.none(), weights), order=st.one_of(st.none(), st.integers(-1, 5)))
def test_any_adams_table_makes_a_scheme_or_an_input_error(explicit, implicit, order):
    implicit = None if implicit is None else completed(implicit)
    check(lambda: adams(completed(explicit), implicit, name="any", order=order))


@settings(max_examples=60, deadline=None)
@given(kicks=weights, drifts=weights, first=st.sampled_from(["", "kick", "drift", "jump"]))
def test_any_splitting_makes_a_scheme_or_an_input_error(kicks, drifts, first):
    check(lambda: splitting(completed(kicks), completed(drifts), name="any", first=first))


def check(build):
    try:
        scheme = build()
    except InputError as error:
        assert "scheme 'any'" in str(error)
    else:
        described = describe(scheme)
        assert described["order"] >= 1
        assert described["real_limit"] >= 0
        assert described["imaginary_limit"] >= 0
