"""`tparticles check` from the first reference to a changed one; most tests reuse what was rendered once."""

import json
import shutil

import pytest
from check_scenes import PLAN, write_scene

from tparticles.errors import BackendError, RunError
from tparticles.regression import check as checking
from tparticles.regression.plan import Plan
from tparticles.regression.shoot import Take, shoot

CHECK = "renders/reference/check"


@pytest.fixture(scope="module")
def takes(tmp_path_factory):
    """The tiny scene as it is, with another vortex and with another exposure, rendered in this process."""
    folder = tmp_path_factory.mktemp("takes")
    plan = Plan(size=(64, 36), frames=(1, 4))
    changes = {"as it is": {}, "turn": {"turn": "20.1"}, "ev": {"ev": "6.95"}}
    return {
        name: shoot(str(write_scene(folder / name, **change)), plan, arch="cpu", threads=2)
        for name, change in changes.items()
    }


@pytest.fixture
def rendered(takes, monkeypatch):
    """Return a function that says what the next check will find rendered."""

    def rendered(name):
        take = takes[name] if isinstance(name, str) else name
        monkeypatch.setattr(checking, "shoot_all", lambda plans, paths, *, arch: ((scene, take) for scene in plans))

    rendered("as it is")
    return rendered


def test_from_the_first_reference_to_a_whole_check_in_processes_of_their_own(project, run):
    first = run("check")
    assert first.code == 4 and first.out.splitlines() == [f"missing    tiny: no reference in {CHECK}/tiny"]
    assert "if they should be: tparticles check --update -- tiny" in first.error
    assert run("check", "--update").code == 0
    files = {path.name for path in (project / CHECK / "tiny").iterdir()}
    assert files == {"000001.png", "000004.png", "reference.json"}
    again = run("check", "--json")
    assert again.code == 0 and again.json["status"] == "done"
    (row,) = again.json["scenes"]
    assert (row["outcome"], row["exact"], row["message"]) == ("same", True, "")
    assert [frame["metrics"]["different"] for frame in row["frames"]] == [0.0, 0.0]


def test_what_is_in_a_reference(project, run, rendered):
    run("check", "--update")
    sheet = json.loads((project / CHECK / "tiny/reference.json").read_text())
    assert sheet["scene"]["parameters"] == {"turn": 20.0, "ev": 7.0} and sheet["scene"]["scheme"] == "rk4"
    assert set(sheet["made_with"]) == {"tparticles", "taichi", "numpy"} and sheet["machine"].endswith("-cpu")
    moments = sheet["shots"][1]["moments"]["dots"]
    assert moments["count"] == 40 and moments["spread"] > 0.5 and 1400 < moments["temperature"] < 1600


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("turn", ["turn was 20.0, is 20.1", "physics and picture changed: dots: mean position"]),
        ("ev", ["ev was 7.0, is 6.95", "the picture changed, the physics did not: "]),
    ],
)
@pytest.mark.parametrize("tolerant", [(), ("--tolerant",)])
def test_a_change_is_told_by_its_kind(run, project, rendered, change, words, tolerant):
    run("check", "--update")
    rendered(change)
    found = run("check", "--json", *tolerant)
    assert found.code == found.json["exit_code"] == 4
    message = found.json["scenes"][0]["message"]
    assert all(word in message for word in words)


def test_an_update_is_explicit_and_refused_on_ci(run, project, rendered, monkeypatch):
    run("check", "--update")
    before = (project / CHECK / "tiny/000004.png").read_bytes()
    rendered("turn")
    assert run("check").code == 4
    monkeypatch.setenv("CI", "true")
    refused = run("check", "--update")
    assert refused.code == 2 and "not updated where CI is set" in refused.error
    assert (project / CHECK / "tiny/000004.png").read_bytes() == before
    monkeypatch.delenv("CI")
    updated = run("check", "--update")
    assert updated.code == 0 and updated.out.startswith("updated    tiny: turn was 20.0, is 20.1; ")
    assert (project / CHECK / "tiny/000004.png").read_bytes() != before
    assert run("check").code == 0
    stamp = (project / CHECK / "tiny/reference.json").stat().st_mtime_ns
    assert run("check", "--update").out.startswith("same ")
    assert (project / CHECK / "tiny/reference.json").stat().st_mtime_ns == stamp


def test_bits_count_on_the_same_version_and_class_of_machine(run, project, rendered, takes):
    run("check", "--update")
    take = takes["as it is"]
    images = {number: image.copy() for number, image in take.images.items()}
    images[4][0, 0, 0] ^= 1
    rendered(Take(0.1, take.sheet, images))
    assert run("check", "--tolerant").out == "close      tiny: 2 frames, within the tolerance\n"
    exact = run("check")
    assert exact.code == 4 and "and none may" in exact.out
    path = project / CHECK / "tiny/reference.json"
    path.write_text(path.read_text().replace('"machine": "', '"machine": "other-'))
    assert run("check").code == 0


