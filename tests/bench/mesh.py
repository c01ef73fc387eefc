"""A step of cloth against others at the same work, in the same run: symplectic Euler and velocity Verlet, f32, on all threads.

`python -m tests.bench mesh`
The peers: a loop in numba that somebody would write by hand (two `prange` loops, compressed rows, arrays of (n, 3); as many
threads), Warp's CPU kernels of the same gather (its CPU device has one thread), and LAMMPS' harmonic bonds (velocity Verlet in f64,
one process, one thread). All do the springs and gravity of the same mesh, which is crumpled: `off` is how far their vertices are
from the engine's after some steps, as a part of a spring. Rounds take turns; the fastest of each counts.
"""

from __future__ import annotations

import os
import time

import numpy as np

import tparticles as tp
from tparticles import backend, schemes

from . import mesh_peers
from .mesh_peers import Peer
from .table import Table

SIDES = {64: 400, 256: 40, 1024: 3}  # vertices along a side: steps in a round
ROUNDS = 5
DT = 1e-5
WANTED = {
    "numba": {64: 1.0, 256: 1.2, 1024: 1.2},
    "warp": dict.fromkeys(SIDES, 2.0),
    "lammps": dict.fromkeys(SIDES, 3.0),
}
SAME_WORK, ALLOWED = 40, 1e-2  # steps after which vertices are compared; a part of a spring
SCHEME = {"numba": "symplectic-euler", "warp": "symplectic-euler", "lammps": "velocity-verlet"}


def engine(mesh: tp.Mesh, scheme: str) -> Peer:
    """Return the engine with a scheme."""
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
    return Peer(lambda steps: stepper.advance(0.0, steps * DT, DT) and None, lambda: system.read()[0])


def numba_peer(mesh: tp.Mesh) -> Peer:
    """Return the loop in numba."""
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
    return Peer(lambda steps: run(x, v, *arguments, steps, np.float32(DT), np.float32(-9.81)), lambda: x)


def crumpled(side: int) -> tp.Mesh:
    """Return a cloth whose springs pull in all directions."""
    flat = tp.cloth(counts=(side, side), size=(2.0, 2.0), mass=0.4, stiffness=50.0)
    noise = np.random.default_rng(0).normal(0.0, 0.1 * flat.rest.min(), flat.x.shape)
    springs = {name: getattr(flat, name) for name in ("mass", "springs", "stiffness", "rest")}
    return tp.Mesh(x=flat.x + noise, **springs).pin([0, side - 1])


def peers(mesh: tp.Mesh) -> tuple[dict[str, Peer], dict[str, str]]:
    """Return the peers that are installed, and why the others are not there."""
    makers = {
        "numba": lambda: numba_peer(mesh),
        "warp": lambda: mesh_peers.warp(mesh, DT),
        "lammps": lambda: mesh_peers.lammps(mesh, DT),
    }
    found, missing = {}, {}
    for name, make in makers.items():
        try:
            found[name] = make()
        except (ImportError, OSError) as error:
            missing[name] = str(error)
    return found, missing


def off(runs: dict[str, Peer], length: float) -> dict[str, float]:
    """Let all take the same steps; return how far each peer's vertices are from the engine's [springs]."""
    for run in runs.values():
        run.run(SAME_WORK)
    gaps = {
        name: float(np.abs(runs[name].x() - runs[SCHEME[name]].x()).max() / length) for name in SCHEME if name in runs
    }
    for name, gap in gaps.items():
        assert gap < ALLOWED, f"{name} does other work: {gap:.3g} of a spring off"
    return gaps


def measure(runs: dict[str, Peer], steps: int) -> dict[str, float]:
    """Return the seconds of a step, the fastest of some rounds in turn."""
    best = dict.fromkeys(runs, np.inf)
    for _ in range(ROUNDS):
        for name, peer in runs.items():
            start = time.perf_counter()
            peer.run(steps)
            best[name] = min(best[name], (time.perf_counter() - start) / steps)
    return best


def main() -> None:
    """Measure all sizes and print the table."""
    threads = len(os.sched_getaffinity(0))
    table = Table(
        f"Cloth: a step, {threads} threads (Warp and LAMMPS: 1), and how many times faster than a peer",
        ("cloth", "springs", "what", "a step [us]", "symplectic faster", "Verlet faster", "wanted", "off [springs]"),
    )
    for side, steps in SIDES.items():
        backend.stop()
        backend.start(arch="cpu", threads=threads, precision="f32")
        mesh = crumpled(side)
        others, missing = peers(mesh)
        ours = {name: engine(mesh, name) for name in ("symplectic-euler", "velocity-verlet")}
        gaps = off(ours | others, float(mesh.rest.min()))
        best = measure(ours | others, steps)
        cloth = (f"{side}x{side}", mesh.spring_count)
        for name in ours:
            table.add(*cloth, name, f"{1e6 * best[name]:.0f}", "", "", "", "")
        for name in others:
            faster = (f"{best[name] / best[scheme]:.2f}" for scheme in ours)
            table.add(*cloth, name, f"{1e6 * best[name]:.0f}", *faster, WANTED[name][side], f"{gaps[name]:.1g}")
        for name, reason in missing.items():
            table.add(*cloth, name, "-", "-", "-", WANTED[name][side], reason)
    table.print()
