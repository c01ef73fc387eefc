"""The report: one HTML file that shows what changed, without anything from elsewhere."""

from __future__ import annotations

import base64
import hashlib
import shlex
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, RunError
from ..output import encode_png
from ..output.files import open_folder
from .check import Cut, Outcome, Selection
from .metrics import difference
from .plan import Plan
from .reference import write_file
from .verdict import Word

NAME = "index.html"
_INSTALL = "pip install 'tparticles[regression]'"
_GAINS = 8, 64  # of the amplified difference: at least, at most


class Report:
    """Writes `folder/index.html`.

    Raises:
        InputError: jinja2 is missing, or the folder cannot be used.
    """

    def __init__(self, folder: Path):
        try:
            import jinja2
        except ImportError:
            raise InputError(f"--report needs jinja2: {_INSTALL}") from None
        self._environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
        self.folder = folder
        try:
            open_folder(folder, NAME.replace(".", r"\."))
            write_file(folder / ".probe", b"")  # permission bits say nothing to root or of a read-only file system
            (folder / ".probe").unlink()
        except RunError as error:
            raise InputError(f"{error}; choose another with --report") from None
        self._flip = _flip()

    def write(self, outcomes: Sequence[Outcome], selection: Selection, command: str) -> Path:
        """Write the page; `command` updates the references if a scene's name is added. Return its path.

        Raises:
            RunError: it cannot be written.
        """
        cards = [card for outcome in outcomes for card in self._cards(outcome, command)]
        cards.sort(key=lambda card: card["passes"])
        style, script = _part("report.css"), _part("report.js")
        sheet = next((outcome.sheet for outcome in outcomes if outcome.sheet), None)
        unused = [f"{path} is used by no scene: remove it" for path in selection.unused]
        text = self._environment.from_string(_part("report.html")).render(
            cards=cards,
            failures=sum(not card["passes"] for card in cards),
            made_with=", ".join(f"{k} {v}" for k, v in sheet.made_with.items()) if sheet else "no scene was rendered",
            machine=sheet.machine if sheet else "this machine",
            notes=[*([] if self._flip else [f"No perceptual difference: {_INSTALL} brings NVIDIA FLIP."]), *unused],
            style=style,
            script=script,
            style_hash=_csp_hash(style),
            script_hash=_csp_hash(script),
        )
        # a lone surrogate of a file's name has no UTF-8
        write_file(self.folder / NAME, text.encode("utf-8", "backslashreplace"))
        return self.folder / NAME

    def _cards(self, outcome: Outcome, command: str) -> Iterator[dict[str, Any]]:
        common = {
            "scene": outcome.name,
            "notes": [*outcome.notes, *([outcome.plan.tolerance.reason] if outcome.plan.tolerance.reason else [])],
            "facts": _facts(outcome),
            "command": f"{command} {shlex.quote(outcome.name)}",
        }
        if outcome.error is not None:
            text = str(outcome.error)
            empty = {"pictures": [], "metrics": [], "both": False, "frame": None}
            yield common | empty | {"word": str(Word.FAILED), "passes": False, "text": text, "reasons": []}
        for cut in outcome.cuts:
            text, reasons = _reasons(cut.verdict.text)
            yield common | {
                "frame": cut.frame,
                "word": str(cut.verdict.word),
                "passes": cut.verdict.word.passes,
                "text": text,
                "reasons": reasons,
                "both": cut.reference is not None and cut.new is not None,
                "pictures": list(self._pictures(cut)),
                "metrics": _metrics(cut, outcome.plan),
            }

    def _pictures(self, cut: Cut) -> Iterator[dict[str, Any]]:
        old, new = cut.reference, cut.new
        if old is not None:
            yield _picture("reference", "Reference", old)
        if new is not None:
            yield _picture("new", "New", new)
        if old is None or new is None or old.shape != new.shape:
            return
        size = np.abs(difference(old, new))
        gain = min(_GAINS[1], max(_GAINS[0], 255 // max(1, int(size.max()))))
        yield _picture("difference", f"Difference, {gain} times", np.minimum(size * gain, 255).astype(np.uint8))
        if self._flip:
            error, mean = self._flip(old, new)
            yield _picture("flip", f"FLIP, mean {mean:.4f}", error)


def _flip() -> Any:
    """Return NVIDIA FLIP (Andersson et al. 2020) as a function of two pictures, or None where it is not installed."""
    try:
        from flip_evaluator import evaluate
    except ImportError:
        return None

    def flip(reference: np.ndarray, new: np.ndarray) -> tuple[np.ndarray, float]:
        error, mean, _ = evaluate(reference / np.float32(255), new / np.float32(255), "LDR")
        return np.clip(np.rint(np.asarray(error) * 255), 0, 255).astype(np.uint8), float(mean)

    return flip


def _picture(kind: str, label: str, image: np.ndarray) -> dict[str, Any]:
    data = base64.b64encode(encode_png(image, {}, compress_level=6)).decode()
    height, width, _ = image.shape
    return {"kind": kind, "label": label, "source": f"data:image/png;base64,{data}", "width": width, "height": height}


def _metrics(cut: Cut, plan: Plan) -> list[tuple[str, str, str]]:
    found, limits = cut.verdict.metrics, plan.tolerance
    if found is None:
        return []
    return [
        ("pixels that differ", f"{found.different:.3%}", ""),
        ("by more than 4 levels", f"{found.changed:.3%}", f"{limits.changed:.3%}"),
        ("largest", f"{found.largest}", f"{limits.largest:g}"),
        ("signed mean", f"{found.mean:+.5f}", f"{limits.mean:g}"),
        ("signed mean of the worst tile", f"{found.tile:.4f}", f"{limits.tile:g}"),
    ]


def _reasons(text: str) -> tuple[str, list[str]]:
    """Return what is said of a frame, and apart the reasons where there are several."""
    said, _, rest = text.partition(": ")
    reasons = rest.split("; ")
    return (said, reasons) if len(reasons) > 1 else (text, [])


def _facts(outcome: Outcome) -> list[tuple[str, Any]]:
    scene = {} if outcome.sheet is None else dict(outcome.sheet.scene)
    rows = {**scene.pop("parameters", {}), **scene}
    size = [("size", "x".join(map(str, outcome.sheet.size)))] if outcome.sheet else []
    how = "bit for bit" if outcome.exact else "within the tolerance"
    return [*rows.items(), *size, ("compared", how), ("seconds", f"{outcome.seconds:.1f}")]


def _part(name: str) -> str:
    return resources.files("tparticles.regression").joinpath("page", name).read_text(encoding="utf-8")


def _csp_hash(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
