from __future__ import annotations

import os
import random
import signal
import threading
import time
import weakref
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tparticles.errors import RunError
from tparticles.output import (
    FrameRecord,
    Mp4,
    Null,
    OutputFrame,
    Pipeline,
    PngSequence,
    States,
    is_whole_png,
    pipeline,
    pixel_hash,
)

# Ctrl-C reaches the main thread of a process, which a worker of pytest-xdist keeps for itself.
pytestmark = pytest.mark.serial


class Recorder:
    """A writer that keeps what it was told; `gate` holds writes up, `fails_at` breaks one."""

    def __init__(self, *, ordered: bool = False, fails_at: int = 0, gate: threading.Event | None = None) -> None:
        self.ordered = ordered
        self.fails_at = fails_at
        self.gate = gate
        self.begun: list[int] = []
        self.written: list[int] = []
        self.threads: set[int] = set()
        self.ends: list[str] = []

    def write(self, frame: OutputFrame) -> None:
        self.begun.append(frame.number)
        self.threads.add(threading.get_ident())
        if self.gate is not None:
            assert self.gate.wait(10)
        if frame.number == self.fails_at:
            raise RunError(f"frame {frame.number} broke")
        self.written.append(frame.number)

    def close(self) -> None:
        self.ends.append("close")

    def abort(self) -> None:
        self.ends.append("abort")


def within(seconds: float, work: Callable[[], object]) -> None:
    """Run `work` on a thread and fail if it has not ended in time; what it raises is raised here."""
    raised: list[BaseException] = []

    def run() -> None:
        try:
            work()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(seconds)
    assert not thread.is_alive(), "deadlock"
    if raised:
        raise raised[0]


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


@pytest.mark.parametrize("queue_size", [1, 3, 20])
@pytest.mark.parametrize("workers", [1, 3])
def test_every_writer_gets_every_frame_and_ordered_ones_in_order(make_frame, workers: int, queue_size: int) -> None:
    free, ordered, records = Recorder(), Recorder(ordered=True), []
    with Pipeline([free, ordered], workers=workers, queue_size=queue_size, on_frame=records.append) as output:
        for number in range(1, 31):
            output.submit(make_frame(number))
    assert ordered.written == list(range(1, 31))
    assert len(ordered.threads) == 1
    assert sorted(free.written) == list(range(1, 31))
    assert len(free.threads) <= workers
    assert threading.get_ident() not in free.threads | ordered.threads
    assert free.ends == ordered.ends == ["close"]
    assert {r.number: r.sha256 for r in records} == {k: pixel_hash(make_frame(k).image) for k in range(1, 31)}
    assert all(isinstance(r, FrameRecord) and r.encode_ms > 0 for r in records)


def test_unordered_writes_run_side_by_side(make_frame) -> None:
    meeting = threading.Barrier(3)

    class Meets(Null):
        def write(self, frame: OutputFrame) -> None:
            meeting.wait(10)

    with Pipeline([Meets()], workers=3) as output:
        for number in (1, 2, 3):
            output.submit(make_frame(number))


def test_pixels_are_hashed_on_a_worker(make_frame, monkeypatch) -> None:
    threads = []
    monkeypatch.setattr(pipeline, "pixel_hash", lambda image: threads.append(threading.get_ident()) or "hash")
    with Pipeline([]) as output:
        output.submit(make_frame(1))
    assert len(threads) == 1 and threads[0] != threading.get_ident()


@pytest.mark.parametrize("ordered", [False, True])
def test_submit_does_not_wait_until_the_queue_is_full(make_frame, ordered: bool) -> None:
    gate, submitted = threading.Event(), []
    writer = Recorder(ordered=ordered, gate=gate)
    with Pipeline([writer], workers=2, queue_size=3) as output:

        def submit_all() -> None:
            for number in range(1, 7):
                output.submit(make_frame(number))
                submitted.append(number)

        thread = threading.Thread(target=submit_all)
        thread.start()
        until(lambda: len(submitted) == 3)
        time.sleep(0.05)
        assert submitted == [1, 2, 3], "the fourth must wait"
        gate.set()
        thread.join(10)
        assert submitted == [1, 2, 3, 4, 5, 6]


def test_drain_waits_for_the_last_callback_and_frames_are_let_go(make_frame) -> None:
    writer, records = Recorder(ordered=True), []

    def report(record: FrameRecord) -> None:
        time.sleep(0.01)
        records.append(record.number)

    with Pipeline([writer], on_frame=report) as output:
        images = []
        for number in range(1, 6):
            frame = make_frame(number)
            images.append(weakref.ref(frame.image))
            output.submit(frame)
            del frame
        output.drain()
        assert sorted(records) == [1, 2, 3, 4, 5]
        until(lambda: not any(ref() is not None for ref in images))
        output.submit(make_frame(6))
    assert writer.written == [1, 2, 3, 4, 5, 6]


