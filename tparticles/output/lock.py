"""One writer per folder: a lock that the system takes back from a dead process."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
import time
from collections.abc import Iterator
from pathlib import Path

from ..errors import InputError

try:
    import fcntl
except ImportError:  # no POSIX: folders are not locked there
    fcntl = None  # type: ignore[assignment]

LOCK_NAME = ".tparticles.lock"
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # of a file system that has none
_WAIT = 0.1  # [s]


class FolderBusyError(InputError):
    """Another process writes into the folder."""


@contextlib.contextmanager
def locked(folder: Path, *, patience: float = 0.0) -> Iterator[None]:
    """Hold the lock of a folder that exists; the file that carries it is gone afterwards.

    The lock is the system's, not the file: of a process that was killed only the file stays, and the next one takes it over.

    patience: how long to wait for another process to let go [s].
    Raises FolderBusyError naming the process that holds it; OSError if the file cannot be made.
    """
    path = folder / LOCK_NAME
    deadline = time.monotonic() + patience
    while (file := _acquire(path)) is None:
        if time.monotonic() >= deadline:
            raise FolderBusyError(
                f"folder {folder} is being written by {_owner(path)}: wait for it, or choose another folder with --out"
            )
        time.sleep(_WAIT)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()  # before it is let go: whoever waits for this file finds it gone and makes a new one
        os.close(file)


def holder(folder: Path) -> str | None:
    """Return who holds the lock of a folder, such as `process 123`, or None if nobody does."""
    path = folder / LOCK_NAME
    try:
        file = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        return None if _lock(file) else _owner(path)
    finally:
        os.close(file)


def _acquire(path: Path) -> int | None:
    """Return the open lock file, ours now, or None if it is another's."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            if not _lock(file):
                os.close(file)
                return None
            if _is_at(file, path):
                os.ftruncate(file, 0)
                os.pwrite(file, f"{os.getpid()} {socket.gethostname()}\n".encode(), 0)
                return file
        except BaseException:
            os.close(file)
            raise
        os.close(file)  # its last owner removed it while we waited


def _lock(file: int) -> bool:
    """Try to lock an open file; False if another has it."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return True
        if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
            raise
        return False
    return True


def _is_at(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def _owner(path: Path) -> str:
    """Return the words for who wrote the lock file."""
    text = ""
    with contextlib.suppress(OSError):
        text = path.read_text(errors="replace")[:300]
    found = re.fullmatch(r"([0-9]+) ([\w.-]+)\n", text)
    if not found:
        return "another process"
    return f"process {found[1]}" + ("" if found[2] == socket.gethostname() else f" on {found[2]}")
