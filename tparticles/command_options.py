"""What several commands share: options, and how results are printed."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import re
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import click

from .errors import InputError


@contextlib.contextmanager
def stdout_kept() -> Iterator[None]:
    """Send what a scene, Taichi or a driver prints to stderr: stdout is for results."""
    try:
        saved = os.dup(1)
    except OSError:  # stdout is closed
        yield
        return
    try:
        os.dup2(2, 1)
        # Taichi, before Python's stdout is another: it would take that for a notebook, and say so.
        from . import tracing  # noqa: F401

        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        with contextlib.suppress(OSError, AttributeError, TypeError):
            ctypes.CDLL(None).fflush(None)  # C's own buffer, which kernels print into
        os.dup2(saved, 1)
        os.close(saved)


def print_json(value: Any) -> None:
    """Print `value` as one strict JSON document."""
    from .output import jsonable

    click.echo(json.dumps(jsonable(value), allow_nan=False))


def size_option(_context: Any, _parameter: Any, value: str | None) -> tuple[int, int] | None:
    """Read `WIDTHxHEIGHT`. Raises `InputError`."""
    if value is None:
        return None
    found = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", value.strip())
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not all(1 <= n <= 16384 for n in size):
        raise InputError(f"--size {value}: WIDTHxHEIGHT is needed, such as 1920x1080, each from 1 to 16384")
    return size


def settings_option(_context: Any, _parameter: Any, values: Sequence[str]) -> dict[str, str]:
    """Read `NAME=VALUE`, as often as it is given. Raises `InputError`."""
    settings: dict[str, str] = {}
    for value in values:
        name, equals, text = value.partition("=")
        name = name.strip()
        if not equals or not name:
            raise InputError(f"--set {value}: name=value is needed")
        if name in settings:
            raise InputError(f"--set {name} is given twice")
        settings[name] = text
    return settings


QUALITY = click.option(
    "--quality",
    metavar="preview|draft|final",
    default="final",
    show_default=True,
    help="480x270, 960x540 or 1920x1080 where the scene names no size; the scene is told, too.",
)
SET = click.option(
    "--set",
    "settings",
    metavar="NAME=VALUE",
    multiple=True,
    callback=settings_option,
    help="A parameter of the scene; `describe` lists them. As often as needed.",
)
PRECISION = click.option("--precision", metavar="f32|f64", default="f32", show_default=True, help="Of the simulation.")
JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON on stdout, and nothing else; in failure too.")
