"""The output folder: whose it is, and what may be replaced in it."""

from __future__ import annotations

import glob
import re
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from ..errors import InputError, unknown
from .files import FRAME_NAME, final_name, reason, temporary_path
from .lock import LOCK_NAME, locked
from .manifest import MANIFEST_NAME, read_manifest

CHECKPOINTS, SHARDS = "checkpoint", "shards"  # folders of what an unfinished run needs
EXISTING = ("error", "overwrite")


@contextmanager
def held_folder(path: str | Path, *, patience: float = 0.3) -> Iterator[None]:
    """Make the folder if need be and keep other processes out of it while the block runs.

    patience: how long to wait for another process to let go [s]; by default as long as one may look who holds it.
    Raises FolderBusyError, an InputError, that names the process which holds it; InputError if nothing can be written there.
    """
    path = Path(path)
    with ExitStack() as stack:
        try:
            if path.exists() and not path.is_dir():
                raise InputError(f"output folder {path} is a file: choose a folder with --out")
            if path.is_symlink() and not path.exists():
                raise InputError(f"output folder {path} is a link that leads nowhere: choose another with --out")
            path.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(path, patience=patience))
        except (OSError, ValueError) as error:
            why = reason(error) if isinstance(error, OSError) else error  # a NUL in the name
            raise InputError(f"cannot write into output folder {path}: {why}; choose another with --out") from error
        yield


def claim_folder(path: str | Path, *, scene: str, identity: str, existing: str = "error") -> None:
    """Make `path` a folder that a run may write into, or say why not.

    A folder that is absent, empty, or holds a run of the same scene and identity is taken as it is: rendering again
    gives the same files. A run of the same scene with another identity is an error unless `existing` is "overwrite";
    then the frames, states, films and log of that run are removed, and nothing else. Its run.json stays until the new one
    replaces it, so the folder is never without an owner. The folder of another scene, or one that holds files but no
    run.json, is never touched.

    scene: name of the scene; identity: hash of all that decides the pictures (scene, parameters, size, seed, ...).
    existing: "error" or "overwrite".
    Raises InputError with the reason and the way out.
    """
    path = Path(path)
    if existing not in EXISTING:
        raise unknown("value of --existing", existing, EXISTING)
    if not scene or scene in (".", "..") or re.search(r"[/\\\0]", scene):
        raise InputError(f"scene name {scene!r} cannot name a file")
    if "\0" in str(path):
        raise InputError(f"output folder {str(path)!r} cannot name a folder")
    try:
        if path.exists() and not path.is_dir():
            raise InputError(f"output folder {path} is a file: choose a folder with --out")
        path.mkdir(parents=True, exist_ok=True)
        _probe(path)
        names = sorted(e.name for e in path.iterdir() if final_name(e) is None and e.name not in (LOCK_NAME, SHARDS))
        if MANIFEST_NAME in names:
            _check_owner(path, scene, identity, existing)
        elif names:
            listed = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
            raise InputError(
                f"output folder {path} holds {listed} but no {MANIFEST_NAME}, so it is not ours: "
                "choose another folder with --out"
            )
    except OSError as error:
        raise InputError(
            f"cannot write into output folder {path}: {reason(error)}; choose another with --out"
        ) from error


def _check_owner(path: Path, scene: str, identity: str, existing: str) -> None:
    try:
        owner = read_manifest(path / MANIFEST_NAME)
    except InputError as error:
        raise InputError(f"output folder {path} is not known to be ours: {error}; choose another with --out") from error
    if owner["scene"] != scene:
        raise InputError(
            f"output folder {path} holds scene '{owner['scene']}', not '{scene}': choose another with --out"
        )
    if owner["identity"] == identity:
        return
    if existing != "overwrite":
        raise InputError(
            f"output folder {path} holds '{scene}' rendered with other parameters or settings, or by another version: "
            "replace it with --existing overwrite, or choose another with --out"
        )
    _remove_run(path, scene)


def _remove_run(path: Path, scene: str) -> None:
    """Remove what a run of `scene` wrote, and no other file. The run.json stays."""
    for folder, suffix in (("frames", ".png"), ("states", ".npz")):
        for file in (path / folder).glob(f"*{suffix}"):
            if re.fullmatch(FRAME_NAME + re.escape(suffix), file.name):
                file.unlink()
        with suppress(OSError):  # it holds files that are not ours, or is not there
            (path / folder).rmdir()
    shutil.rmtree(path / CHECKPOINTS, ignore_errors=True)
    for piece in path.glob("*.film"):
        piece.unlink()
    for log in ("log.h5", "log.unfinished.h5"):
        (path / log).unlink(missing_ok=True)
    # whole films, parts of films and what an interrupted run left of either
    for film in path.glob(f"{glob.escape(scene)}*.mp4"):
        if re.fullmatch(re.escape(scene) + r"(\.frames-[0-9x+-]+)?(\.partial)?\.mp4", film.name):
            film.unlink()


def _probe(folder: Path) -> None:
    """Write a file and remove it: permission bits say nothing to root or of a read-only file system. Raises OSError."""
    probe = temporary_path(folder / "probe")
    with open(probe, "xb"):
        pass
    probe.unlink()
