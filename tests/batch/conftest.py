"""Fixtures of the batch tests: a folder with a tiny scene, commands in processes of their own, a shared kernel cache."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from batch_commands import SCENE, Commands


@pytest.fixture(scope="session", autouse=True)
def kernel_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let all processes of the session share their kernels, and leave the user's cache alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TPARTICLES_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with scenes/dots.py."""
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes/dots.py").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Commands]:
    """Return what runs commands in the folder."""
    commands = Commands(tmp_path)
    yield commands
    commands.close()
