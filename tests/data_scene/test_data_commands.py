"""Data scenes on the command line: render, schema, list, describe --toml."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from documents import ROOT, SCRIPT, TINY
from PIL import Image

sys.path.insert(0, str(ROOT / "tests" / "cli"))
from commands import SAME_BACKEND, Result

from tparticles import backend
from tparticles.cli import main


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with a script and its twin; kernels go to the session's own folder."""
    monkeypatch.setenv("TPARTICLES_CACHE", str(tmp_path_factory.getbasetemp() / "kernels"))
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "tiny.py").write_text(SCRIPT)
    (tmp_path / "film.toml").write_text(TINY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]):
    def run(*arguments: object) -> Result:
        first, *others = map(str, arguments)
        capfd.readouterr()
        with pytest.raises(SystemExit) as left:
            main([first, *(SAME_BACKEND if first == "render" else ()), *others])
        captured = capfd.readouterr()
        return Result(left.value.code, captured.out, captured.err)

    return run


def film(folder: str) -> list[np.ndarray]:
    return [np.asarray(Image.open(path)) for path in sorted(Path(folder, "frames").glob("*.png"))]


def test_render_in_all_forms_gives_the_same_frames(run) -> None:
    Path("film.json").write_text(json.dumps({"extends": "tiny", "parameters": {"rate": 60}}))
    for scene, out in (("film.toml", "a"), ("film.json", "b"), ("tiny", "c")):
        result = run("render", scene, "--no-mp4", "--frames", "1-2", "--out", out)
        assert result.code == 0, result.err
    frames = [film(out) for out in "abc"]
    assert len(frames[0]) == 2 and frames[0][0].max() > 60
    for others in frames[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(frames[0], others, strict=True))
    run_json = json.loads(Path("b/run.json").read_text())
    assert run_json["scene"] == "film"
    assert run_json["parameters"] == {"rate": 60.0, "count": 1, "note": "", "seed": 1}


def test_settings_on_the_command_line(run) -> None:
    rate = "groups[0].emitters[0].births.rate"
    result = run("render", "film.toml", "--no-mp4", "--frames", "1", "--set", f"{rate}=600", "--json", "--quiet")
    assert (result.code, result.json["parameters"]) == (0, {rate: 600})
    assert result.json["frames"][0]["alive"] > 100
    Path("other.toml").write_text(TINY)
    refused = run("render", "film.toml", "--set", f"{rate}=-1", "--out", "none")
    refused.refused(2, "film.toml: $.groups[0].emitters[0].births.rate = -1: should be greater than or equal to 0")
    assert not Path("none").exists()


def test_another_document_in_the_same_folder_is_an_error(run) -> None:
    assert run("render", "film.toml", "--no-mp4", "--frames", "1").code == 0
    Path("film.toml").write_text(TINY.replace("rate = 60", "rate = 90"))
    run("render", "film.toml", "--no-mp4", "--frames", "1").refused(2, "rendered with other parameters or settings")


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("rate = 60", "rate = 1e12", "make 5e+11 particles, at most 2147483648 can be numbered"),
        (
            'births = { kind = "Rate", rate = 60 }',
            'births = { kind = "Burst", count = 1000000000000 }',
            "count = 1000000000000",
        ),
        ("duration = 0.25", "duration = 1e300", "more than 10000000 frames"),
        ("size = [64, 36]", "size = [1000000, 1000000]", "$.size[0] = 1000000: should be less than or equal to 16384"),
        ("seed = 1", "seed = 1\nseed = 2", "no valid TOML: Cannot overwrite a value"),
        ("seed = 1", "seed = 1\nfps = nan", "$.fps = nan: must be finite"),
        ("seed = 1", f"a = {'[' * 10_000}", "nested more than 24 deep"),
        ("seed = 1", 'background = { kind = "Picture", path = "/dev/zero" }', "leaves the working folder"),
    ],
    ids=lambda text: text[:30],
)
def test_hostile_documents_leave_one_line_and_no_folder(run, old: str, new: str, part: str) -> None:
    assert old in TINY
    Path("film.toml").write_text(TINY.replace(old, new))
    run("render", "film.toml", "--no-mp4", "--out", "out").refused(2, part)
    assert not Path("out").exists()


def test_too_many_particles_are_refused_before_they_are_allocated(run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "memory", lambda: 1 << 30)
    Path("film.toml").write_text(TINY.replace("rate = 60", "rate = 1e8"))
    run("render", "film.toml", "--no-mp4", "--out", "out").refused(
        2, "room for 50000000 particles takes", "this machine has"
    )
    assert not Path("out").exists()


def test_schema_is_printed(run) -> None:
    result = run("schema")
    assert (result.code, result.err) == (0, "")
    jsonschema.Draft202012Validator.check_schema(result.json)
    assert "CurlNoise" in result.json["$defs"]


def test_list_shows_documents_too(run, folder: Path) -> None:
    (folder / "scenes" / "data").mkdir()
    (folder / "scenes" / "data" / "tiny.toml").write_text(TINY)
    (folder / "scenes" / "plain.json").write_text("{")
    rows = {row["name"]: row for row in run("list", "--json").json}
    assert list(rows) == ["plain", "tiny", "scenes/data/tiny.toml"]
    assert "no valid JSON" in rows["plain"]["error"]
    assert rows["scenes/data/tiny.toml"]["summary"] == "A tiny film."


def test_describe_writes_a_document(run) -> None:
    result = run("describe", "tiny", "--toml", "--set", "rate=30", "--quality", "preview")
    assert (result.code, result.err) == (0, "")
    assert result.out.startswith('summary = "A tiny script."\n')
    Path("copy.toml").write_text(result.out)
    assert run("describe", "copy.toml", "--toml").out == result.out
    found = run("describe", "copy.toml", "--json").json
    assert (found["scene"], found["parameters"], found["groups"][0]["births"]) == ("copy", {}, 15)
    assert "of a data scene any value can be set by its path" in run("describe", "copy.toml").out
    run("describe", "tiny", "--toml", "--quality", "best").refused(2, "unknown quality 'best'")
    assert run("describe", "tiny", "--toml", "--json").code == 2


def test_describe_names_a_law_of_the_scenes_own(run) -> None:
    text = SCRIPT.replace("import tparticles as tp\n", "import taichi as ti\nimport tparticles as tp\n\n\nclass Breeze:\n"
    "    @ti.func\n    def velocity(self, t, x):\n        return x\n\n")  # fmt: skip
    text = text.replace("tp.Vortex(axis=(0.0, 1.0, 0.0), circulation=20.0, core=0.4)", "Breeze()")
    Path("own.py").write_text(text)
    line = run("describe", "own.py", "--toml").refused(2, "$.groups[0].system.flow is a Breeze")
    assert line.startswith("error: scene 'own' cannot be written as data: ")
