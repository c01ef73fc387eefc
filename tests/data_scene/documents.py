"""Documents for the tests of data scenes."""

from __future__ import annotations

import copy
from functools import cache
from pathlib import Path
from typing import Any

from tparticles import library
from tparticles.errors import InputError

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted((ROOT / "scenes").glob("*.py"))
TWINS = sorted((ROOT / "scenes" / "data").glob("*.toml"))

TINY = """summary = "A tiny film."
duration = 0.25
size = [64, 36]
seed = 1
shutter = 0
scheme = "midpoint"

[camera]
position = [0, -5, 0]
target = [0, 0, 0]

[[groups]]
name = "dots"
system = { kind = "Advected", flow = { kind = "Vortex", axis = [0, 1, 0], circulation = 20, core = 0.4 } }
appearance = { kind = "Ramp", colors = [[1, 0.6, 0.2]], span = 1 }

[[groups.emitters]]
births = { kind = "Rate", rate = 60 }
shape = { kind = "Sphere", radius = 1 }
size = 0.2
preroll = 0.25
"""

SCRIPT = '''"""A tiny script."""
import tparticles as tp


def scene(quality, *, rate: float = 60.0, count: int = 1, note: str = "", seed: int = 1):
    group = tp.Group(
        name="dots",
        system=tp.Advected(flow=tp.Vortex(axis=(0.0, 1.0, 0.0), circulation=20.0, core=0.4)),
        emitters=tp.Emitter(births=tp.Rate(rate=rate), shape=tp.Sphere(radius=1.0), size=0.2, preroll=0.25),
        appearance=tp.Ramp(colors=((1.0, 0.6, 0.2),), span=1.0),
    )
    camera = tp.Camera(position=(0.0, -5.0, 0.0), target=(0.0, 0.0, 0.0))
    return tp.Scene(
        groups=group, camera=camera, duration=0.25, size=(64, 36), seed=seed, shutter=0.0, scheme="midpoint"
    )
'''


FEW = {  # what keeps a scene short
    "swirl": {"count": 20_000},
    "cloth_drop": {"count": 16},
    "flag": {"count": 12},
    "jelly": {"count": 6},
    "rope_bridge": {"planks": 8, "ratio": 1e3},
}


def tiny(**changes: Any) -> dict[str, Any]:
    """Return the document of `TINY`; a change is a path with dots as double underscores, groups__0__name."""
    from tparticles.data_scene.files import parse

    document = copy.deepcopy(parse(TINY, ".toml"))
    for path, value in changes.items():
        *way, last = [int(part) if part.isdigit() else part for part in path.split("__")]
        place: Any = document
        for part in way:
            place = place[part]
        place[last] = value
    return document


@cache
def of_its_own(path: Path) -> str:
    """Return why a script has no data scene, an empty text if it has one."""
    from tparticles.describe import toml

    try:
        toml(str(path), settings=FEW.get(path.stem, {}), quality="final")
    except InputError as error:
        return str(error)
    return ""


def built(path: Path, quality: str = "final", **settings: Any) -> Any:
    """Return the scene of a file."""
    return library.load(str(path)).build(quality=quality, settings=settings)
