from __future__ import annotations

import errno
import io
import os
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from tparticles.errors import RunError
from tparticles.output import OutputFrame, PngSequence, encode_png, is_whole_png, pixel_hash


def chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    """Return (kind, data) of each chunk; every byte and every checksum is accounted for."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    found, at = [], 8
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + 8 + length]
        (crc,) = struct.unpack(">I", data[at + 8 + length : at + 12 + length])
        assert crc == zlib.crc32(kind + body)
        found.append((kind, body))
        at += 12 + length
    assert at == len(data)
    return found


def noise(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)


def decoded(data: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(data)) as image:
        assert image.mode == "RGB"
        return np.asarray(image)


@pytest.mark.parametrize("level", [0, 1, 9])
@pytest.mark.parametrize("shape", [(48, 64), (1, 1), (3, 1), (1, 7), (5, 3)])
def test_pixels_come_back(shape: tuple[int, int], level: int) -> None:
    image = noise(*shape)
    assert np.array_equal(decoded(encode_png(image, {}, compress_level=level)), image)


@pytest.mark.parametrize(
    "view",
    [
        lambda a: a[::-1],
        lambda a: a[:, ::-1],
        lambda a: a[::2, 1::3],
        lambda a: a.transpose(1, 0, 2),
        lambda a: a[..., ::-1],
        np.asfortranarray,
    ],
)
def test_pixels_come_back_from_any_memory_layout(view) -> None:
    image = view(noise(48, 64))
    assert np.array_equal(decoded(encode_png(image, {})), image)


def test_chunks_stand_in_legal_order() -> None:
    found = chunks(encode_png(noise(48, 64), {"version": "1", "seed": "7"}))
    assert [kind for kind, _ in found] == [b"IHDR", b"sRGB", b"gAMA", b"cHRM", b"iTXt", b"iTXt", b"IDAT", b"IEND"]
    content = dict(found)
    assert content[b"IHDR"] == struct.pack(">IIBBBBB", 64, 48, 8, 2, 0, 0, 0)
    assert content[b"sRGB"] == b"\0"
    assert content[b"gAMA"] == struct.pack(">I", 45455)
    assert content[b"IEND"] == b""


def test_another_reader_finds_the_colour_space_and_the_provenance() -> None:
    text = {"version": "0.1.0", "scene": "campfire", "note": "Funken über Glut, 火花", "empty": ""}
    with Image.open(io.BytesIO(encode_png(noise(4, 4), text))) as image:
        image.load()
        assert image.text == text  # pyright: ignore[reportAttributeAccessIssue]
        assert image.info["srgb"] == 0
        assert image.info["gamma"] == pytest.approx(1 / 2.2, abs=1e-4)
        assert image.info["chromaticity"][:2] == (0.3127, 0.329)


_KEYWORDS = st.text(st.characters(min_codepoint=0x21, max_codepoint=0x7E), min_size=1, max_size=79)
_WORDS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=40)


@settings(max_examples=40, deadline=None)
@given(st.dictionaries(_KEYWORDS, _WORDS, max_size=5))
def test_any_text_comes_back(text: dict[str, str]) -> None:
    found = [body for kind, body in chunks(encode_png(noise(2, 2), text)) if kind == b"iTXt"]
    parts = [body.split(b"\0\0\0\0\0", 1) for body in found]
    assert {key.decode("latin-1"): words.decode() for key, words in parts} == text


@pytest.mark.parametrize("text", [{"": "x"}, {"k" * 80: "x"}, {"a\0b": "x"}, {" a": "x"}, {"火": "x"}, {"a": "x\0y"}])
def test_text_that_png_cannot_hold_is_refused(text: dict[str, str]) -> None:
    with pytest.raises(ValueError, match="provenance"):
        encode_png(noise(2, 2), text)


def test_equal_frames_are_equal_files(tmp_path: Path, make_frame) -> None:
    for name in ("a", "b"):
        PngSequence(tmp_path / name).write(make_frame(3))
    assert (tmp_path / "a/000003.png").read_bytes() == (tmp_path / "b/000003.png").read_bytes()


@pytest.mark.parametrize("level", [-1, 10])
def test_a_level_that_zlib_does_not_know_is_refused(tmp_path: Path, level: int) -> None:
    with pytest.raises(ValueError, match="compress_level"):
        PngSequence(tmp_path, compress_level=level)


def test_sequence_names_counts_and_closes(tmp_path: Path, make_frame) -> None:
    writer = PngSequence(tmp_path / "a/b")
    for number in (1, 3, 999_999, 1_000_000):
        writer.write(make_frame(number))
    writer.close()
    assert writer.finished == 4
    names = ["000001.png", "000003.png", "1000000.png", "999999.png"]
    assert sorted(path.name for path in writer.folder.iterdir()) == names
    assert all(is_whole_png(path) for path in writer.folder.iterdir())


def test_many_threads_write_one_sequence(tmp_path: Path, make_frame) -> None:
    writer = PngSequence(tmp_path)
    frames = [make_frame(number) for number in range(1, 41)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(writer.write, frames))
    assert writer.finished == 40
    for frame in frames:
        written = decoded((tmp_path / f"{frame.number:06d}.png").read_bytes())
        assert pixel_hash(written) == pixel_hash(frame.image)


@pytest.mark.parametrize("cut", [1, 12, 20, 500])
def test_a_cut_png_is_not_whole(tmp_path: Path, cut: int) -> None:
    data, path = encode_png(noise(48, 64), {}), tmp_path / "cut.png"
    path.write_bytes(data)
    assert is_whole_png(path)
    path.write_bytes(data[:-cut])
    assert not is_whole_png(path)


@pytest.mark.parametrize("data", [b"", b"\x89PNG\r\n\x1a\n", b"x" * 100])
def test_what_is_no_png_is_not_whole(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "other.png"
    path.write_bytes(data)
    assert not is_whole_png(path)


@pytest.mark.parametrize("call", ["replace", "fsync"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EACCES, errno.EIO])
def test_a_failed_write_leaves_the_old_file_and_says_what_is_safe(
    tmp_path: Path, make_frame, monkeypatch: pytest.MonkeyPatch, call: str, number: int
) -> None:
    writer = PngSequence(tmp_path)
    writer.write(make_frame(1))
    before = (tmp_path / "000001.png").read_bytes()

    def fail(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, call, fail)
    with pytest.raises(RunError) as caught:
        writer.write(OutputFrame(1, make_frame(2).image))
    message = str(caught.value)
    assert str(tmp_path / "000001.png") in message
    assert os.strerror(number) in message
    assert "1 frame is finished and safe" in message
    assert [path.name for path in tmp_path.iterdir()] == ["000001.png"]
    assert (tmp_path / "000001.png").read_bytes() == before
    assert caught.value.exit_code == 1


_KILLED = """
import os, signal, sys
import numpy as np
from tparticles.output import OutputFrame, PngSequence
writer = PngSequence(sys.argv[1])
image = np.zeros((48, 64, 3), np.uint8)
writer.write(OutputFrame(1, image))
os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
writer.write(OutputFrame(2, image))
"""


def test_a_kill_before_the_rename_leaves_no_half_frame_and_the_next_run_cleans_up(tmp_path: Path, run_python) -> None:
    assert run_python(_KILLED, tmp_path).returncode == -9
    others = {tmp_path / ".mine.tmp", tmp_path / ".run.json.0123abcd.tmp"}
    for path in others:
        path.touch()
    (left,) = set(tmp_path.glob(".*.tmp")) - others
    assert left.name.startswith(".000002.png.")
    assert [path.name for path in tmp_path.glob("*.png")] == ["000001.png"]
    PngSequence(tmp_path)
    assert set(tmp_path.glob(".*.tmp")) == others, "only frames that this writer left may go"
    for path in others:
        path.unlink()


_FULL = """
import sys
import numpy as np
from tparticles.errors import RunError
from tparticles.output import OutputFrame, PngSequence
if len(sys.argv) > 2:
    import resource
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
writer = PngSequence(sys.argv[1] + "/frames")
rng = np.random.default_rng(0)
try:
    for number in range(1, 100):
        side = 8 if number < 4 else 64
        writer.write(OutputFrame(number, rng.integers(0, 256, (side, side, 3), dtype=np.uint8)))
