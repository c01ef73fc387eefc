"""What goes wrong on the way: Ctrl-C, a full disk, a dead ffmpeg, a closed pipe. Finished frames stay, and run.json tells."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from commands import ROOT, Result, Run, command
from PIL import Image

from tparticles.output import is_whole_png, pixel_hash, read_manifest
from tparticles.output.ffmpeg import count_frames, find_ffmpeg


def check_kept(folder: Path, status: str) -> int:
    """Check that pictures are whole, that run.json tells the truth and that nothing is left over; return how many there are."""
    run = read_manifest(folder / "run.json")
    assert run["status"] == status
    told = {row["frame"]: row["sha256"] for row in run["frames"]}
    found = {int(path.stem): path for path in (folder / "frames").glob("*.png")}
    assert set(told) <= set(found)
    for number, path in found.items():
        assert is_whole_png(path)
        with Image.open(path) as image:
            assert told.get(number, "") in ("", pixel_hash(np.asarray(image)))
    assert not list(folder.rglob("*.tmp"))
    return len(found)


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupted_render_keeps_what_is_finished_and_goes_on(
    scene, process: Run, tmp_path: Path, name: str
) -> None:
    scene(duration="200.0")
    arguments = ("render", "tiny.py", "--out", "o", "--json")
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    running = subprocess.Popen(
        command(*arguments), env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    with running:
        deadline = time.monotonic() + 60
        while len(list(tmp_path.glob("o/frames/*.png"))) < 5:
            assert running.poll() is None and time.monotonic() < deadline
            time.sleep(0.01)
        running.send_signal(getattr(signal, name))
        out, err = running.communicate(timeout=60)
    result = Result(running.returncode, out, err)
    assert result.code == 130
    *progress, last = result.err.splitlines()
    assert last == "error: interrupted; what is finished stays"
    assert all(line.startswith("tiny: frame ") for line in progress)
    assert result.json == {"status": "interrupted", "error": "interrupted; what is finished stays", "exit_code": 130}
    n = check_kept(tmp_path / "o", "interrupted")
    assert 5 <= n < 4800
    assert sorted(p.name for p in (tmp_path / "o").iterdir()) == ["frames", "run.json", "tiny.partial.mp4"]
    # the film may hold a frame more than there are pictures: its encoder had it
    assert 0 < count_frames(find_ffmpeg(), tmp_path / "o/tiny.partial.mp4") <= n + 2
    if name == "SIGINT":
        (tmp_path / "o/frames/.000003.png.0123abcd.tmp").touch()  # as a killed process leaves
        assert process("render", "tiny.py", "--out", "o", "--frames", f"2-{n + 1}", "--quiet", "--no-mp4").code == 0
        assert check_kept(tmp_path / "o", "done") == n + 1
        assert [row["frame"] for row in read_manifest(tmp_path / "o/run.json")["frames"]] == list(range(1, n + 2))


def test_a_file_that_may_not_grow_is_told_in_one_line(scene, process: Run, tmp_path: Path) -> None:
    scene(more=", background=tp.Gradient(top=(0.2, 0.4, 0.6), bottom=(0.9, 0.6, 0.3))", size="(1280, 720)")
    limit = "import os, resource as r, sys; r.setrlimit(r.RLIMIT_FSIZE, (20000, 20000)); os.execv(sys.argv[1], sys.argv[1:])"
    wrapper = (sys.executable, "-c", limit)
    result = process("render", "tiny.py", "--out", "o", "--frames", "1", "--no-mp4", "--quiet", wrapper=wrapper)
    result.refused(1, "cannot write o/frames/000001.png: File too large", "0 frames are finished and safe")
    assert check_kept(tmp_path / "o", "failed") == 0
    assert "File too large" in read_manifest(tmp_path / "o/run.json")["error"]


def test_a_full_disk_is_told_in_one_line_and_finished_frames_survive(scene, process: Run, tmp_path: Path) -> None:
    scene(duration="20.0")
    small = tmp_path / "small"
    small.mkdir()
    # the mount lives and dies with the shell's own name space: what is on it is copied out
    shell = f'mount -t tmpfs -o size=96k none "{small}" || exit 77; "$@"; code=$?; cp -a "{small}/o" "{tmp_path}/kept"; exit $code'
    result = process(
        *("render", "tiny.py", "--out", small / "o", "--quiet"),
        wrapper=("unshare", "--map-root-user", "--mount", "sh", "-c", shell, "sh"),
    )
    if result.code == 77 or "unshare" in result.err:
        pytest.skip(f"cannot mount a tmpfs: {result.err.strip()}")
    line = result.refused(1, "cannot write", "No space left on device")
    n = sum(1 for _ in (tmp_path / "kept/frames").glob("*.png"))
    assert n > 0
    if ".png" in line:
        assert f"{n} frames are finished and safe" in line or f"{n - 1} frames" in line
    # with not a byte left, run.json may be the last one that was saved
    check_kept(tmp_path / "kept", read_manifest(tmp_path / "kept/run.json")["status"])


def test_a_film_that_fails_to_start_leaves_no_ffmpeg_behind(scene, process: Run, tmp_path: Path) -> None:
    scene(law="nothing * x")
    ffmpeg = tmp_path / "ffmpeg"
    ffmpeg.write_text(f'#!/bin/sh\necho $$ >> "{tmp_path}/started"\nexec "{find_ffmpeg()}" "$@"\n')
    ffmpeg.chmod(0o755)
    process("render", "tiny.py", "--quiet", IMAGEIO_FFMPEG_EXE=str(ffmpeg)).refused(2, 'Name "nothing" is not defined')
    pids = [int(pid) for pid in (tmp_path / "started").read_text().split()]
    assert pids
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    assert sorted(p.name for p in (tmp_path / "renders/tiny").iterdir()) == ["frames", "run.json"]


def test_a_closed_pipe_is_no_traceback() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(command("schemes"), stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_results_that_cannot_be_written_are_an_error() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(command("schemes"), stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert done.stderr.splitlines()[0] == "error: cannot write: No space left on device"


def test_a_bug_keeps_its_traceback_and_is_json_too(run: Run, monkeypatch) -> None:
    from tparticles import library

    def broken() -> list[library.Outline]:
        raise AssertionError("what cannot be")

    monkeypatch.setattr(library, "outlines", broken)
    result = run("list", "--json")
    assert result.json == {
        "status": "failed",
        "error": "internal error: AssertionError: what cannot be",
        "exit_code": 1,
    }
    assert "Traceback" in result.err and result.err.splitlines()[-1].startswith("error: internal error")


@pytest.mark.parametrize("ends", ["by itself", "interrupted"])
def test_a_process_leaves_its_kernels_to_the_next(scene, tmp_path, ends):
    """However it ends: compiling them is most of what a first film takes."""
    arguments = (
        "render",
        scene(duration="2.0"),
        "--out",
        tmp_path / "out",
        "--size",
        "64x36",
        "--no-mp4",
        "--arch",
        "cpu",
    )
    process = subprocess.Popen(command(*arguments), env=os.environ | {"TPARTICLES_CACHE": str(tmp_path / "cache")})
    if ends == "interrupted":
        frame = tmp_path / "out" / "frames" / "000001.png"
        while not frame.exists() and process.poll() is None:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
    assert process.wait(120) in (0, 130)
    assert len(list((tmp_path / "cache").rglob("*.tic"))) > 5
