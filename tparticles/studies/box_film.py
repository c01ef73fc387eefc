"""The same box under several schemes, side by side in one film: the paper's Figures 1 to 3."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from .. import backend
from ..errors import InputError, RunError
from ..frame import FrameReport
from ..mesh_group import MeshGroup
from ..output import Mp4, OutputFrame
from ..output.files import atomic_file, reason
from ..output.png import encode_png
from ..physics.mesh import Mesh
from ..physics.mesh_builders import lattice, spring_box
from ..render.wires import Wires
from ..scene import Camera, Gradient, Scene
from ..schemes import Scheme
from ..simulation import Simulation
from ..stepping.control import Fixed
from . import report, style
from .box_paper import DT, ROOM_SIZE, SIZE

SECONDS, FASTER, FPS = 40.0, 4, 25  # of the box's time; played so many times as fast
CELL = 224  # [px], each room
_PITCH = 17.0  # [m] from room to room
_STRAIN = ((0.2, 0.5, 1.0), (0.85, 0.9, 1.0), (1.0, 0.35, 0.15))
_PICTURED = (0.2, 0.4, 0.9)  # of the film: the moments of the picture

Array = np.ndarray


def film(
    chosen: Sequence[Scheme], stiffness: float, folder: Path, *, seconds: float = SECONDS, tell: Callable[[str], None]
) -> list[Path]:
    """Film the boxes of `chosen` with springs of `stiffness` [N/m]; return box-film.mp4 and box-film.png in `folder`.

    Raises:
        InputError: a scheme that cannot run a damped box.
    """
    for scheme in chosen:
        if 2 not in scheme.system_orders or "velocity-free forces" in scheme.needs:
            raise InputError(f"scheme '{scheme.name}' cannot run a damped spring box: take another with --scheme")
    per_frame = FASTER * round(1 / (FPS * DT)) * DT
    paths = []
    for scheme in chosen:
        tell(f"box: {scheme.name}")
        paths.append(_path(scheme, stiffness, per_frame, max(1, round(seconds / per_frame))))
    labels = [scheme.name for scheme in chosen]
    pictures, kept, total = _pictures(np.stack(paths, axis=1)), [], len(paths[0])
    moments = {max(0, round(part * total) - 1) for part in _PICTURED}
    columns, rows = _grid(len(chosen))
    overlay = _overlay(labels, columns, rows, f"k = {stiffness:g} N/m, dt = {DT:g} s, {FASTER} times as fast")
    writer = Mp4(folder / "box-film.mp4", fps=Fraction(FPS), size=(columns * CELL, rows * CELL))
    try:
        for number, picture in enumerate(pictures):
            tell(f"box: frame {number + 1} of {total}")
            picture = overlay(picture)
            writer.write(OutputFrame(number + 1, picture))
            if number in moments:
                kept.append(picture)
    except BaseException:
        writer.abort()
        raise
    writer.close()
    still = folder / "box-film.png"
    try:
        with atomic_file(still) as file:
            file.write(encode_png(np.ascontiguousarray(np.concatenate(kept, axis=1)), {}))
    except OSError as error:
        raise RunError(f"cannot write {still}: {reason(error)}") from error
    return [writer.path, still]


def _path(scheme: Scheme, stiffness: float, per_frame: float, count: int) -> Array:
    """Return where the vertices are in each frame, (count, 8, 3); a box that is no number any more stays."""
    from .box_run import BoxRun, Drop
    from .ensemble import start_engine

    backend.stop()
    start_engine(threads=1)
    run = BoxRun(scheme, stiffness=(stiffness,))
    run.start([Drop.of(0)])
    frames: list[Array] = []
    for n in range(count):
        run.stepper.advance(n * per_frame, (n + 1) * per_frame, DT)
        x = run.state()[0][0].copy()
        frames.append(x if np.isfinite(x).all() or not frames else frames[-1])
    return np.stack(frames)


def _grid(count: int) -> tuple[int, int]:
    columns = math.ceil(math.sqrt(count))
    return columns, math.ceil(count / columns)


def _pictures(paths: Array) -> Iterator[Array]:
    """Yield a picture for each frame of paths (frames, boxes, 8, 3), the boxes in rooms of a grid."""
    count = paths.shape[1]
    columns, rows = _grid(count)
    places = np.array([[_PITCH * (n % columns), 0.0, -_PITCH * (n // columns)] for n in range(count)])
    corners = lattice(counts=(2, 2, 2), size=ROOM_SIZE, face_diagonal=0.0, body_diagonal=0.0)
    corners = corners.moved(tuple(np.array([0.0, 0.0, ROOM_SIZE / 2]) - corners.center))
    middle = places.min(axis=0) / 2 + places.max(axis=0) / 2 + [0.0, 0.0, ROOM_SIZE / 2]
    fov = 16.0
    away = rows * _PITCH / 2 / math.tan(math.radians(fov / 2)) + ROOM_SIZE / 2
    backend.stop()
    simulation = Simulation(
        Scene(
            groups=(
                _still("rooms", _side_by_side(corners, places), Wires(colors=((0.25, 0.28, 0.34),), width=0.1)),
                _still(
                    "boxes",
                    _side_by_side(spring_box(size=SIZE), places),
                    Wires(by="strain", colors=_STRAIN, low=-0.5, high=0.5, width=0.16, dot=0.45),
                ),
            ),
            camera=Camera(position=tuple(middle - np.array([0.0, away, 0.0])), target=tuple(middle), fov=fov),
            background=Gradient(top=(0.02, 0.025, 0.04), bottom=(0.03, 0.03, 0.04)),
            size=(columns * CELL, rows * CELL),
            shutter=0.0,
        ),
        arch="cpu",
    )
    for group in simulation.groups:
        group.emit(0.0, 1.0)
    for number, frame in enumerate(paths, start=1):
        x = (frame + places[:, None]).reshape(-1, 3)
        simulation.groups[1].system.write(x, np.zeros_like(x))
        yield simulation.draw(FrameReport(number, 0.0)).copy()


def _still(name: str, mesh: Mesh, look: Wires) -> Any:
    return MeshGroup(name=name, mesh=mesh, forces=(), appearance=look, steps=Fixed(dt=1.0))


def _side_by_side(mesh: Mesh, places: Array) -> Mesh:
    first, *others = (mesh.moved(tuple(place)) for place in places)
    for other in others:
        first = first.joined(other)
    return first


def _overlay(labels: Sequence[str], columns: int, rows: int, title: str) -> Callable[[Array], Array]:
    """Return what writes the names over a picture; nothing where matplotlib is missing."""
    if not report.has_matplotlib():
        return lambda picture: picture
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with style.look():
        figure = Figure(figsize=(columns * CELL / 100, rows * CELL / 100), dpi=100)
        canvas = FigureCanvasAgg(figure)
        figure.patch.set_alpha(0.0)
        for n, label in enumerate(labels):
            at = (n % columns + 0.07) / columns, 1 - (n // columns + 0.13) / rows
            figure.text(*at, label, color="white", fontsize=9)
        figure.text(0.99, 0.004, title, color="#BBBBBB", fontsize=7, ha="right")
        canvas.draw()
        text = np.asarray(canvas.buffer_rgba()).astype(float)
    cover = text[..., 3:] / 255

    def over(picture: Array) -> Array:
        return np.rint((1 - cover) * picture + cover * text[..., :3]).astype(np.uint8)

    return over
