"""The file: what is read is what was written, or it is refused by name; and when a checkpoint is made."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tparticles import checkpoint
from tparticles.checkpoint import Checkpoints, Interval, newest, read_checkpoint, write_checkpoint
from tparticles.errors import InputError

STATE: dict[str, dict[str, Any]] = {
    "film": {"frame": 7, "dt_min": 0.1 + 0.2, "steps": 2**40, "least": np.float32(0.5), "torn": np.bool_(True)},
    "group dots": {"x": np.arange(12, dtype=np.float32).reshape(3, 4), "id": np.arange(4, dtype=np.int32), "born": 9},
    "group none": {"x": np.empty((3, 0), np.float32)},
}


def write(path: Path, frame: int = 7, identity: str = "abc") -> Path:
    write_checkpoint(path, STATE, identity=identity, frame=frame)
    return path


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    found = read_checkpoint(write(tmp_path / "0.checkpoint"), identity="abc")
    assert (found.frame, list(found.sections)) == (7, list(STATE))
    assert found.sections["film"] == STATE["film"]
    for section, values in STATE.items():
        for name, value in values.items():
            assert np.array_equal(found.sections[section][name], value)
            if isinstance(value, np.ndarray):
                assert found.sections[section][name].dtype == value.dtype
    assert [path.name for path in tmp_path.iterdir()] == ["0.checkpoint"]


def test_a_cut_file_is_refused_wherever_it_is_cut(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole").read_bytes()
    path = tmp_path / "0.checkpoint"
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"0\.checkpoint is refused: it is (no checkpoint|cut or damaged)"):
            read_checkpoint(path, identity="abc")


def test_a_flipped_bit_is_refused_wherever_it_is(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole").read_bytes()
    path = tmp_path / "0.checkpoint"
    for k in range(len(whole)):
        path.write_bytes(whole[:k] + bytes([whole[k] ^ (1 << k % 8)]) + whole[k + 1 :])
        with pytest.raises(InputError, match=r"0\.checkpoint is refused"):
            read_checkpoint(path, identity="abc")


def test_what_is_of_something_else_is_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "0.checkpoint")
    with pytest.raises(InputError, match=r"0\.checkpoint is refused: it is of another scene or other settings"):
        read_checkpoint(path, identity="abd")
    path.write_bytes(path.read_bytes().replace(b"checkpoint 1", b"checkpoint 2", 1))
    with pytest.raises(InputError, match="it has format 2, this program reads 1"):
        read_checkpoint(path, identity="abc")
    with pytest.raises(InputError, match=r"absent cannot be read: No such file"):
        read_checkpoint(tmp_path / "absent", identity="abc")
    monkeypatch.setattr(checkpoint, "__version__", "0.0.9")
    write(path)
    monkeypatch.undo()
    with pytest.raises(InputError, match=r"it is of tparticles 0\.0\.9, this is"):
        read_checkpoint(path, identity="abc")


def test_the_newest_is_told_by_its_frame_whatever_the_clock_says(tmp_path: Path) -> None:
    write(tmp_path / "0.checkpoint", frame=20)
    write(tmp_path / "1.checkpoint", frame=10)
    os.utime(tmp_path / "0.checkpoint", (0, 0))
    found = newest(tmp_path, identity="abc", usable=lambda frame: True, tell=pytest.fail)
    assert found is not None and found.frame == 20


def test_the_older_one_takes_the_place_of_one_that_is_refused(tmp_path: Path) -> None:
    new, said = write(tmp_path / "0.checkpoint", frame=20), []
    write(tmp_path / "1.checkpoint", frame=10)
    os.truncate(new, new.stat().st_size - 1)
    found = newest(tmp_path, identity="abc", usable=lambda frame: True, tell=said.append)
    assert found is not None and found.frame == 10
    assert len(said) == 1 and f"{new} is refused: it is cut or damaged" in said[0]
    assert newest(tmp_path, identity="abc", usable=lambda frame: frame < 5, tell=said.append) is None
    assert "pictures before its frame 10 are missing or damaged" in said[-1]
    assert newest(tmp_path / "absent", identity="abc", usable=lambda frame: True, tell=pytest.fail) is None


@pytest.mark.parametrize(
    ("text", "value"), [("10s", Interval(10.0)), ("0.5s", Interval(0.5)), ("24f", Interval(frames=24))]
)
def test_intervals(text: str, value: Interval) -> None:
    assert Interval.read(text) == value
    assert not value.never and Interval.read("off").never


@pytest.mark.parametrize(
    "text", ["", "10", "0s", "0.0s", "0f", "-1s", "1.5f", "nan s", "infs", "1e3s", "1sf", "never", "9" * 400 + "s"]
)
def test_intervals_that_are_none(text: str) -> None:
    with pytest.raises(
        InputError, match=r"--checkpoint-every .*: seconds of work such as 10s, frames such as 24f, or off"
    ):
        Interval.read(text)


class Clock:
    """A render of which only the time passes."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, interval: str, **options: Any):
        self.now, self.said, self.folder = 0.0, [], folder
        monkeypatch.setattr(checkpoint.time, "monotonic", lambda: self.now)
        options = {"before": lambda: None, "tell": self.said.append, **options}
        self.checkpoints = Checkpoints(folder, identity="abc", interval=Interval.read(interval), **options)

    def frame(self, number: int, *, finish: bool = True, cost: float = 0.0) -> None:
        def snapshot() -> dict[str, dict[str, Any]]:
            self.now += cost
            return STATE

        self.checkpoints.begun(number)
        if finish:
            self.checkpoints.finished(number)
        self.checkpoints.after(number, snapshot)
        self.wait()

    def wait(self) -> None:
        self.checkpoints._writer.submit(lambda: None).result()

    def frames(self) -> set[int]:
        return {read_checkpoint(path, identity="abc").frame for path in self.folder.glob("*.checkpoint")}


