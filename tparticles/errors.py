"""One hierarchy of errors. Each says what is wrong, where, and what is allowed; the exit code is the kind.

Everything the program raises on purpose derives from `TparticlesError`, so the command line can print one line
and leave with `exit_code`; anything else is a bug and keeps its traceback.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any


class TparticlesError(Exception):
    """Base of every deliberate error. `exit_code` is what the command line leaves with."""

    exit_code = 1


class RunError(TparticlesError):
    """Failed while running: NaN, blow-up, overflow, a full disk, a dead encoder. Exit code 1."""


class InputError(TparticlesError):
    """Bad input: a scene, a parameter, an option, a path. Exit code 2."""

    exit_code = 2


class BackendError(TparticlesError):
    """The machine cannot do what was asked for: an architecture, a precision. Exit code 3."""

    exit_code = 3


class MismatchError(TparticlesError):
    """What was made is not what the reference shows. Exit code 4; `details` is what --json tells of it."""

    exit_code = 4

    def __init__(self, message: str, details: Mapping[str, Any] | None = None):
        super().__init__(message)
        self.details = dict(details or {})


def nearest(name: str, allowed: Iterable[str]) -> str:
    """Return `"; did you mean 'x'?"` for the closest allowed name, or an empty string."""
    close = difflib.get_close_matches(name, list(allowed), n=1, cutoff=0.5)
    return f"; did you mean '{close[0]}'?" if close else ""


def unknown(kind: str, name: str, allowed: Iterable[str]) -> InputError:
    """Build the error for a name that is not one of `allowed`: it lists them and suggests the nearest."""
    names = sorted(allowed)
    return InputError(f"unknown {kind} '{name}'{nearest(name, names)} (known: {', '.join(names) or 'none'})")
