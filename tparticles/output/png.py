"""Numbered PNG files that say what colour space they are in and what made them."""

from __future__ import annotations

import io
import struct
import threading
import zlib
from pathlib import Path

import numpy as np
from PIL import Image, ImageFile
from PIL.PngImagePlugin import PngImageFile, PngInfo

from ..errors import RunError
from .base import OutputFrame
from .files import FRAME_NAME, atomic_file, frame_path, frames_finished, open_folder, reason

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_END = struct.pack(">I4sI", 0, b"IEND", zlib.crc32(b"IEND"))
# White and primaries of sRGB in 1/100000, for readers that know cHRM but not sRGB (PNG specification, 11.3.2).
_CHROMATICITIES = (31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)


# Pillow takes a file in pieces of this size, and Python's lock between them, which the simulation holds most of the time.
ImageFile.MAXBLOCK = max(ImageFile.MAXBLOCK, 1 << 22)


class PngSequence:
    """Writes `folder/000001.png`, `folder/000002.png`, ...; frames may come in any order and on several threads.

    folder: created if it is not there; temporary files of a killed run in it are removed.
    compress_level: of zlib, 0 to 9. Level 6 makes files a quarter smaller and takes 3 to 6 times as long.
    Raises RunError if the folder cannot be used, ValueError for another level.
    """

    ordered: bool = False

    def __init__(self, folder: str | Path, *, compress_level: int = 1) -> None:
        if not 0 <= compress_level <= 9:
            raise ValueError(f"compress_level is {compress_level}: must be 0 to 9")
        self.folder = Path(folder)
        self._level = compress_level
        self._finished = 0
        self._counting = threading.Lock()
        open_folder(self.folder, FRAME_NAME + r"\.png")

    @property
    def finished(self) -> int:
        """How many frames are on the disk under their final names."""
        return self._finished

    def write(self, frame: OutputFrame) -> None:
        """Encode and write one frame. Raises RunError that names the file, the reason and what is finished."""
        data = encode_png(frame.image, frame.provenance, compress_level=self._level)
        path = frame_path(self.folder, frame.number, ".png")
        try:
            with atomic_file(path) as file:
                file.write(data)
        except OSError as error:
            raise RunError(f"cannot write {path}: {reason(error)}; {frames_finished(self._finished)}") from error
        with self._counting:
            self._finished += 1

    def close(self) -> None:
        """Do nothing: each frame is finished when `write` returns."""

    def abort(self) -> None:
        """Do nothing: a frame is there whole or not at all."""


def encode_png(image: np.ndarray, text: dict[str, str], *, compress_level: int = 1) -> bytes:
    """Return the bytes of a PNG marked as sRGB.

    image: sRGB, uint8, shape (h, w, 3).
    text: keyword (1 to 79 printable Latin-1 characters) to UTF-8 text, stored as iTXt.
    compress_level: of zlib, 0 to 9.
    Raises ValueError for a keyword or text that PNG cannot hold.
    """
    info = PngInfo()
    info.add(b"sRGB", b"\0")  # perceptual intent
    info.add(b"gAMA", struct.pack(">I", 45455))  # 1 / 2.2
    info.add(b"cHRM", struct.pack(">8I", *_CHROMATICITIES))
    for keyword, words in text.items():
        _check_text(keyword, words)
        info.add_itxt(keyword, words)
    data = io.BytesIO()
    Image.fromarray(image).save(data, "PNG", pnginfo=info, compress_level=compress_level)
    return data.getvalue()


def is_whole_png(path: str | Path) -> bool:
    """Return whether the file begins and ends as a PNG does.

    Pillow opens and reads a PNG that lost its last 20 bytes without a word, so a frame is looked at from its end.
    Raises OSError if the file cannot be read.
    """
    with open(path, "rb") as file:
        if file.read(len(_SIGNATURE)) != _SIGNATURE:
            return False
        file.seek(0, 2)
        file.seek(max(0, file.tell() - len(_END)))
        return file.read() == _END


def read_png(path: str | Path, size: tuple[int, int]) -> np.ndarray | None:
    """Return the pixels of one of our frames, uint8, shape (h, w, 3); None if the file is not whole or of another size [px].

    What the file says of its size is looked at before anything is decoded, so that no bomb is unpacked.
    Raises OSError if the file cannot be read.
    """
    if not is_whole_png(path):
        return None
    with open(path, "rb") as file:
        head = file.read(26)
        if struct.unpack(">II", head[16:24]) != size or head[24:] != b"\x08\x02":  # 8 bits of each of R, G, B
            return None
        file.seek(0)
        try:
            return np.asarray(PngImageFile(file))
        except (SyntaxError, ValueError, OSError, EOFError, zlib.error, struct.error):
            return None


def _check_text(keyword: str, words: str) -> None:
    """Refuse what the PNG specification forbids and Pillow would write."""
    printable = all(" " <= c <= "~" or "\xa1" <= c <= "\xff" for c in keyword)
    if not (1 <= len(keyword) <= 79 and printable and keyword.strip() == keyword):
        raise ValueError(f"provenance key {keyword!r} must be 1 to 79 printable Latin-1 characters")
    if "\0" in words:
        raise ValueError(f"provenance text of {keyword!r} holds a NUL character")
