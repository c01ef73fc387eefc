"""Black bodies against colour-science, a float64 oracle and their own table."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tparticles.errors import InputError
from tparticles.render import blackbody
from tparticles.render.blackbody import (
    LUMINANCE,
    XYZ_FROM_SRGB,
    BlackbodyTable,
    chromatic_adaptation,
    linear_srgb,
    radiance_to_xyz,
)

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it warns about optional packages that it does not find
    import colour

OBSERVER = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]

# An independent float64 integration at 1 nm: T [K], luminance [cd/m^2], x, y, linear sRGB / Y.
ORACLE = [
    (1000.0, 2.686962312224918, 0.6527506433045079, 0.3444617081067539,
     (4.599701628972517, 0.039980425428149884, -0.08989704412423759)),
    (1500.0, 7740.290513295265, 0.5857179311873112, 0.3931213204713408,
     (3.2642133645231777, 0.43436501360773216, -0.0641221472282206)),
    (2000.0, 463763.1643463059, 0.5266774842967266, 0.41329700810947256,
     (2.5200051367725638, 0.6470467528462966, 0.020485738039913166)),
    (3000.0, 30218152.691665422, 0.43693107181212987, 0.4040740130673315,
     (1.7707269807798816, 0.8443735739112408, 0.27212553774069076)),
    (6500.0, 3072518978.886997, 0.3135260346763706, 0.32362866205983215,
     (1.0432044218881908, 0.9836207212709517, 1.0350304716563175)),
]  # fmt: skip
RATIOS = [(1000.0, 798.0, 356.9193257134262), (1000.0, 900.0, 13.422185738323718), (1200.0, 1000.0, 51.85651765441045),
          (1500.0, 1000.0, 2880.6844361303965)]  # fmt: skip


def chromaticity(xyz):
    return (xyz / xyz.sum(axis=-1, keepdims=True))[..., :2]


def reference_xyz(T):
    """Absolute XYZ by colour-science, summed at 1 nm."""
    c1 = np.pi * blackbody.C1L
    sd = colour.sd_blackbody(
        T, colour.SpectralShape(360, 830, 1), c1=c1, c2=blackbody.C2
    )  # [W / (sr m^2 nm)] over [nm]
    return colour.sd_to_XYZ(sd, OBSERVER, k=683.0, method="Integration")


def test_the_shipped_observer_is_the_standard_one():
    rows = np.loadtxt(blackbody.Path(blackbody.__file__).with_name("cie1931.csv"), delimiter=",")
    assert np.array_equal(rows[:, 0], OBSERVER.wavelengths[::5])
    np.testing.assert_allclose(rows[:, 1:], OBSERVER.values[::5], rtol=1e-9)


def test_second_radiation_constant_is_codata():
    assert pytest.approx(0.01438776877503933, rel=1e-15) == blackbody.C2


def test_agrees_with_colour_science():
    T = np.geomspace(500.0, 12000.0, 30)
    expected = np.array([reference_xyz(t) for t in T])
    xyz = radiance_to_xyz(T)
    np.testing.assert_allclose(chromaticity(xyz), chromaticity(expected), rtol=2e-5)
    np.testing.assert_allclose(xyz[:, 1], expected[:, 1], rtol=2e-4)
    np.testing.assert_allclose(xyz[1:, 1] / xyz[:-1, 1], expected[1:, 1] / expected[:-1, 1], rtol=2e-4)


@pytest.mark.parametrize(("T", "luminance", "x", "y", "rgb"), ORACLE)
def test_agrees_with_the_oracle(T, luminance, x, y, rgb):
    xyz = radiance_to_xyz(T)
    assert xyz[1] == pytest.approx(luminance, rel=3e-6)
    np.testing.assert_allclose(chromaticity(xyz), [x, y], rtol=5e-6)
    np.testing.assert_allclose(linear_srgb(T) / xyz[1], rgb, atol=1e-5)


@pytest.mark.parametrize(("T", "T_reference", "ratio"), RATIOS)
def test_luminance_ratios_agree_with_the_oracle(T, T_reference, ratio):
    xyz = radiance_to_xyz([T, T_reference])
    assert xyz[0, 1] / xyz[1, 1] == pytest.approx(ratio, rel=5e-6)


def test_luminance_of_linear_srgb_is_Y():
    T = np.geomspace(500.0, 12000.0, 9)
    np.testing.assert_allclose(linear_srgb(T) @ LUMINANCE, radiance_to_xyz(T)[:, 1], rtol=1e-13)


def test_blue_is_negative_below_1900_K_and_is_kept():
    assert linear_srgb(1850.0)[2] < 0.0 < linear_srgb(1950.0)[2]


def test_extremes_are_quiet_and_have_the_right_limits():
    with np.errstate(all="raise"):
        xyz = radiance_to_xyz([1e-320, 1e-3, 5.0, 1e199, 1e200, 1.7e308])
    assert not xyz[:3].any()
    np.testing.assert_allclose(xyz[4] / xyz[3], 10.0, rtol=1e-12)  # Rayleigh-Jeans: proportional to T
    assert np.all(xyz[5] == np.inf)


@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 3)])
def test_shapes_follow_T(shape):
    T = np.full(shape, 1500.0)
    for got in (radiance_to_xyz(T), linear_srgb(T), linear_srgb(T, white=3000.0), BlackbodyTable.build().lookup(T)):
        assert got.shape == (*shape, 3)
        assert got.dtype == np.float64


@pytest.mark.parametrize("T", [0.0, -1.0, np.nan, np.inf])
def test_bad_temperatures_are_refused(T):
    for call in (radiance_to_xyz, linear_srgb):
        with pytest.raises(InputError, match=f"T = {T:g} K is not allowed .*above 0 K"):
            call([1000.0, T])


@pytest.mark.parametrize("T", [-1.0, np.nan, np.inf])
def test_bad_temperatures_are_refused_by_the_table(T):
    with pytest.raises(InputError, match=f"T = {T:g} K is not allowed .*at least 0 K"):
        BlackbodyTable.build(n=2).lookup(T)


@pytest.mark.parametrize("T", [999.9, 25000.1, np.nan])
def test_bad_whites_are_refused(T):
    for call in (chromatic_adaptation, lambda white: linear_srgb(1000.0, white=white)):
        with pytest.raises(InputError, match=r"at least 1000 K and at most 25000 K"):
            call(T)
    with pytest.raises(InputError, match=r"shape \(2,\)"):
        chromatic_adaptation(np.array([2000.0, 3000.0]))  # pyright: ignore[reportArgumentType]


@settings(deadline=None)
@given(st.floats(1000.0, 25000.0))
def test_adaptation_makes_its_white_neutral_and_keeps_its_luminance(T):
    Y = radiance_to_xyz(T)[1]
    np.testing.assert_allclose(linear_srgb(T, white=T), [Y, Y, Y], rtol=1e-12)


@pytest.mark.parametrize("T", [1000.0, 2700.0, 6504.0, 25000.0])
def test_adaptation_agrees_with_colour_science(T):
    xyz = radiance_to_xyz(T)
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(xyz / xyz[1], XYZ_FROM_SRGB.sum(axis=1), "CAT16")
    expected = np.linalg.inv(XYZ_FROM_SRGB) @ adapt @ XYZ_FROM_SRGB
    np.testing.assert_allclose(chromatic_adaptation(T), expected, rtol=1e-9, atol=1e-9)


def test_adaptation_at_6504_K_is_as_near_the_identity_as_documented():
    matrix = chromatic_adaptation(6504.0)
    assert 0.028 < np.abs(matrix - np.eye(3)).max() < 0.029
    assert 0.042 < np.abs(matrix @ np.ones(3) - 1.0).max() < 0.043


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("white", [None, 1000.0, 6504.0, 25000.0])
def test_table_agrees_with_direct_integration(dtype, white):
    T = np.geomspace(500.0, 12000.0, 9973)
    expected = linear_srgb(T, white=white)
    table = BlackbodyTable.build(adaptation=None if white is None else chromatic_adaptation(white))
    got = table.lookup(T, dtype=dtype)
    assert got.dtype == dtype
    np.testing.assert_allclose(got @ LUMINANCE, expected @ LUMINANCE, rtol=2e-4)
    got_xyz, expected_xyz = got.astype(float) @ XYZ_FROM_SRGB.T, expected @ XYZ_FROM_SRGB.T
    np.testing.assert_allclose(chromaticity(got_xyz), chromaticity(expected_xyz), rtol=6e-5)


def test_table_error_falls_with_the_square_of_n():
    T = np.geomspace(500.0, 12000.0, 9973)
    Y = radiance_to_xyz(T)[:, 1]
    coarse, fine = (np.abs(BlackbodyTable.build(n=n).lookup(T) @ LUMINANCE / Y - 1.0).max() for n in (512, 1024))
    assert fine < 5e-5
    assert 3.5 < coarse / fine < 4.5


def test_table_is_uniform_in_reciprocal_temperature_from_hot_to_cold():
    table = BlackbodyTable.build(n=24)
    T = 1.0 / (table.u_min + np.arange(24) / table.steps_per_u)
    np.testing.assert_allclose(T[[0, -1]], [12000.0, 500.0], rtol=1e-12)
    np.testing.assert_allclose(table.values[:, 0], np.log(radiance_to_xyz(T)[:, 1]), rtol=1e-10)
    np.testing.assert_allclose(table.lookup(T[1:-1]), linear_srgb(T[1:-1]), rtol=1e-9)


def test_table_is_black_below_and_constant_above():
    table = BlackbodyTable.build()
    assert not table.lookup([0.0, 300.0, 499.999]).any()
    assert table.lookup(500.0)[0] > 0.0
    np.testing.assert_array_equal(table.lookup([12000.5, 1e300]), table.lookup([12000.0, 12000.0]))


def test_table_lookup_is_the_documented_recipe():
    table = BlackbodyTable.build(n=40, adaptation=chromatic_adaptation(3000.0))
    for T in (500.0, 777.7, 1223.0, 11999.0, 12000.0):
        s = max((1.0 / T - table.u_min) * table.steps_per_u, 0.0)
        i = min(int(s), table.n - 2)
        row = table.values[i] + (s - i) * (table.values[i + 1] - table.values[i])
        np.testing.assert_allclose(table.lookup(T), np.exp(row[0]) * row[1:], rtol=1e-12)


def test_table_is_frozen():
    table = BlackbodyTable.build(n=2)
    with pytest.raises(dataclasses.FrozenInstanceError):
        table.values = np.zeros((2, 4))  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(ValueError, match="read-only"):
        table.values[0, 0] = 1.0


@pytest.mark.parametrize("adaptation", [np.eye(2), np.full((3, 3), np.nan)])
def test_bad_adaptations_are_refused(adaptation):
    with pytest.raises(InputError, match="adaptation"):
        BlackbodyTable.build(adaptation=adaptation)


def test_bad_table_sizes_are_refused():
    with pytest.raises(InputError, match="n = 1 "):
        BlackbodyTable.build(n=1)
    for values in (np.zeros((1, 4)), np.zeros((5, 3)), np.zeros(4), np.full((2, 4), np.inf)):
        with pytest.raises(InputError, match="values"):
            BlackbodyTable(values)
