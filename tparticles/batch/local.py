"""Processes on this machine: so many films at a time, and the next ones getting ready meanwhile."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from .. import backend

_GRACE = 15.0  # [s] to keep what is finished, before a process is killed
_SPARE = 0.8  # of the memory may be in use if other films are to get ready
Event = dict[str, Any]


class Child:
    """A process that renders one film. Its events, and at last one "end", go to `told` with its name.

    log: what it says on stderr; removed if that is nothing.
    """

    def __init__(self, name: str, order: Event, told: queue.SimpleQueue[tuple[str, Event]], log: Path):
        self.name, self.state = name, "starting"
        self._told, self._log = told, log
        self._deadline = float("inf")
        log.parent.mkdir(parents=True, exist_ok=True)
        with open(log, "ab") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tparticles.batch.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                cwd=order["folder"],
                text=True,
                encoding="utf-8",
                errors="replace",
                start_new_session=True,  # Ctrl-C is ours: we pass it on
            )
        self.pid = self._process.pid
        self._send(json.dumps(order))
        threading.Thread(target=self._listen, daemon=True).start()

    def go(self) -> None:
        """Let it render."""
        self.state = "rendering"
        self._send("go")

    def stop(self) -> None:
        """Ask it to keep what is finished and end, and see to it that it does."""
        if self._deadline == float("inf"):
            self._deadline = time.monotonic() + _GRACE
            self._process.terminate()

    def kill_late(self) -> None:
        """Kill it if it was asked to end and did not."""
        if time.monotonic() > self._deadline:
            self._process.kill()

    def _send(self, line: str) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # it is dead: its end will tell
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()

    def _listen(self) -> None:
        assert self._process.stdout is not None and self._process.stdin is not None
        end: Event | None = None
        for line in self._process.stdout:
            with contextlib.suppress(ValueError):
                event = json.loads(line)
                if event.get("event") == "end":
                    end = event
                else:
                    self._told.put((self.name, event))
        code = self._process.wait()
        self._process.stdout.close()
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        with contextlib.suppress(OSError):
            if self._log.stat().st_size == 0:
                self._log.unlink()
                self._log.parent.rmdir()
        self._told.put((self.name, end if end is not None and code >= 0 else _death(code)))


def _death(code: int) -> Event:
    """Return the end of a process that could not tell it itself."""
    if code >= 0:
        return {"event": "end", "code": code or 1, "error": f"its process ended with {code} and without a word"}
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    return {"event": "end", "code": 128 - code, "error": f"its process was killed by {name}"}


class Local:
    """A pool of processes on this machine.

    workers: films at a time. standby: let the next ones get ready up to their first frames meanwhile, where memory allows.
    """

    def __init__(self, workers: int, logs: Path, *, standby: bool = True):
        self.workers = workers
        self.threads: int | None = max(1, cores() // workers)
        self._logs, self._standby = logs, standby
        self._spare = 0  # how many may get ready; known when the first film is
        self._told: queue.SimpleQueue[tuple[str, Event]] = queue.SimpleQueue()
        self._children: dict[str, Child] = {}

    def room(self) -> int:
        """Return how many films it takes now."""
        return self.workers + self._spare - len(self._children)

    def submit(self, name: str, order: Event) -> None:
        """Begin with a film. Its first event is "started"."""
        self._children[name] = Child(name, order, self._told, self._logs / f"{name}.log")
        self._told.put((name, {"event": "started", "where": f"process {self._children[name].pid}"}))

    def next(self, timeout: float) -> tuple[str, Event] | None:
        """Return the next event and its film, or None after `timeout` [s]."""
        for child in self._children.values():
            child.kill_late()
        try:
            name, event = self._told.get(timeout=timeout)
        except queue.Empty:
            return None
        if event["event"] == "ready":
            self._children[name].state = "ready"
            self._plan(event)
        elif event["event"] == "end":
            del self._children[name]
        self._let_go()
        return name, event

    def _let_go(self) -> None:
        rendering = sum(child.state == "rendering" for child in self._children.values())
        for child in self._children.values():
            if child.state == "ready" and rendering < self.workers:
                child.go()
                rendering += 1
                self._told.put((child.name, {"event": "go"}))

    def _plan(self, event: Event) -> None:
        """Learn from a film that is ready how many others have room beside: as many as are rendered and half as many, if so.

        A short film takes longer to get ready than to render; with fewer, a worker's place is empty when a film ends.
        """
        fit = int(_SPARE * backend.memory() / max(1, event.get("peak", 0))) - self.workers
        on = self._standby and event.get("arch") == "cpu"
        self._spare = max(0, min(fit, -(-3 * self.workers // 2))) if on else 0

    def stop(self, name: str) -> None:
        """Stop a film; what is finished of it is kept."""
        if child := self._children.get(name):
            child.stop()

    def close(self) -> list[tuple[str, Event]]:
        """Stop all films, wait until they have ended, and return their last events."""
        for child in self._children.values():
            child.stop()
        last = []
        while self._children:
            if told := self.next(0.2):
                last.append(told)
        return last


def cores() -> int:
    """Return how many CPU cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
