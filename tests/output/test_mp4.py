from __future__ import annotations

import re
import struct
import subprocess
from fractions import Fraction
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from tparticles.errors import InputError
from tparticles.output import Mp4, OutputFrame, check_film

FFMPEG = imageio_ffmpeg.get_ffmpeg_exe()
SIZE = (64, 48)
CONTAINERS = (b"moov", b"trak", b"mdia", b"minf", b"stbl")


def boxes(data: bytes) -> list[tuple[bytes, bytes]]:
    """Return (kind, data) of every MP4 box in the order of the file, those inside others too."""
    found, at = [], 0
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        start, end = at + 8, at + length if length else len(data)
        if length == 1:
            start, end = at + 16, at + struct.unpack(">Q", data[at + 8 : at + 16])[0]
        found.append((kind, data[start:end]))
        if kind in CONTAINERS:
            found += boxes(data[start:end])
        elif kind == b"stsd":
            found += boxes(data[start + 8 : end])
        elif kind == b"avc1":
            found += boxes(data[start + 78 : end])
        at = end
    return found


def described(path: Path) -> str:
    """Return what ffmpeg says of the film's picture stream."""
    said = subprocess.run([FFMPEG, "-hide_banner", "-i", str(path)], capture_output=True, text=True).stderr
    return next(line for line in said.splitlines() if "Video:" in line)


def decoded(path: Path, matrix: str = "bt709") -> np.ndarray:
    """Return the frames as RGB, shape (n, h, w, 3), read with the given matrix."""
    to_rgb = f"scale=in_color_matrix={matrix}:in_range=tv:out_range=pc:flags=bicubic+accurate_rnd+full_chroma_int"
    command = [FFMPEG, "-v", "error", "-i", str(path), "-vf", to_rgb, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    pixels = np.frombuffer(subprocess.run(command, capture_output=True, check=True).stdout, np.uint8)
    return pixels.reshape(-1, SIZE[1], SIZE[0], 3)


@pytest.mark.parametrize("count", [1, 2, 31])
@pytest.mark.parametrize("fps", [Fraction(24), Fraction(25), Fraction(30000, 1001), Fraction(24000, 1001), Fraction(1)])
def test_the_film_holds_every_frame_at_the_exact_rate(
    tmp_path: Path, make_frame, fps: Fraction, count: int, film_at
) -> None:
    film = film_at(tmp_path / "film.mp4", fps=fps)
    for number in range(1, count + 1):
        film.write(make_frame(number))
    film.close()
    assert film.frames == count
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]
    found = boxes(film.path.read_bytes())
    content = dict(found)
    assert struct.unpack(">I", content[b"stsz"][8:12]) == (count,)
    (timescale,) = struct.unpack(">I", content[b"mdhd"][12:16])
    runs = struct.iter_unpack(">II", content[b"stts"][8:])
    assert {Fraction(timescale, delta) for _, delta in runs} == {fps}
    kinds = [kind for kind, _ in found]
    assert kinds.index(b"moov") < kinds.index(b"mdat"), "the index stands in front"
    assert len(decoded(film.path)) == count


@pytest.mark.parametrize("size", [(64, 48), (2, 2), (66, 50), (34, 18)])
def test_the_size_is_never_changed(tmp_path: Path, make_frame, size: tuple[int, int], film_at) -> None:
    film = film_at(tmp_path / "film.mp4", size=size)
    film.write(make_frame(1, size))
    film.close()
    assert struct.unpack(">HH", dict(boxes(film.path.read_bytes()))[b"avc1"][24:28]) == size
    assert f", {size[0]}x{size[1]}" in described(film.path)


def test_the_colours_are_tagged(tmp_path: Path, make_frame, film_at) -> None:
    film = film_at(tmp_path / "film.mp4")
    film.write(make_frame(1))
    film.close()
    assert re.search(r"h264 .*yuv420p\(tv, bt709[,)]", described(film.path))
    # colr box: nclx, primaries 1, transfer 1, matrix 1 (bt709 all), not full range
    assert dict(boxes(film.path.read_bytes()))[b"colr"] == b"nclx" + struct.pack(">HHHB", 1, 1, 1, 0)


