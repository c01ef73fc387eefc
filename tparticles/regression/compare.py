"""Two pictures, two folders of frames, or two films, held against each other picture by picture."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..errors import InputError
from ..output.ffmpeg import find_ffmpeg
from ..output.files import reason
from .pictures import check_pixels, read_png
from .tolerance import USUAL, Tolerance
from .verdict import Verdict, Word, judge

_FILMS = (".mp4", ".m4v", ".mov")


@dataclass(frozen=True)
class Pair:
    """The outcome for one picture; `name` is that of its file, or `frame N` of a film."""

    name: str
    verdict: Verdict

    def row(self) -> dict[str, Any]:
        """Return it as a row of the JSON."""
        metrics = self.verdict.metrics
        return {
            "picture": self.name,
            "outcome": str(self.verdict.word),
            "message": self.verdict.text,
            "metrics": metrics and metrics.row(),
        }


def pairs(first: Path, second: Path, *, limits: Tolerance = USUAL) -> Iterator[Pair]:
    """Compare the pictures of two PNG files, folders or films; `first` is the reference.

    Raises:
        InputError: one is not there, cannot be read, or the two are not of one kind.
    """
    kinds = _kind(first), _kind(second)
    if kinds[0] != kinds[1]:
        raise InputError(f"{first} is a {kinds[0]}, {second} a {kinds[1]}: two of one kind are needed")
    if kinds[0] == "folder":
        yield from _folders(first, second, limits)
    elif kinds[0] == "film":
        yield from _films(first, second, limits)
    else:
        yield Pair(second.name, judge(read_png(first), read_png(second), limits))


def summary(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return the lines for people: each picture that differs, and how many do not."""
    lines = [f"{row['outcome']:10} {row['picture']}: {row['message']}" for row in rows if row["message"]]
    same = sum(row["outcome"] == "same" for row in rows)
    close = sum(row["outcome"] == "close" for row in rows)
    return [
        *lines,
        f"{len(rows)} compared: {same} the same, {close} within the tolerance, {len(rows) - same - close} different",
    ]


def _kind(path: Path) -> str:
    try:
        if path.is_dir():
            return "folder"
        if not path.exists():
            raise InputError(f"{path} does not exist")
    except (OSError, ValueError) as error:
        raise InputError(f"{str(path)[:200]!r} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    return "film" if path.suffix.lower() in _FILMS else "picture"


def _folders(first: Path, second: Path, limits: Tolerance) -> Iterator[Pair]:
    files = [{path.name: path for path in _frames(folder)} for folder in (first, second)]
    for name in sorted(files[0].keys() | files[1].keys()):
        missing = [str(folder) for folder, held in zip((first, second), files, strict=True) if name not in held]
        if missing:
            yield Pair(name, Verdict(Word.MISSING, f"it is not in {missing[0]}"))
        else:
            yield Pair(name, judge(read_png(files[0][name]), read_png(files[1][name]), limits))


def _frames(folder: Path) -> list[Path]:
    """Return the PNG files of a folder, or of its `frames` where it is the output of a render."""
    try:
        found = list(folder.glob("*.png")) or list((folder / "frames").glob("*.png"))
    except OSError as error:
        raise InputError(f"{folder} cannot be read: {reason(error).lower()}") from None
    if not found:
        raise InputError(f"{folder} holds no PNG files")
    return found


def _films(first: Path, second: Path, limits: Tolerance) -> Iterator[Pair]:
    for number, (a, b) in enumerate(zip_longest(_film(first), _film(second)), start=1):
        name = f"frame {number}"
        if a is None or b is None:
            ended = first if a is None else second
            yield Pair(name, Verdict(Word.MISSING, f"{ended} has {number - 1} frames, the other more"))
            return
        yield Pair(name, judge(a, b, limits))


def _film(path: Path) -> Iterator[np.ndarray]:
    """Yield the frames of a film, decoded by ffmpeg, which may open this file and no other.

    Raises:
        InputError: it is no film, or damaged; BackendError: there is no ffmpeg.
    """
    command = [find_ffmpeg(), "-nostdin", "-loglevel", "quiet", "-xerror", "-err_detect", "explode"]
    command += ["-protocol_whitelist", "file,pipe", "-f", "mov", "-i", f"file:{path.absolute()}"]
    command += ["-map", "0:v:0", "-fps_mode", "passthrough", "-f", "image2pipe", "-c:v", "ppm", "pipe:1"]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        try:
            yield from _ppm(path, process.stdout)
        finally:
            process.stdout.close()  # it ends at once if nobody wants the rest
    if process.returncode:
        raise InputError(f"{path} cannot be read as a film")


def _ppm(path: Path, stream: IO[bytes]) -> Iterator[np.ndarray]:
    """Yield the pictures of a stream of binary PPM files."""
    while stream.readline() == b"P6\n":
        width, height = map(int, stream.readline().split())
        check_pixels(path, width, height)
        stream.readline()  # 255, the largest value
        data = stream.read(3 * width * height)
        if len(data) < 3 * width * height:
            return  # ffmpeg's exit code tells why
        yield np.frombuffer(data, np.uint8).reshape(height, width, 3)
