"""Scenes: load them; scripts: read their parameters, run their `scene` function.

A script is a Python file with `def scene(quality, *, name=default, ...) -> Scene`. Whatever it raises is shown with the script's
own line.
"""

from __future__ import annotations

import ast
import contextlib
import importlib.util
import inspect
import linecache
import re
import sys
import traceback
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from .data_scene.files import SUFFIXES, parse, read_text
from .errors import InputError, TparticlesError, nearest, unknown
from .parameter import Parameter
from .scene_files import DATA, find, named
from .spec import explain

if TYPE_CHECKING:
    from .data_scene.source import DataScene

_LONGEST = 300  # characters shown of somebody else's message
_LONGEST_LINE = 80  # and of a line of source


@dataclass(frozen=True)
class Script:
    """A loaded scene script. `source` is the text that was run, whatever becomes of the file."""

    name: str
    path: Path
    source: str
    summary: str
    function: Callable[..., Any]
    parameters: dict[str, Parameter]

    def settings(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """Return `wanted` (text or values, by name) as values of the right types.

        Raises:
            InputError: an unknown name (the nearest is suggested), an ill-typed value, NaN or infinity.
        """
        for name in wanted:
            if name not in self.parameters:
                known = sorted(self.parameters)
                raise InputError(
                    f"scene '{self.name}' has no parameter '{name}'{nearest(name, known)} (known: {', '.join(known) or 'none'})"
                )
        try:
            return {name: self.parameters[name].read(value) for name, value in wanted.items()}
        except InputError as error:
            raise InputError(f"scene '{self.name}': {error}") from None

    def values(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of all parameters: `wanted` as `settings` reads it, the others by default."""
        return {name: p.default for name, p in self.parameters.items()} | self.settings(wanted)

    def build(self, *, quality: str, settings: Mapping[str, Any]) -> Any:
        """Return the `Scene` that the script describes.

        Raises:
            InputError: the script raised something (its own line is shown) or returned something else.
        """
        from .scene import Scene

        values = self.settings(settings)
        with _loading(self.path):
            scene = self.function(quality, **values)
        if inspect.iscoroutine(scene):
            scene.close()
        if not isinstance(scene, Scene):
            raise InputError(f"{self.path}: scene() must return a tparticles.Scene, not {type(scene).__name__}")
        return scene

    @contextlib.contextmanager
    def blamed(self) -> Iterator[None]:
        """Show what a law of the script raises, or why it does not compile, with the script's own line.

        Anything that does not point into the script passes as it is.
        """
        try:
            yield
        except TparticlesError:
            raise
        except Exception as error:
            if line := _own_line(self.path, error):
                raise InputError(f"{line}: {_reason(error)}") from error
            if self._is_of_a_law(error):
                raise InputError(
                    f"{self.path}: a law of this script does not compile ({_reason(error)}): velocity(self, t, x) and "
                    "acceleration(self, t, x, v) must be @ti.func and return a vector of 3"
                ) from error
            raise

    def _is_of_a_law(self, error: Exception) -> bool:
        """Whether an error of the compiler is likely to be the script's: it has laws of its own."""
        import taichi as ti

        own = [c for c in vars(sys.modules[self.function.__module__]).values() if isinstance(c, type)]
        laws = [c for c in own if any(getattr(f, "_is_taichi_function", False) for f in vars(c).values())]
        return isinstance(error, ti.TaichiCompilationError) and any(
            c.__module__ == self.function.__module__ for c in laws
        )


@contextlib.contextmanager
def _loading(path: Path) -> Iterator[None]:
    """Turn whatever a script raises into an InputError with its own line, and keep it from starting Taichi."""
    try:
        with _taichi_held():
            yield
    except SyntaxError as error:
        # source that cannot be decoded has no line
        where = f"{error.filename or path}:{error.lineno}" if error.lineno else str(error.filename or path)
        text = f": `{error.text.strip()}`" if error.text and error.text.strip() else ""
        raise InputError(f"{where}{text}: {error.msg}") from None
    except TparticlesError as error:
        if line := _own_line(path, error):
            raise type(error)(f"{line}: {error}") from None
        raise
    except (Exception, SystemExit) as error:
        raise InputError(f"{_own_line(path, error) or path}: {_reason(error)}") from None


@contextlib.contextmanager
def _taichi_held() -> Iterator[None]:
    """Let no script start or reset Taichi: it would undo what the program chose, and print on stdout."""
    import taichi as ti

    def refuse(*_: Any, **__: Any) -> None:
        raise InputError(
            "a scene does not start Taichi itself: tparticles does, by --arch, --threads and --precision; remove this call"
        )

    held = {name: getattr(ti, name) for name in ("init", "reset")}
    for name in held:
        setattr(ti, name, refuse)
    try:
        yield
    finally:
        for name, function in held.items():
            setattr(ti, name, function)


def _own_line(path: Path, error: BaseException) -> str:
    """Return `file:line: source` of the innermost frame inside the script, or an empty string."""
    own = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
    # Taichi reports the frames of kernels in the text of its errors
    own = re.findall(rf'File "{re.escape(str(path))}", line (\d+), in ', str(error)) or own
    if not own:
        return ""
    text = linecache.getline(str(path), int(own[-1] or 0)).strip()
    return f"{path}:{own[-1]}: `{text if len(text) <= _LONGEST_LINE else text[:_LONGEST_LINE] + '...'}`"


def _reason(error: BaseException) -> str:
    """Return type and message of an exception in one line; of a kernel's error what is said last, below its frames."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if isinstance(error, ValidationError):
        return explain(error, error.title)
    text = (lines[-1] if lines and 'File "' in str(error) else " ".join(lines)).rstrip(".")
    text = text if len(text) <= _LONGEST else text[:_LONGEST] + "..."
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _read(path: Path) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"scene file {path} cannot be read: {error.strerror}") from None
    try:
        return importlib.util.decode_source(data)
    except (SyntaxError, UnicodeDecodeError) as error:
        reason = _not_utf8(data) or f": {getattr(error, 'msg', error)}"
        raise InputError(f"{path}{reason}") from None


def _not_utf8(data: bytes) -> str:
    """Return where `data` is no UTF-8, or an empty string."""
    try:
        data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        return f":{line}: a byte that is no UTF-8 ({data[error.start]:#x}): save it as UTF-8"
    return ""


def load(scene: str) -> Script | DataScene:
    """Load a scene given by name or path: a script without running its `scene` function, or a document.

    Raises:
        InputError: not found; of a script a syntax error or an exception at import (its line is shown), no `scene`, an odd
            signature; of a document what its text says wrong.
    """
    path = find(scene)
    if path.suffix not in SUFFIXES:
        return load_script(path)
    from .data_scene.source import load

    return load(path, _script_of_library)


def _script_of_library(name: str) -> Script:
    """Load the script of that name in ./scenes, and no other file."""
    scripts = named((".py",))
    if name not in scripts:
        raise unknown("script", name, scripts)
    return load_script(scripts[name].resolve())


def load_script(path: Path) -> Script:
    """Load a script; errors as `load` says."""
    source = _read(path)
    spec = importlib.util.spec_from_file_location(f"tparticles_scene_{path.stem}", path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # Taichi and pydantic look the source up by module
    linecache.checkcache(str(path))
    with _loading(path):
        # Not through the loader: its cache takes a file edited within a second, at equal length, for the old one.
        exec(compile(source, str(path), "exec", dont_inherit=True), vars(module))
    function = getattr(module, "scene", None)
    if not callable(function):
        raise _no_scene(path)
    summary = (module.__doc__ or "").strip().partition("\n")[0]
    return Script(path.stem, path, source, summary, function, _parameters(path, function))


def _no_scene(path: Path) -> InputError:
    return InputError(f"{path}: a scene script defines `def scene(quality, *, name=default, ...) -> Scene`")


def _parameters(path: Path, function: Callable[..., Any]) -> dict[str, Parameter]:
    try:
        found = inspect.signature(function).parameters
        hints = _hints(function)
    except Exception as error:  # a builtin, or an annotation that names what is not there
        raise InputError(f"{path}: the signature of scene() cannot be read: {_reason(error)}") from None
    result = {}
    for i, p in enumerate(found.values()):
        if i == 0 and p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD):
            continue  # quality
        if i == 0 or p.kind == p.VAR_POSITIONAL:
            raise InputError(
                f"{path}: scene() must take `quality` as its first argument, and `*` before its parameters"
            )
        if p.kind != p.KEYWORD_ONLY or p.default is p.empty:
            raise InputError(
                f"{path}: parameter '{p.name}' of scene() must be keyword-only (after `*`) and have a default"
            )
        kind = hints.get(p.name, Any if p.default is None else type(p.default))
        result[p.name] = Parameter(p.name, kind, p.default)
    if not found:
        raise InputError(f"{path}: scene() must take `quality` as its first argument")
    return result


def _hints(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of a function's parameters; what it returns is nobody's business here."""
    hints = {n: a for n, a in getattr(function, "__annotations__", {}).items() if n != "return"}
    bare = types.SimpleNamespace(__annotations__=hints)
    return typing.get_type_hints(bare, getattr(function, "__globals__", {}), include_extras=True)


@dataclass(frozen=True)
class Outline:
    """What can be said of a scene without running it: a list of scenes must be quick and run no code.

    `parameters`: defaults by name, as values where they are literals and as source text where not.
    `error`: what is wrong with the file, or an empty string.
    """

    name: str
    summary: str
    parameters: dict[str, Any]
    error: str = ""


def outlines() -> list[Outline]:
    """Read the outlines of all scenes in ./scenes, by name, and then of those in ./scenes/data, by path."""
    found = [outline(path) for _, path in sorted(named().items())]
    data = sorted(path for suffix in SUFFIXES for path in DATA.glob(f"*{suffix}"))
    return found + [replace(outline(path), name=str(path)) for path in data]


def outline(path: Path) -> Outline:
    """Read the outline of a scene; a broken one is described by its `error`."""
    return _document_outline(path) if path.suffix in SUFFIXES else _script_outline(path)


def _document_outline(path: Path) -> Outline:
    try:
        document = parse(read_text(path), path.suffix)
    except InputError as error:
        text = str(error)
        return Outline(path.stem, "", {}, text if str(path) in text else f"{path}: {text}")
    summary, parameters = document.get("summary", ""), document.get("parameters", {})
    summary = " ".join(summary.split()) if isinstance(summary, str) else ""
    if isinstance(base := document.get("extends"), str):
        summary = f"{summary or 'data'} (extends {base})"
    return Outline(path.stem, summary, parameters if isinstance(parameters, dict) else {})


def _script_outline(path: Path) -> Outline:
    try:
        source = _read(path)
        tree = ast.parse(source, str(path))
    except InputError as error:
        return Outline(path.stem, "", {}, str(error))
    except SyntaxError as error:
        where = f"{path}:{error.lineno}" if error.lineno else str(path)
        return Outline(path.stem, "", {}, f"{where}: {error.msg}")
    except (ValueError, RecursionError, MemoryError) as error:
        return Outline(path.stem, "", {}, f"{path}: {_reason(error)}")
    summary = (ast.get_docstring(tree) or "").partition("\n")[0]
    found = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "scene"]
    if found:
        arguments = found[-1].args
        pairs = zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
        return Outline(path.stem, summary, {a.arg: _literal(d) for a, d in pairs if d is not None})
    # it may be imported or made by a call; then only running the script would tell
    bound = "scene" in {n.id for n in ast.walk(tree) if isinstance(n, ast.Name)} or "scene" in {
        a.asname or a.name for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) for a in n.names
    }
    return Outline(path.stem, summary, {}, "" if bound else str(_no_scene(path)))


def _literal(node: ast.expr) -> Any:
    try:
        return ast.literal_eval(node)
    except ValueError:
        return ast.unparse(node)
