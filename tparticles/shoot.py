"""A render at work: frames from a simulation, or from the pieces of several, to pictures, film, states and run.json."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from . import output
from .backend import Backend
from .checkpoint import Checkpoints
from .errors import RunError
from .output.files import frame_path
from .output.sealed import Sections
from .resume import Start
from .simulation import Frame

if TYPE_CHECKING:
    from .job import Job

_WORKERS = 2  # PNG threads
_QUEUE = 8  # frames in flight, 6 MB each at 1920x1080


class Source(Protocol):
    """What frames come from, see `Simulation`."""

    @property
    def backend(self) -> Backend:
        """What it runs on."""
        ...

    def frames(self, numbers: Sequence[int], *, after: Callable[[int], None]) -> Iterator[Frame]:
        """Yield the frames `numbers`; call `after` for each that is simulated."""
        ...

    def snapshot(self) -> Sections:
        """Return the state after the latest frame."""
        ...

    def restore(self, state: Sections) -> None:
        """Go on from a state."""
        ...

    def finished(self, number: int) -> None:
        """A frame is on the disk. May be called on any thread."""
        ...


def shoot(
    job: Job,
    source: Source,
    manifest: output.Manifest,
    start: Start,
    *,
    progress: Callable[[Frame, int], None],
    tell: Callable[[str], None],
) -> None:
    """Write all that `job` asks for: what is there already goes into the film again, the others come from `source`.

    Raises RunError: something failed on the way; what was drawn before is written.
    """
    rows: dict[int, dict[str, Any]] = {}

    def finished(record: output.FrameRecord) -> None:
        row = rows.pop(record.number)
        row["ms"]["encode"] = record.encode_ms
        manifest.add(row | {"sha256": record.sha256})
        checkpoints.finished(record.number)
        source.finished(record.number)

    with contextlib.ExitStack() as undo:
        checkpoints = Checkpoints(
            job.checkpoints,
            identity=job.owner(source.backend.arch),
            interval=job.interval,
            keep=start.checkpoint,
            before=manifest.save,
            tell=tell,
        )
        undo.callback(checkpoints.close)
        writers = _writers(job, undo)
        if job.options.mp4:
            _encode_again(job, writers[0], start.kept)
        if start.checkpoint is not None:
            source.restore(start.checkpoint.sections)
        with output.Pipeline(writers, workers=_WORKERS, queue_size=_QUEUE, on_frame=finished) as pipeline:
            try:
                shots = source.frames(start.others, after=lambda number: checkpoints.after(number, source.snapshot))
                for done, frame in enumerate(shots, start=1):
                    rows[frame.number] = frame.report.row()
                    states = merged(frame.state()) if job.options.states else None
                    checkpoints.begun(frame.number)
                    pipeline.submit(output.OutputFrame(frame.number, frame.image, job.provenance(frame), states))
                    if done == 1:
                        pipeline.drain()  # somebody waits for it: let it not share the machine with the second
                    progress(frame, len(start.kept) + done)
            except Exception:
                with contextlib.suppress(Exception):  # the first error is the one to tell
                    pipeline.drain()  # what was drawn before it is kept; only Ctrl-C drops what waits
                raise


def _writers(job: Job, undo: contextlib.ExitStack) -> list[output.Writer]:
    """Open what is written, in `undo` too: it closes what is open if a later one, or the pipeline, fails."""
    writers: list[output.Writer] = []

    def add(writer: output.Writer) -> None:
        undo.callback(writer.abort)
        writers.append(writer)

    if job.options.mp4:
        add(output.Mp4(job.film_path, fps=job.scene.fps, size=job.size))
    if job.pictures is not None:
        add(output.PngSequence(job.pictures))
    if job.options.states:
        add(output.States(job.out / "states"))
    return writers


def _encode_again(job: Job, film: output.Writer, kept: Sequence[int]) -> None:
    """Begin the film with the frames that an earlier run finished: what it had encoded ended with it."""
    assert job.pictures is not None or not kept
    for number in kept:
        path = frame_path(job.pictures or job.out, number, ".png")
        image = output.read_png(path, job.size)
        if image is None:
            raise RunError(f"cannot read {path}: it was whole a moment ago")
        film.write(output.OutputFrame(number, image))


def merged(groups: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the states of all groups as one set of arrays: `group` is the index into `groups`, NaN what one does not have."""
    result: dict[str, np.ndarray] = {"groups": np.array(list(groups))}
    counts = [len(state["id"]) for state in groups.values()]
    result["group"] = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    for name in dict.fromkeys(name for state in groups.values() for name in state):
        have = next(state[name] for state in groups.values() if name in state)
        parts = [
            state[name] if name in state else np.full((count, *have.shape[1:]), np.nan, have.dtype)
            for count, state in zip(counts, groups.values(), strict=True)
        ]
        result[name] = np.concatenate(parts)
    return result
