"""What `render` writes and prints: pictures, films, states, run.json, provenance; twice, in parts, with other settings."""

from __future__ import annotations

import json
import re
import subprocess
from fractions import Fraction
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
from commands import Result, Run, run_process, write_scene
from PIL import Image

from tparticles.output import pixel_hash, read_manifest
from tparticles.output.ffmpeg import count_frames

PNG_ONLY = ("--no-mp4", "--quiet")
# Sparks that fly, over dots that drift: two groups with different attributes.
TWO_GROUPS = {
    "groups": """(group, tp.Group(
            name="sparks",
            system=tp.Newtonian(forces=(tp.Gravity(),)),
            emitters=tp.Emitter(births=tp.Rate(rate=100.0), temperature=tp.Spread(mean=1500.0, variance=100.0), size=0.1),
            cooling=tp.Exponential(time=1.0),
        ))"""
}


def pictures(folder: Path) -> dict[int, bytes]:
    return {int(path.stem): path.read_bytes() for path in sorted((folder / "frames").glob("*.png"))}


def rows(folder: Path) -> dict[int, dict[str, Any]]:
    return {row["frame"]: row for row in read_manifest(folder / "run.json")["frames"]}


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory, kernel_cache: None) -> tuple[Path, Result]:
    """One film of two groups, rendered in a process of its own with everything that can be written."""
    folder = tmp_path_factory.mktemp("film")
    write_scene(folder / "two.py", **TWO_GROUPS)
    options = ("--out", "out", "--states", "--json", "--threads", "2", "--seed", "7", "--set", "rate=80")
    return folder / "out", run_process("render", "two.py", *options, folder=folder)


def test_everything_asked_for_is_written(film) -> None:
    folder, result = film
    assert result.code == 0, result
    assert sorted(p.name for p in folder.iterdir()) == ["frames", "run.json", "states", "two.mp4"]
    numbers = [f"{n:06d}" for n in range(1, 7)]
    assert [p.name for p in sorted((folder / "frames").iterdir())] == [f"{n}.png" for n in numbers]
    assert [p.name for p in sorted((folder / "states").iterdir())] == [f"{n}.npz" for n in numbers]


def test_json_is_the_run_and_progress_goes_to_stderr(film) -> None:
    folder, result = film
    assert result.json == json.loads((folder / "run.json").read_text())
    lines = result.err.splitlines()
    assert 1 <= len(lines) <= 3
    assert re.fullmatch(r"two: frame 1 \(1/6\), \d+ alive", lines[0])
    assert re.fullmatch(r"two: frame 6 \(6/6\), \d+ alive", lines[-1])


def test_the_run_says_what_was_rendered(film) -> None:
    run = film[1].json
    assert run["scene"] == "two"
    assert run["parameters"] == {"rate": 80.0, "seed": 7, "note": ""}
    assert (run["seed"], run["fps"], run["size"], run["frame_count"]) == (7, "24", [64, 36], 6)
    assert (run["status"], run["error"], run["arch"], run["precision"]) == ("done", None, "cpu", "f32")
    assert (run["scheme"]["name"], run["scheme"]["order"], run["clamp"]) == ("abm5-pec", 5, "equal")
    assert set(run["versions"]) == {"tparticles", "python", "taichi", "numpy", "pillow", "imageio-ffmpeg"}
    assert re.fullmatch("[0-9a-f]{16}", run["scene_hash"])
    assert run["identity"] == f"{run['scene_hash']}-cpu"


def test_the_run_has_a_row_for_each_frame(film) -> None:
    found = film[1].json["frames"]
    assert [row["frame"] for row in found] == [1, 2, 3, 4, 5, 6]
    alive = 0
    for row in found:
        assert row["time"] == pytest.approx(row["frame"] / 24, abs=1e-12)
        assert set(row["ms"]) == {"births", "step", "draw", "encode"}
        assert all(ms >= 0 for ms in row["ms"].values())
        assert 0 < row["dt_min"] <= row["dt_max"] <= (1 + 1e-7) / 24  # counted as f32
        assert row["steps"] > 0
        alive += row["born"] - row["died"]
        assert row["alive"] == alive > 0


