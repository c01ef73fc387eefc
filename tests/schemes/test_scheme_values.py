"""Schemes are values, found by name, compared and hashed by content; the reference interpreter walks them."""

from __future__ import annotations

import dataclasses
import json
import math
import pickle
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scheme_samples import BY_NAME, ONE_STEP_EXPLICIT, SCHEMES, make

from tparticles.errors import InputError
from tparticles.schemes import CATALOGUE, Op, OpKind, describe, get, runge_kutta, step

F = Fraction
ROOT = Path(__file__).parents[2]

E, C = OpKind.EVALUATE, OpKind.COMBINE


def test_the_catalogue_is_read_only_and_keyed_by_name():
    assert {"euler", "midpoint", "rk4"} < set(CATALOGUE)
    assert all(scheme.name == name for name, scheme in CATALOGUE.items())
    with pytest.raises(TypeError):
        CATALOGUE["mine"] = CATALOGUE["euler"]  # type: ignore[index]


def test_names_need_no_scheme_and_taking_one_builds_no_other():
    code = """
from tparticles import schemes
built = []
check = schemes.Scheme.__post_init__
schemes.Scheme.__post_init__ = lambda scheme: (check(scheme), built.append(scheme.name))[0]
assert "rk4" in schemes.CATALOGUE and "rk5" not in schemes.CATALOGUE
print(len(schemes.CATALOGUE), list(schemes.CATALOGUE)[:2], repr(schemes.CATALOGUE)[:18], schemes.CATALOGUE.get("rk5"), built)
schemes.get("rk4"), schemes.get("rk4")
print(built)
schemes.get("ab4"), schemes.CATALOGUE["bdf2"]
print(built)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.splitlines() == [
        f"{len(CATALOGUE)} ['euler', 'midpoint'] Lazy(euler, midpoi None []",
        "['rk4']",
        # With their starters, of which rk4 is there already.
        "['rk4', 'ab4', 'sdirk2', 'bdf2']",
    ], done.stderr


def test_get_takes_a_name_or_a_scheme():
    assert get("rk4") is CATALOGUE["rk4"]
    mine = make()
    assert get(mine) is mine
    with pytest.raises(InputError, match=r"unknown scheme 'rk5'; did you mean 'rk4'\? \(known: ab2, .*euler.*\)"):
        get("rk5")
    with pytest.raises(InputError, match="not 4"):
        get(4)  # type: ignore[arg-type]


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_describe_is_json(scheme):
    described = describe(scheme)
    keys = ["name", "order", "evaluations", "real_limit", "imaginary_limit", "a_stable", "l_stable", "needs"]
    assert list(described) == keys
    # Unbounded limits are infinity; it is for a writer of JSON to say null.
    finite = {key: None if value == math.inf else value for key, value in described.items()}
    assert json.loads(json.dumps(finite, allow_nan=False)) == finite


def test_schemes_are_frozen_hashable_and_equal_by_value():
    with pytest.raises(dataclasses.FrozenInstanceError):
        make().order = 2  # type: ignore[misc]
    for scheme in SCHEMES:
        copy = pickle.loads(pickle.dumps(scheme))
        assert copy == scheme
        assert hash(copy) == hash(scheme)
    assert len(set(SCHEMES)) == len(SCHEMES)


def test_limits_do_not_change_a_scheme():
    fresh, used = make(), make()
    assert used.real_limit == 2
    assert fresh == used
    assert hash(fresh) == hash(used)


def test_floats_and_fractions_of_one_tableau_are_one_scheme():
    a, b = [[], [F(1, 3)], [0, F(2, 3)]], [F(1, 4), 0, F(3, 4)]
    as_floats = [[float(entry) for entry in row] for row in a], [float(entry) for entry in b]
    square = np.array([[0, 0, 0], [1 / 3, 0, 0], [0, 2 / 3, 0]])
    assert runge_kutta(a, b, name="heun3") == runge_kutta(*as_floats, name="heun3")
    assert runge_kutta(a, b, name="heun3") == runge_kutta(square, b, name="heun3")


def test_a_tableau_translates_to_evaluations_and_combinations():
    assert CATALOGUE["midpoint"].ops == (
        Op(E, slope=0, time=0.0),
        Op(C, weights=(0.5,)),
        Op(E, slope=1, time=0.5),
        Op(C, weights=(0.0, 1.0)),
    )
    assert all(type(weight) is float for scheme in SCHEMES for op in scheme.ops for weight in op.weights)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.complex64, np.complex128])
def test_step_keeps_dtype_and_input(dtype):
    z = np.ones((3, 2), dtype)
    out = step(BY_NAME["rk4"], lambda t, z: -z, np.float64(0.0), z, np.float64(0.1))
    assert out.dtype == dtype
    assert out.shape == z.shape
    assert np.all(z == 1)
    np.testing.assert_allclose(out, math.exp(-0.1), rtol=1e-6)


@pytest.mark.parametrize("name", ["euler", "rk4", "kutta-rk3", "dormand-prince-5", "butcher-6"])
def test_step_is_exact_on_fractions(name):
    scheme, z = BY_NAME[name], F(-3, 7)
    exact = sum(coefficient * z**k for k, coefficient in enumerate(scheme.stability.numerator))
    assert step(scheme, lambda _, x: z * x, 0, 1, F(1)) == exact
    boxed = step(scheme, lambda _, x: z * x, 0, np.array([1, F(2)], dtype=object), 1)
    assert list(boxed) == [exact, 2 * exact]


@pytest.mark.parametrize("scheme", ONE_STEP_EXPLICIT, ids=lambda scheme: scheme.name)
def test_step_asks_at_the_stage_times(scheme):
    asked = []
    step(scheme, lambda t, z: asked.append(t) or 0.0, 10.0, 1.0, 0.5)
    times = [op.time for op in scheme.ops if op.kind is E]
    assert asked == [10.0 + time * 0.5 for time in times]
    assert len(asked) == scheme.stages


def test_step_follows_the_order_of_the_ops():
    # The second evaluation overwrites slope 0 after the state has moved on: z = 1, 1 + 1, then 1 + 2.
    again = make(ops=(Op(E), Op(C, weights=(1.0,)), Op(E, time=1.0), Op(C, weights=(1.0,))))
    assert step(again, lambda _, z: z, 0.0, 1.0, 1.0) == 3.0
    assert step(make(ops=(Op(C),)), lambda _, z: z, 0.0, 1.0, 1.0) == 1.0
