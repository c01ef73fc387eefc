"""What a writer is, what it is given, and the two writers that need no file."""

from __future__ import annotations

import hashlib
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np


@dataclass(frozen=True, eq=False)
class OutputFrame:
    """One finished frame on its way to the files.

    The arrays belong to whoever receives the frame: hand over fresh ones and do not write to them afterwards.

    number: counts from 1.
    image: sRGB, uint8, shape (h, w, 3).
    provenance: what made the picture (version, scene hash, frame, seed, scheme); goes into the PNG as text. No times,
        hosts or paths, so that equal pictures are equal files.
    states: the live state, one array per attribute, or None.
    Raises ValueError for another dtype or shape, or for a number below 1.
    """

    number: int
    image: np.ndarray
    provenance: dict[str, str] = field(default_factory=dict)
    states: dict[str, np.ndarray] | None = None

    def __post_init__(self) -> None:
        if self.number < 1:
            raise ValueError(f"number is {self.number}: frames count from 1")
        shape, dtype = self.image.shape, self.image.dtype
        if dtype != np.uint8 or len(shape) != 3 or shape[2] != 3 or 0 in shape:
            raise ValueError(f"image is {dtype} {shape}: must be uint8 of shape (h, w, 3), not empty")


class Writer(Protocol):
    """Where frames go. `write` runs on a worker thread; `close` or `abort` is called once, when no `write` runs."""

    @property
    def ordered(self) -> bool:
        """True if frames must come one at a time, in order; False if `write` may run on several threads at once."""
        ...

    def write(self, frame: OutputFrame) -> None:
        """Write one frame. Raises RunError if it cannot be written."""
        ...

    def close(self) -> None:
        """Finish and verify. Raises RunError if what was written is not all there."""
        ...

    def abort(self) -> None:
        """Stop early: keep what is finished, leave nothing half-written, raise nothing."""
        ...


class Null:
    """Takes every frame and writes nothing."""

    ordered: bool = False

    def write(self, frame: OutputFrame) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def abort(self) -> None:
        """Do nothing."""


class Tee:
    """Several writers as one, called in turn.

    A `Pipeline` takes several writers itself and runs them side by side, which is faster.
    """

    def __init__(self, *writers: Writer) -> None:
        self._writers = writers
        self.ordered: bool = any(writer.ordered for writer in writers)

    def write(self, frame: OutputFrame) -> None:
        """Write the frame with each writer; the first error stops."""
        for writer in self._writers:
            writer.write(frame)

    def close(self) -> None:
        """Close every writer, also those after one that fails; the first error is raised."""
        close_all(self._writers)

    def abort(self) -> None:
        """Abort every writer."""
        abort_all(self._writers)


def close_all(writers: tuple[Writer, ...]) -> None:
    """Close every writer, also those after one that fails, then raise the first error."""
    error = None
    for writer in writers:
        try:
            writer.close()
        except BaseException as raised:  # an interruption too: no writer may be left open
            error = error or raised
            writer.abort()
    if error is not None:
        raise error


def abort_all(writers: tuple[Writer, ...]) -> None:
    """Abort every writer, also those after one that raises."""
    with ExitStack() as stack:
        for writer in reversed(writers):
            stack.callback(writer.abort)


def pixel_hash(image: np.ndarray) -> str:
    """Return the SHA-256 of a picture's shape and pixels, as 64 hex digits.

    image: uint8, shape (h, w, 3). Files are no measure of equality: PNG bytes change with the zlib version.
    """
    digest = hashlib.sha256(f"{image.dtype} {'x'.join(map(str, image.shape))}\n".encode())
    digest.update(np.ascontiguousarray(image).data)
    return digest.hexdigest()
