"""What goes wrong in the night: workers and batches killed, Ctrl-C, a second batch, a clock that is set back. Nothing is lost."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest
from batch_commands import FAST, SLOW, Commands, alive, children, hashes, kill, states, until

from tparticles.output import is_whole_png

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="needs Linux's /proc to find worker processes"
)


def frames(folder: Path, job: str) -> int:
    return len(list((folder / "jobs" / job / "frames").glob("*.png")))


def workers(pid: int) -> list[int]:
    return children(pid, "tparticles.batch.worker")


def test_a_killed_worker_is_replaced_and_the_film_is_the_same(run: Commands, tmp_path: Path) -> None:
    arguments = ("sweep", "dots", "--seeds", "1-2", "--arch", "cpu", "--no-mp4", "--frames", "1-250", "--workers", 2)
    batch = run.start(*arguments, "--out", "o", "--json")
    until(lambda: frames(tmp_path / "o", "seed=1") > 20 or frames(tmp_path / "o", "seed=2") > 20, batch)
    killed = workers(batch.process.pid)[0]
    kill(killed)
    assert batch.end().code == 0, batch
    events = [e for e in batch.events if e["event"] == "job"]
    (again,) = [e for e in events if e["state"] == "waiting"]
    assert again["error"] == "its process was killed by SIGKILL"
    assert states(tmp_path / "o") == {"seed=1": "done", "seed=2": "done"}
    attempts = {row["name"]: row["attempts"] for row in json.loads((tmp_path / "o/batch.json").read_text())["jobs"]}
    assert sorted(attempts.values()) == [1, 2] and attempts[again["job"]] == 2
    alone = run("render", "dots", *FAST, "--frames", "1-250", "--seed", again["job"][-1], "--out", "alone", "--quiet")
    assert alone.code == 0, alone
    assert hashes(tmp_path / "o/jobs" / again["job"]) == hashes(tmp_path / "alone")
    assert len(hashes(tmp_path / "alone")) == 250


def test_a_batch_that_is_interrupted_ends_its_workers_and_goes_on(run: Commands, tmp_path: Path) -> None:
    batch = run.start("sweep", "dots", "--seeds", "1-4", *SLOW, "--out", "o", "--workers", 1)
    until(lambda: frames(tmp_path / "o", "seed=1") > 3, batch)
    # the next two films get ready up to their first frames, and wait
    until(lambda: frames(tmp_path / "o", "seed=2") == frames(tmp_path / "o", "seed=3") == 1, batch)
    some = frames(tmp_path / "o", "seed=1")
    until(lambda: frames(tmp_path / "o", "seed=1") > some + 50, batch)
    assert [frames(tmp_path / "o", f"seed={seed}") for seed in (2, 3, 4)] == [1, 1, 0]
    pids = workers(batch.process.pid)
    first = next(pid for pid in pids if str(pid) in (tmp_path / "o/jobs/seed=1/.tparticles.lock").read_text())
    # a second batch, and a render into a folder that is being rendered, are refused by name
    second = run("sweep", "dots", "--seeds", "1-4", *SLOW, "--out", "o")
    second.refused(2, f"o is being written by process {batch.process.pid}", "--out")
    into = run("render", "dots", *SLOW, "--seed", "1", "--out", "o/jobs/seed=1")
    into.refused(2, f"o/jobs/seed=1 is being written by process {first}")
    assert f"o: running (process {batch.process.pid})" in run("status", "o").out
    batch.process.send_signal(signal.SIGINT)
    batch.end().refused(130, "interrupted; what is finished stays")
    until(lambda: not any(map(alive, pids)), seconds=10)
    assert set(states(tmp_path / "o").values()) == {"waiting"}
    run_json = json.loads((tmp_path / "o/jobs/seed=1/run.json").read_text())
    assert run_json["status"] == "interrupted" and len(run_json["frames"]) > 3
    assert all(map(is_whole_png, (tmp_path / "o/jobs").rglob("*.png")))
    assert "o: interrupted; 4 waiting" in run("status", "o").out

    # a killed batch takes its workers along, and leaves a record that goes on, too
    again = run.start("retry", "o", "--workers", 2)
    before = frames(tmp_path / "o", "seed=2")
    until(lambda: frames(tmp_path / "o", "seed=2") > before + 3, again)
    pids = workers(again.process.pid)
    assert len(pids) >= 2
    kill(again.process.pid)
    again.end()
    until(lambda: not any(map(alive, pids)), seconds=20)
    assert "o: stopped; " in run("status", "o").out
    assert "running" in states(tmp_path / "o").values()

    # and cancel ends one from outside
    third = run.start("retry", "o", "--workers", 1)
    until(lambda: len(workers(third.process.pid)) > 0 and "running" in states(tmp_path / "o").values(), third)
    until(lambda: run("status", "o").out.startswith("o: running"), third)
    told = run("cancel", "o")
    assert told.code == 0 and told.out == "o: 4 cancelled\n", told
    third.end().refused(130, "cancelled; what is finished stays")
    assert set(states(tmp_path / "o").values()) == {"cancelled"}


def test_a_film_that_takes_too_long_is_stopped_and_kept(run: Commands, tmp_path: Path) -> None:
    batch = run.start("sweep", "dots", *SLOW, "--out", "o", "--timeout", "4", "--retries", "0")
    until(lambda: workers(batch.process.pid), batch)
    pids = workers(batch.process.pid)
    batch.end().refused(1, "1 of 1 jobs failed", "took longer than --timeout 4 s")
    assert not any(map(alive, pids))
    assert all(map(is_whole_png, tmp_path.rglob("*.png")))
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_clock_set_back_changes_nothing(run: Commands, tmp_path: Path) -> None:
    # every reading of the wall clock in the batch's process is an hour before the one before
    code = (
        "import time, itertools; back = itertools.count(); real = time.time\n"
        "time.time = lambda: real() - 3600.0 * next(back)\n"
        "from tparticles.cli import main; main()"
    )
    done = run.python(code, "sweep", "dots", "--seeds", "1-2", *FAST, "--out", "o", "--timeout", "60").end()
    assert done.code == 0, done
    rows = json.loads((tmp_path / "o/batch.json").read_text())["jobs"]
    assert all(row["state"] == "done" and 0.0 < row["seconds"] < 60.0 for row in rows)


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root for a tmpfs")
def test_a_full_disk_fails_films_in_one_line_and_loses_none(run: Commands, tmp_path: Path) -> None:
    code = (
        "import os, subprocess, sys\n"
        "from tparticles.cli import main\n"
        "os.makedirs('small', exist_ok=True)\n"
        "if subprocess.run(['mount', '-t', 'tmpfs', '-o', 'size=200k', 'none', 'small']).returncode: sys.exit(77)\n"
        "try: main()\n"
        "finally: subprocess.run(['cp', '-a', 'small/o', 'kept']); subprocess.run(['umount', '-l', 'small'])\n"
    )
    arguments = ("sweep", "dots", "--seeds", "1-2", *SLOW, "--out", "small/o", "--retries", "0", "--workers", 1)
    done = run.python(code, *arguments).end()
    if done.code == 77:
        pytest.skip(f"cannot mount a tmpfs: {done.err.strip()}")
    done.refused(1, "No space left on device")
    whole = [path for path in (tmp_path / "kept/jobs").rglob("*.png") if is_whole_png(path)]
    assert len(whole) > 10 and len(whole) == len(list((tmp_path / "kept/jobs").rglob("*.png")))
    json.loads((tmp_path / "kept/batch.json").read_text())
