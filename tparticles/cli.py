"""The command line: render, list, describe, schemes, doctor.

Exit codes: 0 done, 1 failed while running, 2 bad input, 3 backend unavailable, 130 interrupted. Results go to stdout, progress and
errors to stderr; with --json, stdout holds one JSON document and nothing else, in failure too.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import re
import signal
import sys
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import click

from . import __version__
from .errors import InputError, TparticlesError
from .studies.commands import study

INTERRUPTED = 130
_MANY_OBJECTS = 100_000


class _InterruptError(TparticlesError):
    """Ctrl-C, or a request to end. Of a KeyboardInterrupt, click would print an empty line."""

    exit_code = INTERRUPTED

    def __str__(self) -> str:
        return "interrupted; what is finished stays"


class _Commands(click.Group):
    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise _InterruptError from None


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit."""
    # Imports and kernels make many objects that stay: the collector would look at them again and again, and find nothing.
    gc.set_threshold(_MANY_OBJECTS)
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    signals: list[int] = []
    try:
        with _interrupts(signals):
            cli.main(args=arguments, prog_name="tparticles", standalone_mode=False, obj=signals)
            if sys.stdout is not None:
                sys.stdout.flush()  # here, where a full disk or a closed pipe can still be told
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # or Python complains again when it ends
        sys.exit(1)
    except (Exception, KeyboardInterrupt) as error:
        # An interrupted import fails with an ImportError, and so on: whatever it looks like, this was the reason.
        asked = signals or isinstance(error, KeyboardInterrupt)
        _fail(_InterruptError() if asked else error, as_json="--json" in arguments)
    sys.exit(0)


def _fail(error: BaseException, *, as_json: bool) -> NoReturn:
    """Say what is wrong in one line, and leave with its exit code. Only a bug keeps its traceback."""
    status = "failed"
    if isinstance(error, _InterruptError):
        status = "interrupted"
        with contextlib.suppress(ValueError):  # not in the main thread
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is done: an impatient second one has nothing to stop
    message, code = _explain(error)
    message = re.sub(r" at 0x[0-9a-f]+", "", " ".join(message.split()))  # one line, and no addresses, whatever is in it
    with contextlib.suppress(OSError, ValueError):
        click.echo(f"error: {message}", err=True)
    with contextlib.suppress(OSError, ValueError):
        if as_json:
            click.echo(json.dumps({"status": status, "error": message, "exit_code": code}))
    sys.exit(code)


def _explain(error: BaseException) -> tuple[str, int]:
    """Return message and exit code."""
    if isinstance(error, TparticlesError):
        return str(error), error.exit_code
    if isinstance(error, click.ClickException):
        return _usage(error) + error.format_message(), error.exit_code
    if isinstance(error, MemoryError):
        return "out of memory: take a smaller --size or fewer particles", 1
    if isinstance(error, OSError):
        return f"{error.filename or 'cannot write'}: {error.strerror or error}", 1
    traceback.print_exception(error)
    return f"internal error: {type(error).__name__}: {error}", 1


def _usage(error: click.ClickException) -> str:
    """Return which command refused its arguments."""
    context = error.ctx if isinstance(error, click.UsageError) else None
    return "" if context is None or context.parent is None else f"{context.info_name}: "


@contextlib.contextmanager
def _interrupts(received: list[int]) -> Iterator[None]:
    """Raise KeyboardInterrupt on Ctrl-C, and where a batch system or a closing terminal ends us: finished frames are kept."""

    def interrupt(number: int, _: Any) -> None:
        received.append(number)
        raise KeyboardInterrupt

    kinds = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    ours = (signal.SIG_DFL, signal.default_int_handler)  # where it is ignored, `nohup` and `&` mean it
    taken = {}
    with contextlib.suppress(ValueError):  # not in the main thread
        taken = {kind: signal.signal(kind, interrupt) for kind in kinds if signal.getsignal(kind) in ours}
    try:
        yield
    finally:
        for kind, handler in taken.items():
            signal.signal(kind, handler)


