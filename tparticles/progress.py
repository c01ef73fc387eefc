"""How far a render is, on stderr: a bar on a terminal, a line now and then elsewhere, nothing if quiet."""

from __future__ import annotations

import sys
import time
from collections import deque
from types import TracebackType
from typing import Any, Self

_WINDOW = 30.0  # [s] over which the speed is measured
_TIMED = 3  # frames after the first that tell it at least: the first waits for the compiler, and what it had to simulate before
_FIRST, _LONGEST = 5.0, 60.0  # [s] between two lines: a night's film must not fill a log


class Progress:
    """Call `step` for each frame inside the `with` block.

    name: of the scene; total: how many frames will be drawn.
    """

    def __init__(self, name: str, total: int, *, quiet: bool = False):
        self._name, self._total, self._quiet = name, total, quiet
        self._bar: Any = None
        self._task: Any = None
        self._next_line, self._pause = 0.0, _FIRST
        self._times: deque[tuple[float, int]] = deque()  # of the frames drawn: when, and how many there were

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr is not None and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
            from rich.progress import Progress as Bar

            self._bar = Bar(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("[cyan]{task.fields[alive]} alive"),
                TextColumn("{task.fields[left]}", markup=False),
                console=Console(stderr=True),
            )
            self._bar.start()
            self._task = self._bar.add_task(f"{self._name} (compiling)", total=self._total, alive=0, left="")
        return self

    def step(self, frame: Any, done: int) -> None:
        """Show that `done` frames are drawn, `frame` being the latest; the first call may find frames of an earlier run."""
        now = time.monotonic()
        self._times.append((now, done))
        while len(self._times) > _TIMED + 1 and now - self._times[0][0] > _WINDOW:
            self._times.popleft()
        if self._bar is not None:
            told = {"alive": frame.report.alive, "left": self._left()}
            self._bar.update(self._task, completed=done, description=self._name, **told)
        elif not self._quiet:
            self._line(frame, done, now)

    def _left(self) -> str:
        """Return how long the others will take, or an empty string where too few frames tell."""
        (before, count), (now, done) = self._times[0], self._times[-1]
        if done - count < _TIMED or done >= self._total:
            return ""
        return f"{duration((now - before) / (done - count) * (self._total - done))} left"

    def _line(self, frame: Any, done: int, now: float) -> None:
        if now < self._next_line and done < self._total:
            return
        self._pause = min(1.5 * self._pause, _LONGEST)
        self._next_line = now + self._pause
        left = f", {left}" if (left := self._left()) else ""
        line = f"{self._name}: frame {frame.number} ({done}/{self._total}), {frame.report.alive} alive{left}"
        print(line, file=sys.stderr, flush=True)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


class BatchProgress:
    """How far a batch is: a bar for each film under way and one for all; call `hear` for each event inside the `with` block.

    total: how many jobs there are; done: how many of them already are.
    """

    def __init__(self, total: int, done: int = 0, *, quiet: bool = False):
        self._total, self._quiet = total, quiet
        self._done, self._failed = done, 0
        self._running: dict[str, float] = {}  # how much of each film is rendered, 0 to 1
        self._start, self._at_start = time.monotonic(), done
        self._bars: Any = None
        self._tasks: dict[str, Any] = {}

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr is not None and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn
            from rich.progress import Progress as Bars

            text = [TextColumn("{task.description}", markup=False), TextColumn("{task.fields[told]}", markup=False)]
            self._bars = Bars(text[0], BarColumn(), text[1], console=Console(stderr=True))
            self._bars.start()
            self._tasks[""] = self._bars.add_task("all", total=float(self._total), completed=self._done, told="")
        return self

    def hear(self, event: dict[str, Any]) -> None:
        """Show what happened: see `batch.runner.Runner`."""
        name = event.get("job", "")
        if event["event"] == "frame":
            self._running[name] = event["done"] / max(1, event["frames"])
        elif event["event"] == "job":
            self._change(name, event)
        if self._bars is not None:
            self._draw(name, event)
        elif not self._quiet and event["event"] == "job" and event["state"] != "running":
            error = f" ({event['error']})" if event.get("error") else ""
            print(f"{name}: {event['state']}{error}; {self.summary()}", file=sys.stderr, flush=True)

    def _change(self, name: str, event: dict[str, Any]) -> None:
        self._running.pop(name, None)
        if event["state"] == "running":
            self._running[name] = 0.0
        self._done += event["state"] == "done"
        self._failed += event["state"] == "failed"

    def summary(self) -> str:
        """Return how far all are, in words."""
        parts = [f"{self._done} of {self._total} done"]
        parts += [f"{self._failed} failed"] if self._failed else []
        finished = self._done - self._at_start + self._failed + sum(self._running.values())
        left = self._total - self._at_start - finished
        if finished > 0.0 and left > 0.0:
            parts.append(f"{duration((time.monotonic() - self._start) / finished * left)} left")
        return ", ".join(parts)

    def _draw(self, name: str, event: dict[str, Any]) -> None:
        for gone in [n for n in self._tasks if n and n not in self._running]:
            self._bars.remove_task(self._tasks.pop(gone))
        if name in self._running:
            if name not in self._tasks:
                self._tasks[name] = self._bars.add_task(name, total=1.0, told="starting")
            told = f"{event['done']}/{event['frames']}" if event["event"] == "frame" else "starting"
            self._bars.update(self._tasks[name], completed=self._running[name], told=told)
        whole = self._done + self._failed + sum(self._running.values())
        self._bars.update(self._tasks[""], completed=whole, told=self.summary())

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()


def duration(seconds: float) -> str:
    """Return a time as people say it: `40 s`, `12 min`, `3.5 h`."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
