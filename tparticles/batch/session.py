"""A batch from the command line: checks, the pool, progress or events, and what is shown at the end."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Mapping
from typing import Any

import click

from ..command_options import stdout_kept
from ..errors import InputError, RunError, unknown
from ..progress import BatchProgress, duration
from .local import Local, cores
from .record import Record
from .runner import Runner
from .tasks import check_scene

MANY = 10_000  # jobs that nobody starts by mistake
_CHECKS = 60.0  # [s] for looking at jobs before the batch begins
_SHOWN = 20  # jobs of a dry run that are listed


def check_count(total: int, yes: bool) -> None:
    """Refuse very many jobs that nobody confirmed, before one of them is made. Raises InputError."""
    if total > MANY and not yes:
        raise InputError(f"{total} jobs: add --yes if you mean it")


class Session:
    """Runs or describes the waiting jobs of a record, as the options of the command line say.

    Raises InputError: a scene that may not be run, an unknown value.
    """

    def __init__(
        self,
        record: Record,
        *,
        signals: list[int],
        existing: str,
        allow_python: bool,
        workers: int | None,
        retries: int,
        timeout: float | None,
        dask: str | None,
        gpu: bool,
        as_json: bool,
        quiet: bool,
    ):
        from .standing import EXISTING

        if existing not in EXISTING:
            raise unknown("value of --existing", existing, EXISTING)
        if dask is not None and workers is not None:
            raise InputError("--workers is of this machine: a cluster has as many as were started for it")
        if gpu and dask is None:
            raise InputError("--gpu goes with --dask: choose a GPU of this machine with --arch cuda or --arch vulkan")
        for scene in {entry.task.scene for entry in record.entries.values()}:
            check_scene(scene, allow_python=allow_python)
        self.record, self._signals, self._existing = record, signals, existing
        self._workers = workers or cores()
        self._retries, self._timeout, self._dask, self._gpu = retries, timeout, dask, gpu
        self._json, self._quiet = as_json, quiet

    def describe(self) -> None:
        """Print jobs, frames, bytes and time of what would be rendered; write nothing.

        Raises InputError: see `standing.check`; RunError: a probe failed.
        """
        from .estimate import estimate

        workers = min(self._workers, max(1, len(self.record.entries)))
        with stdout_kept():
            from .standing import check

            found = check(self.record, existing=self._existing, seconds=_CHECKS)
            unseen = sum(e.state == "waiting" and e.frames is None for e in self.record.entries.values())
            total = estimate(found, workers=workers, threads=max(1, cores() // workers), tell=self._tell)
        if self._json:
            rows = [{"job": e.task.name, "frames": len(j.frames), "size": list(j.size)} for e, j in found]
            self._print(
                {"event": "plan", **total, "unseen": unseen, "done": self.record.counts()["done"], "rows": rows}
            )
            return
        for entry, job in found[:_SHOWN]:
            click.echo(f"{entry.task.name}: {len(job.frames)} frames of {job.size[0]}x{job.size[1]}")
        if len(found) > _SHOWN:
            click.echo(f"... and {len(found) - _SHOWN} more")
        n, done = len(found), self.record.counts()["done"]
        parts = [f"{n} job{'' if n == 1 else 's'}, {total['frames']} frames", f"about {total['bytes'] / 2**20:.1f} MiB"]
        parts.append(f"at least {duration(total['seconds'])} with {workers} worker{'' if workers == 1 else 's'}")
        parts += [f"{done} done already"] if done else []
        parts += [f"{unseen} more not looked at"] if unseen else []
        click.echo(", ".join(parts))

    def run(self) -> None:
        """Run what waits; the folder is held by the caller.

        Raises InputError: see `standing.check`; RunError: jobs failed, the scheduler is gone, batch.json cannot be kept;
        CancelledError; KeyboardInterrupt.
        """
        with stdout_kept():
            from .standing import check

            if any(entry.state == "waiting" for entry in self.record.entries.values()):
                check(self.record, existing=self._existing, seconds=_CHECKS)
        counts = self.record.counts()
        with BatchProgress(len(self.record.entries), counts["done"], quiet=self._quiet or self._json) as progress:
            self._drive(progress)
        self._show()
        self._finish()

    def _drive(self, progress: BatchProgress) -> None:
        waiting = self.record.counts()["waiting"]

        def hear(event: Mapping[str, Any]) -> None:
            progress.hear(dict(event))
            if self._json:
                self._print(event)

        Runner(
            self.record,
            self._pool(max(1, waiting)),
            existing=self._existing,
            retries=self._retries,
            timeout=self._timeout,
            hear=hear,
            signals=self._signals,
        ).run()

    def _pool(self, waiting: int) -> Any:
        if self._dask is None:
            return Local(min(self._workers, waiting), self.record.folder / "logs")
        from .cluster import Cluster

        return Cluster(self._dask, gpu=self._gpu)

    def _show(self) -> None:
        """Make the contact sheet and the page; that they cannot be made costs no film."""
        from .gallery import show

        try:
            show(self.record)
        except OSError as error:
            click.echo(f"no contact sheet: {error.strerror or error}", err=True)

    def _finish(self) -> None:
        counts = self.record.counts()
        if self._json:
            self._print({"event": "batch", "status": self.record.status, "folder": str(self.record.folder), **counts})
        elif not self._quiet:
            click.echo(
                f"{counts['done']} of {len(self.record.entries)} films in {self.record.folder}: index.html, contact.png"
            )
        failed = [entry for entry in self.record.entries.values() if entry.state == "failed"]
        if failed:
            first = f"'{failed[0].task.name}': {failed[0].error}"
            raise RunError(
                f"{len(failed)} of {len(self.record.entries)} jobs failed, the first {first}; "
                f"`tparticles retry {self.record.folder}` runs them again"
            )

    def _print(self, event: Mapping[str, Any]) -> None:
        click.echo(json.dumps(event, allow_nan=False))

    def _tell(self, line: str) -> None:
        if not self._quiet and sys.stderr is not None and sys.stderr.isatty():
            click.echo(line[: shutil.get_terminal_size().columns], err=True)
