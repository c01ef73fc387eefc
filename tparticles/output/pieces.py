"""Pieces: what one shard puts on a film, frame by frame, to be summed with the others'.

A film is a sum of integers (i64), so the sum of the pieces is the film of all particles, to the bit, in whatever order they come.
Blocks of pixels without light are left out, the others take as few bytes a number as they need.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .files import frame_path
from .sealed import Sections, read_sealed, write_sealed

_KIND = "film"
_BLOCK = 192  # numbers, 64 pixels
_TYPES = ("i2", "i4", "i8")


def piece_path(folder: Path, number: int) -> Path:
    """Return where the piece of a frame lies."""
    return frame_path(folder, number, ".film")


def write_piece(
    folder: Path, sums: np.ndarray, row: dict[str, Any], *, version: str, identity: str, more: Sections | None = None
) -> None:
    """Write the film `sums` (i64, shape (h, w, 3)) of the frame that `row` reports on, and what else the shard has of it.

    Raises OSError.
    """
    size = {"height": sums.shape[0], "width": sums.shape[1]}
    sections: Sections = {"row": row, "size": size, "film": _packed(sums), **(more or {})}
    write_sealed(
        piece_path(folder, row["frame"]), sections, kind=_KIND, version=version, identity=identity, frame=row["frame"]
    )


def add_piece(folder: Path, number: int, total: np.ndarray, *, version: str, identity: str) -> dict[str, Any]:
    """Add the film of frame `number` to `total` (i64, shape (h, w, 3)); return all that the piece holds, its `row` above all.

    Raises:
        InputError: it is missing, damaged, or of another scene, version or size; names the file.
    """
    found = read_sealed(piece_path(folder, number), kind=_KIND, version=version, identity=identity)
    size = found.sections["size"]
    if (size["height"], size["width"], 3) != total.shape or found.frame != number:
        raise InputError(f"film {found.path} is refused: it is of another size or frame")
    _add(found.sections["film"], total)
    return dict(found.sections)


def _packed(sums: np.ndarray) -> dict[str, np.ndarray]:
    """Return for each type the numbers of the blocks that need it, and their values."""
    flat = sums.reshape(-1)
    if flat.size % _BLOCK:
        flat = np.pad(flat, (0, -flat.size % _BLOCK))
    blocks = flat.reshape(-1, _BLOCK)
    low, high = blocks.min(axis=1), blocks.max(axis=1)
    left, packed = (low != 0) | (high != 0), {}
    for kind in _TYPES:
        limits = np.iinfo(kind)
        fits = left & (low >= limits.min) & (high <= limits.max)
        left &= ~fits
        where = np.flatnonzero(fits).astype(np.int32)
        packed[f"{kind} blocks"] = where
        packed[kind] = (blocks if len(where) == len(blocks) else blocks[where]).astype(kind)
    return packed


def _add(packed: Mapping[str, np.ndarray], total: np.ndarray) -> None:
    flat = total.reshape(-1)
    whole = flat.size // _BLOCK
    blocks, rest = flat[: whole * _BLOCK].reshape(-1, _BLOCK), flat[whole * _BLOCK :]
    for kind in _TYPES:
        where, values = packed[f"{kind} blocks"], packed[kind]
        if len(where) and where[-1] == whole:  # the last block is not full
            rest += values[-1][: len(rest)]
            where, values = where[:-1], values[:-1]
        if len(where) == whole:
            blocks += values
        else:
            blocks[where] += values
