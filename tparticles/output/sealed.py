"""A file of numbers and arrays that is whole or refused: what checkpoints and films in pieces are kept in.

Layout: a line `tparticles KIND 1`, a line of JSON (version, identity, frame, the names, types and shapes), the arrays one after
another, and the SHA-256 of all that. No pickle: reading one runs no code.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .files import atomic_file, reason

_FORMAT = 1
_TRAILER = hashlib.sha256().digest_size
_LONGEST_HEADER = 1 << 20  # bytes

Sections = Mapping[str, Mapping[str, Any]]  # named numbers and arrays


@dataclass(frozen=True)
class Sealed:
    """What a file holds: the number of a frame, and sections of named numbers and arrays."""

    path: Path
    frame: int
    sections: Sections


def write_sealed(path: Path, sections: Sections, *, kind: str, version: str, identity: str, frame: int) -> None:
    """Write `sections` to `path`, which appears whole or not at all.

    kind: a word; version: of the program; identity: of the render. Raises OSError.
    """
    arrays, described = [], {}
    for section, values in sections.items():
        described[section] = {}
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                arrays.append(np.ascontiguousarray(value))
                value = {"dtype": value.dtype.str, "shape": value.shape}
            described[section][name] = value
    header = {"version": version, "identity": identity, "frame": frame, "sections": described}
    head = f"tparticles {kind} {_FORMAT}\n{json.dumps(header, default=_plain)}\n".encode("ascii")
    digest = hashlib.sha256()
    with atomic_file(path) as file:
        for part in (head, *(array.reshape(-1).view(np.uint8).data for array in arrays)):
            digest.update(part)
            file.write(part)
        file.write(digest.digest())


def _plain(value: Any) -> Any:
    """Return a NumPy scalar as JSON can hold it."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} ({type(value).__name__}) cannot be kept")


def read_sealed(path: Path, *, kind: str, version: str, identity: str) -> Sealed:
    """Return what `path` holds.

    Raises:
        InputError: it cannot be read, is cut or damaged, or is of another kind, format, version or identity; names the file.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{kind} {path} cannot be read: {reason(error)}") from None
    head = re.match(rb"tparticles %s (\d{1,9})\n" % kind.encode(), content)
    if not head:
        raise InputError(f"{kind} {path} is refused: it is no {kind}")
    if int(head[1]) != _FORMAT:
        raise InputError(f"{kind} {path} is refused: it has format {int(head[1])}, this program reads {_FORMAT}")
    if hashlib.sha256(memoryview(content)[:-_TRAILER]).digest() != content[-_TRAILER:]:
        raise InputError(f"{kind} {path} is refused: it is cut or damaged, its checksum is wrong")
    end = content.index(b"\n", head.end())
    header = json.loads(content[head.end() : end])
    if header["version"] != version:
        raise InputError(f"{kind} {path} is refused: it is of tparticles {header['version']}, this is {version}")
    if header["identity"] != identity:
        raise InputError(f"{kind} {path} is refused: it is of another scene or other settings")
    return Sealed(path, header["frame"], _unpacked(header["sections"], content, end + 1))


def _unpacked(sections: dict[str, dict[str, Any]], content: bytes, offset: int) -> Sections:
    """Return the sections with their arrays, which lie in `content` from `offset` on."""
    for values in sections.values():
        for name, value in values.items():
            if isinstance(value, dict):
                dtype, shape = np.dtype(value["dtype"]), value["shape"]
                count = math.prod(shape)
                values[name] = np.frombuffer(content, dtype, count, offset).reshape(shape)
                offset += count * dtype.itemsize
    return sections


def frame_of(path: Path) -> int | None:
    """Return the frame that a file says it is of, whole or not; None if it says none. Raises FileNotFoundError."""
    try:
        with open(path, "rb") as file:
            file.readline(100)
            return int(json.loads(file.readline(_LONGEST_HEADER))["frame"])
    except FileNotFoundError:
        raise
    except (OSError, ValueError, LookupError, TypeError):
        return None
