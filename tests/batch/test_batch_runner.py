"""Retries, timeouts and states, against a pool that does as it is told."""

from __future__ import annotations

import json
import time
from collections import deque
from pathlib import Path
from typing import Any

import pytest

from tparticles.batch.record import Entry, Record
from tparticles.batch.runner import CANCEL_NAME, CancelledError, Runner
from tparticles.batch.tasks import Task
from tparticles.errors import InputError
from tparticles.progress import BatchProgress, duration

DONE = {"event": "end", "code": 0, "frames": 3}


def death(code: int = 137) -> dict[str, Any]:
    return {"event": "end", "code": code, "error": f"died with {code}"}


class Scripted:
    """A pool whose jobs end as a script says: a list of ends for each job; one without an end runs until it is stopped."""

    threads = 1

    def __init__(self, ends: dict[str, list[dict[str, Any]]], room: int = 2):
        self.ends, self.size = ends, room
        self.orders: list[dict[str, Any]] = []
        self.running: set[str] = set()
        self.told: deque[tuple[str, dict[str, Any]]] = deque()
        self.most = 0

    def room(self) -> int:
        return self.size - len(self.running)

    def submit(self, name: str, order: dict[str, Any]) -> None:
        self.orders.append(order)
        self.running.add(name)
        self.most = max(self.most, len(self.running))
        self.told.append((name, {"event": "started"}))
        self.told.append((name, {"event": "frame", "done": 1, "frames": 3}))
        if self.ends[name]:
            self.told.append((name, self.ends[name].pop(0)))

    def next(self, timeout: float) -> tuple[str, dict[str, Any]] | None:
        if not self.told:
            time.sleep(min(timeout, 0.01))
            return None
        name, event = self.told.popleft()
        if event["event"] == "end":
            self.running.discard(name)
        return name, event

    def stop(self, name: str) -> None:
        self.told.append((name, death(130)))

    def close(self) -> list[tuple[str, dict[str, Any]]]:
        return list(self.told)


def record(folder: Path, *names: str) -> Record:
    return Record(folder, [Entry(Task(name=name, scene="s")) for name in names])


def test_what_fails_is_run_again_as_often_as_was_said(tmp_path: Path) -> None:
    pool = Scripted({"a": [DONE], "b": [death(), death(1), DONE], "c": [death(), death(), death()]})
    jobs = record(tmp_path, "a", "b", "c")
    Runner(jobs, pool, retries=2).run()
    assert {n: (e.state, e.attempts, e.exit_code) for n, e in jobs.entries.items()} == {
        "a": ("done", 1, 0),
        "b": ("done", 3, 0),
        "c": ("failed", 3, 137),
    }
    assert (jobs["b"].error, jobs["c"].error) == (None, "died with 137")
    assert jobs.status == "failed"
    assert json.loads((tmp_path / "batch.json").read_text())["jobs"][2]["state"] == "failed"
    assert pool.most == 2
    assert [order["again"] for order in pool.orders if order["task"]["name"] == "b"] == [False, True, True]


@pytest.mark.parametrize("code", [2, 3])
def test_bad_input_is_not_tried_again(tmp_path: Path, code: int) -> None:
    jobs = record(tmp_path, "a")
    Runner(jobs, Scripted({"a": [death(code), DONE]}), retries=5).run()
    assert (jobs["a"].state, jobs["a"].attempts, jobs["a"].exit_code) == ("failed", 1, code)


def test_what_takes_too_long_is_stopped_by_a_clock_that_nobody_sets(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(time, "time", lambda: 0.0)  # set back to 1970
    jobs = record(tmp_path, "a", "b")
    Runner(jobs, Scripted({"a": [], "b": [DONE]}), timeout=0.15).run()
    assert (jobs["a"].state, jobs["a"].error) == ("failed", "took longer than --timeout 0.15 s")
    assert 0.15 <= jobs["a"].seconds < 30.0
    assert jobs["b"].state == "done"


def test_a_batch_that_is_cancelled_leaves_what_is_done(tmp_path: Path) -> None:
    jobs = record(tmp_path, "a", "b", "c")
    pool = Scripted({"a": [DONE], "b": [], "c": []})

    def hear(event: dict[str, Any]) -> None:
        if event.get("state") == "done":
            (tmp_path / CANCEL_NAME).touch()

    with pytest.raises(CancelledError, match="cancelled"):
        Runner(jobs, pool, hear=hear).run()
    assert [e.state for e in jobs.entries.values()] == ["done", "cancelled", "cancelled"]
    assert not (tmp_path / CANCEL_NAME).exists()
    assert json.loads((tmp_path / "batch.json").read_text())["status"] == "cancelled"


def test_an_interruption_lets_jobs_wait_for_the_next_time(tmp_path: Path) -> None:
    jobs = record(tmp_path, "a", "b", "c")
    signals: list[int] = []
    pool = Scripted({"a": [DONE], "b": [], "c": []})
    with pytest.raises(KeyboardInterrupt):
        Runner(
            jobs, pool, hear=lambda e: signals.append(2) if e.get("state") == "done" else None, signals=signals
        ).run()
    assert [e.state for e in jobs.entries.values()] == ["done", "waiting", "waiting"]
    assert json.loads((tmp_path / "batch.json").read_text())["status"] == "interrupted"


def test_a_record_that_cannot_be_kept_is_told_before_a_job_begins(tmp_path: Path) -> None:
    pool = Scripted({"a": [DONE]})
    with pytest.raises(InputError, match=r"cannot write .*batch\.json"):
        Runner(record(tmp_path / "gone", "a"), pool).run()
    assert not pool.orders


def test_progress_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with BatchProgress(4, 1) as progress:
        for event in (
            {"event": "job", "job": "a", "state": "running"},
            {"event": "frame", "job": "a", "done": 5, "frames": 10},
            {"event": "job", "job": "a", "state": "done"},
            {"event": "job", "job": "b", "state": "running"},
            {"event": "job", "job": "b", "state": "failed", "error": "boom"},
        ):
            progress.hear(event)
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("a: done; 2 of 4 done, ") and first.endswith(" left")
    assert second.startswith("b: failed (boom); 2 of 4 done, 1 failed, ")


@pytest.mark.parametrize(("seconds", "words"), [(3.2, "3 s"), (99, "99 s"), (600, "10 min"), (7200, "2.0 h")])
def test_durations_in_words(seconds: float, words: str) -> None:
    assert duration(seconds) == words
