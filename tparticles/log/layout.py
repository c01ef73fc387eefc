"""What is where in a log, and in the memory that rows travel through."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from types import ModuleType
from typing import Any

import numpy as np

from ..errors import InputError
from ..stepping.rows import ENERGIES, EVENT, Rows

FORMAT, VERSION = "tparticles log", 1
NAME, UNFINISHED = "log.h5", "log.unfinished.h5"
STATE = ("x", "v", "a")
__all__ = ["ENERGIES", "EVENT", "FORMAT", "NAME", "STATE", "UNFINISHED", "VERSION"]

_BLOCK = 16 << 20  # bytes of rows that travel together
_CHUNK = 256 << 10  # bytes of a quantity that are compressed together
_MOST_ROWS, _CHUNK_ROWS = 4096, 512
_EVENTS = 4096  # contacts with a block of rows, at least


def rows_per_block(vertices: int, kind: str) -> int:
    """Return how many rows of so many vertices travel together; `kind`: the type of their numbers."""
    rows = max(1, min(_MOST_ROWS, _BLOCK // (9 * vertices * np.dtype(kind).itemsize)))
    chunk = rows_per_chunk(3 * vertices, kind)
    return rows - rows % chunk if rows > chunk else rows  # no chunk is written twice


def rows_per_chunk(width: int, kind: str) -> int:
    """Return how many rows of so many numbers are compressed together."""
    return max(1, min(_CHUNK_ROWS, _CHUNK // (width * np.dtype(kind).itemsize)))


def _parts(vertices: int, kind: str) -> dict[str, tuple[tuple[int, ...], str]]:
    rows = rows_per_block(vertices, kind)
    return {
        "state": ((3, rows, 3, vertices), kind),
        "energy": ((rows, len(ENERGIES)), "f8"),
        "step": ((rows,), "i8"),
        "time": ((rows,), "f8"),
        "dt": ((rows,), "f8"),
        "events": ((1 + max(_EVENTS, 2 * vertices), len(EVENT)), "f8"),
    }


def block_bytes(vertices: int, kind: str) -> int:
    """Return how much memory a block of rows takes."""
    return sum(-(-_bytes(shape, kind) // 64) * 64 for shape, kind in _parts(vertices, kind).values())


def _bytes(shape: tuple[int, ...], kind: str) -> int:
    return int(np.prod(shape, dtype=np.int64)) * np.dtype(kind).itemsize


def block(memory: Any, first: int, vertices: int, kind: str) -> Rows:
    """Return a block of rows that lies in `memory`, a buffer, from byte `first` on."""
    arrays = {}
    for name, (shape, of) in _parts(vertices, kind).items():
        arrays[name] = np.frombuffer(memory, of, int(np.prod(shape)), first).reshape(shape)
        first += -(-_bytes(shape, of) // 64) * 64
    return Rows(**arrays)


def hdf5() -> tuple[ModuleType, ModuleType]:
    """Return the libraries that read and write logs, h5py and hdf5plugin.

    Raises:
        InputError: they are not installed.
    """
    check_libraries("log", "h5py", "hdf5plugin")
    return importlib.import_module("h5py"), importlib.import_module("hdf5plugin")


def check_libraries(extra: str, *names: str) -> None:
    """Raise InputError where one of the libraries of an extra is not installed."""
    for name in names:
        if name in sys.modules and sys.modules[name] is not None:
            continue
        if name in sys.modules or importlib.util.find_spec(name) is None:
            raise InputError(f"{name} is missing; install it with: pip install 'tparticles[{extra}]'")