@contextlib.contextmanager
def _stdout_kept() -> Iterator[None]:
    """Send what a scene, Taichi or a driver prints to stderr: stdout is for results."""
    try:
        saved = os.dup(1)
    except OSError:  # stdout is closed
        yield
        return
    try:
        os.dup2(2, 1)
        # Taichi, before Python's stdout is another: it would take that for a notebook, and say so.
        from . import tracing  # noqa: F401

        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        with contextlib.suppress(OSError, AttributeError, TypeError):
            ctypes.CDLL(None).fflush(None)  # C's own buffer, which kernels print into
        os.dup2(saved, 1)
        os.close(saved)


def _print_json(value: Any) -> None:
    from .output import jsonable

    click.echo(json.dumps(jsonable(value), allow_nan=False))


@click.group(
    cls=_Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(__version__, prog_name="tparticles")
@click.pass_context
def cli(context: click.Context) -> None:
    """Particle systems on Taichi, rendered without a screen.

    SCENE is a Python file that defines `def scene(quality, *, name=default, ...)`, or the name of one in ./scenes.

    \b
    tparticles list                                     what there is
    tparticles render campfire                          a film in renders/campfire
    tparticles render campfire --quality preview --frames 1-48 --set wind=2 --out /tmp/windy

    Exit codes: 0 done, 1 failed while running, 2 bad input, 3 backend unavailable, 130 interrupted.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


def _size(_context: Any, _parameter: Any, value: str | None) -> tuple[int, int] | None:
    if value is None:
        return None
    found = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", value.strip())
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not all(1 <= n <= 16384 for n in size):
        raise InputError(f"--size {value}: WIDTHxHEIGHT is needed, such as 1920x1080, each from 1 to 16384")
    return size


def _settings(_context: Any, _parameter: Any, values: Sequence[str]) -> dict[str, str]:
    settings: dict[str, str] = {}
    for value in values:
        name, equals, text = value.partition("=")
        name = name.strip()
        if not equals or not name:
            raise InputError(f"--set {value}: name=value is needed")
        if name in settings:
            raise InputError(f"--set {name} is given twice")
        settings[name] = text
    return settings


_QUALITY = click.option(
    "--quality",
    metavar="preview|draft|final",
    default="final",
    show_default=True,
    help="480x270, 960x540 or 1920x1080 where the scene names no size; the scene is told, too.",
)
_SET = click.option(
    "--set",
    "settings",
    metavar="NAME=VALUE",
    multiple=True,
    callback=_settings,
    help="A parameter of the scene; `describe` lists them. As often as needed.",
)
_PRECISION = click.option("--precision", metavar="f32|f64", default="f32", show_default=True, help="Of the simulation.")
_JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON on stdout, and nothing else; in failure too.")


@cli.command()
@click.argument("scene")
@click.option("--out", metavar="DIR", help="Output folder (default: renders/ and the scene's name).")
@click.option(
    "--frames",
    metavar="RANGE",
    help="What to draw: 1-240, 1-240x2 (every second), 7, 100- (to the end), or several with commas. Others are simulated, "
    "not drawn; frames already in the folder stay. The film of a part gets a name of its own.",
)
@click.option("--fps", metavar="RATE", help="Frame rate: 24, 25, 30000/1001 (default: the scene's).")
@click.option("--size", metavar="WxH", callback=_size, help="Width and height in pixels; even for an MP4.")
@_QUALITY
@_SET
@click.option("--seed", metavar="N", type=click.IntRange(min=0), help="Another seed for all random numbers.")
@click.option("--scheme", metavar="NAME", help="Another integration scheme; see `tparticles schemes`.")
@_PRECISION
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
@_JSON
@click.option("--quiet", is_flag=True, help="No progress and no summary.")
@click.pass_obj
def render(signals: list[int], scene: str, *, as_json: bool, quiet: bool, out: str | None, **options: Any) -> None:
    """Render SCENE to PNG frames and an MP4 film.

    Writes DIR/frames/*.png, DIR/SCENE.mp4 and DIR/run.json, which says what was rendered, with a row for each frame. With --json,
    that is what is printed at the end. Ctrl-C keeps what is finished.
    """
    if out is not None and not out.strip():
        raise InputError("--out is empty: name a folder")
    start = time.perf_counter()
    with _stdout_kept():
        from .job import Job, Options
        from .progress import Progress

        job = Job(scene, Options(out=None if out is None else Path(out), **options))
        with Progress(job.script.name, len(job.frames), quiet=quiet) as progress:

            def step(frame: Any, done: int) -> None:
                if signals:  # an import or a destructor may swallow the exception
                    raise KeyboardInterrupt
                progress.step(frame, done)

            run = job.run(step)
    if as_json:
        _print_json(run)
    elif not quiet:
        places = {"mp4": job.film_path, "png": job.out / "frames", "states": job.out / "states"}
        written = ", ".join(str(place) for name, place in places.items() if options[name])
        n = len(job.frames)
        click.echo(f"{n} frame{'' if n == 1 else 's'} in {time.perf_counter() - start:.1f} s: {written}")


@cli.command("list")
@_JSON
def list_(as_json: bool) -> None:
    """List the scenes in ./scenes, with their parameters.

    They are read, not run; a broken one is listed with what is wrong.
    """
    from . import library

    found = [library.outline(library.SCENES / f"{name}.py") for name in library.names()]
    if as_json:
        rows = [
            {"name": s.name, "summary": s.summary, "parameters": s.parameters, "error": s.error or None} for s in found
        ]
        click.echo(json.dumps(rows, default=str))
        return
    for s in found:
        parameters = " ".join(f"{name}={default}" for name, default in s.parameters.items())
        click.echo(f"{s.name:12} {f'error: {s.error}' if s.error else s.summary}")
        if parameters:
            click.echo(f"{'':12} {parameters}")
    if not found:
        click.echo(f"no scenes in {library.SCENES.resolve()}", err=True)


@cli.command()
@click.argument("scene")
@_SET
@_QUALITY
@_PRECISION
@_JSON
def describe(scene: str, settings: Mapping[str, str], quality: str, precision: str, as_json: bool) -> None:
    """Describe SCENE: parameters, bytes per particle.

    Parameters with their types and values, frames, steps, and for each group its emitters, its births, how many particles can
    be alive at once, and the attributes that one particle takes.
    """
    with _stdout_kept():
        from .describe import describe_scene, text

        found = describe_scene(scene, settings=settings, quality=quality, precision=precision)
    if as_json:
        _print_json(found)
    else:
        click.echo(text(found))


@cli.command()
@click.argument("name", required=False)
@_JSON
def schemes(name: str | None, as_json: bool) -> None:
    """List the integration schemes: order, cost, stability limits.

    With NAME, show that one with its program. Limits are in units of step times rate: the largest stable step on the negative
    real and on the imaginary axis. One that is infinite is `inf` in the table and null in JSON.
    """
    from .schemes import CATALOGUE, get
    from .schemes import describe as row
    from .schemes.listing import sheet, table

    chosen = list(CATALOGUE.values()) if name is None else [get(name)]
    if as_json:
        _print_json([row(scheme) for scheme in chosen])
    else:
        click.echo(table(chosen) if name is None else sheet(chosen[0]))


@cli.command()
@_JSON
def doctor(as_json: bool) -> None:
    """Check what this machine has.

    Versions, architectures, ffmpeg, the kernel cache, disk.
    """
    with _stdout_kept():
        from .describe import examine

        found = examine()
    if as_json:
        _print_json(found)
    else:
        for name, value in found.items():
            click.echo(f"{name:14} {value}")


cli.add_command(study)
