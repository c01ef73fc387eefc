"""What a new frame is beside its reference, in a word, a sentence and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from . import moments
from .metrics import Metrics, measure
from .tolerance import Tolerance


class Word(StrEnum):
    """The outcome. The first two pass."""

    SAME = "same"  # bit for bit
    CLOSE = "close"  # within the tolerance
    DIFFERENT = "different"
    MISSING = "missing"  # there is no reference
    BROKEN = "broken"  # the reference cannot be used
    FAILED = "failed"  # there is no new picture

    @property
    def passes(self) -> bool:
        """Whether nothing needs to be looked at."""
        return self in (Word.SAME, Word.CLOSE)


@dataclass(frozen=True)
class Verdict:
    """The outcome for one frame; `text` explains one that does not pass. `metrics` are there if both pictures were compared."""

    word: Word
    text: str = ""
    metrics: Metrics | None = None


def judge(
    reference: np.ndarray,
    new: np.ndarray,
    limits: Tolerance,
    *,
    reference_moments: Mapping[str, moments.Moments] | None = None,
    new_moments: Mapping[str, moments.Moments] | None = None,
    exact: bool = False,
) -> Verdict:
    """Compare a picture with its reference, and, where both have moments, the physics behind it.

    `exact`: every pixel must be the same.
    """
    if reference.shape != new.shape:
        return Verdict(Word.DIFFERENT, f"the picture is {_size(new)}, its reference {_size(reference)}")
    metrics = measure(reference, new)
    picture = metrics.faults(limits)
    if exact and not picture and metrics.different:
        picture = [f"{metrics.different:.3%} of the pixels differ, by {metrics.largest}/255 at most, and none may"]
    known = reference_moments is not None and new_moments is not None
    physics = moments.faults(reference_moments or {}, new_moments or {}, limits) if known else []
    if not (picture or physics):
        return Verdict(Word.CLOSE if metrics.different else Word.SAME, metrics=metrics)
    return Verdict(Word.DIFFERENT, _sentence(physics, picture, known), metrics)


def _sentence(physics: list[str], picture: list[str], known: bool) -> str:
    if physics and picture:
        head = "physics and picture changed"
    elif physics:
        head = "the physics changed, the picture did not"
    else:
        head = "the picture changed" + (", the physics did not" if known else "")
    return f"{head}: {'; '.join(physics + picture)}"


def _size(image: np.ndarray) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"
