"""run.json: what a run was asked for, how far it came, and one row for each finished frame."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path, PurePath
from typing import Any, Literal

import numpy as np

from ..errors import InputError, RunError
from .files import atomic_file, open_folder, reason

MANIFEST_NAME = "run.json"
_RESERVED = ("status", "error", "frames")
_OWNER = ("scene", "identity")  # texts; see claim_folder


class Manifest:
    """The run.json of a run that is under way; at any moment the file is whole, whatever kills the process.

    Saved when it is made, then at most once in `interval` seconds when rows come, and by `finish`. Methods may be
    called from any thread.

    path: of the file; header: what the run was asked for, with `scene` and `identity` for `claim_folder`.
    interval: between saves [s]; stretched so that saving takes at most a twentieth of the time.
    Raises RunError if it cannot be saved, ValueError for a header without these or with `status`, `error`, `frames`.
    """

    def __init__(self, path: str | Path, header: Mapping[str, object], *, interval: float = 1.0) -> None:
        if taken := [key for key in header if key in _RESERVED]:
            raise ValueError(f"header holds {', '.join(taken)}: these names belong to the manifest")
        if missing := [key for key in _OWNER if not isinstance(header.get(key), str)]:
            raise ValueError(f"header lacks {', '.join(missing)}: without it the folder has no owner")
        self.path = Path(path)
        self._header = dict(header)
        self._interval = interval
        self._rows: dict[int, str] = {}
        self._status = "running"
        self._error: str | None = None
        self._next_save = 0.0
        self._lock = threading.Lock()
        open_folder(self.path.parent, MANIFEST_NAME.replace(".", r"\."))
        self._save()

    def add(self, row: Mapping[str, object]) -> None:
        """Add the row of a frame whose files are finished; `row["frame"]` is its number, and its last row counts.

        Raises RunError if it cannot be saved, ValueError without a number or after `finish`.
        """
        number = row.get("frame")
        if not isinstance(number, int) or isinstance(number, bool):
            raise ValueError(f"row has frame {number!r}: must be the number of the frame")
        line = json.dumps(jsonable(row), allow_nan=False)
        with self._lock:
            if self._status != "running":
                raise ValueError("the manifest is finished")
            self._rows[number] = line
            if time.monotonic() >= self._next_save:
                self._save()

    def save(self) -> None:
        """Put every row on the disk now. Raises RunError if it cannot be saved."""
        with self._lock:
            self._save()

    def finish(self, status: Literal["done", "failed", "interrupted"] = "done", error: str | None = None) -> None:
        """Save for the last time.

        error: what failed, in words. Raises RunError if a run that is "done" cannot be saved; any other run has an
        error of its own that must not be hidden, and the file of the last save is still whole.
        """
        with self._lock:
            self._status, self._error = status, error
            try:
                self._save()
            except RunError:
                if status == "done":
                    raise

    def _save(self) -> None:
        start = time.monotonic()
        try:
            with atomic_file(self.path) as file:
                file.write(self._text().encode("ascii"))
        except OSError as error:
            raise RunError(f"cannot write {self.path}: {reason(error)}") from error
        now = time.monotonic()
        self._next_save = now + max(self._interval, 20.0 * (now - start))

    def _text(self) -> str:
        head = json.dumps(
            jsonable({**self._header, "status": self._status, "error": self._error}), indent=2, allow_nan=False
        )
        rows = ",\n    ".join(line for _, line in sorted(self._rows.items()))
        frames = f"[\n    {rows}\n  ]" if rows else "[]"
        return f'{head.removesuffix("}").rstrip()},\n  "frames": {frames}\n}}\n'


def read_manifest(path: str | Path) -> dict[str, Any]:
    """Return what a run.json holds. Raises InputError if it cannot be read or is not an object with its `scene`."""
    try:
        content = json.loads(Path(path).read_bytes())
    except OSError as error:
        raise InputError(f"cannot read {path}: {reason(error)}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is broken: {error}") from error
    if not isinstance(content, dict) or not all(isinstance(content.get(key), str) for key in _OWNER):
        raise InputError(f"{path} is broken: it does not say which scene it is of")
    return content


def jsonable(value: object) -> Any:
    """Return `value` as JSON can hold it, keys in their order.

    NumPy scalars and arrays become numbers and lists, fractions and paths text, NaN and infinities None (JSON has no
    word for them). Raises TypeError for anything else that JSON does not know.
    """
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.generic | np.ndarray):
        return jsonable(value.tolist())
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    if isinstance(value, Fraction | PurePath):
        return str(value)
    raise TypeError(f"{value!r} ({type(value).__name__}) cannot be written as JSON")
