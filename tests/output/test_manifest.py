from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tparticles.errors import InputError, RunError
from tparticles.output import Manifest, jsonable, manifest, read_manifest

HEADER = {"scene": "campfire", "identity": "abc", "fps": Fraction(30000, 1001), "parameters": {"wind": np.float32(2.5)}}


def test_the_file_reads_as_written(tmp_path: Path) -> None:
    run = Manifest(tmp_path / "run.json", HEADER)
    run.add({"frame": 2, "alive": np.int64(7), "dt_min": float("nan")})
    run.add({"frame": 1, "alive": 5, "sha256": "00"})
    run.finish()
    assert (tmp_path / "run.json").read_text() == (
        '{\n  "scene": "campfire",\n  "identity": "abc",\n  "fps": "30000/1001",\n  "parameters": {\n'
        '    "wind": 2.5\n  },\n  "status": "done",\n  "error": null,\n  "frames": [\n'
        '    {"frame": 1, "alive": 5, "sha256": "00"},\n    {"frame": 2, "alive": 7, "dt_min": null}\n  ]\n}\n'
    )


def test_it_is_on_the_disk_before_the_first_row(tmp_path: Path) -> None:
    Manifest(tmp_path / "new/run.json", HEADER)
    content = read_manifest(tmp_path / "new/run.json")
    assert (content["status"], content["frames"]) == ("running", [])


@pytest.mark.parametrize(("status", "error"), [("done", None), ("failed", 'disk "full"\n'), ("interrupted", None)])
def test_it_says_how_the_run_ended(tmp_path: Path, status, error: str | None) -> None:
    run = Manifest(tmp_path / "run.json", HEADER)
    run.finish(status, error)
    content = read_manifest(tmp_path / "run.json")
    assert (content["status"], content["error"]) == (status, error)
    with pytest.raises(ValueError, match="finished"):
        run.add({"frame": 1})


def test_rows_of_many_threads_are_sorted_and_the_last_of_a_number_counts(tmp_path: Path) -> None:
    run = Manifest(tmp_path / "run.json", HEADER, interval=0.0)
    order = np.random.default_rng(0).permutation(100).tolist()
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda k: run.add({"frame": k, "alive": k}), order))
    run.add({"frame": 50, "alive": -1})
    run.finish()
    rows = read_manifest(tmp_path / "run.json")["frames"]
    assert [row["frame"] for row in rows] == list(range(100))
    assert [row["alive"] for row in rows] == [*range(50), -1, *range(51, 100)]


def test_it_is_saved_about_once_a_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(manifest.time, "monotonic", lambda: now[0])
    run = Manifest(tmp_path / "run.json", HEADER)
    saved = []
    for k in range(30):
        now[0] = 0.1 * k
        run.add({"frame": k})
        saved.append(len(read_manifest(tmp_path / "run.json")["frames"]))
    assert sorted(set(saved)) == [0, 11, 21]
    run.finish()
    assert len(read_manifest(tmp_path / "run.json")["frames"]) == 30


def test_slow_saves_become_rare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter(range(1000))  # each look at the clock is a second later: a save takes one
    monkeypatch.setattr(manifest.time, "monotonic", lambda: float(next(ticks)))
    run = Manifest(tmp_path / "run.json", HEADER)
    sizes = []
    for k in range(60):
        run.add({"frame": k})
        sizes.append(len(read_manifest(tmp_path / "run.json")["frames"]))
    assert 2 <= len(set(sizes)) <= 4


@pytest.mark.parametrize("name", ["status", "error", "frames"])
def test_names_of_the_manifest_cannot_be_taken(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match=name):
        Manifest(tmp_path / "run.json", HEADER | {name: 1})


@pytest.mark.parametrize("name", ["scene", "identity"])
def test_a_manifest_must_say_whose_it_is(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match=f"header lacks {name}"):
        Manifest(tmp_path / "run.json", {key: value for key, value in HEADER.items() if key != name})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("row", [{}, {"frame": None}, {"frame": "1"}, {"frame": 1.0}, {"frame": True}])
