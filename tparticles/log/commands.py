"""The commands that read a log: replay, plot, export."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path
from typing import Any

import click

from ..command_options import SET, size_option, stdout_kept
from ..errors import InputError, unknown

# What an export's file may end with; usd looks for itself. Where it is nothing, a folder is made.
_SUFFIXES: dict[str, tuple[str, ...]] = {"csv": (".csv", ".txt"), "npz": (".npz",), "ply": (), "vtu": ()}
_EXISTING = click.option(
    "--existing", metavar="error|overwrite", default="error", show_default=True, help="Where FILE exists."
)


def _vector(_context: Any, parameter: Any, value: str | None) -> tuple[float, ...] | None:
    """Read `X,Y,Z`. Raises `InputError`."""
    if value is None:
        return None
    try:
        found = tuple(float(part) for part in value.split(","))
    except ValueError:
        found = ()
    if len(found) != 3 or not all(map(math.isfinite, found)):
        raise InputError(f"--{parameter.name} {value}: X,Y,Z in metres is needed, such as 0,-5,1.5")
    return found


def _free(path: Path, existing: str) -> Path:
    """Return a path that may be written. Raises `InputError` where something is there that is not to be replaced."""
    if existing not in ("error", "overwrite"):
        raise InputError(f"--existing {existing}: error or overwrite is needed")
    if existing == "error" and path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise InputError(f"{path} exists: choose another with --out, or replace it with --existing overwrite")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")
    return path


def _check_suffix(path: Path, own: tuple[str, ...], wanted: str) -> None:
    """Refuse a name that promises another kind of file. Folders may be called `run.2`, and one that is there as it likes."""
    if re.fullmatch(r"\.[A-Za-z][A-Za-z0-9]{1,4}", path.suffix) and path.suffix not in own and not path.is_dir():
        raise InputError(f"--out {path}: {wanted}, and no {path.suffix}")


@click.command()
@click.argument("log")
@click.option("--step", metavar="N", type=click.IntRange(min=0), help="One picture, frozen at this step.")
@click.option("--range", "steps", metavar="A-B", help="These steps only (default: all that are logged).")
@click.option("--group", metavar="NAME", help="Whose steps are counted (default: the first mesh's).")
@click.option("--speed", type=float, default=1.0, show_default=True, help="0.1: ten times slower than it was.")
@click.option(
    "--out", metavar="FILE", help="A .mp4 or a .png, or a folder for numbered pictures (default: beside LOG)."
)
@click.option("--fps", metavar="RATE", help="Frame rate (default: the run's).")
@click.option("--size", metavar="WxH", callback=size_option, help="Width and height in pixels (default: the run's).")
@click.option("--quality", metavar="preview|draft|final", help="Size by name (default: the run's).")
@click.option("--camera", metavar="X,Y,Z", callback=_vector, help="Look from here [m].")
@click.option("--target", metavar="X,Y,Z", callback=_vector, help="Look at this point [m].")
@click.option("--fov", metavar="DEGREES", type=float, help="Vertical field of view.")
@SET
@click.option("--changed", is_flag=True, help="Draw with the scene's script though it has changed since.")
@click.option("--arch", metavar="auto|cpu|cuda|vulkan", default="auto", show_default=True, help="As for render.")
@click.option("--threads", metavar="N", type=click.IntRange(min=1), help="CPU threads (default: all cores).")
@_EXISTING
@click.option("--quiet", is_flag=True, help="No progress and no summary.")
@click.pass_obj
def replay(
    signals: list[int],
    log: str,
    *,
    step: int | None,
    steps: str | None,
    group: str | None,
    speed: float,
    out: str | None,
    camera: tuple[float, float, float] | None,
    existing: str,
    quiet: bool,
    **view: Any,
) -> None:
    """Draw LOG again, without simulating.

    LOG is what `tparticles render SCENE --log` wrote. A step, a range of steps, slow motion between the logged steps, another
    camera, or another look by parameters of the scene (--set). Groups that are not in the log are not drawn.
    """
    if step is not None and steps is not None:
        raise InputError("--step and --range: one of them")
    if not (math.isfinite(speed) and 1e-4 <= speed <= 1e4):
        raise InputError(f"--speed {speed:g}: a number from 0.0001 to 10000 is needed")
    path = _free(
        Path(out) if out else Path(log).parent / (f"step-{step}.png" if step is not None else "replay.mp4"), existing
    )
    if (path.suffix == ".png") != (step is not None):
        raise InputError(f"--out {path}: a .png is one picture, of a --step")
    _check_suffix(path, (".mp4", ".png"), "a .mp4, a .png of a --step, or a folder is written")
    with stdout_kept():
        from ..output import check_film
        from .read import Log
        from .replay import Replay, View, write

        with Log(Path(log)) as opened:
            counted = opened.group(group)
            found = Replay(opened, View(position=camera, **view))
            times = found.times(counted, str(step) if step is not None else steps, speed)
            if path.suffix == ".mp4":
                check_film(fps=found.scene.fps, size=found.job.size, otherwise="a folder of pictures: --out FOLDER")

            def progress(done: int) -> None:
                if signals:
                    raise KeyboardInterrupt
                if not quiet and sys.stderr.isatty():
                    click.echo(f"\r{done}/{len(times)}", err=True, nl=done == len(times))

            write(found.pictures(times), path, fps=found.scene.fps, size=found.job.size, progress=progress)
    if not quiet:
        click.echo(
            f"{len(times)} picture{'' if len(times) == 1 else 's'}, t = {times[0]:.6g} to {times[-1]:.6g} s: {path}"
        )


@click.command()
@click.argument("log")
@click.option(
    "--of", "names", metavar="NAME,...", default="energy", show_default=True, help="energy, x, v, a, force, speed, T."
)
@click.option("--ids", metavar="0-9,20", default="0", show_default=True, help="Of which vertices, or particles.")
@click.option("--group", metavar="NAME", help="Of which group (default: the first mesh).")
@click.option("--range", "steps", metavar="A-B", help="These steps only; frames, of particles (default: all).")
@click.option("--out", metavar="FILE", help="A .png, .svg or .pdf (default: beside LOG).")
@_EXISTING
@click.option("--quiet", is_flag=True, help="No summary.")
def plot(
    log: str, *, names: str, ids: str, group: str | None, steps: str | None, out: str | None, existing: str, quiet: bool
) -> None:
    """Draw graphs of LOG over time.

    Energies [J] are of the whole mesh; the others are of the vertices or particles --ids. The force is what a vertex feels in all:
    springs, laws and contact.
    """
    wanted = [name.strip() for name in names.split(",")]
    path = _free(Path(out) if out else Path(log).parent / f"{'-'.join(wanted)}.png", existing)
    from .plot import draw
    from .read import Log, row_range
    from .series import series
    from .source import numbers

    with Log(Path(log)) as opened:
        chosen = opened.group(group)
        found = series(chosen, wanted, row_range(steps, chosen), numbers(ids))
        if len(found[0].time) < 2:
            raise InputError(f"one {chosen.unit} of '{chosen.name}' makes no graph over time: two are needed")
        draw(found, f"{opened.header['scene']}: {chosen.name}, {chosen.scheme}", path)
    if not quiet:
        click.echo(f"{len(found[0].time)} {chosen.unit}s of '{chosen.name}': {path}")


@click.command()
@click.argument("log")
@click.option("--to", "kind", metavar="csv|npz|ply|vtu|usd", required=True, help="The format.")
@click.option("--group", metavar="NAME", help="Which group (default: the first mesh).")
@click.option(
    "--range", "steps", metavar="A-B", help="These steps (frames, of particles): 100-200, 0-5000x10 (default: all)."
)
@click.option(
    "--out", metavar="FILE", help="Where to; for ply and vtu a folder (default: beside LOG, by the group's name)."
)
@click.option("--changed", is_flag=True, help="usd: take colours of the scene's script though it has changed since.")
@_EXISTING
@click.option("--quiet", is_flag=True, help="No summary.")
def export(
    log: str,
    *,
    kind: str,
    group: str | None,
    steps: str | None,
    out: str | None,
    changed: bool,
    existing: str,
    quiet: bool,
) -> None:
    """Write rows of LOG for other programs.

    csv for spreadsheets (energies in a second file), npz for NumPy, vtu for ParaView (a file for each step, and a .pvd that
    lists them), ply (a file for each step), usd for Blender and Houdini: points with ids, velocities, widths and display colours.
    """
    from .export import FORMATS, default_name

    if kind not in FORMATS:
        raise unknown("format", kind, FORMATS)
    from .export import export as write_files
    from .read import Log, row_range

    with stdout_kept(), Log(Path(log)) as opened:
        chosen = opened.group(group)
        rows = row_range(steps, chosen)
        path = _free(Path(out) if out else Path(log).parent / default_name(kind, chosen.name), existing)
        if kind in _SUFFIXES:
            _check_suffix(
                path, _SUFFIXES[kind], f"{kind} is written, {'a file' if _SUFFIXES[kind] else 'into a folder'}"
            )
        if kind == "usd":
            from .export_usd import export_usd
            from .replay import scene_of

            written = export_usd(scene_of(opened, changed=changed), chosen, rows, path)
        else:
            written = write_files(chosen, rows, kind, path)
    if not quiet:
        more = f" and {len(written) - 1} more" if len(written) > 1 else ""
        click.echo(f"{len(rows)} {chosen.unit}{'' if len(rows) == 1 else 's'} of '{chosen.name}': {written[-1]}{more}")
