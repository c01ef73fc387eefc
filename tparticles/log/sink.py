"""The near end of a log: memory for rows, shared with the process that writes them."""

from __future__ import annotations

import contextlib
import mmap
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RunError
from ..stepping.rows import Rows
from . import layout, writer

_BLOCKS = 3  # of each mesh: one is filled while the others are written
_IN_MEMORY = "/dev/shm"
_PACKAGES = str(Path(__file__).parents[2])


class MeshSink:
    """Takes the rows of one mesh: a `Sink`."""

    def __init__(self, log: LogWriter, index: int, blocks: Sequence[Rows]):
        self._log, self._index, self._blocks = log, index, blocks
        self._free = list(range(len(blocks)))
        self._used: dict[int, int] = {id(rows): n for n, rows in enumerate(blocks)}
        self.given = time.monotonic()

    def take(self) -> Rows:
        """Return empty rows; waits for the writer where all are full."""
        while not self._free:
            self._log.hear()
        rows = self._blocks[self._free.pop()]
        rows.filled, rows.events[0, 0] = 0, 0.0
        return rows

    def give(self, rows: Rows) -> None:
        """Have filled rows written."""
        self._log.send("rows", self._index, self._used[id(rows)], rows.filled)
        self.given = time.monotonic()

    def rewind(self, rows: int, time: float) -> None:
        """Forget all rows but the first ones, and the contacts from `time` [s] on."""
        self._log.send("rewind", self._index, rows, time)

    def freed(self, block: int) -> None:
        """A block was written."""
        self._free.append(block)


class LogWriter:
    """Writes a log through a process of its own. `close` it in the end.

    Arguments:
        path: the file; one that is there is replaced, or, up to the rows that `earlier` counts (see `mark`), continued.
        header: what the log says of its run.
        meshes, particles: what is logged; for meshes `name`, `attributes`, `arrays` that stay, `vertices` and `kind` of the rows;
            for groups of particles `name`, `attributes`, `columns` (components and type by name).

    Nobody waits for the process to start: whether the log can be written is heard of where it is used, as a RunError.
    """

    def __init__(
        self,
        path: Path,
        header: Mapping[str, Any],
        meshes: Sequence[Mapping[str, Any]],
        particles: Sequence[Mapping[str, Any]],
        earlier: Mapping[str, int] | None = None,
    ):
        self.path = path
        self._marked: dict[str, int] | None = None
        self._failure = "its writer has ended"  # what the writer says of it, if it does
        places, size = _places(meshes)
        shared = [{**m, "places": blocks} for m, blocks in zip(meshes, places, strict=True)]
        contents = pickle.dumps((path, dict(header), shared, list(particles), earlier), pickle.HIGHEST_PROTOCOL)
        with tempfile.NamedTemporaryFile(
            dir=_roomy_folder(size + len(contents))
        ) as file:  # its name goes, the memory stays
            file.truncate(size)
            self._memory = mmap.mmap(file.fileno(), size)
            # Not through the pipe: what is longer than a pipe holds would wait until the process has started.
            file.seek(size)
            file.write(contents)
            file.flush()
            paths = os.pathsep.join([_PACKAGES, os.environ.get("PYTHONPATH", "")])
            self._process = subprocess.Popen(
                [sys.executable, "-m", writer.__name__, str(file.fileno()), str(size)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                pass_fds=[file.fileno()],
                env=os.environ | {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"},  # its threads spin for a while
                start_new_session=True,  # Ctrl-C is the simulation's, which then ends the log
            )
            self.sinks = [
                MeshSink(self, n, [layout.block(self._memory, place, m["vertices"], m["kind"]) for place in blocks])
                for n, (m, blocks) in enumerate(zip(meshes, places, strict=True))
            ]

    def send(self, *message: Any) -> None:
        """Tell the writer. Raises RunError if it has failed."""
        self._tell(message)

    def _tell(self, message: Any) -> None:
        assert self._process.stdin
        try:
            pickle.dump(message, self._process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
            self._process.stdin.flush()
        except OSError:
            self._listen()
            raise self._broken() from None

    def hear(self) -> None:
        """Wait for what the writer says. Raises RunError if it has failed."""
        if not self._reply():
            raise self._broken()

    def _listen(self) -> None:
        """Hear all that the writer has to say until it ends."""
        while self._reply():
            pass

    def _reply(self) -> bool:
        """Take the next reply; return False if there is none to come."""
        assert self._process.stdout
        try:
            kind, *content = pickle.load(self._process.stdout)
        except (EOFError, OSError):
            return False
        if kind == "failed":
            self._failure = content[0]
            raise self._broken()
        if kind == "marked":
            self._marked = content[0]
        if kind == "free":
            self.sinks[content[0]].freed(content[1])
        return True

    def _broken(self) -> RunError:
        return RunError(f"cannot write {self.path}: {self._failure}")

    def torn(self, mesh: int, time: float, springs: np.ndarray) -> None:
        """Note springs that were torn by `time` [s]."""
        self.send("torn", mesh, time, springs)

    def particles(self, group: int, frame: int, time: float, columns: Mapping[str, np.ndarray]) -> None:
        """Log a group at a frame."""
        self.send("particles", group, frame, time, dict(columns))

    def mark(self) -> dict[str, int]:
        """Wait until all that was given is written; return how many rows of everything that makes."""
        self._marked = None
        self.send("mark")
        while self._marked is None:
            self.hear()
        return self._marked

    def close(self, *, complete: bool) -> None:
        """Have all written; `complete`: the run has come to its end. Raises RunError if it cannot be written."""
        try:
            self.send("end", int(complete))
            self._listen()
        finally:
            code = self._end()
        if code != 0:
            raise self._broken()

    def _end(self) -> int:
        """Let the writer end; return its exit code."""
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe
            with contextlib.suppress(OSError):
                pipe.close()
        return self._process.wait()


def _places(meshes: Sequence[Mapping[str, Any]]) -> tuple[list[list[int]], int]:
    """Return where the blocks of each mesh begin in the shared memory, and how much it is."""
    places, end = [], 0
    for mesh in meshes:
        size = layout.block_bytes(mesh["vertices"], mesh["kind"])
        places.append([end + n * size for n in range(_BLOCKS)])
        end += _BLOCKS * size
    return places, max(end, 1)


def _roomy_folder(size: int) -> str | None:
    """Return a folder in memory, where there is one with room for so many bytes."""
    try:
        return _IN_MEMORY if shutil.disk_usage(_IN_MEMORY).free > 2 * size else None
    except OSError:
        return None
