"""The command `tparticles study precision`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from ..errors import InputError, unknown

PRECISIONS = ("f32", "f64")


def command(options: Callable[..., Any], teller: Callable[[bool], Callable[[str], None]]) -> click.Command:
    """Return the command; `options` adds those that all studies have, `teller` makes what says how far it is."""

    @click.command()
    @click.argument("subject", metavar="PROBLEM|SCENE")
    @click.option(
        "--precision",
        "precisions",
        metavar="f32,f64",
        default="f32,f64",
        show_default=True,
        help="One or both, with a comma.",
    )
    @click.option("--count", metavar="N", type=click.IntRange(min=1), help="Particles of a PROBLEM (default: 10000).")
    @click.option("--frame", metavar="N", type=click.IntRange(min=1), help="Of a SCENE (default: the last of 2 s).")
    @options
    def precision(subject: str, *, names: Sequence[str], out: str, as_json: bool, quiet: bool, **more: Any) -> None:
        """Cost against error: which scheme, which step.

        Wall time and evaluations against error, for every scheme over steps and tolerances; the cheapest for some errors.

        PROBLEM is abc, stiff-drag or kepler, an ensemble with a known solution, or cloth-1e4, cloth-1e5 or cloth-1e6, a taut
        cloth by its stiffness: next to scipy's solvers in the same run, where scipy is installed. SCENE is a scene file or the
        name of one in ./scenes: errors are in pixels, as its camera sees them.
        """
        from .. import schemes
        from ..command_options import print_json, stdout_kept

        if not out.strip():
            raise InputError("--out is empty: name a folder")
        chosen = [schemes.get(name) for name in dict.fromkeys(names)]
        start, folder = time.perf_counter(), Path(out)
        with stdout_kept():
            from . import report
            from .draw_precision import precision as draw

            name, run = _study(subject, chosen, _precisions(more["precisions"]), more["count"], more["frame"])
            report.claim(folder, name)
            result = run(teller(quiet))
            written = report.write(folder, name, result, {name: draw})
        if not report.has_matplotlib() and not quiet:
            click.echo(report.INSTALL, err=True)
        if as_json:
            print_json(report.document(name, result))
        elif not quiet:
            click.echo(summary(result))
            click.echo(f"{time.perf_counter() - start:.1f} s: {', '.join(map(str, written))}")

    return precision


def _precisions(text: str) -> list[str]:
    found = list(dict.fromkeys(part.strip() for part in text.split(",")))
    for name in found:
        if name not in PRECISIONS:
            raise unknown("precision", name, PRECISIONS)
    return found


def _study(
    subject: str, chosen: Sequence[Any], precisions: Sequence[str], count: int | None, frame: int | None
) -> tuple[str, Callable[[Callable[[str], None]], Any]]:
    """Return the name of the files and what runs the study, with all that was asked for checked."""
    from .. import library, scene_files, schemes
    from . import pixels, precision
    from .work_problems import WORKS

    if subject in WORKS:
        if frame is not None:
            raise InputError(f"--frame belongs to scenes, and '{subject}' is a problem; leave it out")
        if count is not None and WORKS[subject].coupled:
            raise InputError(f"--count belongs to ensembles, and '{subject}' is one mesh; leave it out")
        wanted = chosen or list(schemes.CATALOGUE.values())
        amount = precision.COUNT if count is None else count
        return f"precision-{subject}", lambda tell: precision.study(
            subject, WORKS[subject], wanted, precisions=precisions, count=amount, tell=tell
        )
    if Path(subject).suffix not in (".py", ".toml", ".json") and subject not in scene_files.names():
        raise unknown("problem or scene", subject, [*WORKS, *scene_files.names()])
    if count is not None:
        raise InputError(f"--count belongs to problems, and '{subject}' is a scene; leave it out")
    script = library.load(subject)
    scene = script.build(quality="final", settings={})
    wanted = chosen or [schemes.get(name) for name in pixels.SCHEMES]
    size = scene.resolution("final")
    return f"precision-{script.name}", lambda tell: pixels.study(
        script.name, scene, wanted, size=size, frame=frame, precisions=precisions, tell=tell
    )


def summary(result: Any) -> str:
    """Return the recommendation: the cheapest for each error."""
    from .report import table

    unit = "px" if result.unit == "px" else "s"
    peer = ["scipy's best", "time", "ratio"] if any(p.peer for p in result.points) else []
    rows: list[list[object]] = [
        ["largest error", "precision", "cheapest", "setting", "time", "evaluations", "fewest evaluations", *peer]
    ]
    for c in result.choices:
        row = [_error(c.target, result.unit), c.precision, *_cells(c.best), _least(c.fewest)]
        if peer:
            row += [
                c.peer.solver if c.peer else "none",
                _time(c.peer),
                f"{c.ratio:.0f}x" if c.ratio == c.ratio else "-",
            ]
        rows.append(row)
    lines = [
        f"{result.what}: {result.particles} particles, errors in {unit if unit == 'px' else 'SI units'}",
        table(rows),
    ]
    return "\n".join([*lines, *result.notes])


def _error(target: float, unit: str) -> str:
    return f"{target:g}{' px' if unit == 'px' else ''}"


def _cells(point: Any) -> list[str]:
    if point is None:
        return ["none", "-", "-", "-"]
    return [point.label, _setting(point), _time(point), f"{point.evaluations:.0f}"]


def _setting(point: Any) -> str:
    what = {"fixed": "dt", "error": "rtol", "pixels": "px"}[point.control]
    return f"{what} = {point.setting:.3g}"


def _time(point: Any) -> str:
    return "-" if point is None else f"{1e3 * point.seconds:.3g} ms"


def _least(point: Any) -> str:
    return "-" if point is None else f"{point.label}, {_setting(point)}: {point.evaluations:.0f}"
