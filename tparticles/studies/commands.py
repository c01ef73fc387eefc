"""The commands `tparticles study ...`: run a study, write JSON, CSV and pictures, say in a few lines what it found."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from ..errors import InputError
from . import box_command, precision_command


@click.group(invoke_without_command=True)
@click.pass_context
def study(context: click.Context) -> None:
    """Measure the schemes: order, stability, energy, unequal steps, precision, the spring box.

    Each study writes DIR/NAME.json, DIR/NAME.csv and, where matplotlib is installed (pip install 'tparticles[studies]'),
    pictures DIR/NAME*.png. Results of the same study in DIR are replaced.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


def _options(command: Callable[..., None]) -> Callable[..., None]:
    for option in (
        click.option("--quiet", is_flag=True, help="No progress and no summary."),
        click.option("--json", "as_json", is_flag=True, help="Print JSON on stdout, and nothing else; in failure too."),
        click.option("--out", metavar="DIR", default="renders/studies", show_default=True, help="Output folder."),
        click.option(
            "--scheme",
            "names",
            metavar="NAME",
            multiple=True,
            help="Only this scheme; as often as needed (default: all).",
        ),
    ):
        command = option(command)
    return command


@study.command()
@_options
def order(**options: Any) -> None:
    """Error against step, and its slope.

    Every scheme in f64 on smooth nonlinear problems: a flow, and forces without and with velocity.
    """
    _run("order", **options)


@study.command()
@_options
def stability(**options: Any) -> None:
    """Stability regions and limits.

    The region of each scheme in the plane of dt lambda, and its limit of omega dt against the damping ratio.
    """
    _run("stability", **options)


@study.command()
@_options
def energy(**options: Any) -> None:
    """Energy and phase over 10 000 periods.

    An undamped oscillator and pendula of two amplitudes, on the engine, in 40 steps a period.
    """
    _run("energy", **options)


@study.command("variable-steps")
@_options
def variable_steps(**options: Any) -> None:
    """Alternating steps that blow up together.

    Growth of pairs of unequal steps, each of them stable on its own (J. P. Wright 1998), and what splitting frames does.
    """
    _run("variable-steps", **options)


def _run(name: str, *, names: Sequence[str], out: str, as_json: bool, quiet: bool) -> None:
    from .. import schemes
    from ..command_options import print_json, stdout_kept

    if not out.strip():
        raise InputError("--out is empty: name a folder")
    chosen = [schemes.get(name) for name in dict.fromkeys(names)] or list(schemes.CATALOGUE.values())
    start = time.perf_counter()
    with stdout_kept():
        from . import report

        folder = Path(out)
        report.claim(folder, name)
        module, pictures, summary = _parts(name)
        result = module.study(chosen, tell=_teller(quiet))
        written = report.write(folder, name, result, pictures)
    if not report.has_matplotlib() and not quiet:
        click.echo(report.INSTALL, err=True)
    if as_json:
        print_json(report.document(name, result))
    elif not quiet:
        click.echo(summary(result))
        click.echo(f"{time.perf_counter() - start:.1f} s: {', '.join(map(str, written))}")


def _parts(name: str) -> tuple[Any, dict[str, Callable[[Any], Any]], Callable[[Any], str]]:
    """Return the study's module, its pictures by file name, and what sums it up; loaded here, as they import Taichi."""
    from . import draw_maps, draw_runs, summaries

    if name == "order":
        from . import order as module

        return module, {"order": draw_runs.order}, summaries.order
    if name == "stability":
        from . import stability as module

        return module, {"stability": draw_maps.regions, "stability-damping": draw_maps.damping}, summaries.stability
    if name == "energy":
        from . import energy as module

        return module, {"energy": draw_runs.energy}, summaries.energy
    from . import variable_steps as module

    pictures = {"variable-steps": draw_maps.alternating, "variable-steps-frame": draw_maps.split_frames}
    return module, pictures, summaries.variable_steps


def _teller(quiet: bool) -> Callable[[str], None]:
    """Return what says on a terminal, in one line that is written over, what is being done."""
    shown = not quiet and sys.stderr is not None and sys.stderr.isatty()

    def tell(line: str) -> None:
        if shown:
            click.echo(f"\r\033[K{line}", nl=False, err=True)

    return tell


study.add_command(precision_command.command(_options, _teller))
study.add_command(box_command.command(_options, _teller))
