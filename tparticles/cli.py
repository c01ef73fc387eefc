"""The command line: render, list, describe, schemes, doctor.

Exit codes: 0 done, 1 failed while running, 2 bad input, 3 backend unavailable, 130 interrupted. Results go to stdout, progress and
errors to stderr; with --json, stdout holds JSON and nothing else.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

import click

from . import __version__
from .errors import InputError, TparticlesError

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit."""
    try:
        cli.main(args=None if arguments is None else list(arguments), standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except TparticlesError as error:
        _fail(str(error), error.exit_code)
    except (KeyboardInterrupt, click.Abort):
        _fail("interrupted; finished frames stay", INTERRUPTED)
    except MemoryError:
        _fail("out of memory: take a smaller --size or fewer particles", 1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    sys.exit(0)


def _fail(message: str, code: int) -> NoReturn:
    context = click.get_current_context(silent=True)
    if (context is not None and context.params.get("as_json")) or "--json" in sys.argv:
        click.echo(json.dumps({"status": "interrupted" if code == INTERRUPTED else "failed", "error": message}))
    click.echo(f"error: {message}", err=True)
    sys.exit(code)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="tparticles")
def cli() -> None:
    """Particle systems on Taichi, rendered without a screen."""


def _size(_context: Any, _parameter: Any, value: str | None) -> tuple[int, int] | None:
    if value is None:
        return None
    found = re.fullmatch(r"(\d{1,9})x(\d{1,9})", value.strip())
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not all(1 <= n <= 16384 for n in size):
        raise InputError(f"--size {value}: WIDTHxHEIGHT is needed, such as 1920x1080, each from 1 to 16384")
    return size


def _settings(_context: Any, _parameter: Any, values: Sequence[str]) -> dict[str, str]:
    settings = {}
    for value in values:
        name, equals, text = value.partition("=")
        if not equals or not name:
            raise InputError(f"--set {value}: name=value is needed")
        settings[name.strip()] = text
    return settings


@cli.command()
@click.argument("scene")
@click.option("--out", type=click.Path(path_type=Path), help="Output folder (default: renders/SCENE).")
@click.option("--frames", help="What to draw: 1-240, 1-240x2 (every second), 7, 100-, or several with commas.")
@click.option("--fps", help="Frame rate: 24, 25, 30000/1001 (default: the scene's).")
@click.option("--size", callback=_size, help="WIDTHxHEIGHT in pixels (default: by quality).")
@click.option("--quality", type=click.Choice(["preview", "draft", "final"]), default="final", show_default=True)
@click.option("--set", "settings", multiple=True, callback=_settings, help="A parameter of the scene, name=value.")
@click.option("--seed", type=click.IntRange(min=0), help="Another seed for all random numbers.")
@click.option("--scheme", help="Another integration scheme; see `tparticles schemes`.")
@click.option("--precision", type=click.Choice(["f32", "f64"]), default="f32", show_default=True)
@click.option("--arch", default="auto", show_default=True, help="auto, cpu, cuda or vulkan; a named one never falls back.")
@click.option("--threads", type=click.IntRange(min=1), help="CPU threads (default: all cores).")
@click.option("--png/--no-png", default=True, show_default=True, help="Write frames/*.png.")
@click.option("--mp4/--no-mp4", default=True, show_default=True, help="Write SCENE.mp4.")
@click.option("--states", is_flag=True, help="Write states/*.npz: id, x, v, T, age, birth of every particle.")
@click.option(
    "--existing",
    type=click.Choice(["error", "overwrite"]),
    default="error",
    show_default=True,
    help="What to do where --out holds the scene rendered with other settings.",
)
@click.option("--json", "as_json", is_flag=True, help="Print run.json on stdout at the end, and nothing else.")
@click.option("--quiet", is_flag=True, help="No progress.")
def render(scene: str, *, as_json: bool, quiet: bool, **options: Any) -> None:
    """Render SCENE, a path or a name in scenes/, to PNG frames and an MP4 film."""
    from .job import Job, Options

    job = Job(scene, Options(**options))
    start = time.perf_counter()
    with _progress(job, quiet) as step:
        run = job.run(step)
    if as_json:
        click.echo(json.dumps(run))
    elif not quiet:
        what = [str(job.film_path)] if options["mp4"] else []
        what += [f"{job.out}/{name}" for name in ("png", "states") if options[name]]
        click.echo(f"{len(job.frames)} frames in {time.perf_counter() - start:.1f} s: {', '.join(what).replace('/png', '/frames')}")


class _progress:  # noqa: N801
    """A progress bar with an ETA over a trailing window on a terminal, plain lines elsewhere, nothing if quiet."""

    def __init__(self, job: Any, quiet: bool):
        self.job, self.quiet = job, quiet
        self.bar: Any = None
        self.next_line = 0.0

    def __enter__(self) -> Callable[[Any, int], None]:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(stderr=True)
        if not self.quiet and console.is_terminal:
            self.bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("[cyan]{task.fields[alive]} alive"),
                TextColumn("eta"),
                TimeRemainingColumn(),
                console=console,
                speed_estimate_period=30,  # [s], the trailing window
            )
            self.bar.start()
            self.task = self.bar.add_task(f"{self.job.script.name} (compiling)", total=len(self.job.frames), alive=0)
        return self.step

    def step(self, frame: Any, done: int) -> None:
        total = len(self.job.frames)
        if self.bar is not None:
            self.bar.update(self.task, completed=done, alive=frame.report.alive, description=self.job.script.name)
        elif not self.quiet and (time.monotonic() >= self.next_line or done == total):
            self.next_line = time.monotonic() + 5.0
            click.echo(f"frame {frame.number} ({done}/{total}), {frame.report.alive} alive", err=True)

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()


