"""One film by several processes or machines: each simulates and draws a share of the particles, their films are summed.

A particle depends on no other, and a film is a sum of integers: whatever the number of shards, the picture is the same to the bit.
Each shard leaves its pieces in DIR/shards/K-of-N; whoever merges sums them, develops, and removes them when a frame is on the disk.
"""

from __future__ import annotations

import functools
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import __version__, backend, output
from .checkpoint import Checkpoints
from .errors import InputError, RunError
from .job import Job
from .output.files import reason
from .output.pieces import add_piece, piece_path, write_piece
from .output.sealed import Sections
from .resume import Start, find_start, with_last
from .shard_crew import PARENT, Crew, missing
from .shard_estimate import estimate
from .shard_states import State, StateMerge, from_sections, sections
from .simulation import Frame, FrameReport, Share, Simulation, make_film

if TYPE_CHECKING:
    from .log.source import Logging

LOG = "log.h5"
_LEAST_DOTS = 1 << 10  # a film that is only summed takes no dots


def check_shards(job: Job, count: int) -> None:
    """Refuse what cannot be done in shards. Raises InputError."""
    if job.options.resume and not job.options.png and job.options.mp4:
        raise InputError("--shards: a film is resumed from its pictures; leave out --no-png")
    if not 1 <= count <= 10_000:
        raise InputError(f"--shards {count}: 1 to 10000 are allowed")


def folder_of(out: Path, share: Share) -> Path:
    """Return where a shard leaves its pieces; shards count from 1 there, as on the command line."""
    return out / output.SHARDS / f"{share.index + 1}-of-{share.count}"


def _identity(job: Job, arch: str, share: Share) -> str:
    return f"{job.owner(arch)}-shard-{share.index + 1}-of-{share.count}"


def render_shard(
    job: Job,
    share: Share,
    progress: Callable[[Any, int], None],
    *,
    tell: Callable[[str], None],
    merged: int = 0,
    logging: Logging | None = None,
) -> dict[str, Any]:
    """Simulate and draw one share of the particles; return what the shard's run.json holds.

    merged: frames up to this one are summed and done: a resumed shard need not have them. logging: what the first shard logs.
    Raises as `Job.run`.
    """
    check_shards(job, share.count)
    folder = folder_of(job.out, share)
    simulation, source = _source(job, share, folder, logging)
    arch = simulation.backend.arch
    identity = _identity(job, arch, share)
    with output.held_folder(folder):
        output.claim_folder(folder, scene=job.script.name, identity=identity, existing=job.options.existing)
        start = _start(job, folder, identity, merged, tell, last=folder / LOG if logging else None)
        manifest = output.Manifest(folder / "run.json", job.header() | {"identity": identity, "arch": arch})
        checkpoints = Checkpoints(
            folder / output.CHECKPOINTS,
            identity=identity,
            interval=job.interval,
            keep=start.checkpoint,
            before=manifest.save,
            tell=tell,
        )
        try:
            if start.checkpoint is not None:
                source.restore(start.checkpoint.sections)
            with job.script.blamed():
                reports = source.exposures(start.others, after=lambda n: checkpoints.after(n, source.snapshot))
                for done, report in enumerate(reports, start=len(start.kept) + 1):
                    _check_parent()
                    states = {}
                    if job.options.states:
                        states = {group.spec.name: group.state(report.time) for group in simulation.groups}
                    _write(folder, simulation.film.sums(), report, identity, states)
                    manifest.add(report.row())
                    progress(_Shown(report), done)
        except KeyboardInterrupt:
            manifest.finish("interrupted")
            raise
        except BaseException as error:
            manifest.finish("failed", str(error) or type(error).__name__)
            raise
        finally:
            checkpoints.close()
        manifest.finish("done")
        shutil.rmtree(folder / output.CHECKPOINTS, ignore_errors=True)
    return output.read_manifest(folder / "run.json")


def _source(job: Job, share: Share, folder: Path, logging: Logging | None) -> tuple[Simulation, Any]:
    """Return what simulates a share, and what its frames come from: the same, or one that logs them."""
    if logging is None:
        simulation = job.simulation(share)
        return simulation, simulation
    logging.check_share(job.scene, share)
    if share.index:
        raise InputError(f"--log: meshes are simulated by the first shard, not by --shard {share.index + 1}")
    from .log.source import LoggedSimulation

    logged = LoggedSimulation(job, logging, share=share, folder=folder)
    return logged.simulation, logged


@dataclass(frozen=True)
class _Shown:
    """What progress shows of a frame."""

    report: FrameReport

    @property
    def number(self) -> int:
        """The frame's."""
        return self.report.frame


def _start(
    job: Job, folder: Path, identity: str, merged: int, tell: Callable[[str], None], *, last: Path | None
) -> Start:
    if not job.options.resume:
        shutil.rmtree(folder / output.CHECKPOINTS, ignore_errors=True)
        return Start(job.frames)

    def whole(number: int, _: Mapping[str, Any]) -> bool:
        if number <= merged:
            return True
        total = np.zeros((job.size[1], job.size[0], 3), np.int64)
        try:
            piece = add_piece(folder, number, total, version=__version__, identity=identity)
        except InputError:
            return False
        return not job.options.states or bool(from_sections(piece))

    rows = [{"frame": number} for number in job.frames]
    check = whole if last is None else with_last(whole, job.frames[-1], last)
    return find_start(job.frames, rows, check=check, folder=folder / output.CHECKPOINTS, identity=identity, tell=tell)