def test_saturated_colours_come_back(tmp_path: Path, film_at) -> None:
    colours = np.array(
        [
            (255, 0, 0),
            (0, 255, 0),
            (0, 0, 255),
            (255, 255, 0),
            (0, 255, 255),
            (255, 0, 255),
            (255, 255, 255),
            (0, 0, 0),
            (255, 140, 30),
            (128, 128, 128),
            (200, 40, 10),
            (16, 16, 16),
        ],
        np.uint8,
    ).reshape(3, 4, 3)
    image = colours.repeat(16, axis=0).repeat(16, axis=1)
    film = film_at(tmp_path / "film.mp4", crf=4)
    film.write(OutputFrame(1, image))
    film.close()

    def worst(matrix: str) -> int:
        centres = decoded(film.path, matrix)[0, 8::16, 8::16].astype(int)
        return int(np.abs(centres - colours).max())

    assert worst("bt709") <= 3
    assert worst("bt601") > 15, "the pattern would show a wrong matrix"


@pytest.mark.parametrize("name", ["a b.mp4", "100%d.mp4", "-y.mp4", "pipe:1.mp4", "火.mp4", "'q'.mp4", "noend"])
def test_odd_names_are_only_names(tmp_path: Path, make_frame, monkeypatch, name: str, film_at) -> None:
    monkeypatch.chdir(tmp_path)
    film = film_at(Path("pipe:new folder") / name)
    film.write(make_frame(1))
    film.close()
    assert [path.name for path in (tmp_path / "pipe:new folder").iterdir()] == [name]


@pytest.mark.parametrize(
    ("size", "named"),
    [
        ((1919, 1081), "1918x1080 or 1920x1082"),
        ((1919, 1080), "1918x1080 or 1920x1080"),
        ((1920, 1081), "1920x1080 or 1920x1082"),
        ((1, 5), "2x4 or 2x6"),
        ((1, 1), "even sizes, 2x2 "),
        ((0, 48), "0x48: must be at least 2x2"),
        ((64, -2), "64x-2: must be at least 2x2"),
        ((16384, 16384), "16384x16384: too large for an MP4, take 16384x16128 or less"),
        ((16384, 16130), "take 16384x16128 or less"),
        ((16130, 16384), "take 16130x16382 or less"),
        ((16256, 16256), "take 16256x16254 or less"),
        ((20000, 16), "take 16384x16128 or less"),
        ((16, 16386), "take 16x16384 or less"),
    ],
)
def test_sizes_that_cannot_be_name_the_nearest_that_can(
    tmp_path: Path, size: tuple[int, int], named: str, film_at
) -> None:
    with pytest.raises(InputError, match=named):
        film_at(tmp_path / "film.mp4", size=size)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("size", [(16384, 16128), (16128, 16384), (16254, 16254), (16384, 2)])
def test_the_largest_sizes_are_let_through(size: tuple[int, int]) -> None:
    # as ffmpeg 9.0 and x264 took them, a frame each: 800 MB of it are too much for a test
    check_film(fps=Fraction(24), size=size)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"fps": Fraction(0)}, "fps is 0"),
        ({"fps": Fraction(-24)}, "fps is -24"),
        ({"crf": 52}, "crf is 52: must be 0 to 51"),
        ({"crf": -1}, "crf is -1"),
        ({"preset": "slowish"}, "unknown preset 'slowish'; did you mean 'slow'"),
        ({"threads": 0}, "threads is 0"),
    ],
)
def test_bad_options_are_refused(tmp_path: Path, options: dict, named: str) -> None:
    with pytest.raises(InputError, match=re.escape(named)):
        Mp4(tmp_path / "film.mp4", **({"fps": Fraction(24), "size": SIZE} | options))


def test_a_frame_of_another_size_is_refused(tmp_path: Path, make_frame, film_at) -> None:
    film = film_at(tmp_path / "film.mp4")
    with pytest.raises(ValueError, match="frame 1 is 48x64: the film is 64x48"):
        film.write(make_frame(1, (48, 64)))
    film.abort()
