"""The processes that render the shards of a film on this machine: started in turn, heard when they fail, ended with us."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from . import output
from .errors import InputError, RunError, TparticlesError
from .job import Job
from .simulation import Share

PARENT = "TPARTICLES_PARENT"  # of the environment: the process that a shard works for
_LOOK = 0.01  # [s] between two looks for a piece
_PATIENCE = 10.0  # [s] for a shard that is told to stop


def missing(index: int, path: Path) -> None:
    """Say that a piece is not there, and who makes it. Raises RunError."""
    raise RunError(f"{path} is missing: render it with --shard {index + 1}")


class Crew:
    """The processes that render the shards of a film on this machine."""

    def __init__(self, job: Job, count: int, workers: int, command: list[str], log: Sequence[str]):
        self._job, self._command, self._workers, self._log = job, command, workers, log
        self._waiting = [Share(index, count) for index in range(count)]
        self._running: dict[int, subprocess.Popen[str]] = {}
        self._merged = 0

    def begin(self, merged: int) -> None:
        """Start the first processes; frames up to `merged` are done."""
        self._merged = merged
        if not self._job.options.resume:
            shutil.rmtree(self._job.out / output.SHARDS, ignore_errors=True)
        self._fill()

    def wait(self, index: int, path: Path) -> None:
        """Wait a moment for a piece of a shard. Raises what a shard failed with."""
        self._collect()
        self._fill()
        if index not in self._running and all(share.index != index for share in self._waiting) and not path.exists():
            missing(index, path)
        time.sleep(_LOOK)

    def _collect(self) -> None:
        for other, process in list(self._running.items()):
            if process.poll() is not None:
                del self._running[other]
                said = process.communicate()[1]
                if process.returncode:
                    raise _failure(other, process.returncode, said)

    def finish(self) -> None:
        """Let those that have drawn all come to their ends. Raises what a shard failed with."""
        while self._running:
            self._collect()
            time.sleep(_LOOK)

    def stop(self) -> None:
        """End the processes that run."""
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            try:
                process.communicate(timeout=_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()

    def _fill(self) -> None:
        while self._waiting and len(self._running) < self._workers:
            share = self._waiting.pop(0)
            self._running[share.index] = subprocess.Popen(
                [
                    *(*self._command, *(self._log if share.index == 0 else ())),
                    *("--quiet", "--shard", str(share.index + 1), "--merged", str(self._merged)),
                ],
                env=os.environ | {PARENT: str(os.getpid())},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,  # Ctrl-C is ours to pass on
            )


def _failure(index: int, code: int, said: str) -> TparticlesError:
    """Return what a shard ended with: the last line that it said."""
    lines = said.strip().splitlines()
    last = lines[-1].removeprefix("error: ") if lines else f"it ended with code {code}"
    kind = InputError if code == InputError.exit_code else RunError
    return kind(f"shard {index + 1}: {last}")