def test_every_so_many_frames_and_two_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, seen = Clock(tmp_path / "c", monkeypatch, "4f"), []
    for number in range(1, 14):
        clock.frame(number)
        seen.append(clock.frames())
    assert seen == [set()] * 3 + [{4}] * 4 + [{4, 8}] * 4 + [{8, 12}] * 2


def test_by_the_clock_it_takes_a_fiftieth_of_the_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(tmp_path / "c", monkeypatch, "1s")
    made, spent = [], 0.0
    for number in range(1, 600):
        clock.now += 0.5
        before = clock.frames()
        clock.frame(number, cost=0.2)
        if clock.frames() != before:
            made.append(number)
            spent += 0.2
    assert made[0] == 3  # a second after the first frame
    assert spent / clock.now < 1.1 / 50
    assert len(made) > 20


def test_none_is_written_before_its_frames_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order = []
    clock = Clock(tmp_path / "c", monkeypatch, "2f", before=lambda: order.append(clock.frames()))
    clock.frame(1, finish=False)
    clock.frame(2, finish=False)
    clock.frame(3)
    clock.frame(4)  # none while that of frame 2 waits
    clock.checkpoints.finished(2)
    assert clock.frames() == set()
    clock.checkpoints.finished(1)
    clock.wait()
    assert clock.frames() == {2} and order == [set()]
    clock.frame(5)
    assert clock.frames() == {2, 5}
    clock.checkpoints.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("checkpoint")]


def test_the_one_that_was_resumed_from_is_overwritten_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "c"
    folder.mkdir()
    write(folder / "0.checkpoint", frame=20)
    write(folder / "1.checkpoint", frame=10)
    keep = newest(folder, identity="abc", usable=lambda frame: True, tell=pytest.fail)
    clock = Clock(folder, monkeypatch, "1f", keep=keep)
    clock.frame(21)
    assert clock.frames() == {20, 21}


def test_a_full_disk_costs_the_checkpoint_and_not_the_film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(tmp_path / "c", monkeypatch, "1f")
    clock.frame(1)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    clock.frame(2)
    clock.frame(3)
    assert clock.frames() == {1}
    (said,) = clock.said
    assert "no checkpoint of frame 2: " in said and "No space left on device" in said
    monkeypatch.undo()
    assert not list(tmp_path.rglob(".*.tmp"))
