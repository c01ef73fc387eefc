"""One writer per folder: who comes second is refused by name, and a dead one's lock is nobody's."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tparticles.errors import InputError
from tparticles.output import FolderBusyError, claim_folder, held_folder
from tparticles.output.lock import LOCK_NAME, holder

_HOLD = """
import sys, time
from tparticles.output import held_folder
with held_folder(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def other(tmp_path: Path):
    """Another process that holds the folder."""
    with subprocess.Popen([sys.executable, "-c", _HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_the_second_is_told_who_is_first(tmp_path: Path, other: subprocess.Popen[str]) -> None:
    words = f"being written by process {other.pid}: .*--out"
    with pytest.raises(FolderBusyError, match=words) as caught, held_folder(tmp_path):
        pass
    assert caught.value.exit_code == 2
    assert holder(tmp_path) == f"process {other.pid}"


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path: Path, other: subprocess.Popen[str]) -> None:
    other.send_signal(signal.SIGKILL)
    other.wait()
    assert (tmp_path / LOCK_NAME).read_text().startswith(str(other.pid))
    assert holder(tmp_path) is None
    with held_folder(tmp_path):
        assert holder(tmp_path) == f"process {os.getpid()}"
        claim_folder(tmp_path, scene="campfire", identity="now")  # the lock is no foreign file
    assert not list(tmp_path.iterdir())


def test_who_waits_comes_next(tmp_path: Path) -> None:
    def hold() -> None:
        with held_folder(tmp_path):
            ready.set()
            time.sleep(0.3)

    ready = threading.Event()
    first = threading.Thread(target=hold)
    first.start()
    ready.wait()
    with held_folder(tmp_path, patience=10.0):
        assert not first.is_alive() or first.join(5.0) is None
    assert holder(tmp_path) is None


def test_many_take_turns(tmp_path: Path) -> None:
    inside, worst, lock = 0, 0, threading.Lock()

    def work() -> None:
        nonlocal inside, worst
        for _ in range(5):
            with held_folder(tmp_path, patience=30.0):
                with lock:
                    inside += 1
                    worst = max(worst, inside)
                time.sleep(0.002)
                with lock:
                    inside -= 1

    threads = [threading.Thread(target=work) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert worst == 1


@pytest.mark.parametrize("text", ["", "\0\xff", "12 ../../\x1b[31mevil", "9" * 5000])
def test_a_strange_lock_file_is_shown_as_nothing(tmp_path: Path, text: str) -> None:
    import fcntl

    path = tmp_path / LOCK_NAME
    path.write_text(text, encoding="latin-1")
    with open(path) as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(FolderBusyError, match="written by another process"), held_folder(tmp_path):
            pass


@pytest.mark.parametrize("name", ["file", "file/below", "x" * 300, "a\0b", "link", "loop"])
def test_what_cannot_be_a_folder_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("nowhere")
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match="output folder"), held_folder(tmp_path / name):
        pass
