"""The live state of each frame as numbered npz files."""

from __future__ import annotations

import threading
import zipfile
from pathlib import Path

import numpy as np

from ..errors import RunError
from .base import OutputFrame
from .files import FRAME_NAME, atomic_file, frame_path, frames_finished, open_folder, reason


class States:
    """Writes `folder/000001.npz`, ...: one array per attribute, read back with `numpy.load`.

    Not compressed: particle states are nearly noise, and deflate would cost more than the simulation. The bytes
    depend on the arrays alone (no time stamps).

    folder: created if it is not there; temporary files of a killed run in it are removed.
    Raises RunError if the folder cannot be used.
    """

    ordered: bool = False

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._finished = 0
        self._counting = threading.Lock()
        open_folder(self.folder, FRAME_NAME + r"\.npz")

    @property
    def finished(self) -> int:
        """How many frames are on the disk under their final names."""
        return self._finished

    def write(self, frame: OutputFrame) -> None:
        """Write `frame.states`. Raises RunError if it cannot be written, ValueError if there are none."""
        if frame.states is None:
            raise ValueError(f"frame {frame.number} has no states")
        path = frame_path(self.folder, frame.number, ".npz")
        try:
            with atomic_file(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
                for name in sorted(frame.states):
                    # A ZipInfo made from a name alone is dated 1980-01-01.
                    with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                        np.lib.format.write_array(member, np.asanyarray(frame.states[name]), allow_pickle=False)
        except OSError as error:
            raise RunError(f"cannot write {path}: {reason(error)}; {frames_finished(self._finished)}") from error
        with self._counting:
            self._finished += 1

    def close(self) -> None:
        """Do nothing: each frame is finished when `write` returns."""

    def abort(self) -> None:
        """Do nothing: a frame is there whole or not at all."""
