"""Shared by the output tests: small frames, a look at our children, and a guard against leaks after every test."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tparticles.output import Mp4, OutputFrame

ROOT = Path(__file__).parents[2]
Run = Callable[..., subprocess.CompletedProcess[str]]


def children() -> set[int]:
    """Return the ids of our child processes (empty where there is no /proc)."""
    found = set()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(fields[1]) == os.getpid():
            found.add(int(stat.parent.name))
    return found


@pytest.fixture(autouse=True)
def no_leaks(tmp_path: Path) -> Iterator[None]:
    """No test may leave a thread, a child process or a temporary file behind."""
    threads, processes = set(threading.enumerate()), children()
    yield
    for thread in set(threading.enumerate()) - threads:
        thread.join(5)  # Ctrl-C may interrupt the wait for a thread that is about to end
    assert set(threading.enumerate()) <= threads
    assert children() <= processes
    assert not list(tmp_path.rglob(".*.tmp"))


@pytest.fixture
def child_ids() -> Callable[[], set[int]]:
    return children


@pytest.fixture
def make_frame() -> Callable[..., OutputFrame]:
    """Return a function that makes frame `number`: noise that is the same for the same number."""

    def make(number: int, size: tuple[int, int] = (64, 48), **states: np.ndarray) -> OutputFrame:
        rng = np.random.default_rng(number)
        image = rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
        return OutputFrame(number, image, {"version": "0.1.0", "frame": str(number)}, states or None)

    return make


@pytest.fixture
def run_python() -> Run:
    """Return a function that runs a script in a fresh Python and returns what became of it."""

    def run(script: str, *arguments: object, wrapper: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
        command = [*wrapper, sys.executable, "-c", script, *map(str, arguments)]
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        return subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=60)

    return run


@pytest.fixture
def tmpfs(tmp_path: Path, run_python: Run) -> Run:
    """Return a function that runs a script with a small full-able file system at its first argument.

    Skips where the system does not let us mount one. The mount lives and dies with the script's own name space.
    """
    place = tmp_path / "small"
    place.mkdir()

    def wrapper(options: str) -> tuple[str, ...]:
        mount = f'mount -t tmpfs -o {options} none "{place}" && exec "$@"'
        return ("unshare", "--map-root-user", "--mount", "sh", "-c", mount, "sh")

    def run(script: str, *arguments: object, options: str) -> subprocess.CompletedProcess[str]:
        return run_python(script, place, *arguments, wrapper=wrapper(options))

    try:
        trial = run("", options="size=64k")
    except FileNotFoundError:
        pytest.skip("needs unshare (util-linux)")
    if trial.returncode:
        pytest.skip(f"cannot mount a tmpfs: {trial.stderr.strip()}")
    return run


@pytest.fixture
def film_at() -> Callable[..., Mp4]:
    """Return a function that begins a small film, encoded fast."""

    def begin(path: Path, *, fps: Fraction = Fraction(24), size: tuple[int, int] = (64, 48), crf: int = 18) -> Mp4:
        return Mp4(path, fps=fps, size=size, crf=crf, preset="ultrafast", threads=1)

    return begin
