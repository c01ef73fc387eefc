"""Results to files: JSON and CSV always, a picture where matplotlib is there. Each file is whole or not there."""

from __future__ import annotations

import csv
import dataclasses
import importlib.util
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from .. import __version__
from ..errors import InputError, RunError
from ..output import jsonable
from ..output.files import atomic_file, open_folder, reason

INSTALL = "no pictures: matplotlib is missing; install it with: pip install 'tparticles[studies]'"
_DPI = 110


class Result(Protocol):
    """What a study returns: a dataclass of plain data."""

    def rows(self) -> list[dict[str, object]]:
        """Return the rows of its CSV."""
        ...


def document(study: str, result: Any) -> dict[str, Any]:
    """Return a result as one JSON document."""
    return {"study": study, "version": __version__, **jsonable(dataclasses.asdict(result))}


def claim(folder: Path, study: str) -> None:
    """Make the folder, before the study runs.

    Raises InputError where it is a file or cannot be made.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"output folder {folder} is a file: choose a folder with --out")
    try:
        open_folder(folder, rf"{study}(-\w+)?\.(json|csv|png)")
    except RunError as error:
        raise InputError(f"{error}; choose another with --out") from error


def write(folder: Path, study: str, result: Any, pictures: Mapping[str, Callable[[Any], Any]]) -> list[Path]:
    """Write `study`.json, `study`.csv and a .png for each of the pictures; return the paths.

    `pictures`: by file name, the functions that draw the result; without matplotlib none is drawn. Results of the same study that
    are there already are replaced.
    Raises RunError where a file cannot be written.
    """
    contents: list[tuple[str, Callable[[], bytes]]] = [
        (f"{study}.json", lambda: json.dumps(document(study, result), allow_nan=False).encode() + b"\n"),
        (f"{study}.csv", lambda: as_csv(result.rows()).encode()),
    ]
    if has_matplotlib():
        contents += [(f"{name}.png", lambda draw=draw: _png(draw, result)) for name, draw in pictures.items()]
    written = []
    for name, content in contents:
        try:
            with atomic_file(folder / name) as file:
                file.write(content())
        except OSError as error:
            raise RunError(f"cannot write {folder / name}: {reason(error)}") from error
        written.append(folder / name)
    return written


def has_matplotlib() -> bool:
    """Whether pictures can be drawn."""
    try:
        return importlib.util.find_spec("matplotlib") is not None
    except ValueError:  # it was kept out on purpose
        return False


def as_csv(rows: Sequence[Mapping[str, object]]) -> str:
    """Return rows as CSV with a line of names; what is no number is left empty, infinity is `inf`."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(rows[0] if rows else ())
    writer.writerows([_cell(value) for value in row.values()] for row in rows)
    return out.getvalue()


def _cell(value: object) -> object:
    if isinstance(value, float):
        return "" if value != value else f"{value:.10g}"
    return value


def table(rows: Iterable[Sequence[object]]) -> str:
    """Return rows as aligned columns: the first to the left, the others to the right."""
    texts = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in texts
    )


def _png(draw: Callable[[Any], Any], result: Any) -> bytes:
    from . import style

    out = io.BytesIO()
    with style.look():
        # Without the version that matplotlib would write, the same data give the same file.
        draw(result).savefig(out, format="png", dpi=_DPI, metadata={"Software": None})
    return out.getvalue()
