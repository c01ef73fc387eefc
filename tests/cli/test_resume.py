"""A render that is killed, or runs out of disk or encoder, is resumed and ends with the frames of one that was left alone."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import ROOT, Run, command, run_process, write_scene
from PIL import Image

from tparticles.output import pixel_hash, read_manifest
from tparticles.output.ffmpeg import find_ffmpeg

KILLS = 50
FRAMES = 960
# A multistep scheme and short lives: there is a history to be lost, and slots are used again.
PARTS = {
    "duration": f"{FRAMES / 24}",
    "births": "tp.Rate(rate=400.0)",
    "emitter": ", lifetime=tp.Spread(mean=0.4, variance=0.2)",
    "more": ", scheme='ab4'",
}
RENDER = ("render", "spin.py", "--out", "o", "--threads", "1", "--arch", "cpu", "--quiet", "--checkpoint-every", "9f")


def hashes(folder: Path) -> dict[int, str]:
    """Return the hashes of the pictures that are there."""
    found = {}
    for path in sorted((folder / "frames").glob("*.png")):
        with Image.open(path) as image:
            found[int(path.stem)] = pixel_hash(np.asarray(image))
    return found


def rows(folder: Path) -> list[dict[str, Any]]:
    run = read_manifest(folder / "run.json")
    assert (run["status"], run["error"]) == ("done", None)
    return [{name: value for name, value in row.items() if name != "ms"} for row in run["frames"]]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, kernel_cache: None) -> Path:
    """The film, rendered in one go."""
    folder = tmp_path_factory.mktemp("whole")
    write_scene(folder / "spin.py", **PARTS)
    assert run_process(*RENDER, folder=folder).code == 0
    return folder / "o"


def check_same(folder: Path, whole: Path) -> None:
    """Check that a resumed film is the one that was rendered in one go, and that nothing else is left."""
    assert hashes(folder) == hashes(whole)
    assert rows(folder) == rows(whole)
    assert (folder / "spin.mp4").read_bytes() == (whole / "spin.mp4").read_bytes()
    assert sorted(path.name for path in folder.iterdir()) == ["frames", "run.json", "spin.mp4"]
    assert not list(folder.rglob(".*"))


def render_and_kill(folder: Path, chance: random.Random) -> None:
    """Render on, and kill the process when a few more frames are there."""
    folder_of_frames = folder / "o/frames"
    wanted = len(list(folder_of_frames.glob("*.png"))) + chance.randint(0, FRAMES // (2 * KILLS))
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command(*RENDER, "--resume"), cwd=folder, env=environment, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while len(list(folder_of_frames.glob("[0-9]*.png"))) < wanted:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.001)
    time.sleep(chance.random() * 0.02)
    process.kill()
    process.wait()


def test_killed_again_and_again(whole: Path, tmp_path: Path) -> None:
    write_scene(tmp_path / "spin.py", **PARTS)
    chance = random.Random(1)
    for _ in range(KILLS):
        render_and_kill(tmp_path, chance)
    result = run_process(*RENDER, "--resume")
    assert result.code == 0, result
    assert "resumed at frame" in result.err
    check_same(tmp_path / "o", whole)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "o").rglob("*.*g*")}
    assert run_process(*RENDER, "--resume").code == 0  # nothing is left to do
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "o").rglob("*.*g*")} == before
    (tmp_path / "o/spin.mp4").unlink()  # nothing but to encode
    assert run_process(*RENDER, "--resume").code == 0
    check_same(tmp_path / "o", whole)


@pytest.fixture(scope="module")
def remains(tmp_path_factory: pytest.TempPathFactory, whole: Path) -> Path:
    """What is left of a render that ended with its third checkpoint."""
    folder = tmp_path_factory.mktemp("remains")
    write_scene(folder / "spin.py", **PARTS)
    code = (
        "import os, sys\n"
        "from tparticles import checkpoint, cli\n"
        "write, made = checkpoint.write_checkpoint, []\n"
        "def last(path, state, *, identity, frame):\n"
        "    write(path, state, identity=identity, frame=frame)\n"
        "    made.append(frame)\n"
        "    if len(made) == 3: os.kill(os.getpid(), 9)\n"
        "checkpoint.write_checkpoint = last\n"
        "cli.main(sys.argv[1:])"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code, *RENDER], cwd=folder, env=environment, stderr=subprocess.DEVNULL)
    assert done.returncode == -signal.SIGKILL
    return folder


@pytest.fixture
def killed(remains: Path, tmp_path: Path) -> Path:
    """A copy of them."""
    shutil.copytree(remains, tmp_path, dirs_exist_ok=True)
    return tmp_path / "o"


def slots(folder: Path) -> dict[int, Path]:
    """Return the checkpoints by their frame."""
    found = {}
    for path in (folder / "checkpoint").glob("?.checkpoint"):
        with open(path, "rb") as file:
            file.readline()
            found[json.loads(file.readline())["frame"]] = path
    return found


def damage_newest(folder: Path) -> str:
    path = slots(folder)[max(slots(folder))]
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 16
    path.write_bytes(content)
    return f"{path.relative_to(folder.parent)} is refused: it is cut or damaged"


def cut_both(folder: Path) -> str:
    for path in slots(folder).values():
        os.truncate(path, path.stat().st_size // 2)
    return "no checkpoint to resume from: rendering from the beginning"


def swap_pictures(folder: Path) -> str:
    """Leave two whole pictures of which neither is what run.json says."""
    older = min(slots(folder))
    a, b, c = (folder / f"frames/{name}.png" for name in (f"{older + 1:06d}", f"{older + 2:06d}", "0"))
    a.rename(c)
    b.rename(a)
    c.rename(b)
    return f"resumed at frame {older + 1}: {older} of {FRAMES} frames are there"


def cut_picture(folder: Path) -> str:
    """Leave a picture that Pillow still reads."""
    path = folder / "frames/000003.png"
    os.truncate(path, path.stat().st_size - 8)
    return f"pictures before its frame {min(slots(folder))} are missing or damaged"


@pytest.mark.parametrize("harm", [damage_newest, cut_both, swap_pictures, cut_picture])
def test_what_is_damaged_is_refused_and_done_again(killed: Path, whole: Path, run: Run, harm) -> None:
    assert len(slots(killed)) == 2
    expected = harm(killed)
    result = run(*RENDER, "--resume")
    assert result.code == 0, result
    assert expected in result.err
    check_same(killed, whole)


def test_without_resume_it_begins_anew(killed: Path, whole: Path, run: Run) -> None:
    result = run(*RENDER)
    assert (result.code, result.err) == (0, "")
    check_same(killed, whole)


def test_a_film_without_pictures_keeps_them_until_it_is_done(tmp_path: Path, whole: Path) -> None:
    write_scene(tmp_path / "spin.py", **PARTS)
    render_and_kill_once(tmp_path, "--no-png")
    assert (tmp_path / "o/checkpoint/frames").is_dir()
    assert run_process(*RENDER, "--no-png", "--resume").code == 0
    assert sorted(path.name for path in (tmp_path / "o").iterdir()) == ["run.json", "spin.mp4"]
    assert (tmp_path / "o/spin.mp4").read_bytes() == (whole / "spin.mp4").read_bytes()


def render_and_kill_once(folder: Path, *options: str) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command(*RENDER, *options), cwd=folder, env=environment)
    deadline = time.monotonic() + 60
    while not slots(folder / "o"):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.001)
    process.kill()
    process.wait()


def test_an_encoder_that_dies_on_the_way_costs_no_frame(tmp_path: Path, whole: Path) -> None:
    write_scene(tmp_path / "spin.py", **PARTS)
    ffmpeg = tmp_path / "ffmpeg"
    true = find_ffmpeg()
    dies = f'head -c {64 * 36 * 3 * 60} | "{true}" "$@" & sleep 0.5; kill -9 $!; exit 1'
    ffmpeg.write_text(f'#!/bin/sh\ncase "$*" in *pipe:0*) {dies} ;; *) exec "{true}" "$@" ;; esac\n')
    ffmpeg.chmod(0o755)
    run_process(*RENDER, IMAGEIO_FFMPEG_EXE=str(ffmpeg)).refused(1, "cannot write o/spin.mp4: ffmpeg")
    assert not (tmp_path / "o/spin.mp4").exists()
    assert run_process(*RENDER, "--resume").code == 0
    check_same(tmp_path / "o", whole)


def test_a_full_disk_that_is_emptied_costs_no_frame(tmp_path: Path, whole: Path) -> None:
    write_scene(tmp_path / "spin.py", **PARTS)
    small = tmp_path / "small"
    small.mkdir()
    # the mount lives and dies with the shell's own name space; with more room the same folder is gone on with
    shell = (
        f'mount -t tmpfs -o size=300k none "{small}" || exit 77; '
        f'"$@" && exit 78; ls "{small}/o/frames" | wc -l > "{tmp_path}/first"; '
        f'mount -o remount,size=50m "{small}"; "$@" --resume; code=$?; cp -a "{small}/o" "{tmp_path}/kept"; exit $code'
    )
    options = [str(small / "o") if part == "o" else part for part in RENDER]
    result = run_process(*options, wrapper=("unshare", "--map-root-user", "--mount", "sh", "-c", shell, "sh"))
    if result.code == 77 or "unshare" in result.err:
        pytest.skip(f"cannot mount a tmpfs: {result.err.strip()}")
    assert result.code == 0, result
    assert "No space left on device" in result.err.splitlines()[0]
    assert 0 < int((tmp_path / "first").read_text()) < FRAMES
    check_same(tmp_path / "kept", whole)
