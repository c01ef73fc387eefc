"""The command `tparticles study box`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from ..errors import InputError


def command(options: Callable[..., Any], teller: Callable[[bool], Callable[[str], None]]) -> click.Command:
    """Return the command; `options` adds those that all studies have, `teller` makes what says how far it is."""

    @click.command()
    @click.option(
        "--seeds",
        "drops",
        metavar="N",
        type=click.IntRange(1, 1000),
        help="Random throws for each scheme (default: 16).",
    )
    @click.option(
        "--film",
        "stiffness",
        metavar="K",
        type=click.FloatRange(1e-3, 1e12),
        help="In place of the study, film the boxes of all schemes side by side, with springs of K [N/m].",
    )
    @options
    def box(
        drops: int | None, stiffness: float | None, names: Sequence[str], out: str, as_json: bool, quiet: bool
    ) -> None:
        """Scott's falling spring box.

        The stiffness at which energy first grows and at which the box blows up, time per step and performance index of every
        scheme at dt = 0.01 s, beside Table 1 of R. Scott (2002). --film writes DIR/box-film.mp4 and DIR/box-film.png instead.
        """
        from .. import schemes
        from ..command_options import print_json, stdout_kept

        if not out.strip():
            raise InputError("--out is empty: name a folder")
        chosen = [schemes.get(name) for name in dict.fromkeys(names)]
        start, folder = time.perf_counter(), Path(out)
        if stiffness is not None:
            if as_json or drops is not None:
                raise InputError("--film makes pictures alone: leave out --json and --seeds")
            _film(chosen, stiffness, folder, teller(quiet), quiet)
            return
        with stdout_kept():
            from . import box as module
            from . import box_pictures, report

            report.claim(folder, "box")
            result = module.study(
                chosen or list(schemes.CATALOGUE.values()),
                drops=module.DROPS if drops is None else drops,
                tell=teller(quiet),
            )
            pictures = {"box-time": box_pictures.against_time}
            if indexed := box_pictures.has_index(result):
                pictures["box-index"] = box_pictures.index
            else:  # one of another run would not belong to these numbers
                (folder / "box-index.png").unlink(missing_ok=True)
            written = report.write(folder, "box", result, pictures)
        if not indexed and not quiet:
            click.echo("no box-index.png: no scheme both grew and blew up, so none has a performance index", err=True)
        if not report.has_matplotlib() and not quiet:
            click.echo(report.INSTALL, err=True)
        if as_json:
            print_json([module.contract(b) for b in result.boxes])
        elif not quiet:
            from .box_text import summary

            click.echo(summary(result))
            click.echo(f"{time.perf_counter() - start:.1f} s: {', '.join(map(str, written))}")

    return box


def _film(chosen: Sequence[Any], stiffness: float, folder: Path, tell: Callable[[str], None], quiet: bool) -> None:
    from .. import schemes
    from . import box_film, report
    from .box_paper import TABLE

    report.claim(folder, "box-film")
    wanted = chosen or [schemes.get(row.scheme) for row in TABLE]
    written = box_film.film(wanted, stiffness, folder, tell=tell)
    if not quiet:
        click.echo("\n".join(map(str, written)))
