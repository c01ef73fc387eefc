"""Checkpoints: what a killed render continues from.

A file holds the whole state of a simulation between two frames. Two of them take turns in DIR/checkpoint, so that one is whole
whatever happens while the other is written; a checkpoint appears only after all frames before it are on the disk.
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from . import __version__
from .errors import InputError
from .output.files import open_folder
from .output.sealed import Sealed, Sections, frame_of, read_sealed, write_sealed

_SLOTS = ("0.checkpoint", "1.checkpoint")
_KIND = "checkpoint"
_NO_FRAME = -(2**62)
_SHARE = 50  # one part in so many is the most of the time that checkpoints by the clock may take


@dataclass(frozen=True)
class Interval:
    """How often checkpoints are made: every `frames` simulated frames, every `seconds` of work [s], or never."""

    seconds: float = math.inf
    frames: int = 0

    @classmethod
    def read(cls, text: str) -> Interval:
        """Read `10s`, `24f` or `off`. Raises InputError."""
        found = re.fullmatch(r"(?:([0-9]{1,6}(?:\.[0-9]{1,6})?)s|([0-9]{1,9})f|off)", text.strip())
        if not found or (found[1] and not float(found[1])) or (found[2] and not int(found[2])):
            raise InputError(
                f"--checkpoint-every {text}: seconds of work such as 10s, frames such as 24f, or off is needed"
            )
        return cls(float(found[1]) if found[1] else math.inf, int(found[2] or 0))

    @property
    def never(self) -> bool:
        """Whether there are no checkpoints."""
        return self == Interval()


def write_checkpoint(path: Path, state: Sections, *, identity: str, frame: int) -> None:
    """Write the `state` of the render `identity` when frame `frame` was simulated. Raises OSError."""
    write_sealed(path, state, kind=_KIND, version=__version__, identity=identity, frame=frame)


def read_checkpoint(path: Path, *, identity: str) -> Sealed:
    """Return a checkpoint of the render `identity`. Raises InputError that names the file and why it is refused."""
    return read_sealed(path, kind=_KIND, version=__version__, identity=identity)


def newest(folder: Path, *, identity: str, usable: Callable[[int], bool], tell: Callable[[str], None]) -> Sealed | None:
    """Return the newest whole checkpoint in `folder` at a frame from which the film can go on, or None.

    `usable`: whether all that comes before this frame is there. `tell` hears of each one that is refused, by name.
    """
    found = []
    for slot in _SLOTS:
        with suppress(FileNotFoundError):
            # by what it says, not by its date: the clock may have been set back meanwhile
            at = frame_of(folder / slot)
            found.append((_NO_FRAME if at is None else at, folder / slot))
    for _, path in sorted(found, reverse=True):
        try:
            checkpoint = read_checkpoint(path, identity=identity)
        except InputError as error:
            tell(str(error))
            continue
        if usable(checkpoint.frame):
            return checkpoint
        tell(f"checkpoint {path} is refused: pictures before its frame {checkpoint.frame} are missing or damaged")
    return None


@dataclass(eq=False)
class _Pending:
    """A state on its way to the disk, and the frames that must be there first."""

    frame: int
    state: Sections
    missing: set[int]
    seconds: float


class Checkpoints:
    """Makes the checkpoints of a render that is under way; `close` it at the end.

    The state is copied by the thread that simulates; another one writes it, once all frames before it are finished.

    folder: where they go. identity: of the render. interval: between two of them; one in seconds is stretched, to
        spend a fiftieth of the time on them.
    keep: the checkpoint that the render went on from: the other slot comes first.
    before: called before one is written (makes the list of finished frames safe).
    tell: hears, once, that one could not be written; the render goes on without.
    """

    def __init__(
        self,
        folder: Path,
        *,
        identity: str,
        interval: Interval,
        keep: Sealed | None = None,
        before: Callable[[], None],
        tell: Callable[[str], None],
    ):
        self._folder, self._identity, self._interval = folder, identity, interval
        self._before, self._tell = before, tell
        self._slots = [folder / slot for slot in _SLOTS]
        if keep is not None and keep.path == self._slots[0]:
            self._slots.reverse()
        self._last_frame: int | None = None
        self._last_time = self._pause = 0.0
        self._lock = threading.Lock()  # guards what is below
        self._unfinished: set[int] = set()
        self._pending: _Pending | None = None
        self._failed = False
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="checkpoint")

    def begun(self, number: int) -> None:
        """A frame is on its way to the disk."""
        with self._lock:
            self._unfinished.add(number)

    def finished(self, number: int) -> None:
        """A frame is on the disk. May be called on any thread."""
        with self._lock:
            self._unfinished.discard(number)
            if self._pending is not None and number in self._pending.missing:
                self._pending.missing.discard(number)
                self._write_if_ready()

    def after(self, number: int, snapshot: Callable[[], Sections]) -> None:
        """Frame `number` has been simulated: take a `snapshot` if it is time and none is on its way."""
        start = time.monotonic()
        if self._last_frame is None:
            self._last_frame, self._last_time = number - 1, start
        if not self._due(number, start):
            return
        state = snapshot()
        now = time.monotonic()
        with self._lock:
            self._last_frame, self._last_time = number, now
            self._pending = _Pending(number, state, set(self._unfinished), now - start)
            self._write_if_ready()

    def close(self) -> None:
        """Finish what is being written, drop what waits."""
        self._writer.shutdown(cancel_futures=True)

    def _due(self, number: int, now: float) -> bool:
        with self._lock:
            if self._pending is not None or self._last_frame is None:
                return False
            if self._interval.frames:
                return number - self._last_frame >= self._interval.frames
            return now - self._last_time >= max(self._interval.seconds, self._pause)

    def _write_if_ready(self) -> None:
        if self._pending is not None and not self._pending.missing:
            self._writer.submit(self._write, self._pending)

    def _write(self, pending: _Pending) -> None:
        start = time.monotonic()
        try:
            self._before()
            open_folder(self._folder, "|".join(map(re.escape, _SLOTS)))
            write_checkpoint(self._slots[0], pending.state, identity=self._identity, frame=pending.frame)
            self._slots.reverse()
        except Exception as error:  # whatever it is, the film is worth more
            if not self._failed:
                self._tell(f"no checkpoint of frame {pending.frame}: {error}; the render goes on")
            self._failed = True
        finally:
            with self._lock:
                self._pause = _SHARE * (pending.seconds + time.monotonic() - start)
                self._pending = None
