"""The rule itself: numbers of two pictures, moments of two states, and the words made of them."""

import numpy as np
import pytest
from check_scenes import picture
from hypothesis import given, settings
from hypothesis import strategies as st

from tparticles.errors import InputError
from tparticles.regression.metrics import difference, measure
from tparticles.regression.moments import faults, moments
from tparticles.regression.tolerance import USUAL, Tolerance
from tparticles.regression.verdict import Word, judge

STATE = {
    "dots": {
        "id": np.arange(500),
        "x": np.random.default_rng(1).normal(size=(500, 3)).astype(np.float32),
        "v": np.random.default_rng(2).normal(size=(500, 3)).astype(np.float32),
        "T": np.linspace(900.0, 1500.0, 500, dtype=np.float32),
    }
}


def test_bytes_are_widened_before_they_are_subtracted():
    dark, light = np.full((8, 8, 3), 3, np.uint8), np.full((8, 8, 3), 250, np.uint8)
    assert difference(light, dark).min() == difference(light, dark).max() == -247
    found = measure(light, dark)
    assert (found.largest, found.mean, found.tile, found.changed, found.different) == (247, -247.0, 247.0, 1.0, 1.0)


@pytest.mark.parametrize(
    "other", [np.zeros((8, 9, 3), np.uint8), np.zeros((8, 8, 3), np.int16), np.zeros((8, 8), np.uint8)]
)
def test_what_cannot_be_subtracted_is_refused(other):
    with pytest.raises(ValueError, match="cannot be compared"):
        difference(np.zeros((8, 8, 3), np.uint8), other)


@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 2**31))
@settings(max_examples=40, deadline=None)
def test_numbers_of_any_size_of_picture(width, height, seed):
    a, b = picture(seed, (width, height)), picture(seed + 1, (width, height))
    there, back = measure(a, b), measure(b, a)
    assert measure(a, a).row() == dict.fromkeys(there.row(), 0)
    assert there.mean == -back.mean and there.tile == back.tile and there.largest == back.largest
    assert abs(there.mean) <= there.largest and there.tile <= there.largest
    assert there.changed <= there.different


def test_light_lost_from_one_place_is_told_from_noise():
    before = picture(size=(320, 184))
    rng = np.random.default_rng(3)
    noise = before.copy()
    some = rng.choice(before.size // 3, 150, replace=False)
    noise.reshape(-1, 3)[some, 0] += rng.choice([-1, 1], 150).astype(np.int8).view(np.uint8)
    assert measure(before, noise).largest == 1 and not measure(before, noise).faults(USUAL)
    lost = before.copy()
    lost[16:20, 24:28] -= 1  # sixteen pixels, all one level darker
    (fault,) = measure(before, lost).faults(USUAL)
    assert "tile" in fault


def test_other_limits_need_a_reason():
    with pytest.raises(InputError, match="another tile, count needs a written reason"):
        Tolerance(tile=1.0, count=2, reason=" ")
    assert Tolerance(tile=1.0, reason="soft smoke").tile == 1.0
    with pytest.raises(InputError, match="did you mean 'tile'"):
        Tolerance(tiles=1.0)  # type: ignore[call-arg]


def test_moments_of_a_state():
    found = moments(STATE)["dots"]
    x, v = STATE["dots"]["x"].astype(float), STATE["dots"]["v"].astype(float)
    assert found["count"] == 500
    np.testing.assert_allclose(found["position"], x.mean(axis=0))
    np.testing.assert_allclose(found["spread"], np.sqrt(x.var(axis=0).sum()))
    np.testing.assert_allclose(found["kinetic_energy"], (v**2).sum(axis=1).mean() / 2)
    np.testing.assert_allclose(found["temperature"], 1200.0, rtol=1e-6)
    assert moments({"none": {"id": np.arange(0), "x": np.zeros((0, 3))}}) == {"none": {"count": 0}}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"id": np.arange(499), "x": STATE["dots"]["x"][1:]}, "499 particles, not 500"),
        ({"x": STATE["dots"]["x"] + np.float32(1e-3)}, "mean position"),
        ({"x": STATE["dots"]["x"] * np.float32(1.001)}, "spread"),
        ({"T": STATE["dots"]["T"] + np.float32(0.2)}, "mean temperature 1200.2 K, not 1200"),
        ({"v": STATE["dots"]["v"] * np.float32(1.0001)}, "mean kinetic energy"),
        ({"T": None}, "mean temperature is gone"),
    ],
)
def test_what_moments_tell(change, words):
    other = {name: value for name, value in (STATE["dots"] | change).items() if value is not None}
    assert words in "; ".join(faults(moments(STATE), moments({"dots": other}), USUAL))


def test_groups_that_come_and_go_and_noise_in_the_last_bits():
    other = {"sparks": STATE["dots"]}
    assert faults(moments(STATE), moments(other), USUAL) == ["group 'dots' is gone", "group 'sparks' is new"]
    nearly = {"dots": STATE["dots"] | {"x": STATE["dots"]["x"] * np.float32(1 + 1e-6)}}
    assert faults(moments(STATE), moments(nearly), USUAL) == []


def test_physics_and_picture_read_differently():
    image, other = picture(), picture(1)
    before, after = moments(STATE), moments({"dots": STATE["dots"] | {"T": STATE["dots"]["T"] * 2}})

    def words(new, state, **options):
        return judge(image, new, USUAL, reference_moments=before, new_moments=state, **options)

    assert words(image, before).word == Word.SAME and not words(image, before).text
    assert words(other, before).text.startswith("the picture changed, the physics did not: ")
    assert words(image, after).text.startswith("the physics changed, the picture did not: dots: mean temperature")
    assert words(other, after).text.startswith("physics and picture changed: ")
    assert judge(image, other, USUAL).text.startswith("the picture changed: ")
    assert judge(image, picture(0, (32, 36)), USUAL).text == "the picture is 32x36, its reference 64x36"


def test_one_bit_counts_only_where_all_must_be_equal():
    image, other = picture(), picture()
    other[3, 3, 0] ^= 1
    assert judge(image, other, USUAL).word == Word.CLOSE
    exact = judge(image, other, USUAL, exact=True)
    assert exact.word == Word.DIFFERENT and "none may" in exact.text


def test_a_particle_alone_may_round_and_not_move():
    def alone(x):
        return moments({"dot": {"x": np.array([[x, 0.0, 3.0]], np.float32)}})

    assert faults(alone(2.0), alone(2.0 + 1e-6), USUAL) == []
    assert "mean position" in faults(alone(2.0), alone(2.0001), USUAL)[0]
