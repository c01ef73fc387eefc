"""What can go wrong with a film: no ffmpeg, a dead, hanging or lying one, a full disk, an early end."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path

import imageio_ffmpeg
import pytest

from tparticles.errors import BackendError, RunError
from tparticles.output import Mp4, Pipeline, PngSequence, is_whole_png, mp4, pipeline
from tparticles.output.ffmpeg import count_frames

FFMPEG = imageio_ffmpeg.get_ffmpeg_exe()


def program(path: Path, text: str) -> str:
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


@pytest.mark.parametrize("kind", ["absent", "not a program", "no permission"])
def test_a_missing_ffmpeg_says_how_to_get_one(tmp_path: Path, monkeypatch, kind: str, film_at) -> None:
    exe = tmp_path / "ffmpeg"
    if kind != "absent":
        exe.write_bytes(b"\0\1\2")
        exe.chmod(0o755 if kind == "not a program" else 0o644)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(exe))
    with pytest.raises(BackendError, match=r"imageio\[ffmpeg\].*IMAGEIO_FFMPEG_EXE.*--no-mp4") as caught:
        film_at(tmp_path / "out/film.mp4")
    assert str(exe) in str(caught.value)
    assert caught.value.exit_code == 3
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("error", [RuntimeError("No ffmpeg exe could be found"), ImportError("no imageio_ffmpeg")])
def test_no_ffmpeg_anywhere_says_how_to_get_one(tmp_path: Path, monkeypatch, error: Exception, film_at) -> None:
    def fail() -> str:
        raise error

    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", fail)
    with pytest.raises(BackendError, match=r"ffmpeg was not found.*imageio\[ffmpeg\].*--no-mp4"):
        film_at(tmp_path / "film.mp4")


def new_child(child_ids: Callable[[], set[int]], make: Callable[[], Mp4]) -> tuple[Mp4, int]:
    before = child_ids()
    film = make()
    (pid,) = child_ids() - before
    return film, pid


def test_a_killed_ffmpeg_is_an_error_at_the_next_frames(tmp_path: Path, make_frame, child_ids, film_at) -> None:
    film, pid = new_child(child_ids, lambda: film_at(tmp_path / "film.mp4"))
    film.write(make_frame(1))
    os.kill(pid, signal.SIGKILL)
    with pytest.raises(RunError, match=r"film\.mp4: ffmpeg was killed by SIGKILL \(after \d+ frames?\)"):
        for number in range(2, 100):
            film.write(make_frame(number))
    film.abort()
    assert not list(tmp_path.iterdir())


def test_a_killed_ffmpeg_is_an_error_at_the_end(tmp_path: Path, make_frame, child_ids, film_at) -> None:
    film, pid = new_child(child_ids, lambda: film_at(tmp_path / "film.mp4"))
    film.write(make_frame(1))
    os.kill(pid, signal.SIGKILL)
    with pytest.raises(RunError, match=r"ffmpeg was killed by SIGKILL \(after 1 frame\)"):
        film.close()
    assert not list(tmp_path.iterdir())


def test_pngs_survive_a_killed_ffmpeg(tmp_path: Path, make_frame, child_ids, film_at) -> None:
    film, pid = new_child(child_ids, lambda: film_at(tmp_path / "film.mp4"))
    pngs = PngSequence(tmp_path / "frames")
    with pytest.raises(RunError, match="SIGKILL"), Pipeline([pngs, film]) as output:
        for number in range(1, 200):
            output.submit(make_frame(number))
            if number == 10:
                output.drain()
                os.kill(pid, signal.SIGKILL)
    written = sorted((tmp_path / "frames").iterdir())
    assert len(written) == pngs.finished >= 10
    assert all(is_whole_png(path) for path in written)
    assert not (tmp_path / "film.mp4").exists()


def test_ffmpeg_does_not_hear_the_terminals_ctrl_c(tmp_path: Path, child_ids, film_at) -> None:
    film, pid = new_child(child_ids, lambda: film_at(tmp_path / "film.mp4"))
    assert os.getsid(pid) == pid != os.getsid(0)
    film.abort()


def test_the_last_words_are_told_and_the_talk_before_them_does_not_block(
    tmp_path, make_frame, monkeypatch, film_at
) -> None:
    talk = "yes 'a warning of some length' | head -c 1000000 >&2\n"
    end = "head -c 20000 > /dev/null\necho '[out#0/mp4 @ 0x55d0] No space left' >&2\necho 'Conversion failed!' >&2\n"
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", program(tmp_path / "ffmpeg", f"{talk}{end}exit 228"))
    film = film_at(tmp_path / "film.mp4")
    with pytest.raises(RunError, match=r"exit code 228: \[out#0/mp4\] No space left \(after \d+ frames?\)$"):
        for number in range(1, 100):
            film.write(make_frame(number))
    film.abort()


def fake_that_delivers(tmp_path: Path, film: Path) -> str:
    """Return a program that takes all frames, writes `film` whatever they were, and says all is well."""
    copy = f'for last; do :; done; cat > /dev/null; cp "{film}" "${{last#file:}}"'
    return program(tmp_path / "ffmpeg", f'case "$*" in *pipe:0*) {copy} ;; *) exec "{FFMPEG}" "$@" ;; esac')


@pytest.mark.parametrize("held", [0, 3, 4])
def test_missing_frames_are_found_though_ffmpeg_says_all_is_well(
    tmp_path, make_frame, monkeypatch, held: int, film_at
) -> None:
    short = film_at(tmp_path / "short/film.mp4")
    for number in range(1, held + 1):
        short.write(make_frame(number))
    if held:
        short.close()
    else:
        short.abort()
        short.path.touch()
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", fake_that_delivers(tmp_path, short.path))
    film = film_at(tmp_path / "out/film.mp4")
    for number in range(1, 6):
        film.write(make_frame(number))
    with pytest.raises(RunError, match=f"holds {held} of the 5 frames"):
        film.close()
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("cut", [1, 3000, 20000])
def test_frames_of_a_cut_film_are_not_counted(tmp_path: Path, make_frame, cut: int, film_at) -> None:
    film = film_at(tmp_path / "film.mp4", crf=4)
    for number in range(1, 11):
        film.write(make_frame(number))
    film.close()
    assert count_frames(FFMPEG, film.path) == 10
    os.truncate(film.path, film.path.stat().st_size - cut)
    assert count_frames(FFMPEG, film.path) < 10


@pytest.mark.parametrize("count", [0, 1, 12])
def test_abort_keeps_what_is_encoded(tmp_path: Path, make_frame, count: int, film_at) -> None:
    film = film_at(tmp_path / "film.mp4")
    for number in range(1, count + 1):
        film.write(make_frame(number))
    film.abort()
    film.abort()
    film.close()
    assert [path.name for path in tmp_path.iterdir()] == ["film.partial.mp4"][: min(count, 1)]
    if count:
        assert count_frames(FFMPEG, tmp_path / "film.partial.mp4") == count
    with pytest.raises(RunError, match="closed"):
        film.write(make_frame(1))


def test_a_good_film_replaces_the_partial_one(tmp_path: Path, make_frame, film_at) -> None:
    for end in (Mp4.abort, Mp4.close):
        film = film_at(tmp_path / "film.mp4")
        film.write(make_frame(1))
        end(film)
    film.abort()
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


def test_a_film_without_frames_is_an_error(tmp_path: Path, film_at) -> None:
    with pytest.raises(RunError, match="no frame"):
        film_at(tmp_path / "film.mp4").close()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("call", ["replace", "fsync"])
def test_a_film_that_cannot_get_its_name_is_an_error(
    tmp_path: Path, make_frame, monkeypatch, call: str, film_at
) -> None:
    film = film_at(tmp_path / "film.mp4")
    film.write(make_frame(1))

    def fail(*_: object) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, call, fail)
    with pytest.raises(RunError, match=r"film\.mp4: Input/output error"):
        film.close()
    assert not list(tmp_path.iterdir())


def test_a_folder_below_a_file_is_an_error(tmp_path: Path, film_at) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RunError, match="cannot use the folder"):
        film_at(tmp_path / "file/film.mp4")


def test_a_hanging_ffmpeg_does_not_hang_an_abort(tmp_path: Path, make_frame, monkeypatch, film_at) -> None:
    for module, name in ((pipeline, "_PATIENCE"), (mp4, "_PATIENCE"), (mp4, "_STUCK")):
        monkeypatch.setattr(module, name, 0.1)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", program(tmp_path / "ffmpeg", "exec sleep 1000"))
    output = Pipeline([film_at(tmp_path / "out/film.mp4")], queue_size=20)
    for number in range(1, 15):  # more than the pipe holds: the writer waits for ever
        output.submit(make_frame(number))
    output.abort()
    assert not list((tmp_path / "out").iterdir())


_FULL = """
import os, sys
from fractions import Fraction
import numpy as np
from tparticles.errors import RunError
from tparticles.output import Mp4, OutputFrame, Pipeline
if len(sys.argv) > 2:
    import resource
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
film = Mp4(sys.argv[1] + "/film.mp4", fps=Fraction(24), size=(64, 48), crf=0, preset="ultrafast", threads=1)
rng = np.random.default_rng(0)
try:
    with Pipeline([film]) as output:
        for number in range(1, 400):
            output.submit(OutputFrame(number, rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)))
