"""Work against error in pixels: a scene run by other schemes and steps, against a far finer run in f64.

Particles are the same in all runs: births do not depend on the steps. An error is how far a dot is from where the reference has it,
as the scene's camera sees both; dots that the reference has outside the picture do not count.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import backend, schemes
from ..errors import InputError, RunError
from ..render.project import camera_row
from ..scene import Scene
from ..schemes import Scheme
from ..simulation import Simulation
from ..stepping.control import ErrorControl, Fixed, PixelTolerance, check_precision
from ..stepping.report import StepReport
from .precision import Point, Precision, choices

STEPS = (1, 2, 3, 4, 6, 8, 12, 16)  # per frame
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
PIXELS = (2.0, 0.5, 0.125)
TARGETS = (1.0, 0.25)
SECONDS = 2.0  # into the film, where no frame is asked for
SCHEMES = (
    "euler",
    "midpoint",
    "rk3",
    "rk4",
    "bogacki-shampine",
    "dormand-prince",
    "ab2",
    "ab4",
    "abm4",
    "abm5-pec",
    "velocity-verlet",
)
FINEST = 48  # steps per frame of the reference
_SMALLEST = 0.02  # [px]; nobody needs less

Dots = dict[str, tuple[np.ndarray, np.ndarray]]  # by group: id, x


@dataclass(frozen=True)
class Track:
    """A run up to the last of some frames: where the particles are at each, and what it took.

    `seconds`: in the stepper alone, without compilation.
    """

    dots: tuple[Dots, ...]
    seconds: float
    steps: int
    evaluations: int


def track(
    scene: Scene, frames: Sequence[int], *, precision: str, size: tuple[int, int], threads: int | None = None
) -> Track:
    """Run `scene` up to the last of `frames`, which rise.

    Raises:
        InputError, RunError: as `Simulation`.
    """
    backend.stop()  # fields of earlier runs; and cached kernels fit again
    simulation = Simulation(scene, size=size, arch="cpu", precision=precision, threads=threads)
    clock = [0.0]
    for group in simulation.groups:
        if group.stepper:
            _watch(group.stepper, clock, simulation, group.dt)
    dots: list[Dots] = []
    steps = rejected = starting = 0
    for frame in frames:
        report = simulation.advance_to(frame)
        steps, rejected, starting = steps + report.steps, rejected + report.rejected, starting + report.starting
        states = {group.spec.name: group.state(report.time) for group in simulation.groups}
        dots.append({name: (state["id"], state["x"].astype(float)) for name, state in states.items()})
    work = StepReport(steps=steps, rejected=rejected, starting=starting)
    return Track(tuple(dots), clock[0], steps, work.evaluations(scene.running_scheme))


def _watch(stepper: Any, clock: list[float], simulation: Simulation, dt: float) -> None:
    """Compile the stepper now, and add up the time that it takes from now on."""
    advance = stepper.advance
    advance(1, 0.0, 0.0, dt, camera=simulation._camera(0.0))  # no time passes

    def watched(*arguments: Any, **more: Any) -> Any:
        begin = time.perf_counter()
        try:
            return advance(*arguments, **more)
        finally:
            clock[0] += time.perf_counter() - begin

    stepper.advance = watched


def reference(scene: Scene, frames: Sequence[int], *, size: tuple[int, int], steps: int = FINEST) -> tuple[Dots, ...]:
    """Return where the particles are at each of the frames, by Dormand and Prince in f64 with so many steps a frame."""
    fine = dataclasses.replace(
        scene, scheme=schemes.get("dormand-prince"), steps=Fixed(dt=_dt(scene, steps)), clamp="equal"
    )
    return track(fine, frames, precision="f64", size=size).dots


def distances(dots: Dots, truth: Dots, scene: Scene, frame: int, size: tuple[int, int]) -> tuple[np.ndarray, int]:
    """Return how far [px] each dot is from where `truth` has it in the picture, and how many are in only one of the two."""
    camera = camera_row(scene.camera.pose(float(frame / scene.fps)), *size).astype(float)
    found, missing = [], 0
    for name, (ids, x) in truth.items():
        ours, theirs = dots[name]
        _, here, there = np.intersect1d(ids, ours, return_indices=True)
        missing += len(ids) + len(ours) - 2 * len(here)
        u, v, seen = _projected(x[here], camera, size)
        u2, v2, _ = _projected(theirs[there], camera, size)
        found.append(np.hypot(u2 - u, v2 - v)[seen])
    return np.concatenate(found), missing


def _projected(x: np.ndarray, camera: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    d = x - camera[:3]
    depth = d @ camera[9:12]
    scale = camera[12] / np.maximum(depth, 1e-3)
    u, v = camera[13] + scale * (d @ camera[3:6]), camera[14] - scale * (d @ camera[6:9])
    return u, v, (depth > 1e-3) & (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])


def study(
    name: str,
    scene: Scene,
    chosen: Sequence[Scheme],
    *,
    size: tuple[int, int],
    frame: int | None = None,
    precisions: Sequence[str] = ("f32", "f64"),
    steps: Sequence[int] = STEPS,
    tolerances: Sequence[float] = TOLERANCES,
    pixels: Sequence[float] = PIXELS,
    targets: Sequence[float] = TARGETS,
    finest: int = FINEST,
    tell: Callable[[str], None] = lambda _: None,
) -> Precision:
    """Measure each of the schemes on a scene at `frame` (the last of the first two seconds by default), seen in `size` [px].

    `steps` per frame, `tolerances` (rtol = atol) and `pixels` are what is tried; `finest`: steps per frame of the reference.

    Raises:
        InputError: a frame outside the film, or none of the schemes runs the scene.
    """
    last = scene.frame_count
    frame = min(int(SECONDS * scene.fps), last) if frame is None else frame
    if not 1 <= frame <= last:
        raise InputError(f"--frame {frame} leaves the film, which has frames 1-{last}")
    fitting, notes = _fitting(scene, chosen)
    tell(f"precision: reference of {name}")
    (truth,), (coarser,) = (reference(scene, [frame], size=size, steps=n) for n in (finest, finest // 2))
    off, _ = distances(coarser, truth, scene, frame, size)
    if not len(off):
        raise InputError(f"frame {frame} of scene '{name}' shows no particle: choose another with --frame")
    notes.append(
        f"reference: dormand-prince in f64, {finest} steps a frame; {finest // 2} move no dot by more than {off.max():.2g} px"
    )
    points = []
    for precision in precisions:
        for scheme in fitting:
            tell(f"precision: {scheme.name}, {name}, {precision}")
            for control, values in _controls(scene, scheme, steps, tolerances, pixels, precision).items():
                for value, film in values:
                    point = _point(film, frame, truth, scheme.name, control, value, precision, size)
                    if point is None:
                        continue
                    points.append(point)
                    if point.largest < _SMALLEST:
                        break
    return Precision(
        subject=name,
        what=f"scene {name}, frame {frame}, {size[0]}x{size[1]}",
        unit="px",
        particles=len(off),
        points=tuple(points),
        choices=choices(points, targets, precisions),
        notes=tuple(notes),
    )


def _fitting(scene: Scene, chosen: Sequence[Scheme]) -> tuple[list[Scheme], list[str]]:
    fitting, reasons = [], []
    for scheme in chosen:
        try:
            dataclasses.replace(scene, scheme=scheme, steps=Fixed(dt=_dt(scene, 1)), clamp="equal")
            fitting.append(scheme)
        except InputError as error:
            reasons.append(str(error))
    if not fitting:
        raise InputError(reasons[0])
    return fitting, reasons


def _dt(scene: Scene, steps: int) -> float:
    return float(1 / scene.fps) / steps


def _controls(
    scene: Scene,
    scheme: Scheme,
    steps: Sequence[int],
    tolerances: Sequence[float],
    pixels: Sequence[float],
    precision: str,
) -> dict[str, Iterator[tuple[float, Scene]]]:
    """Return the films of each control, with the setting that it is named by."""

    def films(controllers: Sequence[tuple[float, Any]]) -> Iterator[tuple[float, Scene]]:
        for value, controller in controllers:
            try:
                check_precision(controller, precision)
                yield value, dataclasses.replace(scene, scheme=scheme, steps=controller, clamp="equal")
            except InputError:
                continue  # the scheme has no estimate of its error, or f32 does not reach that far

    return {
        "fixed": films([(_dt(scene, n), Fixed(dt=_dt(scene, n))) for n in steps]),
        "error": films([(tolerance, ErrorControl(rtol=tolerance, atol=tolerance)) for tolerance in tolerances]),
        "pixels": films([(px, PixelTolerance(px=px)) for px in pixels]),
    }


def _point(
    film: Scene,
    frame: int,
    truth: Dots,
    name: str,
    control: str,
    setting: float,
    precision: str,
    size: tuple[int, int],
) -> Point | None:
    try:
        found = track(film, [frame], precision=precision, size=size)
        (dots,) = found.dots
    except (InputError, RunError):
        return None  # certainly unstable, or it went astray: no point of the diagram
    off, _ = distances(dots, truth, film, frame, size)
    alive = sum(len(ids) for ids, _ in dots.values())
    return Point(
        solver=name,
        control=control,
        precision=precision,
        setting=setting,
        seconds=found.seconds,
        evaluations=found.evaluations / alive,
        steps=found.steps / alive,
        largest=float(off.max()),
        median=float(np.median(off)),
    )
