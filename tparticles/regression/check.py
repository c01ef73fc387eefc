"""Renders scenes small, holds them against their references, and replaces these where it is told to."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from .. import scene_files
from ..errors import InputError, TparticlesError
from . import reference
from .plan import NAME as PLANS_NAME
from .plan import Plan, read_plans
from .reference import Sheet, Shot
from .shoot import Take, shoot_all
from .verdict import Verdict, Word, judge

FOLDER = Path("renders/reference/check")


@dataclass(frozen=True)
class Cut:
    """One frame that was checked: its verdict, and the two pictures as far as there are any."""

    frame: int
    verdict: Verdict
    reference: np.ndarray | None = None
    new: np.ndarray | None = None


@dataclass(frozen=True)
class Outcome:
    """What came of a scene. `exact`: bits had to be equal. `notes`: what else changed, such as a parameter. `error` stopped it."""

    name: str
    plan: Plan
    seconds: float = 0.0
    exact: bool = False
    sheet: Sheet | None = None
    cuts: tuple[Cut, ...] = ()
    notes: tuple[str, ...] = ()
    error: TparticlesError | None = None
    updated: bool = False

    @property
    def word(self) -> Word:
        """The worst outcome of its frames."""
        if self.error is not None:
            return Word.FAILED
        order = list(Word)
        return max((cut.verdict.word for cut in self.cuts), key=order.index)

    @property
    def text(self) -> str:
        """What is wrong, in a line; empty where all is well."""
        if self.error is not None:
            return str(self.error)
        found = [(cut.frame, cut.verdict.text) for cut in self.cuts if not cut.verdict.word.passes]
        texts = list(dict.fromkeys(text for _, text in found))
        if len(texts) == 1 and len(found) == len(self.cuts):
            lines = texts
        else:
            lines = [f"frame {frame}: {text}" for frame, text in found[:1]]
            lines += [f"{len(found) - 1} more frames differ"] if len(found) > 1 else []
        return "; ".join([*(self.notes if found else ()), *lines])


@dataclass(frozen=True)
class Selection:
    """Which scenes are checked, with their plans, and where their references are. `unused`: what no scene needs."""

    folder: Path
    paths: dict[str, Path]
    plans: dict[str, Plan]
    unused: list[Path] = field(default_factory=list)


def select(scenes: Sequence[str], folder: Path) -> Selection:
    """Find the scenes, by name or path; without any, all of ./scenes.

    Raises:
        InputError: a scene that is not there, two of one name, a broken check.toml.
    """
    plans = read_plans(folder)
    paths: dict[str, Path] = {}
    for scene in scenes or scene_files.names():
        path = scene_files.find(scene)
        if paths.setdefault(path.stem, path) != path:
            raise InputError(f"two scenes are named '{path.stem}': {paths[path.stem]} and {path}; check one at a time")
    if not paths:
        raise InputError(f"no scenes in {scene_files.SCENES.resolve()}")
    # a scene that was named may live elsewhere: only a look at all of them tells what nobody needs
    unused = [] if scenes else _unused(folder, paths, plans)
    return Selection(folder, paths, {name: plans.get(name, Plan()) for name in paths}, unused)


def _unused(folder: Path, paths: Mapping[str, Path], plans: Mapping[str, Plan]) -> list[Path]:
    found = [path for path in sorted(folder.glob("*")) if path.name not in (*paths, PLANS_NAME)]
    found = [path for path in found if not path.name.startswith(".")]
    found += [folder / PLANS_NAME / f"[{name}]" for name in plans if name not in paths]
    for name in paths:
        try:
            sheet = reference.read(folder / name)
        except InputError:
            continue  # its scene tells
        found += reference.stray_pictures(folder / name, sheet) if sheet else []
    return found


def refuse_on_ci() -> None:
    """Raise InputError where references must not be made: nobody would look at them."""
    if os.environ.get("CI", "").lower() not in ("", "0", "false"):
        raise InputError(
            "references are not updated where CI is set: update them by hand, look at them, and commit them"
        )


def run(
    selection: Selection,
    *,
    arch: str,
    tolerant: bool,
    update: bool,
    done: Callable[[Outcome], None] = lambda outcome: None,
) -> list[Outcome]:
    """Check the scenes; call `done` with each outcome as it comes; return all, in the order of the selection.

    `tolerant`: do not ask for equal bits even where the reference is of this version and class of machine.
    `update`: replace the references of scenes that are not the same, after they were compared.

    Raises:
        InputError: an update where CI is set. RunError: a reference cannot be written.
    """
    if update:
        refuse_on_ci()
    found: dict[str, Outcome] = {}
    for name, take in shoot_all(selection.plans, selection.paths, arch=arch):
        folder = selection.folder / name
        outcome = _outcome(name, selection.plans[name], take, folder, tolerant)
        if update and take.sheet is not None and take.images is not None and not _fits(outcome, folder, take.sheet):
            reference.write(folder, take.sheet, dict(take.images))
            outcome = replace(outcome, updated=True)
        found[name] = outcome
        done(outcome)
    return [found[name] for name in selection.paths]


def _fits(outcome: Outcome, folder: Path, sheet: Sheet) -> bool:
    """Whether the references are as they would be written now."""
    try:
        return outcome.word == Word.SAME and reference.read(folder) == sheet
    except InputError:
        return False


def _outcome(name: str, plan: Plan, take: Take, folder: Path, tolerant: bool) -> Outcome:
    outcome = Outcome(name, plan, take.seconds, error=take.error, sheet=take.sheet)
    if take.sheet is None or take.images is None:
        return outcome
    try:
        old = reference.read(folder)
    except InputError as error:
        broken = Verdict(Word.BROKEN, str(error))
        return replace(outcome, cuts=_all(take, broken))
    if old is None:
        missing = Verdict(Word.MISSING, f"no reference in {folder}")
        return replace(outcome, cuts=_all(take, missing))
    exact = not tolerant and old.bits_of(take.sheet)
    cuts = tuple(_cuts(plan, take, old, folder, exact))
    return replace(outcome, exact=exact, cuts=cuts, notes=tuple(_notes(old, take.sheet)))


def _all(take: Take, verdict: Verdict) -> tuple[Cut, ...]:
    return tuple(Cut(frame, verdict, new=image) for frame, image in (take.images or {}).items())


def _cuts(plan: Plan, take: Take, old: Sheet, folder: Path, exact: bool) -> Iterator[Cut]:
    assert take.sheet is not None and take.images is not None
    for shot in take.sheet.shots:
        new = take.images[shot.frame]
        before = old.shot(shot.frame)
        if before is None:
            yield Cut(shot.frame, Verdict(Word.MISSING, f"no reference of frame {shot.frame} in {folder}"), new=new)
            continue
        yield _cut(plan, before, shot, old, folder, new, exact)
    for shot in old.shots:
        if shot.frame not in take.images:
            yield Cut(
                shot.frame, Verdict(Word.DIFFERENT, "the reference has this frame, and it is not rendered any more")
            )


def _cut(plan: Plan, before: Shot, shot: Shot, old: Sheet, folder: Path, new: np.ndarray, exact: bool) -> Cut:
    try:
        picture = reference.read_picture(folder, old, before)
    except InputError as error:
        return Cut(shot.frame, Verdict(Word.BROKEN, str(error)), new=new)
    verdict = judge(
        picture,
        new,
        plan.tolerance,
        reference_moments=before.moments,
        new_moments=shot.moments,
        exact=exact,
    )
    return Cut(shot.frame, verdict, picture, new)


def _notes(old: Sheet, new: Sheet) -> Iterator[str]:
    """Say what of the scene itself is not as it was, which may be why."""
    for key in old.scene.keys() | new.scene.keys():
        before, now = old.scene.get(key), new.scene.get(key)
        if before == now:
            continue
        if isinstance(before, dict) and isinstance(now, dict):
            changed = [k for k in before.keys() | now.keys() if before.get(k) != now.get(k)]
            yield from (f"{k} was {before.get(k)}, is {now.get(k)}" for k in sorted(changed))
        else:
            yield f"{key} was {before}, is {now}"
