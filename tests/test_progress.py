"""What the progress of a render says of the time that is left."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from tparticles import progress
from tparticles.progress import Progress


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Return a function that shows frames that took so long [s], from `done` on, and returns the lines said, one a frame."""
    clock = SimpleNamespace(now=1000.0)
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock.now)
    monkeypatch.setattr(progress, "_FIRST", 0.0)

    def lines(*seconds: float, total: int, done: int = 0) -> list[str]:
        with Progress("film", total) as shown:
            for n, pause in enumerate(seconds, done + 1):
                clock.now += pause
                shown.step(SimpleNamespace(number=n, report=SimpleNamespace(alive=9)), n)
        return capsys.readouterr().err.splitlines()

    return lines


def test_the_first_frame_and_its_compilation_are_not_counted(lines) -> None:
    said = lines(60.0, 1.0, 1.0, 1.0, 1.0, total=10)
    assert said == [
        "film: frame 1 (1/10), 9 alive",
        "film: frame 2 (2/10), 9 alive",
        "film: frame 3 (3/10), 9 alive",
        "film: frame 4 (4/10), 9 alive, 6 s left",
        "film: frame 5 (5/10), 9 alive, 5 s left",
    ]


def test_frames_of_an_earlier_run_are_not_counted(lines) -> None:
    assert lines(60.0, 2.0, 2.0, 2.0, total=100, done=90)[-1] == "film: frame 94 (94/100), 9 alive, 12 s left"


def test_only_the_last_frames_tell(lines) -> None:
    assert lines(1.0, *[1.0] * 40, *[10.0] * 4, total=55)[-1].endswith(", 2 min left")


def test_the_last_frame_leaves_nothing(lines) -> None:
    assert lines(1.0, 1.0, 1.0, 1.0, total=4)[-1] == "film: frame 4 (4/4), 9 alive"