def test_the_hash_is_of_the_pixels_in_the_file(film) -> None:
    folder, result = film
    for row in result.json["frames"]:
        with Image.open(folder / f"frames/{row['frame']:06d}.png") as image:
            assert image.mode == "RGB"
            assert pixel_hash(np.asarray(image)) == row["sha256"]


def test_a_picture_says_what_made_it(film) -> None:
    folder, result = film
    with Image.open(folder / "frames/000003.png") as image:
        text = image.text  # type: ignore[attr-defined]
    versions, scene_hash = result.json["versions"], result.json["scene_hash"]
    assert {name: str(value) for name, value in text.items()} == {
        "Software": f"tparticles {versions['tparticles']}",
        "Scene": f"two {scene_hash}",
        "Frame": "3",
        "Seed": "7",
        "Scheme": "abm5-pec",
    }


def test_states_hold_every_particle(film) -> None:
    folder, result = film
    row = result.json["frames"][3]
    with np.load(folder / "states/000004.npz") as file:
        states = dict(file)
    assert set(states) == {"groups", "group", "id", "x", "v", "T", "birth", "age"}
    assert states["groups"].tolist() == ["dots", "sparks"]
    assert all(len(states[name]) == row["alive"] for name in states if name != "groups")
    assert states["x"].shape == states["v"].shape == (row["alive"], 3)
    dots, sparks = states["group"] == 0, states["group"] == 1
    assert dots.any() and sparks.any()
    assert np.isnan(states["v"][dots]).all() and np.isnan(states["T"][dots]).all()
    assert np.isfinite(states["v"][sparks]).all() and (states["T"][sparks] > 1000).all()
    np.testing.assert_allclose(states["age"], row["time"] - states["birth"])
    assert (states["age"] > 0).all()


def test_the_same_again_gives_the_same_files(process: Run, scene, tmp_path: Path) -> None:
    scene()
    assert process("render", "tiny.py", "--out", "o", "--frames", "1-2", *PNG_ONLY).code == 0
    first, told = pictures(tmp_path / "o"), rows(tmp_path / "o")
    assert process("render", "tiny.py", "--out", "o", "--frames", "1-2", *PNG_ONLY).code == 0
    assert pictures(tmp_path / "o") == first
    assert {n: row["sha256"] for n, row in rows(tmp_path / "o").items()} == {
        n: row["sha256"] for n, row in told.items()
    }


def test_other_settings_need_leave_and_another_scene_gets_none(process: Run, run: Run, scene, tmp_path: Path) -> None:
    scene()
    scene("other")
    out = tmp_path / "o"
    assert process("render", "tiny.py", "--out", out, "--frames", "1", *PNG_ONLY).code == 0
    before = pictures(out)
    said = ("holds 'tiny' rendered with other parameters or settings", "--existing overwrite", "--out")
    run("render", "tiny.py", "--out", out, "--frames", "1", "--seed", "2", *PNG_ONLY).refused(2, *said)
    for existing in ("error", "overwrite"):
        other = run("render", "other.py", "--out", out, "--existing", existing, *PNG_ONLY)
        other.refused(2, "holds scene 'tiny', not 'other'")
    assert pictures(out) == before
    done = process(
        "render", "tiny.py", "--out", out, "--frames", "2", "--seed", "2", "--existing", "overwrite", *PNG_ONLY
    )
    assert done.code == 0
    assert list(pictures(out)) == list(rows(out)) == [2]
    assert read_manifest(out / "run.json")["seed"] == 2


def test_a_folder_that_is_not_ours_is_left_alone(run: Run, scene, tmp_path: Path) -> None:
    scene()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").touch()
    refused = run("render", "tiny.py", "--out", "mine", "--existing", "overwrite", "--no-mp4")
    refused.refused(2, "output folder mine holds notes.txt but no run.json, so it is not ours")
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["notes.txt"]


