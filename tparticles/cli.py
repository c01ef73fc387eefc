"""The command line: render, list, describe, schemes, doctor.

Exit codes: 0 done, 1 failed while running, 2 bad input, 3 backend unavailable, 4 not as the reference, 130 interrupted. Results go
to stdout, progress and errors to stderr; with --json, stdout holds one JSON document and nothing else, in failure too.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import re
import signal
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NoReturn

import click

from . import __version__
from .batch.commands import COMMANDS as BATCH_COMMANDS
from .command_options import JSON, PRECISION, QUALITY, SET, print_json, stdout_kept
from .data_scene.commands import schema
from .errors import InputError, TparticlesError
from .log.commands import export, plot, replay
from .regression.commands import check, compare
from .render_command import render
from .studies.commands import study

INTERRUPTED = 130
_MANY_OBJECTS = 300_000


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


def collect_seldom() -> None:
    """Imports and kernels make many objects that stay: the collector would look at them again and again, and find nothing."""
    gc.set_threshold(_MANY_OBJECTS)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit."""
    collect_seldom()
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
            details = getattr(error, "details", {})
            click.echo(json.dumps(details | {"status": status, "error": message, "exit_code": code}))
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


@click.group(
    cls=_Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(__version__, prog_name="tparticles")
@click.pass_context
def cli(context: click.Context) -> None:
    """Particle systems on Taichi, rendered without a screen.

    SCENE is a Python file that defines `def scene(quality, *, name=default, ...)`, a TOML or JSON file that describes a scene
    (`tparticles schema`), or the name of one in ./scenes; of a script and a document of one name the script is taken.

    \b
    tparticles list                                     what there is
    tparticles render campfire                          a film in renders/campfire
    tparticles render campfire --quality preview --frames 1-48 --set wind=2 --out /tmp/windy

    Exit codes: 0 done, 1 failed while running, 2 bad input, 3 backend unavailable, 4 not as the reference, 130 interrupted.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


@cli.command("list")
@JSON
def list_(as_json: bool) -> None:
    """List the scenes there are, with their parameters.

    Those in ./scenes by name, those in ./scenes/data by path. They are read, not run; a broken one is listed with what is wrong.
    """
    from . import library, scene_files

    found = library.outlines()
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
        click.echo(f"no scenes in {scene_files.SCENES.resolve()}", err=True)


@cli.command()
@click.argument("scene")
@SET
@QUALITY
@PRECISION
@click.option(
    "--toml", "as_toml", is_flag=True, help="Print SCENE as a data scene instead, with the values that are set."
)
@JSON
def describe(
    scene: str, settings: Mapping[str, str], quality: str, precision: str, as_toml: bool, as_json: bool
) -> None:
    """Describe SCENE: parameters, bytes per particle.

    Parameters with their types and values, frames, steps, and for each group its emitters, its births, how many particles can
    be alive at once, and the attributes that one particle takes. With --toml, the scene itself as a document, which renders the
    same frames; a scene with laws of its own has none.
    """
    if as_toml and as_json:
        raise InputError("--toml and --json: one of them")
    if as_toml:
        with stdout_kept():
            from .describe import toml

            document = toml(scene, settings=settings, quality=quality)
        click.echo(document, nl=False)
        return
    with stdout_kept():
        from .describe import describe_scene, text

        found = describe_scene(scene, settings=settings, quality=quality, precision=precision)
    if as_json:
        print_json(found)
    else:
        click.echo(text(found))


@cli.command()
@click.argument("name", required=False)
@JSON
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
        print_json([row(scheme) for scheme in chosen])
    else:
        click.echo(table(chosen) if name is None else sheet(chosen[0]))


@cli.command()
@JSON
def doctor(as_json: bool) -> None:
    """Check what this machine has.

    Versions, architectures, ffmpeg, the kernel cache, disk.
    """
    with stdout_kept():
        from .describe import examine

        found = examine()
    if as_json:
        print_json(found)
    else:
        for name, value in found.items():
            click.echo(f"{name:14} {value}")


cli.add_command(check)
cli.add_command(compare)
cli.add_command(render)
cli.add_command(replay)
cli.add_command(plot)
cli.add_command(export)
cli.add_command(schema)
cli.add_command(study)
for command in BATCH_COMMANDS:
    cli.add_command(command)
