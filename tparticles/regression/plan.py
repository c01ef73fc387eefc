"""What is rendered of a scene to check it: a size, a few frames, parameters that keep it short; and its tolerance."""

from __future__ import annotations

import tomllib
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ..errors import InputError
from ..output.files import reason
from ..spec import spec
from .tolerance import USUAL, Tolerance

NAME = "check.toml"
_WIDTH = 320  # [px]
_SECONDS = (0.0, 1.0, 2.0)  # of film time
_Side = Annotated[int, Field(ge=1, le=4096)]
_Frame = Annotated[int, Field(ge=1)]


@spec
class Plan:
    """How a scene is checked; by default 320 pixels wide in its own shape, its first frame and those at 1 s and 2 s.

    `set`: parameters of the scene, by name. `tolerance`: see `Tolerance`; one that is not the usual needs its `reason`.
    """

    size: tuple[_Side, _Side] | None = None
    frames: Annotated[tuple[_Frame, ...], BeforeValidator(lambda v: tuple(v) if isinstance(v, list) else v)] = ()
    set: dict[str, Any] = field(default_factory=dict)
    tolerance: Tolerance = USUAL

    def __post_init__(self) -> None:
        if any(b <= a for a, b in zip(self.frames, self.frames[1:], strict=False)):
            raise InputError(f"frames = {list(self.frames)}: must rise")

    def picture_size(self, full: tuple[int, int]) -> tuple[int, int]:
        """Return the size to draw a scene in that is `full` at its own."""
        return self.size or (_WIDTH, max(1, round(_WIDTH * full[1] / full[0])))

    def frame_numbers(self, *, count: int, fps: float) -> tuple[int, ...]:
        """Return the frames to draw of a film of `count` frames."""
        if self.frames:
            return self.frames
        return tuple(sorted({min(count, max(1, round(t * fps))) for t in _SECONDS}))


def read_plans(folder: Path) -> dict[str, Plan]:
    """Return the plans that `check.toml` in the folder of references gives, by scene; none where there is no such file.

    Raises:
        InputError: it cannot be read, or a table is wrong; says which.
    """
    path = folder / NAME
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except OSError as error:
        raise InputError(f"{path} cannot be read: {reason(error).lower()}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: {error}") from None
    return {name: _plan(table, f"{path}, [{name}]") for name, table in tables.items()}


def _plan(table: Any, where: str) -> Plan:
    try:
        if not isinstance(table, dict):
            raise InputError("a table with size, frames, set or tolerance is needed")
        limits = table.get("tolerance", {})
        if not isinstance(limits, dict):
            raise InputError("tolerance must be a table of limits with their reason")
        options: dict[str, Any] = {**table, "tolerance": Tolerance(**limits)}
        return Plan(**options)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