def test_ranges_of_frames_add_up(process: Run, scene, tmp_path: Path) -> None:
    scene()
    for frames in ("1-2", "3-4"):
        assert process("render", "tiny.py", "--out", "parts", "--frames", frames, "--quiet").code == 0
    assert list(pictures(tmp_path / "parts")) == list(rows(tmp_path / "parts")) == [1, 2, 3, 4]
    films = sorted(p.name for p in (tmp_path / "parts").glob("*.mp4"))
    assert films == ["tiny.frames-1-2.mp4", "tiny.frames-3-4.mp4"]
    # every second frame, straight through: the same pictures
    assert process("render", "tiny.py", "--out", "whole", "--frames", "1-4x2,4", *PNG_ONLY).code == 0
    assert pictures(tmp_path / "whole") == {n: pictures(tmp_path / "parts")[n] for n in (1, 3, 4)}
    assert (
        read_manifest(tmp_path / "whole/run.json")["identity"] == read_manifest(tmp_path / "parts/run.json")["identity"]
    )


def test_seed_and_scheme_change_the_pictures_and_are_told(process: Run, scene, tmp_path: Path) -> None:
    scene()
    kinds = {"plain": (), "seed": ("--seed", "5"), "scheme": ("--scheme", "euler")}
    for name, options in kinds.items():
        assert process("render", "tiny.py", "--out", name, "--frames", "6", *options, *PNG_ONLY).code == 0
    told = {name: read_manifest(tmp_path / name / "run.json") for name in kinds}
    assert len({run["frames"][0]["sha256"] for run in told.values()}) == 3
    assert len({run["identity"] for run in told.values()}) == 3
    assert (told["seed"]["seed"], told["seed"]["parameters"]["seed"], told["plain"]["seed"]) == (5, 5, 1)
    assert (told["scheme"]["scheme"]["name"], told["plain"]["scheme"]["name"]) == ("euler", "abm5-pec")


def check_film(path: Path, *, count: int, fps: Fraction) -> None:
    exe = imageio_ffmpeg.get_ffmpeg_exe()
    assert count_frames(exe, path) == count
    said = subprocess.run([exe, "-hide_banner", "-i", path], capture_output=True, text=True).stderr
    found = re.search(r"Duration: 00:00:(\d\d\.\d\d),.* 64x36,.* ([\d.]+) fps", said, re.DOTALL)
    assert found, said
    assert float(found[1]) == pytest.approx(count / fps, abs=0.011)
    assert float(found[2]) == pytest.approx(float(fps), abs=0.006)


def test_a_film_has_the_rate_of_the_scene(film) -> None:
    check_film(film[0] / "two.mp4", count=6, fps=Fraction(24))


def test_a_film_and_states_without_pictures(process: Run, scene, tmp_path: Path) -> None:
    scene()
    result = process("render", "tiny.py", "--fps", "25", "--no-png", "--states")
    assert result.code == 0
    assert re.fullmatch(r"6 frames in [\d.]+ s: renders/tiny/tiny\.mp4, renders/tiny/states\n", result.out)
    folder = tmp_path / "renders/tiny"
    assert sorted(p.name for p in folder.iterdir()) == ["run.json", "states", "tiny.mp4"]
    check_film(folder / "tiny.mp4", count=6, fps=Fraction(25))
    with np.load(folder / "states/000006.npz") as states:
        assert set(states) == {"groups", "group", "id", "x", "birth", "age"}


def test_a_quiet_film_alone(process: Run, scene, tmp_path: Path) -> None:
    scene()
    result = process("render", "tiny.py", "--fps", "30000/1001", "--no-png", "--quiet")
    assert (result.code, result.out, result.err) == (0, "", "")
    folder = tmp_path / "renders/tiny"
    assert sorted(p.name for p in folder.iterdir()) == ["run.json", "tiny.mp4"]
    assert [row["time"] for row in rows(folder).values()] == pytest.approx(
        [k * 1001 / 30000 for k in range(1, 8)], abs=1e-12
    )
    check_film(folder / "tiny.mp4", count=7, fps=Fraction(30000, 1001))
