"""How much a picture and a state may differ where bits need not be equal."""

from __future__ import annotations

import dataclasses
from typing import Annotated

from pydantic import Field

from ..errors import InputError
from ..spec import NonNegative, spec

TILE = 8  # [px] side of a tile
LARGE = 4  # [levels] from which on a pixel counts as changed
_Levels = Annotated[float, Field(ge=0, le=255, allow_inf_nan=False)]


@spec
class Tolerance:
    """The tolerant rule: what is allowed between a reference and a new frame of another version or kind of machine.

    `changed`: part of the pixels that may differ by more than 4 of 255 levels in a channel. `largest` [levels] of any channel.
    `mean` [levels] of the signed difference over the picture, `tile` [levels] over any tile of 8 x 8 pixels: a lost particle takes
    light from one place, whereas noise in the last bits cancels there. `count`: particles of a group; `moments`: relative, for
    mean position and spread (to the spread), temperature and kinetic energy. `reason`: why, where a limit is not the usual one.

    The limits lie between what is harmless and what is not, as measured on this project's scenes in 320x180
    (tests/regression/test_damages.py): in f64 or on Vulkan instead of f32 on a CPU a tile differs by 0.021 levels at most, with
    the faintest 0.1 % of the particles lost by 0.047 at least.

    Raises:
        InputError: a wrong value, or an unusual limit without a reason.
    """

    changed: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = 2e-4
    largest: _Levels = 8.0
    mean: _Levels = 2e-3
    tile: _Levels = 0.03
    count: Annotated[int, Field(ge=0)] = 0
    moments: NonNegative = 5e-5
    reason: str = ""

    def __post_init__(self) -> None:
        unusual = [
            f.name for f in dataclasses.fields(self) if f.name != "reason" and getattr(self, f.name) != f.default
        ]
        if unusual and not self.reason.strip():
            raise InputError(f"a tolerance with another {', '.join(unusual)} needs a written reason")


USUAL = Tolerance()
