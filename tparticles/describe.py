"""What a scene holds and what a machine has, as data and as text."""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any, get_args

from . import __version__, library
from .backend import Precision
from .errors import InputError, TparticlesError, unknown
from .output import check_ffmpeg
from .parameter import plain
from .scene import QUALITIES
from .stepping.pace import memory
from .systems.attributes import ATTRIBUTES
from .systems.population import schedules


def describe_scene(scene: str, *, settings: Mapping[str, Any], quality: str, precision: str) -> dict[str, Any]:
    """Return parameters, time, groups with attributes, bytes and capacity of a scene; starts no backend.

    Raises:
        InputError: see `library.load` and `Script.build`.
    """
    if quality not in QUALITIES:
        raise unknown("quality", quality, QUALITIES)
    if precision not in get_args(Precision):
        raise unknown("precision", precision, get_args(Precision))
    script = library.load(scene)
    values = script.values(settings)
    built = script.build(quality=quality, settings=settings).of_quality(quality)
    end = built.duration
    groups = []
    for group in built.particles:
        names = group.attributes(streaks=built.shutter > 0)
        births = schedules(group.name, group.emitters, seed=built.seed, end=end)
        capacity = group.derived_capacity(births, look=built.look, frame=built.longest_advance)
        carried = [ATTRIBUTES[n] for n in names]
        carried += memory(built.running_scheme, group.components, adaptive=built.adaptive)
        each = sum(attribute.bytes(precision) for attribute in carried)
        groups.append(
            {
                "name": group.name,
                "system": type(group.system).__name__,
                "emitters": [e.name for e in group.emitters],
                "births": sum(s.total for s in births),
                "capacity": capacity,
                "attributes": {attribute.name: attribute.bytes(precision) for attribute in carried},
                "bytes_per_particle": each,
                "bytes": capacity * each,
            }
        )
    for mesh in built.meshes:
        scheme = mesh.scheme or built.scheme
        groups.append(
            {
                "name": mesh.name,
                "system": "SpringMesh",
                "vertices": mesh.mesh.vertex_count,
                "springs": mesh.mesh.spring_count,
                "scheme": scheme.name,
                "steps": repr(mesh.steps or built.steps),
                "stable_step": mesh.stable_step(scheme),
            }
        )
    return {
        "scene": script.name,
        "summary": script.summary,
        "parameters": {
            name: {"type": p.type_name, "default": plain(p.default), "value": plain(values[name])}
            for name, p in script.parameters.items()
        },
        "frames": built.frame_count,
        "fps": str(built.fps),
        "size": list(built.resolution(quality)),
        "scheme": built.scheme.name,
        "steps": repr(built.steps),
        "clamp": built.clamp,
        "groups": groups,
    }


def toml(scene: str, *, settings: Mapping[str, Any], quality: str) -> str:
    """Return the text of a data scene that describes the same as `scene` with these settings, in this quality.

    Raises:
        InputError: see `library.load` and `Script.build`; the scene has a law of its own, or another thing that data cannot say.
    """
    from .data_scene.files import LARGEST_FILE
    from .data_scene.toml import dumps
    from .data_scene.write import write_scene

    if quality not in QUALITIES:
        raise unknown("quality", quality, QUALITIES)
    script = library.load(scene)
    built = script.build(quality=quality, settings=settings)
    try:
        text = dumps(write_scene(built, summary=script.summary))
        if len(text.encode()) > LARGEST_FILE:
            raise InputError(f"its meshes take {len(text) / 2**20:.0f} MiB, at most {LARGEST_FILE >> 20} are read")
        return text
    except InputError as error:
        raise InputError(f"scene '{script.name}' cannot be written as data: {error}") from None


def _parameter(name: str, parameter: Mapping[str, Any]) -> str:
    value, default = parameter["value"], parameter["default"]
    changed = f", default {default}" if value != default else ""
    return f"    {name} = {value} ({parameter['type']}{changed})"


def _parameters(parameters: Mapping[str, Any]) -> list[str]:
    if not parameters:
        return ["  no parameters; of a data scene any value can be set by its path (--set look.ev=5)"]
    return ["  parameters (--set name=value):", *(_parameter(name, p) for name, p in parameters.items())]


def text(found: Mapping[str, Any]) -> str:
    """Return the answer of `describe_scene` for people."""
    lines = [
        f"{found['scene']}: {found['summary']}",
        f"  {found['frames']} frames at {found['fps']} fps, {found['size'][0]}x{found['size'][1]}",
        f"  scheme {found['scheme']}, steps {found['steps']}, clamp {found['clamp']}",
        *_parameters(found["parameters"]),
    ]
    for g in found["groups"]:
        if "vertices" in g:
            lines += [
                f"  mesh {g['name']}: {g['vertices']} vertices, {g['springs']} springs, scheme {g['scheme']}, steps {g['steps']}",
                f"    stable step {g['stable_step']:.3g} s",
            ]
            continue
        attributes = " ".join(f"{n}:{b}" for n, b in g["attributes"].items())
        lines += [
            f"  group {g['name']}: {g['system']}, emitters {', '.join(g['emitters'])}",
            f"    {g['births']} births, at most {g['capacity']} alive",
            f"    {g['bytes_per_particle']} bytes per particle ({attributes}), {g['bytes'] / 2**20:.2f} MiB",
        ]
    return "\n".join(lines)


def examine() -> dict[str, str]:
    """Return what matters of this machine, a line each."""
    from . import backend

    def attempt(action: Any) -> str:
        try:
            return str(action())
        except TparticlesError as error:
            return f"missing: {error}"

    found = {
        "tparticles": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in ("taichi", "numpy", "pillow", "imageio-ffmpeg")},
        "cores": str(os.cpu_count()),
        "cpu": "ok",
        **{arch: backend.missing(arch) or "ok" for arch in ("cuda", "vulkan")},
        "ffmpeg": attempt(check_ffmpeg),
        "kernel cache": attempt(backend.cache_folder),
    }
    disk = shutil.disk_usage(".")
    return found | {"disk free": f"{disk.free / 2**30:.1f} GiB of {disk.total / 2**30:.1f} GiB here"}
