"""One reference picture on its own: a PNG, and a JSON file of the same name with the moments behind it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ..errors import InputError
from ..output import encode_png, jsonable
from ..output.files import open_folder, reason
from ..spec import explain
from .moments import Moments
from .pictures import read_png
from .reference import write_file
from .tolerance import Tolerance
from .verdict import Verdict, Word, judge

_MOMENTS = TypeAdapter(dict[str, Moments])


class Single:
    """A reference at `path`, a PNG."""

    def __init__(self, path: Path):
        self.path = path

    def judge(self, image: np.ndarray, state: Mapping[str, Moments] | None, limits: Tolerance) -> Verdict:
        """Compare a picture, and where there are any its moments; a reference that cannot be read is a verdict too.

        Raises:
            InputError: `image` is no uint8 of shape (h, w, 3).
        """
        shape, dtype = getattr(image, "shape", ()), getattr(image, "dtype", type(image).__name__)
        if dtype != np.uint8 or len(shape) != 3 or shape[2] != 3 or 0 in shape:
            raise InputError(f"a picture is uint8 of shape (h, w, 3), this is {dtype} {shape}")
        if not self.path.exists():
            return Verdict(Word.MISSING, f"there is no reference {self.path}")
        try:
            reference, before = read_png(self.path), self._moments()
        except InputError as error:
            return Verdict(Word.BROKEN, str(error))
        return judge(reference, image, limits, reference_moments=before, new_moments=state)

    def write(self, image: np.ndarray, state: Mapping[str, Moments] | None) -> None:
        """Make or replace the reference. Raises RunError with the reason."""
        open_folder(self.path.parent, r".+\.(png|json)")
        if state is not None:
            text = json.dumps(jsonable(state), indent=1, allow_nan=False) + "\n"
            write_file(self.path.with_suffix(".json"), text.encode())
        write_file(self.path, encode_png(image, {}, compress_level=9))

    def keep(self, image: np.ndarray, folder: Path) -> Path:
        """Write the new picture into another folder; return its path."""
        path = folder / self.path.name
        write_file(path, encode_png(image, {}))
        return path

    def _moments(self) -> dict[str, Moments] | None:
        path = self.path.with_suffix(".json")
        try:
            return _MOMENTS.validate_json(path.read_bytes())
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"{path} cannot be read: {reason(error).lower()}") from None
        except ValidationError as error:
            raise InputError(f"{path} is broken: {explain(error, 'moments')}") from None
