"""What a batch will take, before it begins: frames, bytes, and time from a short probe."""

from __future__ import annotations

import queue
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import RunError
from ..job import Job
from .local import Child
from .record import Entry

_MOST_PROBES = 4  # kinds of film that are probed; others are taken for the last one
_LONGEST = 8.0  # [s] of one probe's frames
_FRAMES = 24
_STUCK = 300.0  # [s] until a probe that says nothing is given up


@dataclass(frozen=True)
class Cost:
    """What a film costs: [s] until its first frame, [s] and bytes a frame."""

    start: float
    frame: float
    bytes: float


def estimate(
    found: list[tuple[Entry, Job]], *, workers: int, threads: int | None, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Return frames, bytes and seconds that the films of `found` will take together, from probes of their beginnings.

    A film that fills up with particles takes longer than its beginning: the time is a lower bound.
    Raises RunError: a probe failed, with what it said.
    """
    costs: dict[Any, Cost] = {}
    frames, size, seconds = 0, 0.0, 0.0
    for entry, job in found:
        kind = (job.script.path, job.size, job.options.quality, job.options.png, job.options.mp4, job.options.states)
        if kind not in costs:
            if len(costs) < _MOST_PROBES:
                tell(f"probing {entry.task.name}")
                costs[kind] = _probe(entry, job, threads)
            else:
                costs[kind] = list(costs.values())[-1]
        cost = costs[kind]
        simulated = job.frames[-1]  # the others are simulated, though not drawn
        frames += len(job.frames)
        size += len(job.frames) * cost.bytes
        seconds += cost.start + simulated * cost.frame
    return {"jobs": len(found), "frames": frames, "bytes": round(size), "seconds": round(seconds / workers, 1)}


def _probe(entry: Entry, job: Job, threads: int | None) -> Cost:
    """Render the beginning of a film into a folder of its own, in a process as the batch does."""
    row = entry.task.row()
    last = min(_FRAMES, job.scene.frame_count)
    row["options"] = {**row["options"], "frames": f"1-{last}"}
    with tempfile.TemporaryDirectory(prefix="tparticles-", ignore_cleanup_errors=True) as folder:
        out = Path(folder) / "film"
        order = {"task": row, "out": str(out), "folder": None, "existing": "error", "again": False, "threads": threads}
        order["patience"] = 1.0
        told: queue.SimpleQueue[tuple[str, dict[str, Any]]] = queue.SimpleQueue()
        begun = time.monotonic()
        child = Child(entry.task.name, order, told, Path(folder) / "logs" / "log")
        ready = at = begun
        done = 1
        try:
            while True:
                event = told.get(timeout=_STUCK)[1]
                now = time.monotonic()
                if event["event"] == "end":
                    break
                if event["event"] == "ready":
                    ready = now
                    child.go()
                at, done = now, event["done"]
                if now - ready > _LONGEST:
                    child.stop()
        except queue.Empty:
            raise RunError(f"job '{entry.task.name}': a probe said nothing for {_STUCK:.0f} s") from None
        finally:
            child.stop()
        if event["code"] and ready == begun:
            raise RunError(f"job '{entry.task.name}': {event.get('error')}")
        written = sum(path.stat().st_size for path in out.rglob("*") if path.suffix in (".png", ".mp4", ".npz"))
    return Cost(ready - begun, (at - ready) / max(1, done - 1), written / done)