def test_what_no_scene_needs_is_reported(run, project, rendered):
    run("check", "--update")
    shutil.copytree(project / CHECK / "tiny", project / CHECK / "gone")
    shutil.copy(project / CHECK / "tiny/000001.png", project / CHECK / "tiny/000009.png")
    (project / CHECK / "check.toml").write_text(PLAN + "[old]\nframes = [2]\n")
    found = run("check", "--json")
    assert found.code == 0
    assert found.json["unused"] == [f"{CHECK}/gone", f"{CHECK}/check.toml/[old]", f"{CHECK}/tiny/000009.png"]
    assert "unused     " in run("check").out
    assert run("check", "tiny", "--json").json["unused"] == []


def broken_picture(folder):
    path = folder / "000004.png"
    path.write_bytes(path.read_bytes()[:-20])


def swapped_pictures(folder):
    shutil.copy(folder / "000001.png", folder / "000004.png")


def no_picture(folder):
    (folder / "000004.png").unlink()


def other_file(folder):
    (folder / "000004.png").write_bytes(b"GIF89a")


def cut_sheet(folder):
    path = folder / "reference.json"
    path.write_text(path.read_text()[:200])


def deep_sheet(folder):
    (folder / "reference.json").write_text("[" * 100_000)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (broken_picture, "tiny/000004.png is cut: the end of the PNG is missing"),
        (swapped_pictures, "tiny/000004.png is not the picture that reference.json tells of"),
        (no_picture, "tiny/000004.png cannot be read: no such file or directory"),
        (other_file, "tiny/000004.png is no PNG"),
        (cut_sheet, "tiny/reference.json is broken"),
        (deep_sheet, "tiny/reference.json is broken"),
    ],
)
def test_a_reference_that_cannot_be_used_is_told_and_can_be_replaced(run, project, rendered, damage, words):
    run("check", "--update")
    damage(project / CHECK / "tiny")
    found = run("check")
    assert found.code == 4 and len(found.out.splitlines()) == 1
    assert found.out.startswith("broken ") and words in found.out
    assert run("check", "--update").code == 0 and run("check").code == 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[tiny]\nframe = [1]", "[tiny]: Plan has no parameter 'frame'; did you mean 'frames'?"),
        ("[tiny]\nframes = [4, 1]", "must rise"),
        ("[tiny]\nsize = [0, 5]", "[tiny]: Plan.size"),
        ("[tiny]\ntolerance = {tile = 0.5}", "[tiny]: a tolerance with another tile needs a written reason"),
        ("[tiny]\ntolerance = {tile = nan, reason = 'x'}", "[tiny]: Tolerance.tile"),
        ("tiny = 1", "[tiny]: a table with size"),
        ("[tiny", "check.toml: "),
        ("a = " + "[" * 5000, "check.toml: "),
    ],
)
def test_a_wrong_plan_is_one_line(run, project, rendered, text, words):
    (project / CHECK / "check.toml").write_text(text)
    refused = run("check")
    assert refused.code == 2 and words in refused.error and not refused.out


def test_a_tolerance_with_its_reason_counts(run, project, rendered):
    run("check", "--update")
    rendered("ev")
    limits = "{changed = 1.0, largest = 255, mean = 255, tile = 255, reason = 'the exposure is being chosen'}"
    (project / CHECK / "check.toml").write_text(PLAN + f"tolerance = {limits}")
    assert run("check", "--tolerant").code == 0


def test_bad_input_is_one_line(run, project, rendered):
    (project / "file").write_text("")
    for arguments, code, words in (
        (("check", "tini"), 2, "did you mean 'tiny'"),
        (("check", "--arch", "gpu"), 2, "unknown arch 'gpu'"),
        (("check", "--references", "file"), 2, "--references file is a file: name a folder"),
        (("check", "--references", " "), 2, "--references is empty"),
        (("check", "--report", "file"), 2, "--report file is a file: name a folder"),
        (("check", "--report", "file/page"), 2, "file/page"),
        (("check", "--update", "--references", "/proc/none"), 1, "/proc/none/tiny"),
    ):
        refused = run(*arguments)
        assert refused.code == code and words in refused.error, arguments


def test_a_scene_that_fails_or_kills_its_process_does_not_hide_the_others(run, project):
    (project / "scenes/tiny.py").write_text("def scene(quality):\n    return 1 / 0\n")
    (project / "scenes/deadly.py").write_text("import os\n\n\ndef scene(quality):\n    os._exit(3)\n")
    write_scene(project / "scenes", "fine")
    found = run("check", "--json")
    outcomes = {row["scene"]: (row["outcome"], row["message"]) for row in found.json["scenes"]}
    assert outcomes["deadly"] == ("failed", "its process died")
    assert outcomes["tiny"][0] == "failed" and "ZeroDivisionError" in outcomes["tiny"][1]
    assert outcomes["fine"][0] == "missing"
    assert found.code == 4 and "1 of 3 scenes" in found.json["error"]


def test_the_exit_code_tells_what_kept_a_scene_from_being_rendered(run, project, rendered):
    rendered(Take(0.1, error=BackendError("no driver")))
    assert run("check").code == 3
    rendered(Take(0.1, error=RunError("a particle went astray")))
    assert run("check").error == "error: tiny: a particle went astray"


def test_two_scenes_of_one_name(run, project):
    other = write_scene(project / "elsewhere")
    assert "two scenes are named 'tiny'" in run("check", "tiny", other).error