def test_callbacks_come_one_at_a_time(make_frame) -> None:
    busy, overlaps = threading.Lock(), []

    def report(_: FrameRecord) -> None:
        overlaps.append(not busy.acquire(blocking=False))
        time.sleep(0.002)
        busy.release()

    with Pipeline([Null()], workers=4, on_frame=report) as output:
        for number in range(1, 21):
            output.submit(make_frame(number))
    assert overlaps == [False] * 20


@pytest.mark.parametrize("queue_size", [1, 4])
@pytest.mark.parametrize("fails_at", [1, 5])
@pytest.mark.parametrize("ordered", [False, True])
def test_a_failed_writer_ends_submit_soon_with_its_own_error(
    make_frame, ordered: bool, fails_at: int, queue_size: int
) -> None:
    broken, other = Recorder(ordered=ordered, fails_at=fails_at), Recorder(ordered=not ordered)
    records: list[FrameRecord] = []

    def work() -> None:
        with Pipeline([broken, other], queue_size=queue_size, on_frame=records.append) as output:
            for number in range(1, 1000):
                output.submit(make_frame(number))

    with pytest.raises(RunError, match=f"frame {fails_at} broke"):
        within(10, work)
    assert broken.ends == other.ends == ["abort"]
    assert len(broken.begun) < fails_at + queue_size + 2
    assert fails_at not in [record.number for record in records]


def test_a_failure_wakes_up_a_submit_that_waits_for_room(make_frame) -> None:
    gate = threading.Event()
    broken = Recorder(ordered=True, fails_at=1, gate=gate)
    output = Pipeline([broken, Recorder()], queue_size=2)
    output.submit(make_frame(1))
    output.submit(make_frame(2))
    threading.Timer(0.05, gate.set).start()
    for _ in range(2):
        with pytest.raises(RunError, match="frame 1 broke"):
            within(5, lambda: output.submit(make_frame(3)))
    with pytest.raises(RunError, match="frame 1 broke"):
        output.drain()
    with pytest.raises(RunError, match="frame 1 broke"):
        output.close()
    assert broken.ends == ["abort"]


def test_a_failure_drops_what_is_queued_and_the_first_error_counts(make_frame) -> None:
    first, second = threading.Event(), threading.Event()
    broken = Recorder(ordered=True, fails_at=1, gate=first)
    later = Recorder(ordered=True, fails_at=1, gate=second)
    idle = Recorder(ordered=True, gate=second)
    output = Pipeline([broken, later, idle])
    for number in (1, 2, 3):
        output.submit(make_frame(number))
    until(lambda: broken.begun == later.begun == idle.begun == [1])
    first.set()
    with pytest.raises(RunError) as error:
        output.drain()
    second.set()
    with pytest.raises(RunError) as last:
        output.close()
    assert last.value is error.value
    assert idle.written == [1], "frames 2 and 3 are dropped"


def test_an_abort_that_had_to_wake_a_writer_up_waits_for_its_end(make_frame, monkeypatch) -> None:
    class Stuck(Recorder):
        def write(self, frame: OutputFrame) -> None:
            super().write(frame)
            time.sleep(0.2)

        def abort(self) -> None:
            assert self.gate is not None
            self.gate.set()

    monkeypatch.setattr(pipeline, "_PATIENCE", 0.05)
    stuck = Stuck(gate=threading.Event())
    output = Pipeline([stuck])
    output.submit(make_frame(1))
    until(lambda: stuck.begun == [1])
    output.abort()
    assert not [thread for thread in threading.enumerate() if thread.name == "output"]


@pytest.mark.parametrize("end", ["close", "drain"])
def test_a_failure_of_the_last_frame_is_raised_at_the_end(make_frame, end: str) -> None:
    broken, other = Recorder(fails_at=3), Recorder(ordered=True)
    output = Pipeline([broken, other])
    for number in (1, 2, 3):
        output.submit(make_frame(number))
    with pytest.raises(RunError, match="frame 3 broke"):
        getattr(output, end)()
    output.abort()
    assert broken.ends == other.ends == ["abort"]


def test_an_error_of_the_callback_is_an_error_of_the_run(make_frame) -> None:
    def report(record: FrameRecord) -> None:
        raise RunError("run.json: no space")

    with pytest.raises(RunError, match=r"run\.json"), Pipeline([Null()], on_frame=report) as output:
        for number in range(1, 100):
            output.submit(make_frame(number))


def test_a_failed_close_closes_the_other_writers_and_is_raised(make_frame) -> None:
    class Lost(Recorder):
        def close(self) -> None:
            super().close()
            raise RunError("frames are missing")

    lost, other = Lost(ordered=True), Recorder()
    with pytest.raises(RunError, match="missing"), Pipeline([lost, other]) as output:
        output.submit(make_frame(1))
    assert (lost.ends, other.ends) == (["close", "abort"], ["close"])


