"""Reports for tests: outcomes without a render, some of them with hostile words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from check_scenes import picture

from tparticles.errors import RunError
from tparticles.regression.check import Cut, Outcome, Selection
from tparticles.regression.plan import Plan
from tparticles.regression.reference import Sheet, Shot
from tparticles.regression.report import Report
from tparticles.regression.verdict import Verdict, Word, judge

HOSTILE = "</script><script>document.title='owned'</script><img src=x onerror=\"document.title='owned'\">'\"&{{7*7}}"


def plain() -> np.ndarray:
    """Return a picture that is green all over."""
    return np.full((36, 64, 3), (0, 200, 0), np.uint8)


def red() -> np.ndarray:
    """Return a picture that is red all over."""
    return np.full((36, 64, 3), (200, 0, 0), np.uint8)


def outcome(name: str, reference: np.ndarray | None, new: np.ndarray, **scene: object) -> Outcome:
    """Return what came of a scene with one frame."""
    facts = {"parameters": {"wind": 0.25, **scene}, "scheme": "rk4"}
    shots = (Shot(frame=1, sha256="", moments={}),)
    sheet = Sheet(made_with={"tparticles": "0"}, machine="here", size=(64, 36), scene=facts, shots=shots)
    missing = Verdict(Word.MISSING, f"no reference in {name}")
    verdict = missing if reference is None else judge(reference, new, Plan().tolerance)
    return Outcome(name, Plan(), 0.5, sheet=sheet, cuts=(Cut(1, verdict, reference, new),))


def outcomes() -> list[Outcome]:
    """Return one scene of each kind; those that pass come first."""
    return [
        outcome("as-it-was", picture(), picture()),
        outcome("changed", plain(), red()),
        outcome(HOSTILE, picture(1), picture(2), **{HOSTILE: HOSTILE}),
        outcome("new-scene", None, picture()),
        Outcome("broken-scene", Plan(), error=RunError(f"it died of {HOSTILE}")),
    ]


def write(folder: Path) -> Path:
    """Write a report; return its path."""
    selection = Selection(Path("references"), {}, {}, [Path("references/unused")])
    return Report(folder).write(outcomes(), selection, "tparticles check --update --")
