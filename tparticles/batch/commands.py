"""The commands `tparticles sweep`, `batch`, `status`, `retry` and `cancel`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from ..command_options import PRECISION, QUALITY, print_json, size_option
from ..errors import InputError

_CANCEL_WAIT = 60.0  # [s] for a batch to end


def _options(*options: Callable[..., Any]) -> Callable[..., Any]:
    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


_ALLOW = click.option(
    "--allow-python", is_flag=True, help="Take Python files from outside scenes/ too: they are code that is run."
)
_YES = click.option("--yes", is_flag=True, help="Yes, so many jobs.")
_EXISTING = click.option(
    "--existing",
    metavar="resume|skip|overwrite|error",
    default="resume",
    show_default=True,
    help="What to do with films that are there: finished ones stay, unfinished ones go on from a checkpoint (resume) or from "
    "their first frame (skip); overwrite renders all anew, error refuses. Films of another scene text or other settings are "
    "an error unless overwritten.",
)
_RUN = _options(
    click.option("--workers", metavar="N", type=click.IntRange(1, 1024), help="Films at a time (default: one a core)."),
    click.option(
        "--retries", metavar="N", type=click.IntRange(0, 1000), default=2, show_default=True, help="Of a failed job."
    ),
    click.option(
        "--timeout", metavar="S", type=click.FloatRange(min=0, min_open=True), help="Of one attempt, in seconds."
    ),
    click.option(
        "--dask", metavar="ADDRESS", help="Run on the Dask cluster of this scheduler, such as tcp://host:8786."
    ),
    click.option("--gpu", is_flag=True, help="With --dask: only on workers started with --resources GPU=1."),
    click.option("--json", "as_json", is_flag=True, help="Print events as JSON, one a line, and nothing else."),
    click.option("--quiet", is_flag=True, help="No progress and no summary."),
)
_BEGIN = _options(
    click.option("--out", metavar="DIR", help="Output folder (default: renders/ and a name)."),
    _EXISTING,
    click.option("--dry-run", is_flag=True, help="Say what would be rendered, and what it takes, from a short probe."),
    _ALLOW,
    _YES,
)


@click.command()
@click.argument("scene")
@click.option(
    "--set",
    "axes",
    metavar="NAME=VALUES",
    multiple=True,
    help="Values of a parameter: 0:2:5 (5 from 0 to 2), 20,50,100, or one. As often as needed: every combination is a film.",
)
@click.option("--seeds", metavar="RANGE", help="Seeds: 1-4, 1-9x2 (every second), 7, or several with commas.")
@click.option("--zip", "paired", is_flag=True, help="Pair the values, first with first, instead of every combination.")
@QUALITY
@click.option("--size", metavar="WxH", callback=size_option, help="Width and height in pixels.")
@click.option("--frames", metavar="RANGE", help="As of render.")
@click.option("--fps", metavar="RATE", help="As of render.")
@click.option("--scheme", metavar="NAME", help="As of render.")
@PRECISION
@click.option("--arch", metavar="auto|cpu|cuda|vulkan", default="auto", show_default=True, help="As of render.")
@click.option("--png/--no-png", default=True, show_default=True, help="Write frames.")
@click.option("--mp4/--no-mp4", default=True, show_default=True, help="Write films.")
@click.option("--states", is_flag=True, help="Write states.")
@_BEGIN
@_RUN
@click.pass_obj
def sweep(signals: list[int], scene: str, axes: Sequence[str], seeds: str | None, paired: bool, **options: Any) -> None:
    """Render SCENE once for each combination of values.

    \b
    tparticles sweep campfire --set wind=0:2:5 --set power=20,50,100 --seeds 1-4 --quality preview

    Each film is rendered in a process of its own into DIR/jobs/NAME; DIR/batch.json says how far each is, and at the end there
    are DIR/contact.png, one still of each film, and DIR/index.html. The same command again renders only what is missing.
    """
    from . import grammar, jobs_file
    from .tasks import OPTIONS

    found: dict[str, tuple[str, ...]] = {}
    for text in axes:
        name, values = grammar.axis(text)
        if name in found:
            raise InputError(f"--set {name} is given twice: list its values with commas")
        found[name] = values
    asked = {name: options.pop(name) for name in OPTIONS}
    chosen = None if seeds is None else tuple(grammar.seeds(seeds))
    fixed = {name: values[0] for name, values in found.items() if len(values) == 1}
    swept = {name: values for name, values in found.items() if len(values) > 1}
    total, tasks = jobs_file.tasks(
        scene,
        swept,
        seeds=chosen,
        paired=paired,
        fixed=fixed,
        options={name: value for name, value in asked.items() if value is not None},
    )
    default = Path("renders") / f"{Path(scene).stem}-sweep"
    _begin(signals, total, tasks, default, **options)


@click.command()
@click.argument("jobs", metavar="JOBS.toml")
@_BEGIN
@_RUN
@click.pass_obj
def batch(signals: list[int], jobs: str, **options: Any) -> None:
    """Render the films that JOBS.toml lists.

    \b
    [defaults]
    quality = "preview"             size, frames, fps, scheme, precision, arch, png, mp4, states too
    [[job]]
    scene = "campfire"              a name in scenes/, or a scene as data (.toml, .json)
    set = { wind = 2.0 }
    [[job]]
    scene = "swirl"
    sweep = { count = [1000, 2000], speed = "0.2:0.6:5" }
    seeds = "1-4"
    """
    from .jobs_file import read_jobs

    total, tasks = read_jobs(Path(jobs))
    _begin(signals, total, tasks, Path("renders") / Path(jobs).stem, **options)


@click.command()
@click.argument("folder", metavar="DIR")
@click.option("--json", "as_json", is_flag=True, help="Print JSON on stdout, and nothing else; in failure too.")
def status(folder: str, as_json: bool) -> None:
    """Say how far the batch in DIR is."""
    from ..output.lock import holder
    from .record import as_rows, read_record

    record = read_record(Path(folder))
    owner = holder(Path(folder))
    state = f"running ({owner})" if owner else ("stopped" if record.status == "running" else record.status)
    counts = {name: n for name, n in record.counts().items() if n}
    if as_json:
        print_json({"status": state, "counts": counts, "jobs": as_rows(record)})
        return
    click.echo(f"{folder}: {state}; {', '.join(f'{n} {name}' for name, n in counts.items())}")
    for entry in record.entries.values():
        if entry.state not in ("done", "waiting"):
            tries = f"{entry.attempts} attempt{'' if entry.attempts == 1 else 's'}"
            click.echo(f"  {entry.task.name}: {entry.state}, {tries}{f', {entry.error}' if entry.error else ''}")


@click.command()
@click.argument("folder", metavar="DIR")
@_EXISTING
@_ALLOW
@_RUN
@click.pass_obj
def retry(signals: list[int], folder: str, allow_python: bool, existing: str, **options: Any) -> None:
    """Run again what is not done of the batch in DIR.

    Failed, cancelled and interrupted jobs, and those that waited.
    """
    from ..output import held_folder
    from .record import read_record, without_state
    from .session import Session

    path = Path(folder)
    read_record(path)  # or an empty folder would be made
    with held_folder(path):
        record = read_record(path)
        record.status = "running"
        without_state(record, ("waiting", "running", "failed", "cancelled"))
        Session(record, signals=signals, existing=existing, allow_python=allow_python, **options).run()


@click.command()
@click.argument("folder", metavar="DIR")
def cancel(folder: str) -> None:
    """End the batch that is running in DIR.

    Works from any machine that sees DIR. Films stop and keep what is finished; `retry` goes on.
    """
    from ..output import FolderBusyError, held_folder
    from ..output.lock import holder
    from .record import read_record
    from .runner import CANCEL_NAME

    path = Path(folder)
    read_record(path)
    if holder(path):
        (path / CANCEL_NAME).touch()
    deadline = time.monotonic() + _CANCEL_WAIT
    while holder(path) and time.monotonic() < deadline:
        time.sleep(0.1)
    try:
        with held_folder(path):
            (path / CANCEL_NAME).unlink(missing_ok=True)
            record = read_record(path)
            for entry in record.entries.values():
                if entry.state in ("waiting", "running"):
                    entry.state = "cancelled"
            record.save(now=True)
    except FolderBusyError as error:
        raise InputError(f"{folder} is asked to end, but has not within {_CANCEL_WAIT:.0f} s: {error}") from None
    click.echo(f"{folder}: {', '.join(f'{n} {name}' for name, n in record.counts().items() if n)}")


def _begin(
    signals: list[int],
    total: int,
    tasks: Any,
    default: Path,
    *,
    out: str | None,
    existing: str,
    dry_run: bool,
    allow_python: bool,
    yes: bool,
    **options: Any,
) -> None:
    from ..output import held_folder
    from .record import Entry, Record, prepare_folder
    from .session import Session, check_count
    from .tasks import named

    if out is not None and not out.strip():
        raise InputError("--out is empty: name a folder")
    check_count(total, yes)
    folder = default if out is None else Path(out)
    found = named(tasks)
    run = {"signals": signals, "existing": existing, "allow_python": allow_python, **options}
    if dry_run:
        Session(Record(folder, [Entry(task) for task in found]), **run).describe()
        return
    session = Session(Record(folder, [Entry(task) for task in found]), **run)
    made = not folder.exists()
    try:
        with held_folder(folder):
            session.record = prepare_folder(folder, found, replace=existing == "overwrite")
            session.run()
    except InputError:
        if made:
            with contextlib.suppress(OSError):  # something is in it
                folder.rmdir()
        raise


COMMANDS = (sweep, batch, status, retry, cancel)
