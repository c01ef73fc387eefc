"""A log as USD points with time samples, for Blender, Houdini and others."""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
# usd-core is an extra.

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, RunError
from ..output.files import temporary_path
from . import layout
from .colors import colors, widths
from .read import MeshLog, ParticleLog

FORMATS = (".usd", ".usdc", ".usda")


def export_usd(scene: Any, group: MeshLog | ParticleLog, rows: np.ndarray, path: Path) -> list[Path]:
    """Write rows of a group as points: positions [m], velocities [m/s], accelerations of meshes, ids, widths [m], display colours.

    A time code is a frame of the scene's rate, with the row at t = 0 at time code 0; z is up.
    Raises:
        InputError: a suffix that is not USD's, usd-core is missing.
        RunError: the file cannot be written.
    """
    if path.suffix not in FORMATS:
        raise InputError(f"--out {path}: one of {', '.join(FORMATS)} is needed")
    layout.check_libraries("export", "pxr")
    from pxr import Sdf, Usd, UsdGeom, Vt

    part = temporary_path(path).with_suffix(path.suffix)
    try:
        stage = Usd.Stage.CreateNew(str(part))
        rate = float(scene.fps)
        stage.SetTimeCodesPerSecond(rate)
        stage.SetFramesPerSecond(rate)
        stage.SetStartTimeCode(float(group.time[rows[0]]) * rate)
        stage.SetEndTimeCode(float(group.time[rows[-1]]) * rate)
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        name = re.sub(r"\W", "_", group.name, flags=re.ASCII)
        points = UsdGeom.Points.Define(stage, Sdf.Path("/" + (name if not name[:1].isdigit() else f"_{name}")))
        stage.SetDefaultPrim(points.GetPrim())
        color = points.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        # once more as a primvar: Blender passes over the ids proper
        id_ = UsdGeom.PrimvarsAPI(points).CreatePrimvar("id", Sdf.ValueTypeNames.IntArray, UsdGeom.Tokens.vertex)
        spec = next(g for g in scene.groups if g.name == group.name)
        for row in rows:
            state = group.state(int(row))
            code = Usd.TimeCode(state.time * rate)
            ids = group.ids if isinstance(group, MeshLog) else state.columns["id"][:, 0]
            points.CreatePointsAttr().Set(_vectors(Vt, state.x), code)
            points.CreateIdsAttr().Set(Vt.Int64Array.FromNumpy(ids.astype(np.int64)), code)
            id_.Set(Vt.IntArray.FromNumpy(ids.astype(np.int32)), code)
            points.CreateWidthsAttr().Set(Vt.FloatArray.FromNumpy(widths(spec, group, state).astype(np.float32)), code)
            color.Set(_vectors(Vt, colors(spec, scene.look, group, state)), code)
            if state.v is not None:
                points.CreateVelocitiesAttr().Set(_vectors(Vt, state.v), code)
            if state.a is not None:
                points.CreateAccelerationsAttr().Set(_vectors(Vt, state.a), code)
            points.CreateExtentAttr().Set(
                UsdGeom.Points.ComputeExtent(*_boxed(Vt, state.x, widths(spec, group, state))), code
            )
        points.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
        stage.GetRootLayer().Save()
        del stage
        os.replace(part, path)
    except (OSError, RuntimeError) as error:  # pxr raises its own, which are RuntimeErrors
        part.unlink(missing_ok=True)
        raise RunError(f"cannot write {path}: {' '.join(str(error).split())[-200:]}") from None
    return [path]


def _vectors(vt: Any, values: np.ndarray) -> Any:
    return vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def _boxed(vt: Any, x: np.ndarray, width: np.ndarray) -> tuple[Any, Any]:
    return _vectors(vt, x), vt.FloatArray.FromNumpy(np.ascontiguousarray(width, np.float32))
