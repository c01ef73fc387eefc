"""Imports run one way: read with `ast`, module by module."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "tparticles"
FILES = sorted(PACKAGE.rglob("*.py"))

# What each part of the package may import of it, itself aside. Neutral ground: errors, spec, rng, backend, binding, hints.
ALLOWED = {
    "errors": set(),
    "spec": {"errors"},
    "track": {"errors", "spec"},
    "rng": {"errors"},
    "tracing": set(),
    "hints": set(),
    "backend": {"errors", "tracing"},
    "binding": {"errors", "backend"},
    "schemes": {"errors"},
    "physics": {"errors", "rng", "spec", "track", "backend"},
    "systems": {"errors", "spec", "rng", "backend", "hints", "binding", "physics"},
    "stepping": {
        "errors",
        "spec",
        "backend",
        "hints",
        "binding",
        "schemes",
        "systems",
        "physics.law",
        "physics.colliders",
    },
    "render": {"errors", "spec", "track", "backend", "hints", "binding"},
    "output": {"errors"},
    "frame": {"stepping"},
}
# The joins: a scene describes, a simulation runs. Nobody else sees both what moves and what draws.
JOINS = {"scene", "simulation", "particle_motion", "mesh_group", "mesh_motion"}
ON_TOP = {
    "log",
    "regression",
    "cli",
    "command_options",
    "render_command",
    "checkpoint",
    "resume",
    "sharded",
    "shard_crew",
    "shard_estimate",
    "shard_states",
    "shoot",
}
ON_TOP |= {
    "data_scene",
    "job",
    "library",
    "scene_files",
    "describe",
    "batch",
    "parameter",
    "progress",
    "studies",
    "__main__",
    "__init__",
}


def name_of(path):
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


def imports(path):
    """Return the modules of the package that a file imports, such as `physics.law`."""
    parts = list(path.relative_to(PACKAGE.parent).with_suffix("").parts)
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            targets = [alias.name.split(".") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = parts[: len(parts) - node.level] if node.level else []
            base = base + (node.module.split(".") if node.module else [])
            # "from .. import backend" names a module, "from ..errors import InputError" does not
            targets = [[*base, alias.name] if is_module([*base, alias.name]) else base for alias in node.names]
        else:
            continue
        found |= {".".join(target[1:]) for target in targets if target[0] == "tparticles"}
    return found - {""}


def is_module(parts):
    path = PACKAGE.parent.joinpath(*parts)
    return parts[0] == "tparticles" and (path.with_suffix(".py").exists() or path.is_dir())


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_imports_run_one_way(path):
    part = name_of(path).split(".")[0]
    seen = imports(path)
    if part in ALLOWED:
        good = ALLOWED[part] | {part}
        bad = {name for name in seen if not any(name == g or name.startswith(f"{g}.") for g in good)}
        assert not bad, f"{name_of(path)} must not import {sorted(bad)}"
    else:
        assert part in JOINS | ON_TOP, f"say in this test what the new module {part} may import"


def test_only_the_joins_see_both_what_moves_and_what_draws():
    both = set()
    for path in FILES:
        parts = {name.split(".")[0] for name in imports(path)}
        if parts & {"systems", "stepping"} and "render" in parts:
            both.add(name_of(path))
    # A study measures what the join makes, in the pixels of its picture.
    assert {name for name in both if not name.startswith("studies.")} <= JOINS
    assert "simulation" in both


def test_nobody_below_imports_what_stands_on_top():
    top = ON_TOP - {"__init__"}
    for path in FILES:
        if name_of(path).split(".")[0] not in top:
            assert not {name.split(".")[0] for name in imports(path)} & top, name_of(path)


def calls(path):
    """Return the dotted names that a file calls."""
    return {ast.unparse(node.func) for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)}


def test_only_the_backend_starts_taichi():
    for path in FILES:
        if name_of(path) != "backend":
            assert not calls(path) & {"ti.init", "ti.reset", "taichi.init", "taichi.reset"}, name_of(path)
    assert {"ti.init", "ti.reset"} <= calls(PACKAGE / "backend.py")


def test_no_random_numbers_of_taichi():
    # They differ with the number of threads.
    for path in FILES:
        assert not calls(path) & {"ti.random", "ti.randn"}, name_of(path)


def test_schemes_and_output_do_without_taichi():
    for path in FILES:
        if name_of(path).split(".")[0] in ("schemes", "output", "errors", "spec", "__init__"):
            tree = ast.parse(path.read_text())
            modules = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
            modules |= {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module}
            assert not any(m.split(".")[0] == "taichi" for m in modules), name_of(path)


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_files_stay_small(path):
    assert len(path.read_text().splitlines()) <= 400
