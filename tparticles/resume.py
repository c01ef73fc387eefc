"""What an unfinished render left behind, and where to go on: frames that are whole, and the state after the last of them."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .checkpoint import newest
from .output import pixel_hash, read_png
from .output.files import frame_path
from .output.sealed import Sealed

_WORKERS = 2  # threads that decode pictures

Check = Callable[[int, Mapping[str, Any]], bool]  # whether the files of a frame are what its row in run.json says


@dataclass(frozen=True)
class Start:
    """Where a render sets out: `kept` frames are there, the `others` follow the state of `checkpoint`, or the film's beginning."""

    others: tuple[int, ...]
    kept: tuple[int, ...] = ()
    checkpoint: Sealed | None = None


def find_start(
    frames: Sequence[int],
    rows: Sequence[Mapping[str, Any]],
    *,
    check: Check,
    folder: Path,
    identity: str,
    tell: Callable[[str], None],
    anywhere: bool = False,
) -> Start:
    """Return where to go on with a film of `frames`, of which an earlier run finished those with `rows`.

    check: tells whether the files of a finished frame are whole. folder: of the checkpoints. tell: hears what is refused and why.
    anywhere: whether a frame can be made without those before it.
    """
    whole = _whole(frames, {row["frame"]: row for row in rows}, check)
    first_missing = next((n for n in frames if n not in whole), None)
    if first_missing is None:
        return Start(others=(), kept=tuple(frames))
    if anywhere:
        return Start(tuple(n for n in frames if n >= first_missing), tuple(n for n in frames if n < first_missing))
    found = newest(folder, identity=identity, usable=lambda frame: frame < first_missing, tell=tell)
    at = frames[0] - 1 if found is None else found.frame
    return Start(tuple(n for n in frames if n > at), tuple(n for n in frames if n <= at), found)


def _whole(frames: Sequence[int], rows: Mapping[int, Mapping[str, Any]], check: Check) -> set[int]:
    def is_whole(number: int) -> bool:
        try:
            return number in rows and check(number, rows[number])
        except OSError:
            return False

    with ThreadPoolExecutor(_WORKERS) as pool:
        return {number for number, whole in zip(frames, pool.map(is_whole, frames), strict=True) if whole}


def picture_check(pictures: Path | None, states: Path | None, size: tuple[int, int]) -> Check:
    """Return the check of frames in the folders `pictures` and `states`, where there are any."""

    def check(number: int, row: Mapping[str, Any]) -> bool:
        if states is not None and not zipfile.is_zipfile(frame_path(states, number, ".npz")):
            return False
        if pictures is None:
            return True
        image = read_png(frame_path(pictures, number, ".png"), size)
        return image is not None and pixel_hash(image) == row.get("sha256")

    return check


def with_last(check: Check, number: int, path: Path) -> Check:
    """Return a check that has the last frame, `number`, drawn again where `path` is not there, which comes with it."""
    return lambda frame, row: (frame != number or path.is_file()) and check(frame, row)
