"""Programs as formulas, for people."""

from __future__ import annotations

import pytest
from scheme_samples import SCHEMES

from tparticles.schemes import CATALOGUE, Op, OpKind
from tparticles.schemes.listing import FAMILIES, WIDTH, family, formula, sheet, table

K = OpKind


@pytest.mark.parametrize(
    ("op", "text"),
    [
        (Op(K.EVALUATE, slope=2, time=0.5), "k2 = f(t + 1/2 dt, z)"),
        (Op(K.EVALUATE, time=-1.0), "k0 = f(t - dt, z)"),
        (Op(K.COMBINE), "z = z0"),
        (Op(K.COMBINE, weights=(-1.0, 0.0, 1 / 6, 0.1 * 2**0.5)), "z = z0 + dt (-k0 + 1/6 k2 + 0.1414213562 k3)"),
        (Op(K.COMBINE, weights=(1.5, -0.5), variable=((1, 0.5, 0), (0, -0.5, 0))), "z = z0 + dt ((1 + 1/2 r) k0 + (-1/2 r) k1)"),
        (Op(K.COMBINE, weights=(1 / 3,), variable=((0.0, 1.0, 2.0),)), "z = z0 + dt (r / (1 + 2 r) k0)"),
        (Op(K.KICK, weights=(-0.5, 0.5)), "v = v + dt (-1/2 a0 + 1/2 a1)"),
        (Op(K.DRIFT, weights=(1.0,)), "x = x + dt v"),
        (Op(K.DRIFT, weights=(-0.25,)), "x = x - 1/4 dt v"),
        (Op(K.SOLVE, weights=(0.5,), time=1.0), "solve z = zbar + 1/2 dt k0 with k0 = f(t + dt, z), where zbar is z so far"),
        (Op(K.SOLVE, weights=(1.0,), linear=True), "k0 = (I - dt df/dz)^-1 f(t, z); z = z + dt k0"),
        (Op(K.ROTATE, slope=1, source=0), "k1 = k0"),
        (Op(K.DIFFERENCE, slope=1), "k1 = (z - z0) / dt"),
    ],
)  # fmt: skip
def test_ops_read_as_formulas(op, text):
    assert formula(op) == text


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_every_scheme_fits_a_terminal(scheme):
    lines = sheet(scheme).splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert all(any(f"    {formula(op)[:40]}" in line for line in lines) for op in (*scheme.ops, *scheme.history))
    assert scheme.starter is None or any(line.endswith(f": {scheme.starter.name}") for line in lines)
    assert lines[0] == f"{scheme.name}: {family(scheme)}"
    # The program is given once in full.
    assert sum(line.startswith("  program") for line in lines) == 1


def test_the_table_has_a_line_for_each():
    text = table(SCHEMES)
    rows = text[: text.index("\nsources")].splitlines()
    assert len(rows) == 1 + len(SCHEMES) + len(FAMILIES)
    assert max(map(len, text.splitlines())) <= WIDTH
    assert {family(scheme) for scheme in CATALOGUE.values()} == set(FAMILIES)
    assert table([]).splitlines()[1:] == []
