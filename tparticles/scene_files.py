"""The files of scenes: find them by name or path.

A name is looked up in ./scenes: NAME.py first, then NAME.toml and NAME.json (see `data_scene`), so that a script and a document of
one name can lie side by side; the document is then taken by its path.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .data_scene.files import SUFFIXES
from .errors import InputError, unknown

SCENES = Path("scenes")
DATA = SCENES / "data"  # the scripts of ./scenes written as data
_SUFFIXES = (".py", *SUFFIXES)
_LONGEST = 300  # characters shown of what was asked for


def find(scene: str) -> Path:
    """Return the path of a scene: a file, or a name in ./scenes, where a script comes before a document.

    Raises:
        InputError: there is none; the nearest name is suggested.
    """
    path = Path(scene)
    try:
        if path.suffix not in _SUFFIXES and len(path.parts) < 2:
            found = [p for p in (SCENES / f"{scene}{suffix}" for suffix in _SUFFIXES) if p.is_file()]
            if found and scene:
                return found[0].resolve()
            if not path.is_file():
                raise _unknown_scene(scene)
        if path.is_dir():
            raise InputError(
                f"scene '{scene}' is a folder: a Python, TOML or JSON file or a name in {SCENES}/ is needed"
            )
        if not path.is_file():
            near = next((f"{scene}{s}" for s in _SUFFIXES if Path(f"{scene}{s}").is_file()), "")
            raise InputError(f"scene file '{scene}' does not exist" + (f"; did you mean '{near}'?" if near else ""))
        if path.suffix not in _SUFFIXES:
            raise InputError(f"'{scene}' is no scene: a .py, .toml or .json file, or a name in {SCENES}/, is needed")
    except (OSError, ValueError) as error:  # too long, NUL, no permission
        shown = scene if len(scene) <= _LONGEST else scene[:_LONGEST] + "..."
        raise InputError(f"scene '{shown}' cannot be read: {getattr(error, 'strerror', None) or error}") from None
    return path.resolve()


def _unknown_scene(scene: str) -> InputError:
    """Build the error for a name that nothing in ./scenes has; where nothing is in there, it says where that is."""
    found = names()
    if found or not scene:
        return unknown("scene", scene, found)
    folder = SCENES.resolve()
    return InputError(
        f"unknown scene '{scene}': {'no scene is in' if folder.is_dir() else 'there is no folder'} {folder}; "
        "give the path of a .py, .toml or .json file, or change to the folder that has scenes/"
    )


def names() -> list[str]:
    """Return the names of the scenes in ./scenes."""
    return sorted(named())


def named(suffixes: Sequence[str] = _SUFFIXES) -> dict[str, Path]:
    """Return the scenes in ./scenes by name; of several files of one name the one whose suffix comes first."""
    found: dict[str, Path] = {}
    for suffix in suffixes:
        for path in SCENES.glob(f"*{suffix}"):
            if not path.stem.startswith("_"):
                found.setdefault(path.stem, path)
    return found
