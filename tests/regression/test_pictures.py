"""Pictures that are none, or not whole: one clear line each."""

import io
import struct
import zlib

import numpy as np
import pytest
from check_scenes import picture
from PIL import Image

from tparticles.errors import InputError
from tparticles.output import encode_png
from tparticles.regression.pictures import read_png

WHOLE = encode_png(picture(), {})


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def bomb(width: int, height: int) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(bytes(10_000_000), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def other_mode(mode: str) -> bytes:
    data = io.BytesIO()
    Image.fromarray(picture()).convert(mode).save(data, "PNG")
    return data.getvalue()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is no PNG"),
        (b"GIF89a", "is no PNG"),
        (WHOLE[:20], "is cut: its header is missing"),
        (WHOLE[:-20], "is cut: the end of the PNG is missing"),
        (WHOLE[: len(WHOLE) // 2] + WHOLE[-12:], "damaged"),
        (WHOLE[:200] + bytes([WHOLE[200] ^ 1]) + WHOLE[201:], "damaged"),
        (bomb(60_000, 60_000), "claims to be 60000x60000"),
        (bomb(2**31 - 1, 1), "claims to be"),
        (other_mode("RGBA"), "mode RGBA: 8-bit RGB is needed"),
        (other_mode("L"), "mode L: 8-bit RGB is needed"),
    ],
)
def test_what_is_no_picture_is_refused_in_a_line(tmp_path, data, words):
    path = tmp_path / "picture.png"
    path.write_bytes(data)
    with pytest.raises(InputError) as refused:
        read_png(path)
    message = str(refused.value)
    assert str(path) in message and words in message and "\n" not in message


def test_the_header_is_looked_at_before_anything_is_unpacked(tmp_path):
    path = tmp_path / "picture.png"
    path.write_bytes(bomb(9000, 9000))
    with pytest.raises(InputError, match=r"is 9000x9000, 64x36 is needed"):
        read_png(path, size=(64, 36))


def test_a_whole_picture_is_read_and_what_is_not_there_is_told(tmp_path):
    (tmp_path / "picture.png").write_bytes(WHOLE)
    assert np.array_equal(read_png(tmp_path / "picture.png", size=(64, 36)), picture())
    for path in (tmp_path / "none.png", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            read_png(path)
