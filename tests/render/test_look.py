"""The look: exposure, tone curves, sRGB, dither, the display table, and what is too dim to show."""

from __future__ import annotations

import dataclasses
import math
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tparticles.errors import InputError
from tparticles.render.blackbody import BlackbodyTable, linear_srgb
from tparticles.render.look import Look, bayer, srgb_decode, srgb_encode

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it warns about optional packages that it does not find
    import colour

TONES = ("linear", "reinhard", "filmic")

looks = st.builds(
    Look,
    ev=st.floats(-4.0, 16.0),
    white_balance=st.floats(1000.0, 25000.0),
    tone=st.sampled_from(TONES),
    white=st.floats(0.01, 100.0),
)


def film_values(look, n=20_000):
    """Film values that fill the curve evenly on both scales, past the point where it clips."""
    return np.unique(np.concatenate([np.linspace(0.0, 1.2 * look.clip, n), np.geomspace(1e-9, 10.0 * look.clip, n)]))


def hable_as_printed(x):
    A, B, C, D, E, F = 0.15, 0.50, 0.10, 0.20, 0.02, 0.30
    return ((x * (A * x + C * B) + D * E) / (x * (A * x + B) + D * F)) - E / F


# sRGB ------------------------------------------------------------------------------------------------------------


def test_srgb_agrees_with_colour_science():
    x = np.linspace(0.0, 1.0, 4001)
    np.testing.assert_allclose(srgb_encode(x), colour.models.eotf_inverse_sRGB(x), atol=1e-15)
    np.testing.assert_allclose(srgb_decode(x), colour.models.eotf_sRGB(x), atol=1e-15)


def test_srgb_known_values():
    np.testing.assert_allclose(srgb_encode([0.0, 0.001, 0.18, 1.0]), [0.0, 0.01292, 0.4613561295, 1.0], atol=1e-10)
    np.testing.assert_allclose(srgb_decode([0.0, 0.02, 0.5, 1.0]), [0.0, 0.02 / 12.92, 0.2140411405, 1.0], atol=1e-10)


@settings(deadline=None)
@given(st.floats(0.0, 1.0))
def test_srgb_round_trip(x):
    assert srgb_decode(srgb_encode(x)) == pytest.approx(x, abs=1e-8)
    assert srgb_encode(srgb_decode(x)) == pytest.approx(x, abs=1e-7)  # the standard's two knees differ by 6e-8


def test_srgb_encode_is_monotonic_across_the_knee():
    x = 0.0031308 + np.linspace(-1e-8, 1e-8, 2001)
    assert np.all(np.diff(srgb_encode(x)) >= 0.0)


# Dither ----------------------------------------------------------------------------------------------------------


def test_bayer_is_the_published_matrix():
    np.testing.assert_array_equal((bayer(1) + 0.5) * 4 - 0.5, [[0, 2], [3, 1]])
    np.testing.assert_array_equal((bayer() + 0.5)[0] * 64 - 0.5, [0, 32, 8, 40, 2, 34, 10, 42])


def test_bayer_has_every_level_once_around_zero():
    matrix = bayer(3)
    np.testing.assert_array_equal(np.sort(matrix.ravel()), (np.arange(64) + 0.5) / 64 - 0.5)
    assert matrix.shape == (8, 8)
    assert matrix.sum() == 0.0


def test_bayer_keeps_the_mean_of_a_flat_area():
    for value in (10.25, 10.5, 10.796875):
        assert np.floor(value + bayer() + 0.5).mean() == pytest.approx(value, abs=1 / 64)


@pytest.mark.parametrize("order", [0, -1, 9])
def test_bayer_refuses_other_orders(order):
    with pytest.raises(InputError, match=f"order = {order} "):
        bayer(order)


# Tone ------------------------------------------------------------------------------------------------------------


