"""`tparticles study ...`: files, exit codes, streams."""

from __future__ import annotations

import csv
import functools
import json
import sys
from pathlib import Path

import pytest

from tparticles.cli import main
from tparticles.studies import report

STUDIES = {
    "order": ["order"],
    "stability": ["stability", "stability-damping"],
    "energy": ["energy"],
    "variable-steps": ["variable-steps", "variable-steps-frame"],
}


@pytest.fixture
def run(capfd, tmp_path, monkeypatch):
    """Run a command in this process, in an empty folder: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        capfd.readouterr()
        with pytest.raises(SystemExit) as left:
            main(["study", *map(str, arguments)])
        captured = capfd.readouterr()
        return left.value.code, captured.out, captured.err

    return run


@pytest.fixture
def short(monkeypatch, cpu64):
    """Make the studies short."""
    from tparticles.studies import energy, order, stability, variable_steps

    for module, settings in {
        order: {"problems": [order.PROBLEMS[1]], "steps": [2, 4, 8, 16], "count": 2},
        stability: {"zetas": [0.0, 0.5], "rays": [90, 180]},
        energy: {"periods": 20, "samples": 5},
        variable_steps: {"width": 8, "height": 6, "engine": False},
    }.items():
        monkeypatch.setattr(module, "study", functools.partial(module.study, **settings))


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_writes_json_csv_and_pictures(run, short, name):
    code, out, err = run(name, "--scheme", "rk4", "--scheme", "midpoint", "--out", "found")
    assert (code, "rk4" in out) == (0, True), err
    folder = Path("found")
    result = json.loads((folder / f"{name}.json").read_text(), parse_constant=lambda word: pytest.fail(word))
    assert result["study"] == name
    rows = list(csv.DictReader((folder / f"{name}.csv").read_text().splitlines()))
    assert {row["scheme"] for row in rows} <= {"rk4", "midpoint"}
    expected = {f"{name}.json", f"{name}.csv"}
    if report.has_matplotlib():
        expected |= {f"{picture}.png" for picture in STUDIES[name]}
        for picture in STUDIES[name]:
            assert (folder / f"{picture}.png").read_bytes().startswith(b"\x89PNG")
    assert {path.name for path in folder.iterdir()} == expected


def test_the_same_study_gives_the_same_files_again(run, short):
    files = []
    for _ in range(2):
        assert run("stability", "--scheme", "ab3", "--out", "found", "--quiet") == (0, "", "")
        files.append({path.name: path.read_bytes() for path in Path("found").iterdir()})
    assert files[0] == files[1]


def test_json_is_all_that_stdout_holds(run):
    code, out, err = run("stability", "--scheme", "trapezoidal", "--json", "--quiet")
    assert (code, err) == (0, "")
    found = json.loads(out, parse_constant=lambda word: pytest.fail(word))
    assert found == json.loads(Path("renders/studies/stability.json").read_text())
    (region,) = found["regions"]
    assert (region["scheme"], region["real_limit"], region["a_stable"]) == ("trapezoidal", None, True)


def test_without_matplotlib_one_line_says_what_to_install(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    code, out, err = run("stability", "--scheme", "rk4")
    assert code == 0
    assert err.splitlines() == [
        "no pictures: matplotlib is missing; install it with: pip install 'tparticles[studies]'"
    ]
    assert sorted(path.name for path in Path("renders/studies").iterdir()) == ["stability.csv", "stability.json"]
    assert "2.7853" in out


@pytest.mark.parametrize("name", STUDIES)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scheme", "rk5"], "unknown scheme 'rk5'; did you mean 'rk"),
        (["--out", "taken"], "output folder taken is a file: choose a folder with --out"),
        (["--out", "taken/in"], "cannot use the folder taken/in"),
        (["--out", " "], "--out is empty"),
        (["--steps", "3"], "No such option"),
    ],
)
def test_bad_input_is_refused_in_one_line(run, name, arguments, message):
    Path("taken").write_text("mine")
    code, out, err = run(name, *arguments)
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith("error: ") and message in line
    assert Path("taken").read_text() == "mine"


def test_bad_input_is_json_where_that_was_asked_for(run):
    code, out, _ = run("order", "--scheme", "rk5", "--json")
    assert code == 2
    assert json.loads(out)["exit_code"] == 2


def test_an_unknown_study_and_none(run):
    assert run("entropy")[0] == 2
    code, out, _ = run()
    assert code == 0
    assert all(name in out for name in STUDIES)


def test_other_files_of_the_folder_stay(run):
    Path("found").mkdir()
    Path("found/notes.txt").write_text("mine")
    assert run("stability", "--scheme", "euler", "--out", "found", "--quiet")[0] == 0
    assert Path("found/notes.txt").read_text() == "mine"


def test_csv_cells():
    text = report.as_csv([{"a": float("nan"), "b": float("inf"), "c": "x, y", "d": 1}])
    assert text.splitlines() == ["a,b,c,d", ',inf,"x, y",1']
    assert report.as_csv([]) == "\n"
