"""What is there of a film already, and whether it may be rendered: looked at before the batch, and again by each worker."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from ..errors import InputError, TparticlesError
from ..job import Job, Options
from ..output import is_whole_png, read_manifest
from ..output.files import frame_path
from ..output.manifest import MANIFEST_NAME
from .record import Entry, Record
from .tasks import Task

EXISTING = ("resume", "skip", "overwrite", "error")


def make_job(task: Task, out: Path, *, existing: str, threads: int | None = None, again: bool = False) -> Job:
    """Return the render that a task asks for.

    again: an earlier attempt of this batch may have left a part of it.
    Raises InputError.
    """
    options = Options(
        out=out,
        settings=task.settings,
        seed=task.seed,
        threads=threads,
        existing="overwrite" if existing == "overwrite" else "error",
        resume=existing == "resume" or again,
        **task.options,
    )
    return Job(task.scene, options)


def finished(job: Job) -> bool:
    """Whether the folder of `job` holds all that it would write.

    Raises InputError if it holds the scene rendered with other settings, another scene, or what is no run.
    """
    path = job.out / MANIFEST_NAME
    if not path.exists():
        return False
    run = read_manifest(path)
    if run["scene"] != job.script.name or run.get("scene_hash") != job.identity:
        if run.get("frames") == [] and run["scene"] == job.script.name:
            return False  # nothing of it was finished: nobody's loss
        raise InputError(
            f"{job.out} holds scene '{run['scene']}' rendered with other parameters, settings or text: replace it with "
            "--existing overwrite, or choose another with --out"
        )
    rows = run.get("frames")
    numbers = {row.get("frame") for row in rows if isinstance(row, dict)} if isinstance(rows, list) else set()
    return run.get("status") == "done" and numbers >= set(job.frames) and _has_files(job)


def _has_files(job: Job) -> bool:
    options = job.options
    if options.mp4 and not job.film_path.is_file():
        return False
    if options.states and not all(frame_path(job.out / "states", n, ".npz").is_file() for n in job.frames):
        return False
    return not options.png or all(is_whole_png(frame_path(job.out / "frames", n, ".png")) for n in job.frames)


def check(
    record: Record, *, existing: str, seconds: float, tell: Callable[[int], None] = lambda done: None
) -> list[tuple[Entry, Job]]:
    """Look at the waiting jobs of a batch before it begins, as many as `seconds` allow; each worker looks again.

    Jobs that are finished become "done", unless they are to be overwritten. Returns the others with their renders.
    Raises InputError that names the job: a bad scene or parameter, a stale result, any result if `existing` is "error".
    """
    end = time.monotonic() + seconds
    found = []
    for number, entry in enumerate(record.entries.values(), start=1):
        if entry.state != "waiting" or time.monotonic() > end:
            continue
        out = record.out(entry.task.name)
        try:
            if existing == "error" and (out / MANIFEST_NAME).exists():
                raise InputError(f"{out} holds results already: --existing resume, skip or overwrite says what to do")
            job = make_job(entry.task, out, existing=existing)
            entry.frames = len(job.frames)
            if existing != "overwrite" and finished(job):
                entry.state = "done"
                continue
        except TparticlesError as error:
            raise type(error)(f"job '{entry.task.name}': {error}") from None
        found.append((entry, job))
        tell(number)
    return found
