"""Drives a batch: hands jobs to a pool, hears how far they are, retries, and keeps batch.json."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from ..errors import InputError, RunError
from .record import Entry, Record

CANCEL_NAME = ".tparticles.cancel"  # a file by which another process asks us to end
_PAUSE = 0.2  # [s]
_PATIENCE = 30.0  # [s] for the process that had a job before to let go of its folder
_NEVER_AGAIN = (2, 3)  # bad input and missing backends are the same the next time
_INTERRUPTED = 130


class Pool(Protocol):
    """Where jobs are rendered: see `local.Local`."""

    threads: int | None

    def room(self) -> int:
        """Return how many jobs it takes now."""
        ...

    def submit(self, name: str, order: dict[str, Any]) -> None:
        """Begin with a job."""
        ...

    def next(self, timeout: float) -> tuple[str, dict[str, Any]] | None:
        """Return the next event and its job, or None after `timeout` [s]."""
        ...

    def stop(self, name: str) -> None:
        """Stop a job."""
        ...

    def close(self) -> list[tuple[str, dict[str, Any]]]:
        """Stop all jobs, wait for their ends, and return their last events."""
        ...


@dataclass
class _Clock:
    """How long a job has been at work [s]; waiting behind its first frame does not count."""

    spent: float = 0.0
    since: float | None = field(default_factory=time.monotonic)

    def pause(self) -> None:
        self.spent, self.since = self.seconds, None

    def resume(self) -> None:
        self.since = time.monotonic() if self.since is None else self.since

    @property
    def seconds(self) -> float:
        return self.spent + (0.0 if self.since is None else time.monotonic() - self.since)


class CancelledError(RunError):
    """Somebody asked for the end with `tparticles cancel`."""

    exit_code = _INTERRUPTED


class Runner:
    """Runs the waiting jobs of a record.

    existing: see `standing.EXISTING`. retries: how often a job that fails is run again. timeout: of one attempt [s].
    hear: is told what happens, as JSON could hold it; signals: grows when the process is asked to end.
    """

    def __init__(
        self,
        record: Record,
        pool: Pool,
        *,
        existing: str = "resume",
        retries: int = 0,
        timeout: float | None = None,
        hear: Callable[[dict[str, Any]], None] = lambda event: None,
        signals: list[int] | None = None,
    ):
        self.record, self.pool, self.hear = record, pool, hear
        self._existing, self._retries, self._timeout = existing, retries, timeout
        self._signals = [] if signals is None else signals
        self._waiting = deque(name for name, entry in record.entries.items() if entry.state == "waiting")
        self._clocks: dict[str, _Clock] = {}
        self._late: set[str] = set()
        self._cancel = record.folder / CANCEL_NAME

    def run(self) -> None:
        """Run until every job is done or has failed for good.

        Raises CancelledError; RunError if batch.json cannot be kept at last; KeyboardInterrupt after all workers have ended.
        """
        self._cancel.unlink(missing_ok=True)
        self._save(now=True)
        try:
            while self._waiting or self._clocks:
                self._look_up()
                for _ in range(min(self.pool.room(), len(self._waiting))):
                    self._submit(self._waiting.popleft())
                if told := self.pool.next(_PAUSE):
                    self._handle(*told)
                self._stop_late()
                self._save()
        except BaseException as error:
            self._close("cancelled" if isinstance(error, CancelledError) else "waiting")
            self.record.status = "cancelled" if isinstance(error, CancelledError) else "interrupted"
            self._save(now=True)
            raise
        self.pool.close()
        self.record.status = "failed" if self.record.counts()["failed"] else "done"
        self.record.save(now=True)

    def _look_up(self) -> None:
        if self._signals:
            raise KeyboardInterrupt
        if self._cancel.exists():
            self._cancel.unlink(missing_ok=True)
            raise CancelledError("cancelled; what is finished stays, `tparticles retry` goes on")

    def _submit(self, name: str) -> None:
        entry = self.record[name]
        order = {
            "task": entry.task.row(),
            "out": str(self.record.out(name).absolute()),
            "folder": os.getcwd(),
            "existing": self._existing,
            "again": entry.attempts > 0,
            "lives": 1 + self._retries - entry.attempts,
            "threads": self.pool.threads,
            "patience": _PATIENCE if entry.attempts else 1.0,
        }
        self._clocks[name] = _Clock()
        self.pool.submit(name, order)

    def _handle(self, name: str, event: dict[str, Any]) -> None:
        if name not in self._clocks:
            return  # of an attempt that was given up
        entry, clock, kind = self.record[name], self._clocks[name], event["event"]
        if kind == "started":
            entry.attempts += 1
            self._clocks[name] = _Clock()
            self._change(entry, "running", where=event.get("where"))
        elif kind == "ready":
            clock.pause()
        elif kind == "go":
            clock.resume()
        elif kind == "end":
            self._end(entry, event)
        if isinstance(event.get("frames"), int):
            entry.frames = event["frames"]
            if kind in ("ready", "frame"):
                self.hear({"event": "frame", "job": name, "done": event["done"], "frames": entry.frames})

    def _end(self, entry: Entry, event: dict[str, Any]) -> None:
        name, code = entry.task.name, event["code"]
        entry.seconds += self._clocks.pop(name).seconds
        entry.exit_code, entry.error = code, event.get("error")
        if name in self._late:
            self._late.discard(name)
            entry.exit_code, entry.error = 1, f"took longer than --timeout {self._timeout:g} s"
        if code == 0:
            entry.exit_code, entry.error = 0, None
            self._change(entry, "done")
        elif code in _NEVER_AGAIN or entry.attempts > self._retries:
            self._change(entry, "failed")
        else:
            self._waiting.append(name)
            self._change(entry, "waiting")

    def _stop_late(self) -> None:
        if self._timeout is None:
            return
        for name, clock in self._clocks.items():
            if clock.seconds > self._timeout and name not in self._late:
                self._late.add(name)
                self.pool.stop(name)

    def _close(self, state: str) -> None:
        """Stop what runs; what was finished by then counts."""
        for name, event in self.pool.close():
            if event["event"] == "end" and event["code"] == 0 and name in self._clocks:
                self._end(self.record[name], event)
        for entry in self.record.entries.values():
            if entry.state in ("running", "waiting"):
                if entry.task.name in self._clocks:
                    entry.seconds += self._clocks.pop(entry.task.name).seconds
                if entry.state != state:
                    self._change(entry, state)

    def _change(self, entry: Entry, state: str, **more: Any) -> None:
        entry.state = state
        told = {"attempts": entry.attempts, "seconds": round(entry.seconds, 3), "error": entry.error, **more}
        self.hear({"event": "job", "job": entry.task.name, "state": state, **told})

    def _save(self, *, now: bool = False) -> None:
        """Save; a full disk now may have room again at the end, and the films' own folders know what is finished."""
        try:
            self.record.save(now=now)
        except RunError as error:
            if now and self.record.status == "running":
                raise InputError(str(error)) from error
