from __future__ import annotations

import hashlib

import numpy as np
import pytest

from tparticles.output import Null, OutputFrame, Tee, pixel_hash


@pytest.mark.parametrize(
    ("number", "image"),
    [
        (0, np.zeros((4, 4, 3), np.uint8)),
        (-1, np.zeros((4, 4, 3), np.uint8)),
        (1, np.zeros((4, 4, 3), np.float32)),
        (1, np.zeros((4, 4, 4), np.uint8)),
        (1, np.zeros((4, 4), np.uint8)),
        (1, np.zeros((0, 4, 3), np.uint8)),
    ],
)
def test_a_frame_refuses_what_is_no_picture(number: int, image: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"number is|image is"):
        OutputFrame(number, image)


def test_pixel_hash_is_sha256_of_shape_and_bytes() -> None:
    image = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    assert pixel_hash(image) == hashlib.sha256(b"uint8 2x4x3\n" + bytes(range(24))).hexdigest()


def test_pixel_hash_sees_shape_and_pixels_but_not_memory_layout() -> None:
    image = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    assert pixel_hash(image) != pixel_hash(image.reshape(4, 2, 3))
    assert pixel_hash(image[::-1]) == pixel_hash(image[::-1].copy()) != pixel_hash(image)


class _Spy:
    def __init__(self, *, ordered: bool = False, fails: bool = False) -> None:
        self.ordered = ordered
        self.fails = fails
        self.calls: list[str] = []

    def write(self, frame: OutputFrame) -> None:
        self.calls.append(f"write {frame.number}")

    def close(self) -> None:
        self.calls.append("close")
        if self.fails:
            raise OSError("lost")

    def abort(self) -> None:
        self.calls.append("abort")


def test_tee_calls_each_writer_and_closes_all_when_one_fails(make_frame) -> None:
    first, second = _Spy(fails=True), _Spy()
    tee = Tee(first, second, Null())
    tee.write(make_frame(1))
    with pytest.raises(OSError, match="lost"):
        tee.close()
    assert first.calls == ["write 1", "close", "abort"]
    assert second.calls == ["write 1", "close"]


def test_tee_aborts_all() -> None:
    spies = [_Spy(), _Spy()]
    Tee(*spies).abort()
    assert [spy.calls for spy in spies] == [["abort"], ["abort"]]


@pytest.mark.parametrize("ordered", [False, True])
def test_tee_needs_order_if_one_of_its_writers_does(ordered: bool) -> None:
    assert Tee(_Spy(), _Spy(ordered=ordered)).ordered is ordered
