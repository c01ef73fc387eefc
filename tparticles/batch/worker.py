"""One process, one film: `python -m tparticles.batch.worker` reads its order on stdin and tells on stdout how far it is.

Both are JSON, a line each. The film waits behind its first frame for the line `go`: until then, imports, kernels and particles get
ready beside the films that are rendered. The end of stdin means that whoever asked is gone: what is finished is kept.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any, NoReturn

from ..cli import INTERRUPTED, _explain, _interrupts, collect_seldom
from ..command_options import stdout_kept
from ..errors import InputError

_OFTEN = 0.2  # [s] between two lines about frames


class _Channel:
    """The way back to whoever asked."""

    def __init__(self) -> None:
        self._file = os.fdopen(os.dup(1), "w", encoding="utf-8")

    def tell(self, event: str, **more: Any) -> None:
        """Send one event; raises KeyboardInterrupt if nobody listens any more."""
        try:
            self._file.write(json.dumps({"event": event, **more}) + "\n")
            self._file.flush()
        except OSError:
            raise KeyboardInterrupt from None


class _Gate:
    """Opens when `go` comes; if stdin ends, the process is interrupted."""

    def __init__(self) -> None:
        self._open = threading.Event()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        for line in sys.stdin:
            if line.strip() == "go":
                self._open.set()
        os.kill(os.getpid(), signal.SIGTERM)

    def wait(self) -> None:
        """Wait for it; an interruption passes."""
        while not self._open.wait(1.0):
            pass


def render(order: dict[str, Any], channel: _Channel, gate: _Gate, signals: list[int]) -> dict[str, Any]:
    """Render what is ordered; return what the end tells of it."""
    from ..job import Frame
    from ..output import held_folder
    from .standing import finished, make_job
    from .tasks import Task

    out, existing, again = Path(order["out"]), order["existing"], order["again"]
    with held_folder(out, patience=order["patience"]):
        pass  # the process that had this job before may be on its way out
    job = make_job(Task.of(order["task"]), out, existing=existing, threads=order["threads"], again=again)
    total = len(job.frames)
    if existing != "overwrite" and finished(job):
        return {"skipped": True, "frames": total}
    next_line = 0.0

    def step(frame: Frame, done: int) -> None:
        nonlocal next_line
        if signals:  # an import or a destructor may swallow the exception
            raise KeyboardInterrupt
        if not next_line:
            channel.tell("ready", arch=frame._simulation.backend.arch, peak=_peak(), done=done, frames=total)
            gate.wait()
        now = time.monotonic()
        if now >= next_line or done == total:
            channel.tell("frame", done=done, frames=total)
            next_line = now + _OFTEN

    job.run(step)
    return {"frames": total}


def _peak() -> int:
    """Return the most memory that the process has had so far [bytes]."""
    try:
        import resource
    except ImportError:
        return 0
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return used if sys.platform == "darwin" else 1024 * used


def main() -> NoReturn:
    """Take one order, tell how it ends, and leave with its exit code."""
    collect_seldom()
    channel, signals = _Channel(), list[int]()
    code, end = 0, {}
    try:
        with _interrupts(signals), stdout_kept():
            line = sys.stdin.readline()
            if not line:
                raise KeyboardInterrupt
            try:
                order = json.loads(line)
            except ValueError:
                raise InputError(
                    "a worker reads its order as JSON on stdin: use `tparticles sweep` or `batch`"
                ) from None
            end = render(order, channel, _Gate(), signals)
    except KeyboardInterrupt:
        code, end = INTERRUPTED, {"error": "interrupted"}
    except Exception as error:
        message, code = _explain(error)
        code, message = (INTERRUPTED, "interrupted") if signals else (code, " ".join(message.split()))
        end = {"error": message}
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # all is told: the end of stdin has nothing left to stop
    with contextlib.suppress(KeyboardInterrupt):
        channel.tell("end", code=code, **end)
    sys.exit(code)


if __name__ == "__main__":
    main()
