"""A sweep of short preview films with two workers against one, and how long a warm film takes to start.

`python -m tests.bench sweep`

One worker alone means one process at a time; as the program runs it, the next film gets ready beside the one that is rendered.
Rounds take turns, on the first two cores this process may use. Processor time is what to look at where others use the machine too.
"""

import os
import resource
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from tests.bench.table import Table
from tparticles.batch.local import Local
from tparticles.batch.record import Entry, Record
from tparticles.batch.runner import Runner
from tparticles.batch.tasks import Task

FILMS, ROUNDS, FRAMES = 16, 3, 24
OPTIONS = {"quality": "preview", "size": (480, 270), "frames": f"1-{FRAMES}", "arch": "cpu"}
SCENE = str(Path(__file__).parents[2] / "scenes" / "campfire.py")


def tasks() -> list[Task]:
    """Return the films: the wind differs, so they share their kernels."""
    return [Task(name=f"wind={i}", scene=SCENE, settings={"wind": 0.1 * i}, options=OPTIONS) for i in range(FILMS)]


class Timed(Local):
    """A pool that measures how long each film needs, from the moment that another one makes room, to be past its first frame."""

    def __init__(self, workers: int, logs: Path, *, standby: bool):
        super().__init__(workers, logs, standby=standby)
        self.free, self.starts = [time.perf_counter()] * workers, list[float]()

    def next(self, timeout: float) -> tuple[str, dict[str, Any]] | None:
        """Return what the pool returns, and note the time."""
        told = super().next(timeout)
        if told and told[1]["event"] == "end":
            self.free.append(time.perf_counter())
        elif told and told[1]["event"] == "go":
            self.starts.append(time.perf_counter() - self.free.pop(0))
        return told


class Run:
    """One sweep: how long it takes in all, how much processor time, and how long films take to start."""

    def __init__(self, folder: Path, *, workers: int, standby: bool):
        folder.mkdir()
        record = Record(folder, [Entry(task) for task in tasks()])
        before, begun = _children(), time.perf_counter()
        pool = Timed(workers, folder / "logs", standby=standby)
        Runner(record, pool).run()
        self.wall, self.processor, self.starts = time.perf_counter() - begun, _children() - before, pool.starts
        assert record.counts()["done"] == FILMS, [entry.error for entry in record.entries.values()]


def _children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # a user's process keeps the bytecode of what it imports
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    ways = {
        "1 worker, one process at a time": {"workers": 1, "standby": False},
        "1 worker, the next film gets ready meanwhile": {"workers": 1, "standby": True},
        "2 workers, one process each": {"workers": 2, "standby": False},
        "2 workers, the next film gets ready meanwhile": {"workers": 2, "standby": True},
    }
    with tempfile.TemporaryDirectory() as base:
        Run(Path(base) / "warm-up", workers=2, standby=True)
        runs: dict[str, list[Run]] = {name: [] for name in ways}
        for i in range(ROUNDS):
            for j, (name, how) in enumerate(ways.items()):
                runs[name].append(Run(Path(base) / f"{i}-{j}", **how))
    title = f"{FILMS} campfires of {FRAMES} frames, 480x270, PNG and MP4, warm kernel cache, 2 cores"
    table = Table(
        title,
        ("way", "wall [s]", "against the first (wanted: 1.7)", "processor [s]", "start of a film [s] (wanted: 1)"),
    )
    first = next(iter(runs.values()))
    for name, found in runs.items():
        ratio = median(a.wall / b.wall for a, b in zip(first, found, strict=True))
        starts = [start for run in found for start in run.starts[2:]]  # of those that are not the first
        table.add(
            name,
            f"{median(run.wall for run in found):.1f}",
            f"{ratio:.2f}",
            f"{median(run.processor for run in found):.1f}",
            f"{median(starts):.2f}",
        )
    table.print()