def _write(folder: Path, sums: np.ndarray, report: FrameReport, identity: str, states: Mapping[str, State]) -> None:
    row = report.row()
    row |= {f"ms {part}": ms for part, ms in row.pop("ms").items()}
    row.pop("solves", None)  # the shard's own run.json holds them
    try:
        write_piece(folder, sums, row, version=__version__, identity=identity, more=sections(states))
    except OSError as error:
        raise RunError(f"cannot write {piece_path(folder, report.frame)}: {reason(error)}") from error


def _check_parent() -> None:
    """End with the process that we work for: it may have been killed."""
    parent = os.environ.get(PARENT)
    if parent is not None and int(parent) != os.getppid():
        raise RunError("the process that merges the shards is gone")


@dataclass
class Merge:
    """The frames of a film, summed from the pieces of `count` shards; see `Source`.

    wait: called again and again while a piece is not there yet, with its shard; raises where it will never be.
    begin: called with the last frame that is there already, before the first piece is needed.
    """

    job: Job
    count: int
    begin: Callable[[int], None] = field(default=lambda merged: None)
    wait: Callable[[int, Path], None] = field(default=lambda index, path: missing(index, path))

    def __post_init__(self) -> None:
        o = self.job.options
        self.backend = backend.start(arch=o.arch, threads=o.threads, precision=o.precision)
        self._film = make_film(self.job.scene, self.job.size, capacity=_LEAST_DOTS)
        self._table, self._film_max = self.job.scene.look.display_table()
        self._states = StateMerge(self.job.scene) if o.states else None

    def frames(self, numbers: Sequence[int], *, after: Callable[[int], None]) -> Iterator[Frame]:
        """Yield the frames `numbers`, each when all of its pieces are there."""
        if numbers:
            self.begin(numbers[0] - 1)
        width, height = self.job.size
        for number in numbers:
            total = np.zeros((height, width, 3), np.int64)
            report = FrameReport(number, 0.0)
            states = []
            for index in range(self.count):
                piece = self._add(index, number, total)
                _count_in(report, piece["row"])
                states.append(from_sections(piece))
            self._film.clear()
            self._film.merge(total)
            image = self._film.develop(self._table, self._film_max, dither=self.job.scene.look.dither)
            yield _Summed(number, image, report, None, self._states.merged(states) if self._states else {})
            after(number)

    def _add(self, index: int, number: int, total: np.ndarray) -> dict[str, Any]:
        share = Share(index, self.count)
        folder = folder_of(self.job.out, share)
        path = piece_path(folder, number)
        while not path.exists():
            self.wait(index, path)
        identity = _identity(self.job, self.backend.arch, share)
        piece = add_piece(folder, number, total, version=__version__, identity=identity)
        if self._states and not from_sections(piece):
            raise InputError(f"film {path} is refused: it holds no states; render it with --states --shard {index + 1}")
        return piece

    def finished(self, number: int) -> None:
        """Remove the pieces of a frame that is on the disk."""
        for index in range(self.count):
            piece_path(folder_of(self.job.out, Share(index, self.count)), number).unlink(missing_ok=True)

    def snapshot(self) -> Sections:
        """Return nothing: each frame is made of its pieces alone."""
        return {}

    def restore(self, state: Sections) -> None:
        """Do nothing."""


@dataclass
class _Summed(Frame):
    """A frame made of pieces."""

    states: dict[str, State]

    def state(self) -> dict[str, State]:
        """Return the living of all shards, by group."""
        return self.states


def _count_in(report: FrameReport, row: dict[str, Any]) -> None:
    """Add up what the shards report; the time of a frame is that of all of them together."""
    report.time = row["time"]
    for name in ("born", "died", "alive", "rejected", "starting"):
        setattr(report, name, getattr(report, name) + row[name])
    for part in report.ms:
        report.ms[part] += row[f"ms {part}"]
    if row["steps"]:
        report.dt_min = min(report.dt_min, row["dt_min"]) if report.steps else row["dt_min"]
        report.dt_max = max(report.dt_max, row["dt_max"])
        report.steps += row["steps"]


def merge_shards(
    job: Job, count: int, progress: Callable[[Frame, int], None], *, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Make the film of the pieces that `count` shards have left; return what run.json holds. Raises as `Job.run`."""
    check_shards(job, count)
    run = job.run(progress, tell=tell, source=lambda: Merge(job, count), anywhere=True)
    _clear(job, count)
    return run


def _clear(job: Job, count: int) -> None:
    """Remove what the shards have left, but for the log."""
    log = folder_of(job.out, Share(0, count)) / LOG
    if log.is_file():
        os.replace(log, job.out / LOG)
    shutil.rmtree(job.out / output.SHARDS, ignore_errors=True)


def render_in_shards(
    job: Job,
    count: int,
    progress: Callable[[Frame, int], None],
    *,
    command: Sequence[str],
    workers: int | None,
    tell: Callable[[str], None],
    announce: Callable[[str], None] | None = None,
    log: Sequence[str] = (),
) -> dict[str, Any]:
    """Render `count` shards by processes of this machine, `workers` at a time, and merge them as they come.

    command: renders the film; each process gets it with its shard, the first one with the options `log`, too. announce: hears
    first what it will take. Raises as `Job.run`.
    """
    check_shards(job, count)
    cores = backend.cores()
    workers = min(count, workers or cores)
    command = [*command, "--threads", str(job.options.threads or max(1, cores // workers))]
    if announce is not None:
        announce(estimate(job, count, workers, command))
    crew = Crew(job, count, workers, [*command, "--shards", str(count)], log)
    try:
        source = functools.partial(Merge, job, count, begin=crew.begin, wait=crew.wait)
        logged = not log or (folder_of(job.out, Share(0, count)) / LOG).is_file()
        run = job.run(progress, tell=tell, source=source, anywhere=True, last=None if logged else job.out / LOG)
        crew.finish()
    finally:
        crew.stop()
    _clear(job, count)
    return run