def test_abort_finishes_what_is_begun_and_drops_the_rest(make_frame) -> None:
    gate = threading.Event()
    fast, slow = Recorder(), Recorder(ordered=True, gate=gate)
    records: list[FrameRecord] = []
    output = Pipeline([fast, slow], workers=1, queue_size=10, on_frame=records.append)
    held = threading.Event()
    fast.gate = held
    for number in range(1, 9):
        output.submit(make_frame(number))
    until(lambda: fast.begun == [1] and slow.begun == [1])
    timer = threading.Timer(0.05, lambda: (gate.set(), held.set()))
    timer.start()
    within(5, output.abort)
    assert fast.written == slow.written == [1]
    assert [record.number for record in records] == [1]
    assert fast.ends == slow.ends == ["abort"]


def test_after_an_abort_all_writers_hold_the_same_frames(make_frame) -> None:
    gate = threading.Event()
    fast, slow = Recorder(), Recorder(ordered=True, gate=gate)
    output = Pipeline([fast, slow], workers=2, queue_size=10)
    for number in range(1, 5):
        output.submit(make_frame(number))
    until(lambda: len(fast.written) == 4 and slow.begun == [1])
    threading.Timer(0.05, gate.set).start()
    within(5, output.abort)
    assert sorted(fast.written) == slow.written == [1, 2, 3, 4]


@pytest.mark.parametrize("error", [ValueError("simulation"), KeyboardInterrupt(), SystemExit(3)])
def test_an_exception_in_the_block_aborts_and_comes_through(make_frame, error: BaseException) -> None:
    writer = Recorder(ordered=True)
    with pytest.raises(type(error)) as caught, Pipeline([writer]) as output:
        output.submit(make_frame(1))
        raise error
    assert caught.value is error
    assert writer.ends == ["abort"]


def test_a_ctrl_c_while_it_waits_aborts(make_frame) -> None:
    class Interrupts(Recorder):
        def write(self, frame: OutputFrame) -> None:
            super().write(frame)
            if frame.number == 1:
                os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.02)

    writer = Interrupts(ordered=True)
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs have it ignored
    try:
        with pytest.raises(KeyboardInterrupt), Pipeline([writer], queue_size=3) as output:
            for number in range(1, 4):
                output.submit(make_frame(number))
    finally:
        signal.signal(signal.SIGINT, previous)
    assert writer.ends == ["abort"]


def test_a_closed_pipeline_takes_no_frame(make_frame) -> None:
    writer = Recorder()
    output = Pipeline([writer])
    output.close()
    output.close()
    output.abort()
    with pytest.raises(RuntimeError, match="closed"):
        output.submit(make_frame(1))
    assert writer.ends == ["close"]


@pytest.mark.parametrize("sizes", [{"workers": 0}, {"queue_size": 0}, {"workers": -1}])
def test_sizes_below_one_are_refused(sizes: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="at least 1"):
        Pipeline([], **sizes)


@pytest.mark.parametrize("seed", range(25))
def test_no_mix_of_delays_failures_and_aborts_deadlocks(make_frame, seed: int) -> None:
    chance = random.Random(seed)

    class Shaky(Recorder):
        def write(self, frame: OutputFrame) -> None:
            time.sleep(chance.random() * 0.002)
            super().write(frame)

    writers = [Shaky(ordered=chance.random() < 0.5, fails_at=chance.choice([0, 0, 3, 9])) for _ in range(3)]
    stop_at = chance.choice([0, 0, 7])

    def work() -> None:
        sizes = {"workers": chance.randint(1, 3), "queue_size": chance.randint(1, 5)}
        with Pipeline(writers, **sizes) as output:
            for number in range(1, 13):
                if number == stop_at:
                    raise KeyboardInterrupt
                output.submit(make_frame(number, (2, 2)))

    failing = stop_at or any(writer.fails_at for writer in writers)
    try:
        within(10, work)
    except (RunError, KeyboardInterrupt):
        assert failing
        assert all(writer.ends == ["abort"] for writer in writers)
    else:
        assert not failing
        assert all(sorted(writer.written) == list(range(1, 13)) for writer in writers)


def test_real_writers_side_by_side(tmp_path: Path, make_frame) -> None:
    film = Mp4(tmp_path / "film.mp4", fps=Fraction(24), size=(64, 48), preset="ultrafast")
    writers = [PngSequence(tmp_path / "frames"), film, States(tmp_path / "states")]
    rows: list[int] = []
    with Pipeline(writers, on_frame=lambda record: rows.append(record.number)) as output:
        for number in range(1, 21):
            output.submit(make_frame(number, x=np.full((3, 3), number)))
    assert sorted(rows) == list(range(1, 21))
    assert (tmp_path / "film.mp4").exists()
    assert sum(is_whole_png(path) for path in (tmp_path / "frames").iterdir()) == 20
    assert len(list((tmp_path / "states").iterdir())) == 20
