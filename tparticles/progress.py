"""How far a render is, on stderr: a bar on a terminal, a line now and then elsewhere, nothing if quiet."""

from __future__ import annotations

import sys
import time
from collections import deque
from types import TracebackType
from typing import Any, Self

_WINDOW = 30.0  # [s] over which the speed is measured
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
        self._times: deque[tuple[float, int]] = deque([(time.monotonic(), 0)])

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr is not None and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
            from rich.progress import Progress as Bar

            self._bar = Bar(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("[cyan]{task.fields[alive]} alive"),
                TextColumn("eta"),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                speed_estimate_period=_WINDOW,
            )
            self._bar.start()
            self._task = self._bar.add_task(f"{self._name} (compiling)", total=self._total, alive=0)
        return self

    def step(self, frame: Any, done: int) -> None:
        """Show that `done` frames are drawn, `frame` being the latest."""
        if self._bar is not None:
            self._bar.update(self._task, completed=done, alive=frame.report.alive, description=self._name)
        elif not self._quiet:
            self._line(frame, done)

    def _line(self, frame: Any, done: int) -> None:
        now = time.monotonic()
        self._times.append((now, done))
        while len(self._times) > 2 and now - self._times[0][0] > _WINDOW:
            self._times.popleft()
        if now < self._next_line and done < self._total:
            return
        self._pause = min(1.5 * self._pause, _LONGEST)
        self._next_line = now + self._pause
        before, count = self._times[0]
        left = (now - before) / (done - count) * (self._total - done)
        eta = f", {left:.0f} s left" if done < self._total else ""
        line = f"{self._name}: frame {frame.number} ({done}/{self._total}), {frame.report.alive} alive{eta}"
        print(line, file=sys.stderr, flush=True)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
