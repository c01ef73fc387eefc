"""Sweeps of real films in real processes: the same pixels as `render`, idempotent, shown at the end."""

from __future__ import annotations

import json
import os
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from batch_commands import FAST, Commands, hashes, states
from PIL import Image

ALL_DONE = {"rate=20": "done", "rate=60": "done", "rate=100": "done"}


class Links(HTMLParser):
    """Collects what a page names."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))


def test_a_sweep_from_nothing_to_everything_there(run: Commands, tmp_path: Path) -> None:
    arguments = (
        "sweep",
        "dots",
        "--set",
        "rate=20:100:3",
        "--arch",
        "cpu",
        "--frames",
        "1-3",
        "--out",
        "o",
        "--workers",
        2,
    )
    first = run(*arguments, "--json")
    assert first.code == 0, first
    assert states(tmp_path / "o") == ALL_DONE
    events = first.events
    assert {e["job"] for e in events if e["event"] == "job" and e["state"] == "done"} == set(ALL_DONE)
    assert any(e["event"] == "frame" and (e["done"], e["frames"]) == (3, 3) for e in events)
    assert events[-1] | {"folder": "o", "status": "done", "done": 3, "failed": 0} == events[-1]
    # one process for each film, and the same pixels as on their own
    assert len({e["where"] for e in events if e.get("state") == "running"}) == 3
    alone = run("render", "dots", *FAST, "--set", "rate=60", "--out", "alone", "--quiet")
    assert alone.code == 0, alone
    assert hashes(tmp_path / "o/jobs/rate=60") == hashes(tmp_path / "alone")
    check_gallery(tmp_path / "o")
    assert not (tmp_path / "o/logs").exists()

    # the same again renders nothing
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "o/jobs").rglob("*") if p.is_file()}
    again = run(*arguments, "--json")
    assert again.code == 0 and [e["event"] for e in again.events] == ["batch"]
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "o/jobs").rglob("*") if p.is_file()} == before
    run(*arguments, "--existing", "error").refused(2, "job 'rate=20'", "holds results already")

    # a damaged film is mended, the others stay
    (tmp_path / "o/jobs/rate=60/frames/000002.png").write_bytes(b"")
    assert run(*arguments).code == 0
    assert {p for p in before if p.stat().st_mtime_ns != before[p]} >= {tmp_path / "o/jobs/rate=60/frames/000002.png"}
    assert (tmp_path / "o/jobs/rate=20/run.json").stat().st_mtime_ns == before[tmp_path / "o/jobs/rate=20/run.json"]
    assert hashes(tmp_path / "o/jobs/rate=60") == hashes(tmp_path / "alone")

    # a record that is lost or broken costs no film
    (tmp_path / "o/batch.json").write_text("{")
    run(*arguments).refused(2, "o/batch.json is broken", "move it away, and the films that are there are taken up")
    (tmp_path / "o/batch.json").unlink()
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "o/jobs").rglob("*") if p.is_file()}
    assert run(*arguments).code == 0
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "o/jobs").rglob("*") if p.is_file()} == before

    # another text of the scene makes the results stale
    scene = tmp_path / "scenes/dots.py"
    scene.write_text(scene.read_text().replace("circulation=20.0", "circulation=21.0"))
    run(*arguments).refused(
        2, "job 'rate=20'", "rendered with other parameters, settings or text", "--existing overwrite"
    )
    # other jobs in the same folder are a mistake, more of them are not
    run("sweep", "dots", "--set", "rate=7,8", *FAST, "--out", "o").refused(
        2, "a batch with other jobs, such as 'rate=20'"
    )
    assert run(*arguments, "--existing", "overwrite", "--quiet").code == 0
    assert hashes(tmp_path / "o/jobs/rate=60") != hashes(tmp_path / "alone")


def check_gallery(folder: Path) -> None:
    """Check that the sheet shows three bright stills and that everything the page names is there."""
    with Image.open(folder / "contact.png") as sheet:
        assert sheet.size[0] > 3 * 288
        for i in range(3):
            still = sheet.crop((8 + i * 296, 8, 8 + i * 296 + 288, 170))
            assert max(still.convert("L").getextrema()) > 100
    text = (folder / "index.html").read_text()
    links = Links()
    links.feed(text)
    films = [attributes for tag, attributes in links.tags if tag == "video"]
    assert len(films) == 3
    for film in films:
        for name in ("src", "poster"):
            address = film[name] or ""
            assert not re.match(r"[a-z]+:|/", address)
            assert (folder / unquote(address)).is_file()
    assert not any(tag == "script" for tag, _ in links.tags)
    assert "default-src 'none'" in text


def test_a_film_that_fails_costs_no_other_and_retry_runs_it_again(run: Commands, tmp_path: Path) -> None:
    scene = tmp_path / "scenes/dots.py"
    text = scene.read_text()
    # only known when it runs: the parent's look finds nothing
    scene.write_text(
        text.replace('trouble == "refuse"', '__import__("sys").argv[-1].endswith("worker.py") and rate == 60.0')
    )
    done = run("sweep", "dots", "--set", "rate=20,60", *FAST, "--out", "o")
    done.refused(1, "1 of 2 jobs failed, the first 'rate=60'", "ValueError: no such film", "tparticles retry o")
    assert states(tmp_path / "o") == {"rate=20": "done", "rate=60": "failed"}
    row = json.loads((tmp_path / "o/batch.json").read_text())["jobs"][1]
    assert (row["attempts"], row["exit_code"]) == (1, 2)  # bad input is the same the next time
    told = run("status", "o")
    assert "o: failed; 1 done, 1 failed" in told.out and "rate=60: failed, 1 attempt, " in told.out
    assert run("status", "o", "--json").events[0]["counts"] == {"done": 1, "failed": 1}
    assert "failed" in (tmp_path / "o/index.html").read_text()
    scene.write_text(text)
    before = (tmp_path / "o/jobs/rate=20/run.json").stat().st_mtime_ns
    assert run("retry", "o").code == 0
    assert (tmp_path / "o/jobs/rate=20/run.json").stat().st_mtime_ns == before
    assert states(tmp_path / "o") == {"rate=20": "done", "rate=60": "done"}


def test_a_hostile_parameter_is_only_text(run: Commands, tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>/../../x"
    done = run("sweep", "dots", "--set", f"note={evil},plain", *FAST, "--out", "o", "--quiet")
    assert done.code == 0, done
    names = sorted(path.name for path in (tmp_path / "o/jobs").iterdir())
    assert len(names) == 2 and all(re.fullmatch(r"note=[\w.~-]+", name) for name in names)
    text = (tmp_path / "o/index.html").read_text()
    assert "<script" not in text and "&lt;script&gt;" in text


def test_a_dry_run_writes_nothing(run: Commands, tmp_path: Path) -> None:
    arguments = ("sweep", "dots", "--set", "rate=20,60", *FAST, "--out", "o", "--dry-run")
    done = run(*arguments)
    assert done.code == 0, done
    *rows, last = done.out.splitlines()
    assert rows == ["rate=20: 3 frames of 64x36", "rate=60: 3 frames of 64x36"]
    assert re.fullmatch(r"2 jobs, 6 frames, about \d+\.\d MiB, at least \d+ s with \d workers?", last)
    assert not (tmp_path / "o").exists()
    (plan,) = run(*arguments, "--json").events
    assert (plan["jobs"], plan["frames"]) == (2, 6)
    assert 100 < plan["bytes"] < 100_000 and 0.1 < plan["seconds"] < 60.0


REFUSED = [
    (("sweep", "dots", "--set", "rtae=1,2"), "job 'rtae=1': scene 'dots' has no parameter 'rtae'; did you mean 'rate'"),
    (("sweep", "dots", "--set", "rate=1,x"), "job 'rate=x': scene 'dots': parameter rate = x"),
    (("sweep", "dots", "--set", "rate=1:2"), "parameter rate = 1:2"),
    (("sweep", "dots", "--set", "rate=1", "--set", "rate=2"), "--set rate is given twice"),
    (("sweep", "dots", "--set", "rate=1,2", "--seeds", "1-3", "--zip"), "--zip pairs values one by one: rate has 2"),
    (("sweep", "dots", "--seeds", "0-999999"), "1000000 jobs: add --yes if you mean it"),
    (("sweep", "dots", "--existing", "maybe"), "unknown value of --existing 'maybe'"),
    (
        ("sweep", "evil.py"),
        "scene 'evil.py' is a Python file outside scenes/, and a script is code: add --allow-python",
    ),
    (("sweep", "doots"), "unknown scene 'doots'; did you mean 'dots'"),
    (("sweep", "dots", "--gpu"), "--gpu goes with --dask"),
    (("sweep", "dots", "--dask", "nonsense"), "--dask nonsense: an address such as tcp://scheduler:8786"),
    (("sweep", "dots", "--out", "scenes"), "holds dots.py but no batch.json"),
    (("sweep", "dots", "--out", "scenes/dots.py"), "is a file"),
    (("sweep", "dots", "--out", "/proc/self/new"), "cannot write into output folder"),
    (("batch", "none.toml"), "none.toml cannot be read"),
    (("status", "scenes"), "scenes holds no batch: cannot read batch.json"),
    (("retry", "nowhere"), "nowhere holds no batch"),
    (("cancel", "nowhere"), "nowhere holds no batch"),
]


def test_bad_input_is_one_line_before_anything_is_written(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from tparticles.cli import main

    for arguments, words in REFUSED:
        out = () if "--out" in arguments or arguments[0] != "sweep" else ("--out", "o")
        with pytest.raises(SystemExit) as left:
            main([*arguments, *out])
        captured = capfd.readouterr()
        assert (left.value.code, captured.out) == (2, ""), (arguments, captured)
        (line,) = captured.err.splitlines()
        assert words in line, (arguments, line)
        assert not (tmp_path / "nowhere").exists()
        assert not (tmp_path / "o").exists()


def test_jobs_of_a_file_with_a_script_from_elsewhere(run: Commands, tmp_path: Path) -> None:
    os.rename("scenes/dots.py", "elsewhere.py")
    (tmp_path / "night.toml").write_text(
        '[defaults]\nframes = "1-2"\nmp4 = false\narch = "cpu"\n[[job]]\nscene = "elsewhere.py"\nname = "one"\nseed = 4\n'
    )
    run("batch", "night.toml").refused(2, "'elsewhere.py' is a Python file outside scenes/", "--allow-python")
    assert run("batch", "night.toml", "--allow-python", "--quiet").code == 0
    assert states(tmp_path / "renders/night") == {"one": "done"}
    assert json.loads((tmp_path / "renders/night/jobs/one/run.json").read_text())["seed"] == 4
    run("retry", "renders/night").refused(2, "--allow-python")
