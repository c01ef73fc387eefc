"""Pictures from files that may be anything: cut, forged, huge, or no pictures at all."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from PIL import Image

from ..errors import InputError
from ..output import is_whole_png
from ..output.files import reason

_MOST_PIXELS = 89_478_485  # where Pillow begins to warn
_MOST_BYTES = 1 << 29
_HEADER = struct.Struct(">8s4s4sII")  # signature, length and name of IHDR, width, height


def read_png(path: Path, *, size: tuple[int, int] | None = None) -> np.ndarray:
    """Return an RGB picture, uint8, shape (h, w, 3).

    `size`: (width, height) that it must have. It is looked up in the header before anything is unpacked: a small file can claim
    to hold a picture larger than the memory.

    Raises:
        InputError: not to be read, no PNG, cut, damaged, too large, another size, or not of 8-bit RGB.
    """
    try:
        width, height = _claimed_size(path)
        if size is not None and (width, height) != size:
            raise InputError(f"{path} is {width}x{height}, {size[0]}x{size[1]} is needed")
        check_pixels(path, width, height)
        if not is_whole_png(path):
            raise InputError(f"{path} is cut: the end of the PNG is missing")
        with Image.open(path, formats=("PNG",)) as image:
            if image.mode != "RGB":
                raise InputError(f"{path} is a PNG of mode {image.mode}: 8-bit RGB is needed")
            return np.array(image)
    except OSError as error:
        words = reason(error).lower() if error.errno else f"damaged ({error})"
        raise InputError(f"{path} cannot be read: {words}") from None
    except (SyntaxError, ValueError, Image.DecompressionBombError) as error:  # what Pillow raises of broken chunks
        raise InputError(f"{path} is a damaged PNG: {error}") from None


def check_pixels(path: Path, width: int, height: int) -> None:
    """Raise InputError for a picture that would take the memory."""
    if width * height > _MOST_PIXELS:
        raise InputError(f"{path} claims to be {width}x{height}: more than {_MOST_PIXELS} pixels are not unpacked")


def _claimed_size(path: Path) -> tuple[int, int]:
    with open(path, "rb") as file:
        head = file.read(_HEADER.size)
    if path.stat().st_size > _MOST_BYTES:
        raise InputError(f"{path} is larger than {_MOST_BYTES >> 20} MiB: no frame is")
    if not head.startswith(b"\x89PNG\r\n\x1a\n"):
        raise InputError(f"{path} is no PNG")
    if len(head) < _HEADER.size or head[12:16] != b"IHDR":
        raise InputError(f"{path} is cut: its header is missing")
    *_, width, height = _HEADER.unpack(head)
    return width, height