except RunError as error:
    print(error)
import os
print(*sorted(os.listdir(writer.folder)))
"""


def test_a_file_that_cannot_grow_is_an_error_and_finished_frames_survive(tmp_path: Path, run_python) -> None:
    done = run_python(_FULL, tmp_path, 2000)
    message, names = done.stdout.splitlines()
    assert "000004.png: File too large; 3 frames are finished and safe" in message, done.stderr
    assert names.split() == ["000001.png", "000002.png", "000003.png"]
    assert all(is_whole_png(path) for path in (tmp_path / "frames").iterdir())


def test_a_full_disk_is_an_error_and_finished_frames_survive(tmpfs) -> None:
    done = tmpfs(_FULL, options="size=128k")
    message, names = done.stdout.splitlines()
    finished = len(names.split())
    assert 3 < finished < 20
    assert f"{finished + 1:06d}.png: No space left on device; {finished} frames are finished and safe" in message


def test_a_folder_that_cannot_be_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RunError, match="cannot use the folder"):
        PngSequence(tmp_path / "file/frames")


def test_a_folder_that_went_away_is_an_error(tmp_path: Path, make_frame) -> None:
    writer = PngSequence(tmp_path / "frames")
    writer.folder.rmdir()
    with pytest.raises(RunError, match=r"No such file.*0 frames are finished"):
        writer.write(make_frame(1))
