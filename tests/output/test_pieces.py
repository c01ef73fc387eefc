"""Pieces of a film: what is summed is what was cut up, and what is damaged is refused by name."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tparticles.errors import InputError
from tparticles.output.pieces import _packed, add_piece, piece_path, write_piece

SAID = {"version": "1", "identity": "abc"}


def film(seed: int, shape: tuple[int, int, int] = (37, 53, 3)) -> np.ndarray:
    """Return sums of every size from none to nearly 2^63, in patches."""
    rng = np.random.default_rng(seed)
    sums = np.zeros(shape, np.int64)
    flat = sums.reshape(-1)
    for bits in (7, 15, 31, 62):
        where = rng.integers(0, flat.size - 300)
        flat[where : where + 200] = rng.integers(-(2**bits), 2**bits, 200)
    return sums


@given(st.integers(1, 9), st.integers(1, 150), st.integers(0, 2**32 - 1))
def test_a_sum_of_pieces_is_the_sum(
    tmp_path_factory: pytest.TempPathFactory, height: int, width: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    folder = tmp_path_factory.mktemp("pieces")
    total = np.zeros((height, width, 3), np.int64)
    wanted = total.copy()
    for bits in rng.integers(1, 62, 3):
        sums = rng.integers(-(2**bits), 2**bits, total.shape) * (rng.random(total.shape) < 0.01)
        wanted += sums
        write_piece(folder, sums, {"frame": 3, "born": int(bits)}, **SAID)
        assert add_piece(folder, 3, total, **SAID)["row"] == {"frame": 3, "born": bits}
    assert np.array_equal(total, wanted)


def test_what_is_dark_takes_no_room_and_what_is_small_little() -> None:
    packed = _packed(film(1))
    assert sum(array.nbytes for array in packed.values()) < 0.5 * film(1).nbytes
    assert {kind for kind in ("i2", "i4", "i8") if packed[kind].size} == {"i2", "i4", "i8"}
    assert not any(array.size for array in _packed(np.zeros((40, 40, 3), np.int64)).values())
    dense = np.full((64, 64, 3), 2**25)
    assert sum(array.nbytes for array in _packed(dense).values()) < 0.51 * dense.nbytes


def test_what_is_damaged_or_of_another_film_is_refused(tmp_path: Path) -> None:
    write_piece(tmp_path, film(2), {"frame": 1}, **SAID)
    path, total = piece_path(tmp_path, 1), np.zeros((37, 53, 3), np.int64)
    with pytest.raises(InputError, match=r"000001\.film is refused: it is of another size or frame"):
        add_piece(tmp_path, 1, np.zeros((37, 54, 3), np.int64), **SAID)
    with pytest.raises(InputError, match=r"000001\.film is refused: it is of another scene or other settings"):
        add_piece(tmp_path, 1, total, version="1", identity="abd")
    with pytest.raises(InputError, match=r"000002\.film cannot be read: No such file"):
        add_piece(tmp_path, 2, total, **SAID)
    path.rename(piece_path(tmp_path, 2))
    with pytest.raises(InputError, match=r"000002\.film is refused: it is of another size or frame"):
        add_piece(tmp_path, 2, total, **SAID)
    path = piece_path(tmp_path, 2)
    os.truncate(path, path.stat().st_size - 100)
    with pytest.raises(InputError, match=r"000002\.film is refused: it is cut or damaged"):
        add_piece(tmp_path, 2, total, **SAID)
    assert not total.any()
