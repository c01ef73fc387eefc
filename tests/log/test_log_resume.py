"""Logs of films that were interrupted, or rendered in shards: the same as of one in one go, number by number."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin  # noqa: F401  the filters of logs
import numpy as np
import pytest
from conftest import FRAMES, Film, pixels

from tparticles import backend
from tparticles.errors import InputError, RunError
from tparticles.job import Job, Options
from tparticles.log.source import LoggedSimulation, Logging

ROOT = Path(__file__).parents[2]
MESHES = Logging(groups=("box", "cloth"))


def job(logged: Film, out: Path, **more: Any) -> Job:
    options = {"arch": "cpu", "threads": 2, "mp4": False, "checkpoint_every": "3f", **more}
    return Job(str(logged.script), Options(out=out, **options))


def render(asked: Job, logging: Logging | None, *, until: int = FRAMES, log: str = "log.h5") -> list[str]:
    """Render a film, interrupted behind a frame; return what it told."""
    told: list[str] = []

    def progress(frame: Any, done: int) -> None:
        if frame.number == until < FRAMES:
            raise KeyboardInterrupt

    backend.stop()  # or kernels are compiled anew: they know what other fields there are
    source = None if logging is None else lambda: LoggedSimulation(asked, logging)
    last = None if logging is None else asked.out / log
    asked.run(progress, tell=told.append, source=source, last=last)
    return told


def arrays(path: Path) -> dict[str, np.ndarray]:
    """Return all arrays of a log."""
    found: dict[str, np.ndarray] = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


def check_same(folder: Path, whole: Film, *, without: str = "-") -> None:
    """Hold log and pictures of a film against those of one in one go."""
    mine, others = arrays(folder / "log.h5"), arrays(whole.log)
    assert set(mine) == {name for name in others if without not in name}
    for name, values in mine.items():
        assert np.array_equal(values, others[name]), name
    for n in range(1, FRAMES + 1):
        assert pixels(folder / f"frames/{n:06d}.png") == pixels(whole.folder / f"frames/{n:06d}.png"), n
    assert sorted(path.name for path in folder.iterdir()) == ["frames", "log.h5", "run.json"]


def test_an_interrupted_log_goes_on(logged: Film, tmp_path: Path):
    out = tmp_path / "out"
    for until in (2, 8):
        with pytest.raises(KeyboardInterrupt):
            render(job(logged, out, resume=True), Logging(), until=until)
        assert (out / "log.unfinished.h5").is_file() and not (out / "log.h5").exists()
    told = render(job(logged, out, resume=True), Logging())
    assert "resumed at frame" in told[-1]
    check_same(out, logged)
    before = (out / "log.h5").stat()
    render(job(logged, out, resume=True), Logging())  # nothing is left to do
    assert (out / "log.h5").stat().st_mtime_ns == before.st_mtime_ns


def test_a_film_whose_log_was_not_finished_is_not_done(logged: Film, tmp_path: Path):
    out = tmp_path / "out"
    shutil.copytree(logged.folder, out, ignore=shutil.ignore_patterns("*.h5", "*.mp4"))
    assert render(job(logged, out, resume=True), Logging()) == [
        "no checkpoint to resume from: rendering from the beginning"
    ]
    check_same(out, logged)


def test_what_does_not_go_with_a_checkpoint_is_refused(logged: Film, tmp_path: Path):
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        render(job(logged, out), Logging(), until=7)
    with pytest.raises(InputError, match="of a run with a log: resume with the same --log"):
        render(job(logged, out, resume=True), None)
    with pytest.raises(
        InputError, match="--log --resume: the log of the checkpoint is of other steps, vertices or groups"
    ):
        render(job(logged, out, resume=True), Logging(every=2))
    with h5py.File(out / "log.unfinished.h5", "r+") as file:
        file["meshes/box/x"].resize(3, axis=0)
    with pytest.raises(
        RunError, match=r"log\.unfinished\.h5: it ends before the checkpoint, after 3 of [0-9]+ rows of"
    ):
        render(job(logged, out, resume=True), Logging())
    (out / "log.unfinished.h5").unlink()
    with pytest.raises(InputError, match=r"log\.unfinished\.h5 is missing; begin anew without --resume"):
        render(job(logged, out, resume=True), Logging())


def test_the_first_of_two_shards_logs_the_meshes(logged: Film, tmp_path: Path):
    options = ("--out", "out", "--no-mp4", "--quiet", "--arch", "cpu", "--threads", "2", "--shards", "2")
    command = [sys.executable, "-m", "tparticles", "render", str(logged.script), *options, *MESHES.options()]
    done = subprocess.run(
        command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    check_same(tmp_path / "out", logged, without="particles/")
