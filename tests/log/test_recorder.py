"""Rows of every kind of scheme: state, slope and time, on the host's path and on the serial one."""

from __future__ import annotations

import numpy as np
import pytest

import tparticles as tp
from tparticles import backend, schemes
from tparticles.mesh_motion import MeshMotion
from tparticles.stepping import staged
from tparticles.stepping.rows import Request, Rows

GRAVITY = np.array([0.0, 0.0, -9.81])


class Sink:
    """Keeps all rows; holds few at a time."""

    def __init__(self, vertices: int, rows: int = 5):
        self.rows = Rows(
            np.zeros((3, rows, 3, vertices)), np.zeros((rows, 3)), np.zeros(rows, np.int64), np.zeros(rows), np.zeros(rows),
            np.zeros((65, 12)),
        )  # fmt: skip
        self.found: list[tuple[np.ndarray, ...]] = []

    def take(self) -> Rows:
        self.rows.filled, self.rows.events[0, 0] = 0, 0
        return self.rows

    def give(self, rows: Rows) -> None:
        n = rows.filled
        self.found += [
            (rows.step[k], rows.time[k], rows.state[:, k].transpose(0, 2, 1).copy(), rows.energy[k].copy())
            for k in range(n)
        ]

    def rewind(self, rows: int, time: float) -> None:
        del self.found[rows:]


def run(
    scheme: str,
    request_: Request,
    *,
    guard: str = "error",
    dt: float = 0.004,
    stiffness: float = 300.0,
    frames: int = 2,
) -> tuple[list, MeshMotion]:
    mesh = (
        tp.spring_box(stiffness=stiffness, damping=0.0)
        .turned((1, 0.4, 0.2), 30.0)
        .moved((0, 0, 2))
        .launched((1, 0, 0), spin=(1, 2, 3))
    )
    group = tp.MeshGroup(name="box", mesh=mesh, scheme=scheme, guard=guard)
    motion = MeshMotion(
        group, scheme=schemes.get("rk4"), steps=tp.Fixed(dt=dt), clamp="equal", look=tp.Look(), frame=1 / 24,
        record=request_,
    )  # fmt: skip
    sink = Sink(8)
    motion.recorder.sink = sink
    motion.emit(0, 1)
    for n in range(frames):
        motion.advance(n / 24, (n + 1) / 24, np.zeros(1))
    motion.stepper.end_record(frames / 24)
    return sink.found, motion


def slope(mesh, x, v):
    i, j = mesh.springs.T
    d = x[j] - x[i]
    length = np.linalg.norm(d, axis=1)
    pull = (mesh.stiffness * (length - mesh.rest) / length)[:, None] * d
    pull += (mesh.damping * (d * (v[j] - v[i])).sum(1) / length**2)[:, None] * d
    force = np.zeros_like(x)
    np.add.at(force, i, pull)
    np.add.at(force, j, -pull)
    return force / mesh.mass[:, None] + GRAVITY


# that begin with the slope, that do not, that need a start, that reuse the last slope, implicit ones
CASES = [(name, True) for name in ("rk4", "velocity-verlet", "yoshida4", "ab2")] + [
    (name, False) for name in ("velocity-verlet", "yoshida4", "abm4")
]


@pytest.mark.parametrize(("scheme", "serial"), CASES)
def test_rows_hold_state_and_slope(cpu64, monkeypatch, scheme, serial):
    if not serial:
        monkeypatch.setattr(staged, "_WAKE", 0)
    found, motion = run(scheme, Request())
    assert motion.stepper.serial is serial
    assert [row[0] for row in found] == list(range(23))
    assert np.allclose([row[1] for row in found], np.arange(23) / 24 / 11)
    for _, _, (x, v, a), energy in found:
        assert np.allclose(a, slope(motion.mesh, x, v), rtol=1e-9, atol=1e-8)
        assert np.isclose(energy[0], 0.5 * (motion.mesh.mass[:, None] * v * v).sum())
    x, v = motion.system.read()
    assert np.array_equal(found[-1][2][0], x) and np.array_equal(found[-1][2][1], v)


@pytest.mark.parametrize(("scheme", "serial"), CASES)
def test_the_last_row_is_what_a_longer_run_has_there(cpu64, monkeypatch, scheme, serial):
    if not serial:
        monkeypatch.setattr(staged, "_WAKE", 0)
    (short, _), (long, _) = run(scheme, Request(every=4)), run(scheme, Request(every=11), frames=3)
    assert [row[0] for row in short] == [0, 4, 8, 12, 16, 20, 22]
    assert [row[0] for row in long] == [0, 11, 22, 33]
    for ours, theirs in zip(short[-1][2:], long[2][2:], strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


def test_recording_changes_nothing(cpu64):
    (some, motion), (_, other) = (
        run("velocity-verlet", Request()),
        run("velocity-verlet", Request(every=10, ids=np.array([3]))),
    )
    assert np.array_equal(motion.system.read()[0], other.system.read()[0])
    assert len(some) == 23


def test_a_halved_frame_is_recorded_once(cpu64):
    # far beyond the stable step: the guard takes the frame again
    found, motion = run("velocity-verlet", Request(), guard="halve", dt=1 / 96, stiffness=2e5)
    assert motion.stable < 1 / 96
    steps, times = [row[0] for row in found], [row[1] for row in found]
    assert steps == list(range(len(steps))) and len(steps) > 9
    assert (np.diff(times) > 0).all() and times[-1] == 2 / 24
    backend.stop()
