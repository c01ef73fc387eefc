"""Renders the few frames that a check needs; each scene in a process of its own, several at a time."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import RunError, TparticlesError
from .plan import Plan
from .reference import Sheet


@dataclass(frozen=True)
class Take:
    """What came of a scene: its sheet and pictures by frame, or the error that stopped it. `seconds`: how long it took."""

    seconds: float
    sheet: Sheet | None = None
    images: Mapping[int, np.ndarray] | None = None
    error: TparticlesError | None = None


def shoot(scene: str, plan: Plan, *, arch: str, threads: int | None) -> Take:
    """Render a scene's frames in this process; it takes the backend, and drops it in the end."""
    start = time.perf_counter()
    try:
        sheet, images = _render(scene, plan, arch, threads)
        return Take(time.perf_counter() - start, sheet, images)
    except TparticlesError as error:
        return Take(time.perf_counter() - start, error=_plain(error))


def _plain(error: TparticlesError) -> TparticlesError:
    """Return the error without what another process could not read."""
    kind = next(k for k in type(error).__mro__ if k.__module__ == TparticlesError.__module__)
    return kind(str(error))


def _render(scene: str, plan: Plan, arch: str, threads: int | None) -> tuple[Sheet, dict[int, np.ndarray]]:
    from .. import backend
    from ..library import load
    from ..output import pixel_hash
    from ..parameter import plain
    from ..simulation import Simulation
    from ..stepping.mesh_solver_direct import available
    from .moments import moments
    from .reference import Shot, machine_class, versions

    script = load(scene)
    built = script.build(quality="preview", settings=plan.set)
    size = plan.picture_size(built.resolution("preview"))
    shots, images = [], {}
    try:
        with script.blamed():
            simulation = Simulation(built, size=size, arch=arch, threads=threads)
            used = simulation.backend.arch
            for frame in simulation.frames(plan.frame_numbers(count=built.frame_count, fps=float(built.fps))):
                images[frame.number] = frame.image
                of_groups = moments(frame.state())
                shots.append(Shot(frame=frame.number, sha256=pixel_hash(frame.image), moments=of_groups))
    finally:
        backend.stop()
    facts = {
        "parameters": {name: plain(value) for name, value in script.values(plan.set).items()},
        "scheme": built.scheme.name,
        "steps": repr(built.steps),
        "fps": str(built.fps),
        "seed": built.seed,
    }
    stiff = any((mesh.scheme or built.scheme).implicit for mesh in built.meshes)
    machine = machine_class(used, solver=(available() or "cg") if stiff else "")
    sheet = Sheet(made_with=versions(), machine=machine, size=size, scene=facts, shots=tuple(shots))
    return sheet, images


def shoot_all(plans: Mapping[str, Plan], paths: Mapping[str, Path], *, arch: str) -> Iterator[tuple[str, Take]]:
    """Render scenes, as many at a time as there are cores; yield each by name as it is done.

    Where a process dies, of a driver or of memory, the scenes that are left are rendered one by one: that tells whose it was.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    workers = max(1, min(cores, len(plans)))
    left = list(plans)
    for name, take in _pooled(left, plans, paths, arch, workers, max(1, cores // workers)):
        left = [other for other in left if other != name]
        yield name, take
    for name in left:
        found = list(_pooled([name], plans, paths, arch, 1, cores))
        yield from found or [(name, Take(0.0, error=RunError("its process died")))]


def _pooled(
    names: Sequence[str], plans: Mapping[str, Plan], paths: Mapping[str, Path], arch: str, workers: int, threads: int
) -> Iterator[tuple[str, Take]]:
    """Render scenes on a pool of processes until all are done or one process dies."""
    context = multiprocessing.get_context("spawn")  # a kernel hangs in a forked process
    pool = ProcessPoolExecutor(workers, context, initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN))
    try:
        running = {
            pool.submit(shoot, str(paths[name]), plans[name], arch=arch, threads=threads): name for name in names
        }
        for future in as_completed(running):
            try:
                take = future.result()
            except BrokenProcessPool:
                return
            yield running[future], take
    finally:
        for process in (pool._processes or {}).values():  # nothing they could still do is wanted
            process.kill()
        pool.shutdown(cancel_futures=True)
