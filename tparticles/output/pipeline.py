"""Writers on background threads, so that encoding overlaps with the simulation."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from .base import OutputFrame, Writer, abort_all, close_all, pixel_hash

_PATIENCE = 10.0  # [s] that writes in progress get to end by themselves before their writers are aborted


@dataclass(frozen=True)
class FrameRecord:
    """What is known of a frame when every writer has it.

    encode_ms: time that the worker threads spent on it [ms], all writers and the hash together.
    sha256: of the pixels, see `pixel_hash`.
    """

    number: int
    encode_ms: float
    sha256: str


@dataclass(eq=False)
class _Job:
    """A frame on its way: how many lanes still have to do their part, and what they found."""

    frame: OutputFrame
    parts_left: int
    begun: bool = False
    encode_ms: float = 0.0
    sha256: str = ""


@dataclass(eq=False)
class _Lane:
    """A queue, and the writers that each of its frames passes. An ordered writer has a lane and a thread of its own."""

    writers: tuple[Writer, ...]
    hashes: bool
    queue: deque[_Job] = field(default_factory=deque)


class Pipeline:
    """Runs writers on background threads; leave its `with` block normally to close it, by an exception to abort it.

    Writers that need no order share `workers` threads, which also hash the pixels; each ordered writer has a thread of
    its own. `submit` is called from one thread, in the order that the ordered writers are to see. The frames submitted
    belong to the pipeline: hand over fresh arrays and leave them alone.

    writers: closed or aborted with the pipeline.
    workers: threads for writers that need no order.
    queue_size: frames held at most, waiting or being written; bounds the memory. `submit` waits for a free place.
    on_frame: called on a worker thread, one call at a time, when every writer has a frame; in any order of frames.
    Raises ValueError for workers or queue_size below 1.
    """

    def __init__(
        self,
        writers: Sequence[Writer],
        *,
        workers: int = 2,
        queue_size: int = 8,
        on_frame: Callable[[FrameRecord], object] | None = None,
    ) -> None:
        if workers < 1 or queue_size < 1:
            raise ValueError(f"workers is {workers} and queue_size is {queue_size}: both must be at least 1")
        self._writers = tuple(writers)
        self._room = queue_size
        self._on_frame = on_frame or (lambda record: None)
        self._reporting = threading.Lock()
        # Guards everything below; notified at each change.
        self._changed = threading.Condition()
        self._held = 0
        self._stopping = False
        self._error: BaseException | None = None
        shared = _Lane(tuple(writer for writer in self._writers if not writer.ordered), hashes=True)
        own = [_Lane((writer,), hashes=False) for writer in self._writers if writer.ordered]
        self._lanes = [shared, *own]
        self._threads = [self._thread(shared) for _ in range(workers)] + [self._thread(lane) for lane in own]
        for thread in self._threads:
            thread.start()

    def submit(self, frame: OutputFrame) -> None:
        """Queue a frame; waits while the pipeline is full.

        Raises the first error of a writer as soon as there is one, RuntimeError if the pipeline is closed.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._stopping or self._held < self._room)
            self._raise_error()
            if self._stopping:
                raise RuntimeError("the pipeline is closed")
            job = _Job(frame, parts_left=len(self._lanes))
            self._held += 1
            for lane in self._lanes:
                lane.queue.append(job)
            self._changed.notify_all()

    def drain(self) -> None:
        """Wait until every frame submitted so far is written. Raises the first error of a writer."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopping or self._held == 0)
            self._raise_error()

    def close(self) -> None:
        """Write all frames, end the threads and close the writers.

        Raises the first error of a writer, after the others are closed or aborted; aborts if it is interrupted.
        """
        try:
            self._stop()
            self._join()
            self._raise_error()
        except BaseException:
            self.abort()
            raise
        writers, self._writers = self._writers, ()
        close_all(writers)

    def abort(self) -> None:
        """Stop early: finish the frames that a writer has begun with, drop the others, abort the writers.

        Raises nothing, not even the error of a writer. Frames are begun in order, so all writers end with the same.
        """
        with self._changed:
            for lane in self._lanes:
                lane.queue = deque(job for job in lane.queue if job.begun)
        self._stop()
        self._join(_PATIENCE)
        writers, self._writers = self._writers, ()
        abort_all(writers)
        self._join()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            self.abort()

    def _thread(self, lane: _Lane) -> threading.Thread:
        # Daemons: an impatient second Ctrl-C must be able to leave. They only rename whole files into place.
        return threading.Thread(target=self._work, args=(lane,), name="output", daemon=True)

    def _work(self, lane: _Lane) -> None:
        try:
            while self._next(lane):
                pass
        except BaseException as error:
            self._fail(error)

    def _next(self, lane: _Lane) -> bool:
        """Do the lane's part of its next frame. False if there will be no next."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopping or lane.queue)
            if not lane.queue:
                return False
            job = lane.queue.popleft()
            job.begun = True
        start = time.perf_counter()
        if lane.hashes:
            job.sha256 = pixel_hash(job.frame.image)
        for writer in lane.writers:
            writer.write(job.frame)
        self._part_done(job, 1e3 * (time.perf_counter() - start))
        return True

    def _part_done(self, job: _Job, ms: float) -> None:
        with self._changed:
            job.encode_ms += ms
            job.parts_left -= 1
            if job.parts_left:
                return
        with self._reporting:
            self._on_frame(FrameRecord(job.frame.number, job.encode_ms, job.sha256))
        with self._changed:
            self._held -= 1
            self._changed.notify_all()

    def _fail(self, error: BaseException) -> None:
        """Keep the first error, drop what is queued and wake up whoever waits."""
        with self._changed:
            self._error = self._error or error
            for lane in self._lanes:
                lane.queue.clear()
        self._stop()

    def _stop(self) -> None:
        with self._changed:
            self._stopping = True
            self._changed.notify_all()

    def _join(self, timeout: float | None = None) -> None:
        deadline = None if timeout is None else time.monotonic() + timeout
        for thread in self._threads:
            thread.join(None if deadline is None else max(0.0, deadline - time.monotonic()))

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error
