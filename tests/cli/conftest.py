"""Fixtures of the command line's tests: tiny scenes, the command in this process and in its own, a shared kernel cache."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from commands import SAME_BACKEND, Result, Run, Write, run_process, write_scene

from tparticles.cli import main


@pytest.fixture(scope="session", autouse=True)
def kernel_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let all processes of the session share their kernels, and leave the user's cache alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TPARTICLES_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def scene(tmp_path: Path) -> Write:
    """Return a function that writes `tiny.py` (or `name`) with other text in some of `PARTS`."""
    return lambda name="tiny", **parts: write_scene(tmp_path / f"{name}.py", **parts)


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    """Return a function that runs a command in this process."""

    def run(*arguments: object) -> Result:
        first, *others = map(str, arguments)
        capfd.readouterr()
        with pytest.raises(SystemExit) as left:
            main([first, *(SAME_BACKEND if first == "render" else ()), *others])
        captured = capfd.readouterr()
        assert isinstance(left.value.code, int)
        return Result(left.value.code, captured.out, captured.err)

    return run


@pytest.fixture
def process() -> Run:
    """Return a function that runs a command in a process of its own."""
    return run_process
