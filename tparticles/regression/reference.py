"""References on disk: a folder for each scene, with a PNG for each frame and a `reference.json` that tells what they are of."""

from __future__ import annotations

import dataclasses
import json
import platform
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from .. import __version__
from ..errors import InputError, RunError
from ..output import encode_png, jsonable, pixel_hash
from ..output.files import atomic_file, frame_path, open_folder, reason
from ..spec import explain, spec
from .pictures import read_png

NAME = "reference.json"
_MOST_BYTES = 1 << 24
_COMPRESSION = 9


@spec
class Shot:
    """What is known of one frame. `moments`: by group, see `moments.moments`."""

    frame: Annotated[int, Field(ge=1)]
    sha256: str
    moments: dict[str, dict[str, int | float | list[float]]]


@spec
class Sheet:
    """What a `reference.json` holds. `made_with`: versions; `machine`: its class; `scene`: what was rendered, for the report."""

    made_with: dict[str, str]
    machine: str
    size: tuple[int, int]
    scene: dict[str, Any]
    shots: tuple[Shot, ...]

    def shot(self, frame: int) -> Shot | None:
        """Return the shot of a frame."""
        return next((shot for shot in self.shots if shot.frame == frame), None)

    def bits_of(self, other: Sheet) -> bool:
        """Whether the two were made by the same versions on the same class of machine, so that bits must be equal."""
        return (self.made_with, self.machine) == (other.made_with, other.machine)


_SHEET = TypeAdapter(Sheet)


def versions() -> dict[str, str]:
    """Return the versions of all that decides a picture's bits."""
    return {"tparticles": __version__} | {name: version(name) for name in ("taichi", "numpy")}


def machine_class(arch: str, *, solver: str = "") -> str:
    """Return the class of this machine: on one class the same version gives the same bits.

    System, processor with its widest vectors (code is compiled for them), C library (for its functions), architecture of Taichi,
    and the linear solver of implicit meshes, where there are some.
    """
    libc = "".join(platform.libc_ver())
    parts = (sys.platform, platform.machine(), _vectors(), libc, arch, solver)
    return "-".join(part.lower() for part in parts if part)


def _vectors() -> str:
    try:
        flags = Path("/proc/cpuinfo").read_text().split()
    except OSError:
        return ""
    return next((name for name in ("avx512f", "avx2", "avx", "sve") if name in flags), "")


def read(folder: Path) -> Sheet | None:
    """Return the sheet of a scene's references; None where there is none.

    Raises:
        InputError: it cannot be read, is cut, or holds something else.
    """
    path = folder / NAME
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InputError(f"{path} is larger than {_MOST_BYTES >> 20} MiB: it is no reference")
        return _SHEET.validate_json(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {reason(error).lower()}") from None
    except ValidationError as error:
        raise InputError(f"{path} is broken: {explain(error, 'reference')}") from None


def read_picture(folder: Path, sheet: Sheet, shot: Shot) -> np.ndarray:
    """Return the picture of a shot.

    Raises:
        InputError: see `read_png`; or its pixels are not those that the sheet tells of.
    """
    path = frame_path(folder, shot.frame, ".png")
    image = read_png(path, size=sheet.size)
    if pixel_hash(image) != shot.sha256:
        raise InputError(f"{path} is not the picture that {NAME} tells of")
    return image


def write(folder: Path, sheet: Sheet, images: dict[int, np.ndarray]) -> list[Path]:
    """Write references; pictures first, then the sheet, then remove pictures of other frames. Return what was written.

    A folder that a killed process left between is told from a whole one: hashes do not fit.
    Raises RunError where a file cannot be written.
    """
    text = json.dumps(jsonable(dataclasses.asdict(sheet)), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    paths = {n: frame_path(folder, n, ".png") for n in images}
    contents = [(paths[n], encode_png(image, {}, compress_level=_COMPRESSION)) for n, image in images.items()]
    open_folder(folder, r".+\.(png|json)")
    for path, data in [*contents, (folder / NAME, text.encode())]:
        write_file(path, data)
    for path in stray_pictures(folder, sheet):
        path.unlink()
    return [*paths.values(), folder / NAME]


def write_file(path: Path, data: bytes) -> None:
    """Write a file that is whole or not there. Raises RunError with the reason."""
    try:
        with atomic_file(path) as file:
            file.write(data)
    except OSError as error:
        raise RunError(f"cannot write {path}: {reason(error).lower()}") from error


def stray_pictures(folder: Path, sheet: Sheet) -> list[Path]:
    """Return the PNG files in a scene's folder that its sheet does not name."""
    named = {frame_path(folder, shot.frame, ".png") for shot in sheet.shots}
    return sorted(path for path in folder.glob("*.png") if path not in named)
