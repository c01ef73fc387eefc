"""Files that are whole or not there: temporary name in the same folder, fsync, rename."""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ..errors import RunError

_TEMPORARY = re.compile(r"\.(?P<name>.+)\.[0-9a-f]{8}\.tmp")
FRAME_NAME = r"\d{6,}"


def frame_path(folder: Path, number: int, suffix: str) -> Path:
    """Return where frame `number` lives: `folder/000001.png`, with more digits after a million frames."""
    return folder / f"{number:06d}{suffix}"


def temporary_path(path: Path) -> Path:
    """Return a hidden name in the folder of `path` that no other run uses and that `remove_leftovers` knows."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file to write that appears as `path` when the block ends well, and not at all when it raises.

    Raises OSError as the system says it: no space, no permission, a folder that is gone.
    """
    temporary = temporary_path(path)
    try:
        with open(temporary, "xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


def publish(temporary: Path, path: Path) -> None:
    """Flush a file that another process wrote to the disk and give it its final name. Raises OSError."""
    with open(temporary, "rb+") as file:
        os.fsync(file.fileno())
    os.replace(temporary, path)


def final_name(path: Path) -> str | None:
    """Return the name that a temporary file of ours would have got, or None for any other file."""
    match = _TEMPORARY.fullmatch(path.name)
    return match["name"] if match else None


def remove_leftovers(folder: Path, names: str) -> None:
    """Remove temporary files that a killed run left in `folder`, whose final name matches the expression `names`."""
    for path in folder.glob(".*.tmp"):
        name = final_name(path)
        if name is not None and re.fullmatch(names, name):
            path.unlink(missing_ok=True)


def open_folder(folder: Path, names: str) -> None:
    """Create `folder` if need be and clear it of the leftovers of a killed run. Raises RunError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder, names)
    except OSError as error:
        raise RunError(f"cannot use the folder {folder}: {reason(error)}") from error


def reason(error: OSError) -> str:
    """Return what the system said, without the number and the path."""
    return error.strerror or str(error)


def frames_finished(count: int) -> str:
    """Return the words that tell the user what is not lost."""
    return f"{count} frame{' is' if count == 1 else 's are'} finished and safe"
