"""A step of cloth against numba's gather over the same rows, in the same run: symplectic Euler and velocity Verlet, f32.

`python -m tests.bench mesh`
The peer is a loop that somebody would write by hand: two `prange` loops, compressed rows, arrays of (n, 3). Both do the same work,
the springs and gravity, on as many threads. Rounds take turns; the fastest of each counts.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import numpy as np

import tparticles as tp
from tparticles import backend, schemes

from .table import Table

SIDES = {64: 400, 256: 40, 1024: 3}  # vertices along a side: steps in a round
ROUNDS = 5
DT = 1e-5
WANTED = {64: 1.0, 256: 1.2, 1024: 1.2}


def engine(mesh: tp.Mesh, scheme: str) -> Callable[[int], None]:
    """Return what takes steps on the engine."""
    from tparticles.stepping.contact import Contact
    from tparticles.stepping.staged import StagedStepper
    from tparticles.systems.spring_mesh import SpringMesh

    chosen = schemes.get(scheme)
    system = SpringMesh(mesh, forces=(tp.Gravity(),), fixed=mesh.pinned, registers=chosen.registers)
    stepper = StagedStepper(
        system,
        scheme=chosen,
        clamp="equal",
        contact=Contact(system, (), radius=0.0),
        driven=np.zeros(0, int),
        drive=lambda t: np.zeros((0, 3)),
        velocity_free=True,
    )
    return lambda steps: stepper.advance(0.0, steps * DT, DT) and None


def peer(mesh: tp.Mesh) -> Callable[[int], None]:
    """Return what takes steps in numba."""
    import numba

    from tparticles.systems.topology import Rows

    numba.set_num_threads(backend.current().threads)
    rows = Rows.of(mesh)
    stiffness, rest = (values[rows.spring].astype(np.float32) for values in (mesh.stiffness, mesh.rest))
    inverse = np.where(mesh.pinned, 0.0, 1.0 / mesh.mass).astype(np.float32)
    x, v = mesh.x.astype(np.float32), mesh.v.astype(np.float32)

    @numba.njit(parallel=True, fastmath=True)
    def run(x, v, starts, column, stiffness, rest, inverse, steps, dt, g):
        for _ in range(steps):
            for i in numba.prange(x.shape[0]):
                fx, fy, fz = np.float32(0), np.float32(0), np.float32(0)
                for e in range(starts[i], starts[i + 1]):
                    j = column[e]
                    dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
                    pull = stiffness[e] * (np.float32(1) - rest[e] / np.sqrt(dx * dx + dy * dy + dz * dz))
                    fx += pull * dx
                    fy += pull * dy
                    fz += pull * dz
                w = inverse[i]
                if w > 0:
                    v[i, 0] += dt * w * fx
                    v[i, 1] += dt * w * fy
                    v[i, 2] += dt * (w * fz + g)
            for i in numba.prange(x.shape[0]):
                for d in range(3):
                    x[i, d] += dt * v[i, d]

    arguments = (rows.starts, rows.column, stiffness, rest, inverse)
    return lambda steps: run(x, v, *arguments, steps, np.float32(DT), np.float32(-9.81))


def measure(runs: dict[str, Callable[[int], None]], steps: int) -> dict[str, float]:
    """Return the seconds of a step, the fastest of some rounds in turn."""
    best = dict.fromkeys(runs, np.inf)
    for run in runs.values():
        run(2)
    for _ in range(ROUNDS):
        for name, run in runs.items():
            start = time.perf_counter()
            run(steps)
            best[name] = min(best[name], (time.perf_counter() - start) / steps)
    return best


def main() -> None:
    """Measure all sizes and print the table."""
    table = Table(
        "Cloth: seconds of a step, and how many times faster than numba",
        (
            "cloth",
            "springs",
            "symplectic [us]",
            "verlet [us]",
            "numba [us]",
            "numba / symplectic",
            "numba / verlet",
            "wanted",
        ),
    )
    for side, steps in SIDES.items():
        backend.stop()
        backend.start(arch="cpu", threads=len(os.sched_getaffinity(0)), precision="f32")
        mesh = tp.cloth(counts=(side, side), size=(2.0, 2.0), mass=0.4, stiffness=50.0).pin([0, side - 1])
        runs = {name: engine(mesh, name) for name in ("symplectic-euler", "velocity-verlet")} | {"numba": peer(mesh)}
        best = measure(runs, steps)
        ratios = (f"{best['numba'] / best[name]:.2f}" for name in ("symplectic-euler", "velocity-verlet"))
        times = (f"{1e6 * seconds:.0f}" for seconds in best.values())
        table.add(f"{side}x{side}", mesh.spring_count, *times, *ratios, WANTED[side])
    table.print()
