"""The commands `tparticles check` and `tparticles compare`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..command_options import JSON, print_json, stdout_kept
from ..errors import InputError, MismatchError, TparticlesError

if TYPE_CHECKING:
    from .check import Outcome

_FOLDER = "renders/reference/check"
_LONGEST = 400  # characters of a scene's line; the JSON and the report hold all


@click.command()
@click.argument("scenes", metavar="[SCENE ...]", nargs=-1)
@click.option("--update", is_flag=True, help="Replace the references that are not the same. Refused where CI is set.")
@click.option("--report", metavar="DIR", help="Write DIR/index.html, one file that shows what changed.")
@click.option("--references", metavar="DIR", default=_FOLDER, show_default=True, help="Where the references are.")
@click.option(
    "--tolerant",
    is_flag=True,
    help="Ask for no equal bits, even where the reference is of the same version and class of machine.",
)
@click.option("--arch", metavar="auto|cpu|cuda|vulkan", default="cpu", show_default=True, help="What to render on.")
@JSON
def check(
    scenes: Sequence[str],
    update: bool,
    report: str | None,
    references: str,
    tolerant: bool,
    arch: str,
    as_json: bool,
) -> None:
    """Render scenes small and compare with references.

    All of ./scenes if none is named. References of this version and class of machine must be equal bit for bit; others are held
    to limits that let the last bits differ and find a lost particle. Moments of the state (count, mean position, temperature,
    energy) tell a change of physics from one of the picture. DIR/check.toml of the references sets size, frames, set (parameters)
    and tolerance of a scene, where the rule (320 pixels wide, the first frame and those at 1 s and 2 s) does not fit.

    Exit code 4 where something differs or has no reference.
    """
    from .check import refuse_on_ci, run, select

    if update:
        refuse_on_ci()
    _check_arch(arch)
    page = _page(report)
    with stdout_kept():
        selection = select(scenes, _folder("--references", references))
        command = _update_command(references)
        outcomes = run(selection, arch=arch, tolerant=tolerant, update=update, done=_told)
        written = None if page is None else page(outcomes, selection, command)
    result: dict[str, Any] = {
        "status": "done",
        "scenes": [_row(outcome) for outcome in outcomes],
        "unused": [str(path) for path in selection.unused],
        "report": written and str(written),
    }
    if not as_json:
        for outcome in outcomes:
            click.echo(_line(outcome))
        for path in selection.unused:
            click.echo(f"unused     {path}: no scene needs it; remove it")
        if written:
            click.echo(f"report     {written}")
    _leave(outcomes, command, result, updated=update)
    if as_json:
        print_json(result)


def _check_arch(arch: str) -> None:
    from typing import get_args

    from ..backend import Arch
    from ..errors import unknown

    if arch not in get_args(Arch):
        raise unknown("arch", arch, get_args(Arch))


def _folder(option: str, value: str) -> Path:
    if not value.strip() or "\0" in value:
        raise InputError(f"{option} is empty: name a folder")
    path = Path(value)
    if path.exists() and not path.is_dir():
        raise InputError(f"{option} {value} is a file: name a folder")
    return path


def _page(report: str | None) -> Any:
    """Return what writes the report, or None; what it needs is looked for before anything is rendered."""
    if report is None:
        return None
    from .report import Report

    return Report(_folder("--report", report)).write


def _told(outcome: Outcome) -> None:
    click.echo(f"{outcome.name}: checked in {outcome.seconds:.1f} s", err=True)


def _line(outcome: Outcome) -> str:
    """Return a scene's line."""
    word = "updated" if outcome.updated else str(outcome.word)
    frames = f"{len(outcome.cuts)} frame{'' if len(outcome.cuts) == 1 else 's'}"
    how = "bit for bit" if outcome.word == "same" else "within the tolerance"
    text = outcome.text or f"{frames}, {how}"
    return f"{word:10} {outcome.name}: {text if len(text) <= _LONGEST else text[:_LONGEST] + ' ...'}"


def _row(outcome: Outcome) -> dict[str, Any]:
    """Return a scene's part of the JSON."""
    frames = [
        {
            "frame": cut.frame,
            "outcome": str(cut.verdict.word),
            "message": cut.verdict.text,
            "metrics": cut.verdict.metrics and cut.verdict.metrics.row(),
        }
        for cut in outcome.cuts
    ]
    return {
        "scene": outcome.name,
        "outcome": str(outcome.word),
        "exact": outcome.exact,
        "message": outcome.text,
        "updated": outcome.updated,
        "seconds": outcome.seconds,
        "frames": frames,
    }


def _update_command(references: str) -> str:
    """Return the command that updates, but for the scenes' names."""
    where = [] if references == _FOLDER else ["--references", references]
    return shlex.join(["tparticles", "check", "--update", *where, "--"])


def _leave(outcomes: Sequence[Outcome], command: str, result: dict[str, Any], *, updated: bool) -> None:
    """Raise what the exit code is to tell: first of all a difference, then what kept a scene from being rendered."""
    wrong = [o for o in outcomes if not o.word.passes and not (updated and o.updated)]
    compared = [o for o in wrong if o.error is None]
    if compared:
        names = " ".join(shlex.quote(o.name) for o in compared)
        text = f"{len(compared)} of {len(outcomes)} scenes are not as their references; if they should be: {command} {names}"
        raise MismatchError(text, result)
    if wrong:
        error = wrong[0].error
        assert isinstance(error, TparticlesError)
        raise type(error)(f"{wrong[0].name}: {error}")


@click.command()
@click.argument("first", metavar="A")
@click.argument("second", metavar="B")
@JSON
def compare(first: str, second: str, as_json: bool) -> None:
    """Compare two pictures, folders of frames, or films.

    A is the reference. Pictures are PNG, films MP4; frames of folders belong together by name. The limits are those of
    `tparticles check`. Exit code 4 where something differs.
    """
    from .compare import pairs, summary

    rows = [pair.row() for pair in pairs(Path(first), Path(second))]
    different = [row for row in rows if row["outcome"] not in ("same", "close")]
    result = {"status": "done", "a": first, "b": second, "pictures": rows}
    if not as_json:
        for line in summary(rows):
            click.echo(line)
    if different:
        count = f"{len(different)} of {len(rows)} pictures" if len(rows) > 1 else "the picture"
        verb = "differ" if len(different) > 1 else "differs"
        raise MismatchError(f"{count} of {second} {verb} from {first}", result)
    if as_json:
        print_json(result)
