"""batch.json: what a batch was asked for, and how far each of its jobs came."""

from __future__ import annotations

import json
import re
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError, RunError, nearest
from ..output.files import atomic_file, final_name, reason
from ..output.lock import LOCK_NAME
from .tasks import Task

BATCH_NAME = "batch.json"
JOBS = "jobs"  # folder of the films' folders
STATES = ("waiting", "running", "done", "failed", "cancelled")
_OURS = re.compile(r"jobs|logs|index\.html|contact(-[0-9]+)?\.png")  # beside it
_VERSION = 1
_LARGEST = 1 << 30  # bytes


@dataclass
class Entry:
    """A task and what became of it. `seconds`: that its attempts took in all, by a clock that is never set back."""

    task: Task
    state: str = "waiting"
    attempts: int = 0
    exit_code: int | None = None
    error: str | None = None
    seconds: float = 0.0
    frames: int | None = None

    def row(self, folder: Path) -> dict[str, Any]:
        """Return the entry as JSON can hold it."""
        told = {key: value for key, value in vars(self).items() if key != "task"}
        return {
            **self.task.row(),
            **told,
            "seconds": round(self.seconds, 3),
            "out": str(folder / JOBS / self.task.name),
        }


class Record:
    """The batch.json of a folder; at any moment the file is whole, whatever kills the process.

    interval: between saves [s]; stretched so that saving takes at most a twentieth of the time.
    """

    def __init__(self, folder: Path, entries: Iterable[Entry], *, interval: float = 1.0):
        self.folder = folder
        self.entries = {entry.task.name: entry for entry in entries}
        self.status = "running"
        self._interval, self._next = interval, 0.0

    def __getitem__(self, name: str) -> Entry:
        return self.entries[name]

    def counts(self) -> dict[str, int]:
        """Return how many jobs are in each state."""
        found = Counter(entry.state for entry in self.entries.values())
        return {state: found[state] for state in STATES}

    def out(self, name: str) -> Path:
        """Return the folder of a job."""
        return self.folder / JOBS / name

    def save(self, *, now: bool = False) -> None:
        """Save, if it is time to or `now`. Raises RunError if it cannot be written."""
        start = time.monotonic()
        if start < self._next and not now:
            return
        try:
            with atomic_file(self.folder / BATCH_NAME) as file:
                for text in self._text():
                    file.write(text.encode("ascii"))
        except OSError as error:
            raise RunError(f"cannot write {self.folder / BATCH_NAME}: {reason(error)}") from error
        end = time.monotonic()
        self._next = end + max(self._interval, 20.0 * (end - start))

    def _text(self) -> Iterable[str]:
        yield f'{{"version": {_VERSION}, "status": "{self.status}", "jobs": [\n'
        for i, entry in enumerate(self.entries.values()):
            yield ("" if i == 0 else ",\n") + json.dumps(entry.row(self.folder), allow_nan=False)
        yield "\n]}\n"


def read_record(folder: Path) -> Record:
    """Return what a folder's batch.json says. Raises InputError if there is none or it is broken."""
    path = folder / BATCH_NAME
    try:
        with open(path, "rb") as file:
            data = file.read(_LARGEST + 1)
    except (OSError, ValueError) as error:
        why = reason(error) if isinstance(error, OSError) else error
        raise InputError(f"{folder} holds no batch: cannot read {BATCH_NAME}: {why}") from None
    if len(data) > _LARGEST:
        raise InputError(f"{path} is broken: larger than {_LARGEST >> 30} GiB")
    try:
        content = json.loads(data)
        if not isinstance(content, dict) or content.get("version") != _VERSION:
            raise InputError(f"not a batch of version {_VERSION}")
        if not isinstance(content.get("jobs"), list):
            raise InputError("jobs is no list")
        record = Record(folder, [_entry(row) for row in content["jobs"]])
    except (ValueError, RecursionError, InputError) as error:
        raise InputError(f"{path} is broken: {error}") from None
    if len(record.entries) < len(content["jobs"]):
        raise InputError(f"{path} is broken: two jobs have one name")
    record.status = str(content.get("status"))
    return record


def _entry(row: Any) -> Entry:
    if not isinstance(row, dict) or row.get("state") not in STATES:
        raise InputError("a job has no state")
    kinds = {
        "attempts": int,
        "exit_code": int | None,
        "error": str | None,
        "seconds": int | float,
        "frames": int | None,
    }
    for name, kind in kinds.items():
        if not isinstance(row.get(name), kind) or isinstance(row.get(name), bool):
            raise InputError(f"a job's {name} is {row.get(name)!r}")
    return Entry(Task.of(row), row["state"], **{name: row[name] for name in kinds})


def prepare_folder(folder: Path, tasks: Iterable[Task], *, replace: bool) -> Record:
    """Return the record to begin with; what an earlier batch in the folder finished is known again.

    The folder is ours already (see `held_folder`). `replace`: forget an earlier batch of other jobs.
    Raises InputError: the folder holds something else, or a batch with jobs that are not asked for.
    """
    entries = [Entry(task) for task in tasks]
    names = sorted(e.name for e in folder.iterdir() if final_name(e) is None and e.name != LOCK_NAME)
    # where only the record is lost, the films know themselves what they are
    lost = JOBS in names and all(map(_OURS.fullmatch, names))
    if names and BATCH_NAME not in names and not lost:
        listed = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
        raise InputError(f"output folder {folder} holds {listed} but no {BATCH_NAME}: choose another with --out")
    record = Record(folder, entries)
    if BATCH_NAME in names and not replace:
        old = _earlier(folder)
        if gone := [name for name in old.entries if name not in record.entries]:
            close = nearest(gone[0], record.entries)
            raise InputError(
                f"output folder {folder} holds a batch with other jobs, such as '{gone[0]}'{close}: "
                "choose another with --out, or forget them with --existing overwrite"
            )
        for name, entry in old.entries.items():
            record[name].seconds = entry.seconds
    return record


def _earlier(folder: Path) -> Record:
    try:
        return read_record(folder)
    except InputError as error:
        raise InputError(f"{error}; move it away, and the films that are there are taken up without it") from None


def without_state(record: Record, states: Iterable[str] = STATES) -> None:
    """Let every job in one of `states` wait again."""
    for name, entry in record.entries.items():
        if entry.state in states:
            record.entries[name] = Entry(entry.task, seconds=entry.seconds, frames=entry.frames)


def as_rows(record: Record) -> list[Mapping[str, Any]]:
    """Return all jobs as JSON can hold them."""
    return [entry.row(record.folder) for entry in record.entries.values()]
