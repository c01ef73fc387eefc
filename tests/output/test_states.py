from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from tparticles.errors import RunError
from tparticles.output import OutputFrame, States

_STATES = {
    "id": np.arange(5, dtype=np.int32),
    "x": np.linspace(0, 1, 15, dtype=np.float32).reshape(5, 3),
    "T": np.array([np.nan, np.inf, 0, 1, 2], dtype=np.float64),
    "file": np.zeros((0, 3)),
}


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32, np.uint32, np.int64, np.bool_])
def test_arrays_come_back_with_dtype_and_shape(tmp_path: Path, make_frame, dtype: type) -> None:
    x = (np.arange(12).reshape(4, 3) % 2).astype(dtype)
    States(tmp_path).write(make_frame(7, x=x, y=x.T))
    with np.load(tmp_path / "000007.npz") as read:
        assert sorted(read) == ["x", "y"]
        assert np.array_equal(read["x"], x) and read["x"].dtype == dtype
        assert np.array_equal(read["y"], x.T)


def test_values_that_are_no_numbers_and_odd_names_come_back(tmp_path: Path, make_frame) -> None:
    writer = States(tmp_path)
    writer.write(make_frame(1, **_STATES))
    writer.close()
    assert writer.finished == 1
    with np.load(tmp_path / "000001.npz") as read:
        assert sorted(read) == sorted(_STATES)
        for name, array in _STATES.items():
            assert np.array_equal(read[name], array, equal_nan=True)


def test_bytes_depend_on_the_arrays_alone(tmp_path: Path, make_frame) -> None:
    image = make_frame(1).image
    States(tmp_path / "a").write(OutputFrame(1, image, {}, _STATES))
    States(tmp_path / "b").write(OutputFrame(1, image, {}, dict(reversed(_STATES.items()))))
    assert (tmp_path / "a/000001.npz").read_bytes() == (tmp_path / "b/000001.npz").read_bytes()


def test_a_frame_without_states_is_refused(tmp_path: Path, make_frame) -> None:
    with pytest.raises(ValueError, match="frame 1 has no states"):
        States(tmp_path).write(make_frame(1))


def test_objects_are_refused(tmp_path: Path, make_frame) -> None:
    with pytest.raises(ValueError, match=r"[Oo]bject"):
        States(tmp_path).write(make_frame(1, x=np.array([{}], dtype=object)))
    assert not list(tmp_path.iterdir())


def test_a_failed_write_says_what_is_safe_and_leaves_nothing(tmp_path: Path, make_frame, monkeypatch) -> None:
    writer = States(tmp_path)
    for number in (1, 2):
        writer.write(make_frame(number, **_STATES))

    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(RunError, match=r"000003\.npz: No space left on device; 2 frames are finished and safe"):
        writer.write(make_frame(3, **_STATES))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["000001.npz", "000002.npz"]


_LIMITED = """
import resource, sys
import numpy as np
from tparticles.errors import RunError
from tparticles.output import OutputFrame, States
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000,) * 2)
writer = States(sys.argv[1])
for number, count in enumerate((10, 100, 5000), start=1):
    try:
        writer.write(OutputFrame(number, np.zeros((1, 1, 3), np.uint8), {}, {"x": np.zeros(count)}))
    except RunError as error:
        print(error)
"""


def test_a_file_that_cannot_grow_is_an_error(tmp_path: Path, run_python) -> None:
    done = run_python(_LIMITED, tmp_path)
    assert "000003.npz: File too large; 2 frames are finished" in done.stdout
    assert done.stderr == "", "zipfile must not complain when it is thrown away"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["000001.npz", "000002.npz"]
