"""`tparticles compare` on pictures, folders and films."""

import json
from fractions import Fraction

import numpy as np
import pytest
from check_scenes import picture
from click.testing import CliRunner

from tparticles.cli import cli
from tparticles.errors import InputError, MismatchError
from tparticles.output import Mp4, OutputFrame, encode_png


def save(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encode_png(image, {}))
    return path


def film(path, images):
    writer = Mp4(path, fps=Fraction(24), size=(64, 36), preset="ultrafast")
    for number, image in enumerate(images, start=1):
        writer.write(OutputFrame(number, image))
    writer.close()
    return path


def smooth(level):
    """Return a picture that survives its encoding."""
    return np.full((36, 64, 3), level, np.uint8)


@pytest.fixture
def compare(tmp_path, monkeypatch):
    """Return a function that runs the command: the lines it prints, and the error it ends with."""
    monkeypatch.chdir(tmp_path)

    def compare(*arguments):
        done = CliRunner().invoke(cli, ["compare", *map(str, arguments)])
        return done.stdout.splitlines(), done.exception

    return compare


def test_two_pictures(compare, tmp_path):
    a, b = save(tmp_path / "a.png", picture()), save(tmp_path / "b.png", picture())
    assert compare(a, b) == (["1 compared: 1 the same, 0 within the tolerance, 0 different"], None)
    speck = picture()
    speck[5, 5] = 255
    lines, error = compare(a, save(b, speck))
    assert isinstance(error, MismatchError) and error.exit_code == 4 and len(lines) == 2
    assert lines[0].startswith("different  b.png: the picture changed: ")
    lines, error = compare(a, save(b, picture(0, (32, 36))))
    assert "the picture is 32x36, its reference 64x36" in lines[0] and isinstance(error, MismatchError)


def test_json_tells_all_and_the_exit_code(tmp_path):
    from tparticles.cli import main

    a, b = save(tmp_path / "a.png", picture()), save(tmp_path / "b.png", picture(1))
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as left:
        printed = []
        patch.setattr("click.echo", lambda text="", **options: None if options.get("err") else printed.append(text))
        main(["compare", str(a), str(b), "--json"])
    assert left.value.code == 4
    (document,) = map(json.loads, printed)
    assert document["status"] == "failed" and document["exit_code"] == 4
    assert document["pictures"][0]["outcome"] == "different" and document["pictures"][0]["metrics"]["largest"] > 100


def test_folders_of_frames(compare, tmp_path):
    for number in (1, 2):
        save(tmp_path / f"a/frames/{number:06d}.png", picture(number))
        save(tmp_path / f"b/{number:06d}.png", picture(number))
    assert compare("a", "b")[1] is None
    save(tmp_path / "b/000003.png", picture(3))
    lines, error = compare("a", "b")
    assert lines[0] == "missing    000003.png: it is not in a"
    assert str(error) == "1 of 3 pictures of b differs from a"


def test_films(compare, tmp_path):
    a = film(tmp_path / "a.mp4", [smooth(40), smooth(80), smooth(120)])
    assert compare(a, film(tmp_path / "same.mp4", [smooth(40), smooth(80), smooth(120)])) == (
        ["3 compared: 3 the same, 0 within the tolerance, 0 different"],
        None,
    )
    lines, error = compare(a, film(tmp_path / "brighter.mp4", [smooth(40), smooth(90), smooth(120)]))
    assert isinstance(error, MismatchError) and lines[0].startswith("different  frame 2: the picture changed")
    lines, error = compare(a, film(tmp_path / "short.mp4", [smooth(40), smooth(80)]))
    assert isinstance(error, MismatchError) and "has 2 frames, the other more" in lines[0]


@pytest.mark.parametrize("content", [b"", b"no film", b"#EXTM3U\n/etc/passwd\n"])
def test_what_is_no_film(compare, tmp_path, content):
    good = film(tmp_path / "good.mp4", [smooth(40)])
    (tmp_path / "bad.mp4").write_bytes(content)
    (tmp_path / "cut.mp4").write_bytes(good.read_bytes()[:200])
    for bad in ("bad.mp4", "cut.mp4"):
        _, error = compare(good, bad)
        assert isinstance(error, InputError) and str(error) == f"{bad} cannot be read as a film"


def test_bad_input_is_one_line(compare, tmp_path):
    save(tmp_path / "a.png", picture())
    (tmp_path / "empty").mkdir()
    for arguments, words in (
        (("a.png", "none.png"), "none.png does not exist"),
        (("a.png", "empty"), "a.png is a picture, empty a folder: two of one kind are needed"),
        (("empty", "empty"), "empty holds no PNG files"),
        (("a.png", "x" * 5000), "cannot be read"),
    ):
        _, error = compare(*arguments)
        assert isinstance(error, InputError) and words in str(error) and "\n" not in str(error)