def test_exposure_maps_the_saturation_luminance_to_one():
    assert Look(ev=0.0).exposure * 1.2 == pytest.approx(1.0, rel=1e-15)
    assert Look(ev=7.0).exposure * 153.6 == pytest.approx(1.0, rel=1e-15)
    assert Look(ev=3.5).exposure / Look(ev=4.5).exposure == pytest.approx(2.0, rel=1e-15)


@settings(deadline=None)
@given(looks)
def test_curves_are_monotonic_and_span_the_display(look):
    film = film_values(look, 500)
    for curve in (look.tone_curve, look.encode):
        display = curve(film)
        assert display[0] == 0.0
        assert display[-1] == pytest.approx(1.0, abs=1e-15)
        assert display.max() <= 1.0
        assert np.all(np.diff(display) >= -2e-16)  # the last bit of a power may go either way
    assert look.tone_curve(0.99 * look.clip) < 1.0


@pytest.mark.parametrize("tone", TONES)
def test_negative_film_is_black_and_infinite_film_is_white(tone):
    np.testing.assert_allclose(Look(tone=tone).encode([-np.inf, -1.0, -1e-9, np.inf]), [0, 0, 0, 1], atol=1e-15)


def test_linear_only_clips():
    np.testing.assert_array_equal(Look(tone="linear").tone_curve([[0.25, 0.5], [1.0, 3.0]]), [[0.25, 0.5], [1.0, 1.0]])


def test_reinhard_as_printed():
    x = np.array([1e-6, 0.1, 1.0, 3.0])
    np.testing.assert_allclose(Look(tone="reinhard", white=4.0).tone_curve(x), x * (1 + x / 16.0) / (1 + x), rtol=1e-14)


def test_filmic_as_printed():
    x = np.array([1e-3, 0.18, 1.0, 5.0])
    expected = hable_as_printed(2.0 * x) / hable_as_printed(11.2)
    np.testing.assert_allclose(Look(tone="filmic", white=5.6).tone_curve(x), expected, rtol=1e-12)


def test_the_default_toe_does_not_crush_embers():
    x = np.array([1e-6, 1e-4, 1e-2, 0.05])
    gain = Look().tone_curve(x) / x
    np.testing.assert_allclose(gain, gain[0], rtol=0.01)
    assert gain[0] == pytest.approx(0.766, abs=0.001)


# The display table -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("white", [0.01, 1.0, 5.6, 100.0])
@pytest.mark.parametrize("tone", TONES)
def test_display_table_is_accurate_as_a_kernel_reads_it(tone, white, dtype):
    look = Look(tone=tone, white=white)
    table, film_max = look.display_table()
    film = film_values(look)
    v = np.clip(film.astype(dtype), dtype(0), dtype(film_max))
    s = np.sqrt(v / dtype(film_max)) * dtype(len(table) - 1)
    i = np.minimum(s.astype(np.int64), len(table) - 2)
    entries = table.astype(dtype)
    got = entries[i] + (s - i.astype(dtype)) * (entries[i + 1] - entries[i])
    assert got.dtype == dtype
    assert np.abs(got - 255.0 * look.encode(film)).max() < 0.005


@settings(deadline=None)
@given(looks)
def test_display_table_ends_where_the_display_does(look):
    table, film_max = look.display_table(64)
    assert table.shape == (64,)
    assert table[0] == 0.0
    assert table[-1] == pytest.approx(254.999, abs=1e-9)
    assert 255.0 * look.encode(film_max * (1.0 - 1e-6)) < 254.999
    assert 0.99 * look.clip < film_max <= look.clip


def test_display_table_needs_two_entries():
    with pytest.raises(InputError, match="n = 1 "):
        Look().display_table(1)


# Too dim to show -------------------------------------------------------------------------------------------------


def test_threshold_of_the_linear_curve_in_closed_form():
    assert Look(tone="linear").threshold() == pytest.approx(0.5 / 255.0 / 12.92, rel=1e-14)


