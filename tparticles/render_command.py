"""The command `tparticles render`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .command_options import JSON, PRECISION, QUALITY, SET, print_json, size_option, stdout_kept
from .errors import InputError

if TYPE_CHECKING:
    from .job import Job
    from .log.source import Logging
    from .shoot import Source


@click.command()
@click.argument("scene")
@click.option("--out", metavar="DIR", help="Output folder (default: renders/ and the scene's name).")
@click.option(
    "--frames",
    metavar="RANGE",
    help="What to draw: 1-240, 1-240x2 (every second), 7, 100- (to the end), or several with commas. Others are simulated, "
    "not drawn; frames already in the folder stay. The film of a part gets a name of its own.",
)
@click.option("--fps", metavar="RATE", help="Frame rate: 24, 25, 30000/1001 (default: the scene's).")
@click.option("--size", metavar="WxH", callback=size_option, help="Width and height in pixels; even for an MP4.")
@QUALITY
@SET
@click.option("--seed", metavar="N", type=click.IntRange(min=0), help="Another seed for all random numbers.")
@click.option(
    "--scheme",
    metavar="NAME",
    help="Another integration scheme, but for meshes with one of their own; see `tparticles schemes`.",
)
@PRECISION
@click.option(
    "--arch",
    metavar="auto|cpu|cuda|vulkan",
    default="auto",
    show_default=True,
    help="auto takes a GPU where there is one; a named one never falls back.",
)
@click.option("--threads", metavar="N", type=click.IntRange(min=1), help="CPU threads (default: all cores).")
@click.option("--png/--no-png", default=True, show_default=True, help="Write frames/000001.png, ...")
@click.option("--mp4/--no-mp4", default=True, show_default=True, help="Write the film.")
@click.option(
    "--states", is_flag=True, help="Write states/000001.npz, ...: id, group, x, v, T, age, birth of all particles."
)
@click.option(
    "--existing",
    metavar="error|overwrite",
    default="error",
    show_default=True,
    help="What to do where DIR holds this scene rendered with other settings. The same settings give the same files; "
    "another scene's folder is never touched.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Go on with a render of the same that was killed: from its newest whole checkpoint, to the same frames and film. "
    "Where there is none, from the beginning.",
)
@click.option(
    "--checkpoint-every",
    metavar="10s|24f|off",
    help="Keep the state of the simulation in DIR/checkpoint, every so many seconds of work or simulated frames, until the film "
    "is done (default: 10s, stretched to at most 2 % of the time; off with --no-png, where all frames would have to be kept).",
)
@click.option(
    "--shards",
    metavar="N",
    type=click.IntRange(min=1),
    help="Split the particles by their ids: each of N processes simulates and draws a share of them, and the sum of their films is "
    "the same picture to the bit. Meshes are of the first shard.",
)
@click.option(
    "--shard",
    metavar="K|merge",
    help="On a cluster: only share K (from 1) of --shards N, which leaves its films in DIR/shards; or merge those of all.",
)
@click.option(
    "--workers", metavar="N", type=click.IntRange(min=1), help="Shards at a time (default: one for each core)."
)
@click.option("--merged", type=int, default=0, hidden=True)
@click.option(
    "--log",
    is_flag=True,
    help="Write DIR/log.h5: position, velocity and acceleration of every mesh vertex at every step, energies, contacts; particles "
    "once a frame. See `tparticles replay`, `plot` and `export`.",
)
@click.option("--log-every", metavar="N", type=click.IntRange(min=1), help="Log every N-th step of the meshes.")
@click.option("--log-ids", metavar="0-99,200", help="Log these vertices only.")
@click.option("--log-group", metavar="NAME", multiple=True, help="Log this group only; as often as needed.")
@JSON
@click.option("--quiet", is_flag=True, help="No progress and no summary.")
@click.pass_obj
def render(
    signals: list[int],
    scene: str,
    *,
    as_json: bool,
    quiet: bool,
    out: str | None,
    shards: int | None,
    shard: str | None,
    workers: int | None,
    merged: int,
    log: bool,
    log_every: int | None,
    log_ids: str | None,
    log_group: tuple[str, ...],
    **options: Any,
) -> None:
    """Render SCENE to PNG frames and an MP4 film.

    Writes DIR/frames/*.png, DIR/SCENE.mp4 and DIR/run.json, which says what was rendered, with a row for each frame. With --json,
    that is what is printed at the end. Ctrl-C keeps what is finished.
    """
    if out is not None and not out.strip():
        raise InputError("--out is empty: name a folder")
    start = time.perf_counter()
    with stdout_kept():
        from .job import Job, Options
        from .progress import Progress

        index = _shard(shards, shard, workers)
        logging = _logging(log, log_every, log_ids, log_group)
        if logging and shard == "merge":
            raise InputError("--log: the first shard writes the log; leave it out where you merge")
        command = _command(scene, out, options)
        if shards is not None and index is None:  # nothing is simulated here
            options["checkpoint_every"] = "off"
        job = Job(scene, Options(out=None if out is None else Path(out), **options))
        solved: set[str] = set()  # the meshes of which it was told by what
        with Progress(job.script.name, len(job.frames), quiet=quiet) as progress:

            def step(frame: Any, done: int) -> None:
                if signals:  # an import or a destructor may swallow the exception
                    raise KeyboardInterrupt
                for name, solves in () if quiet else frame.report.solves.items():
                    if name not in solved:
                        solved.add(name)
                        tell(f"group '{name}': implicit stages by the {solves['method']} solver ({solves['why']})")
                progress.step(frame, done)

            def tell(text: str) -> None:
                click.echo(f"{job.script.name}: {text}", err=True)

            if shards is None:
                whole = job.out / "log.h5" if logging else None
                run = job.run(step, tell=tell, source=_logged(job, logging) if logging else None, last=whole)
            else:
                from . import sharded

                if index is not None:
                    share = sharded.Share(index, shards)
                    run = sharded.render_shard(job, share, step, tell=tell, merged=merged, logging=logging)
                elif shard is not None:
                    run = sharded.merge_shards(job, shards, step, tell=tell)
                else:
                    if logging:
                        logging.check_share(job.scene, sharded.Share(0, shards))
                        logging.requests(job.scene)
                    announce = None if quiet else tell
                    run = sharded.render_in_shards(
                        job,
                        shards,
                        step,
                        command=command,
                        workers=workers,
                        tell=tell,
                        announce=announce,
                        log=logging.options() if logging else (),
                    )
    if as_json:
        print_json(run)
    elif not quiet:
        places = {"mp4": job.film_path, "png": job.out / "frames", "states": job.out / "states"}
        written = [str(place) for name, place in places.items() if options[name]]
        written += [f"{job.out}/log.h5"] if logging else []
        if index is not None:
            written = [f"{job.out}/shards/{index + 1}-of-{shards}"]
        n = len(job.frames)
        click.echo(f"{n} frame{'' if n == 1 else 's'} in {time.perf_counter() - start:.1f} s: {', '.join(written)}")


def _logging(log: bool, every: int | None, ids: str | None, groups: tuple[str, ...]) -> Logging | None:
    """Return what is logged, if anything. Raises `InputError`."""
    for name, value in (("--log-every", every), ("--log-ids", ids), ("--log-group", groups)):
        if value and not log:
            raise InputError(f"{name}: nothing is logged without --log")
    if not log:
        return None
    from .log.source import Logging

    return Logging(every=every or 1, ids=ids, groups=groups)


def _logged(job: Job, logging: Logging) -> Callable[[], Source]:
    """Return what makes the logged simulation of a job."""
    from .log.source import LoggedSimulation

    return lambda: LoggedSimulation(job, logging)


def _shard(shards: int | None, shard: str | None, workers: int | None) -> int | None:
    """Return the number, from 0, of the shard that is asked for, None if it is none or all. Raises `InputError`."""
    for name, value in (("--shard", shard), ("--workers", workers)):
        if value is not None and shards is None:
            raise InputError(f"{name} {value}: of how many? Give --shards N")
    if shard is None or shard == "merge" or shards is None:
        return None
    if not shard.isascii() or not shard.isdecimal() or not 1 <= int(shard[:9]) <= shards:
        raise InputError(f"--shard {shard}: a number from 1 to {shards}, or merge, is needed")
    return int(shard) - 1


def _command(scene: str, out: str | None, options: Mapping[str, Any]) -> list[str]:
    """Return the command that renders a shard of the same with the same options; which one, and its threads, come behind it."""
    command = [sys.executable, "-m", "tparticles", "render", scene, "--existing", "overwrite"]
    texts = {"out": out, **options}
    if options["size"] is not None:
        texts["size"] = "x".join(map(str, options["size"]))
    for name in ("out", "frames", "fps", "size", "quality", "seed", "scheme", "precision", "arch", "checkpoint_every"):
        if texts[name] is not None:
            command += [f"--{name.replace('_', '-')}", str(texts[name])]
    for name, value in options["settings"].items():
        command += ["--set", f"{name}={value}"]
    return command + ["--resume"] * options["resume"] + ["--states"] * options["states"]