@cli.command("list")
@click.option("--json", "as_json", is_flag=True)
def list_(as_json: bool) -> None:
    """List the scenes in ./scenes with their parameters."""
    from . import library

    scripts = [library.load(name) for name in library.names()]
    if as_json:
        rows = [
            {"name": s.name, "summary": s.summary, "parameters": {n: p.default for n, p in s.parameters.items()}}
            for s in scripts
        ]
        click.echo(json.dumps(rows, default=str))
        return
    for s in scripts:
        parameters = " ".join(f"{n}={p.default}" for n, p in s.parameters.items())
        click.echo(f"{s.name:12} {s.summary}\n{'':12} {parameters}")
    if not scripts:
        click.echo(f"no scenes in {library.SCENES.resolve()}", err=True)


@cli.command()
@click.argument("scene")
@click.option("--set", "settings", multiple=True, callback=_settings, help="A parameter of the scene, name=value.")
@click.option("--quality", type=click.Choice(["preview", "draft", "final"]), default="final", show_default=True)
@click.option("--precision", type=click.Choice(["f32", "f64"]), default="f32", show_default=True)
@click.option("--json", "as_json", is_flag=True)
def describe(scene: str, settings: dict[str, str], quality: str, precision: str, as_json: bool) -> None:
    """Say what SCENE holds: parameters, groups, attributes, bytes per particle, capacity."""
    from .describe import describe_scene, text

    found = describe_scene(scene, settings=settings, quality=quality, precision=precision)
    click.echo(json.dumps(found, default=str) if as_json else text(found))


@cli.command()
@click.option("--json", "as_json", is_flag=True)
def schemes(as_json: bool) -> None:
    """List the integration schemes: order, cost, stability limits."""
    from .schemes import CATALOGUE
    from .schemes import describe as row

    rows = [row(scheme) for scheme in CATALOGUE.values()]
    if as_json:
        click.echo(json.dumps(rows))
        return
    click.echo(f"{'scheme':12} {'order':>5} {'evaluations':>11} {'real limit':>10} {'imaginary limit':>15}")
    for r in rows:
        click.echo(
            f"{r['name']:12} {r['order']:5} {r['evaluations']:11} {r['real_limit']:10.4f} {r['imaginary_limit']:15.4f}"
        )


@cli.command()
@click.option("--json", "as_json", is_flag=True)
def doctor(as_json: bool) -> None:
    """Check what this machine has: versions, architectures, ffmpeg, the kernel cache, disk."""
    from .describe import examine

    found = examine()
    if as_json:
        click.echo(json.dumps(found))
    else:
        width = shutil.get_terminal_size().columns
        for name, value in found.items():
            click.echo(f"{name:14} {value}"[: max(width, 200)])