@settings(deadline=None)
@given(looks, st.sampled_from([1 / 128, 0.5, 1.0, 128.0]))
def test_threshold_is_the_smallest_film_value_that_gives_the_step(look, steps):
    threshold = look.threshold(steps=steps)
    assert 255.0 * look.encode(threshold) == pytest.approx(steps, rel=1e-12)
    assert 255.0 * look.encode(threshold * (1.0 - 1e-9)) < steps


def test_threshold_is_where_rounding_begins_to_show():
    look = Look()
    film = look.threshold() * np.array([0.999, 1.001])
    np.testing.assert_array_equal(np.rint(255.0 * look.encode(film)), [0.0, 1.0])


def test_dither_shows_from_a_128th_of_a_step():
    look = Look()
    film = look.threshold(steps=0.5 - bayer().max()) * np.array([0.999, 1.001])
    shown = [np.any(np.floor(255.0 * look.encode(v) + bayer() + 0.5) > 0.0) for v in film]
    assert shown == [False, True]


@pytest.mark.parametrize("steps", [0.0, -0.5, 255.0, math.nan])
def test_threshold_refuses_other_steps(steps):
    with pytest.raises(InputError, match=r"steps = .* is not allowed \(above 0 and below 255\)"):
        Look().threshold(steps=steps)
    with pytest.raises(InputError, match="steps = "):
        Look().coldest_visible(BlackbodyTable.build(n=2), steps=steps)


@settings(deadline=None)
@given(looks)
def test_coldest_visible_body_just_reaches_the_threshold(look):
    table = BlackbodyTable.build(adaptation=look.adaptation())
    T = look.coldest_visible(table)
    assert 500.0 < T < 12000.0
    film = linear_srgb(T, white=look.white_balance) * look.exposure
    assert film.max() == pytest.approx(look.threshold(), rel=5e-4)  # integrated, not read from the table
    colder = table.lookup(np.linspace(500.0, T - 1e-6, 200)) * look.exposure
    assert np.all(colder < look.threshold())


@settings(deadline=None)
@given(looks, st.floats(0.1, 4.0))
def test_coldest_visible_follows_the_exposure(look, stops):
    table = BlackbodyTable.build(adaptation=look.adaptation())
    brighter = dataclasses.replace(look, ev=look.ev - stops)
    T, T_brighter = look.coldest_visible(table), brighter.coldest_visible(table)
    assert T_brighter < T
    peak, peak_brighter = table.lookup([T, T_brighter]).max(axis=-1)
    assert peak / peak_brighter == pytest.approx(2.0**stops, rel=1e-9)


def test_coldest_visible_for_the_default_look():
    # Half a step of the default look is film 1.981e-4, or 0.0304 cd/m^2 of red: just below the Draper point, 798 K.
    assert Look().coldest_visible(BlackbodyTable.build(adaptation=Look().adaptation())) == pytest.approx(
        790.06, abs=0.1
    )


def test_coldest_visible_is_clamped_to_the_table():
    table = BlackbodyTable.build()
    assert Look(ev=-40.0).coldest_visible(table) == 500.0
    assert Look(ev=40.0).coldest_visible(table, steps=254.0) == 12000.0


# Validation ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ev", math.nan),
        ("ev", math.inf),
        ("ev", 41.0),
        ("white_balance", 999.0),
        ("white_balance", 25001.0),
        ("tone", "aces"),
        ("white", 0.0),
        ("white", 101.0),
        ("dither", "perhaps"),
        ("exposure_value", 1.0),
    ],
)
def test_bad_parameters_are_refused_by_name(name, value):
    with pytest.raises(InputError, match=name):
        Look(**{name: value})


def test_look_is_frozen_and_keyword_only():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Look().ev = 3.0  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(InputError):
        Look(7.0)  # pyright: ignore[reportCallIssue]
    assert Look(ev=3.0) == Look(ev=3.0) != Look(ev=4.0)
