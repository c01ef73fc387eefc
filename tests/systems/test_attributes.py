"""What a particle costs: only the attributes that a group needs are allocated."""

import itertools

import numpy as np
import pytest

import tparticles as tp
from tparticles.errors import InputError
from tparticles.systems.attributes import ATTRIBUTES, Columns, bytes_allocated, bytes_per_particle

BASE = {"f32": 24, "f64": 36}  # x, id, birth
REAL = {"f32": 4, "f64": 8}
FLOW, FORCE = tp.Advected(flow=tp.Uniform()), tp.Newtonian(forces=tp.Gravity())
RAMP, GLOW = tp.Ramp(colors=((1, 1, 1),), span=1.0), tp.Glow()


def group(system=FLOW, appearance=RAMP, cooling=None, **emitter):
    emitter = {"births": tp.Burst(count=1), "lifetime": 1.0, **emitter}
    return tp.Group(name="g", system=system, emitters=tp.Emitter(**emitter), appearance=appearance, cooling=cooling)


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_bytes_of_every_combination(precision):
    for inertia, streaks, size, lifetime, warmth in itertools.product(
        *([False, True] for _ in range(4)), [None, "same", "varies", "char"]
    ):
        spec = group(
            system=FORCE if inertia else FLOW,
            appearance=RAMP if warmth is None else GLOW,
            cooling=tp.Char() if warmth == "char" else None,
            size=(1.0, 0.5) if size else 1.0,
            lifetime=(1.0, 0.5) if lifetime else 1.0,
            **({} if warmth is None else {"temperature": (1500.0, 100.0) if warmth == "varies" else 1500.0}),
        )
        names = spec.attributes(streaks=streaks)
        reals = 3 * (inertia or streaks) + size + lifetime + (warmth in ("varies", "char"))
        assert bytes_per_particle(names, precision) == BASE[precision] + REAL[precision] * reals, names


def test_two_emitters_that_differ_need_an_attribute():
    one, two = (tp.Emitter(name=n, births=tp.Burst(count=1), size=s, lifetime=1.0) for n, s in (("a", 1.0), ("b", 2.0)))
    spec = tp.Group(name="g", system=FLOW, emitters=(one, two), appearance=RAMP)
    assert spec.attributes(streaks=False) == ("x", "id", "birth", "size")
    mortal = tp.Emitter(name="c", births=tp.Burst(count=1), size=1.0)
    spec = tp.Group(name="g", system=FLOW, emitters=(one, mortal), appearance=RAMP)
    assert spec.attributes(streaks=False) == ("x", "id", "birth", "lifetime")


def test_columns_hold_what_was_asked_for_and_no_more(cpu32):
    columns = Columns(("birth", "x", "id", "size"), 100)
    assert columns.names == ("x", "id", "birth", "size")  # in the order of the table, whatever was asked first
    assert "v" not in columns and len(columns.all()) == 6
    assert (columns.capacity, columns.padded) == (100, 112)
    bytes_each = sum(f.to_numpy().itemsize for f in columns.all())
    assert bytes_each == bytes_per_particle(columns.names, "f32") == 28
    assert columns["birth"][0].to_numpy().dtype == np.float64, "birth times are exact in every precision"
    assert bytes_allocated(columns.names, "f32") == 28 + (4 + 4 + 8) + 4
    assert bytes_allocated(columns.names, "f64") == 44 + (4 + 8) + 4


@pytest.mark.parametrize(("capacity", "padded"), [(1, 16), (16, 16), (17, 32)])
def test_columns_are_padded_to_blocks(cpu32, capacity, padded):
    assert Columns(("id",), capacity).padded == padded


def test_columns_refuse_more_than_indices_reach(cpu32):
    with pytest.raises(InputError, match="at most 2147483584 fit one group"):
        Columns(("id",), 2**31)


def test_every_attribute_says_why():
    assert all(a.why and a.components in (1, 3) for a in ATTRIBUTES.values())