def test_a_row_must_have_its_number(tmp_path: Path, row: dict) -> None:
    with pytest.raises(ValueError, match="number of the frame"):
        Manifest(tmp_path / "run.json", HEADER).add(row)


def test_a_full_disk_keeps_the_last_save_and_hides_no_other_error(tmp_path: Path, monkeypatch) -> None:
    run = Manifest(tmp_path / "run.json", HEADER, interval=0.0)
    run.add({"frame": 1})
    before = (tmp_path / "run.json").read_bytes()

    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fail)
    monkeypatch.setattr(run, "_next_save", 0.0)
    with pytest.raises(RunError, match=r"run\.json: No space left"):
        run.add({"frame": 2})
    with pytest.raises(RunError, match=r"run\.json: No space left"):
        run.finish("done")
    run.finish("failed", "no space")
    assert (tmp_path / "run.json").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


_ENDLESS = """
import itertools, sys
from tparticles.output import Manifest
run = Manifest(sys.argv[1], {"scene": "campfire", "identity": "abc", "padding": "x" * 100_000}, interval=0.0)
for frame in itertools.count(1):
    run._next_save = 0.0
    run.add({"frame": frame})
    print(frame, flush=True)
"""


@pytest.mark.parametrize("after", [1, 7, 40])
def test_a_killed_process_leaves_a_whole_file(tmp_path: Path, after: int) -> None:
    command = [sys.executable, "-c", _ENDLESS, str(tmp_path / "run.json")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if int(line) >= after:
                process.kill()
                break
    content = read_manifest(tmp_path / "run.json")
    assert content["status"] == "running"
    numbers = [row["frame"] for row in content["frames"]]
    assert len(numbers) >= after and numbers == list(range(1, len(numbers) + 1))
    Manifest(tmp_path / "run.json", HEADER).finish()
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"], "leftovers are cleared"


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (float("nan"), None),
        (float("-inf"), None),
        (np.float32("nan"), None),
        (np.longdouble(1.5), 1.5),
        (np.array([1.0, np.nan, np.inf]), [1.0, None, None]),
        (np.array([1.5], np.longdouble), [1.5]),
        (np.array(3), 3),
        (np.bool_(True), True),
        (np.uint64(2**63), 2**63),
        (np.str_("a"), "a"),
        ((1, [2, {"a": np.int8(3)}]), [1, [2, {"a": 3}]]),
        ({1: Fraction(1, 3)}, {"1": "1/3"}),
        (Path("a/b"), "a/b"),
        (None, None),
    ],
)
def test_values_become_json(value: object, expected: object) -> None:
    assert json.loads(json.dumps(jsonable(value), allow_nan=False)) == expected


@pytest.mark.parametrize("value", [object(), {1, 2}, 1j, b"x", [np.array([1j])], np.datetime64("2001-01-01")])
def test_other_values_are_refused(value: object) -> None:
    with pytest.raises(TypeError, match="cannot be written as JSON"):
        jsonable(value)


@given(st.recursive(st.floats() | st.integers() | st.text() | st.none(), lambda s: st.lists(s) | st.tuples(s, s)))
def test_nothing_becomes_json_that_json_cannot_hold(value: object) -> None:
    json.loads(json.dumps(jsonable(value), allow_nan=False))


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"scene": 1, "identity": "a"}', "[" * 100_000, "\udcff"])
def test_a_broken_file_is_refused_by_name(tmp_path: Path, content: str) -> None:
    path = tmp_path / "run.json"
    path.write_bytes(content.encode(errors="surrogateescape"))
    with pytest.raises(InputError, match=r"run\.json is broken"):
        read_manifest(path)


def test_a_missing_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read .*run\.json: No such file"):
        read_manifest(tmp_path / "run.json")