except RunError as error:
    print(error)
print("left:", *os.listdir(sys.argv[1]))
"""


def test_a_file_that_cannot_grow_is_an_error(tmp_path: Path, run_python) -> None:
    message, left = run_python(_FULL, tmp_path, 100_000).stdout.splitlines()
    assert re.search(r"film\.mp4: ffmpeg (was killed by SIGXFSZ|ended .*File too large) \(after \d+ frames\)", message)
    assert left in ("left:", "left: film.partial.mp4")


def test_a_full_disk_is_an_error(tmpfs) -> None:
    message, left = tmpfs(_FULL, options="size=300k").stdout.splitlines()
    assert re.search(r"film\.mp4: ffmpeg ended .*: No space left on device \(after \d+ frames\)", message)
    assert left in ("left:", "left: film.partial.mp4")


_KILLED = """
import os, signal, sys
from fractions import Fraction
import numpy as np
from tparticles.output import Mp4, OutputFrame
film = Mp4(sys.argv[1] + "/film.mp4", fps=Fraction(24), size=(64, 48))
for number in range(1, 5):
    film.write(OutputFrame(number, np.zeros((48, 64, 3), np.uint8)))
os.kill(os.getpid(), signal.SIGKILL)
"""


def wait_for_the_end_of(argument: str) -> None:
    """Wait until no process has a command line that holds `argument`."""

    def runs(cmdline: Path) -> bool:
        try:
            return argument in cmdline.read_text(errors="replace")
        except OSError:
            return False

    deadline = time.monotonic() + 10
    while any(runs(cmdline) for cmdline in Path("/proc").glob("[0-9]*/cmdline")):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_killed_run_leaves_no_film_and_the_next_cleans_up(tmp_path: Path, run_python, make_frame, film_at) -> None:
    assert run_python(_KILLED, tmp_path).returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert re.fullmatch(r"\.film\.mp4\.[0-9a-f]{8}\.tmp", left.name)
    wait_for_the_end_of(left.name)  # ffmpeg finds the end of its input by itself
    film = film_at(tmp_path / "film.mp4")
    film.write(make_frame(1))
    film.close()
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]
