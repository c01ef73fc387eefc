"""What a log holds, against the simulation and against NumPy."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from conftest import FRAMES, Film, film, refused

from tparticles import backend
from tparticles.job import Job, Options
from tparticles.log.read import Log, row_range
from tparticles.log.sink import LogWriter
from tparticles.log.source import Logging, numbers
from tparticles.systems.spring_mesh import energies


def scene(logged):
    return Job(str(logged.script), Options(out=logged.folder, mp4=False)).scene


def test_rows_are_all_steps(log: Log):
    for mesh, dt in ((log.meshes["box"], 0.004), (log.meshes["cloth"], None)):
        assert np.array_equal(mesh.step, np.arange(len(mesh)))
        assert (mesh.time[0], mesh.time[-1], mesh.dt[-1]) == (0.0, 0.5, 0.0)
        assert np.allclose(np.diff(mesh.time), mesh.dt[:-1], rtol=1e-9)
        assert dt is None or mesh.dt[:-1].max() <= dt
    assert log.complete


def test_state_slope_and_energies(log: Log, logged: Film):
    spec = next(g for g in scene(logged).meshes if g.name == "cloth")
    mesh = log.meshes["cloth"]
    whole = np.ones(spec.mesh.spring_count, bool)
    i, j = spec.mesh.springs.T
    for row in (0, len(mesh) // 3, len(mesh) - 1):
        state = mesh.state(row)
        expected = list(energies(spec.mesh, state.x, state.v, whole, spec.gravity).values())
        assert np.allclose(mesh.energy[row], expected, rtol=1e-4, atol=1e-7)
        d = (state.x[j] - state.x[i]).astype(float)
        length = np.linalg.norm(d, axis=1)
        pull = (spec.mesh.stiffness * (length - spec.mesh.rest) / length)[:, None] * d
        force = mesh.mass[:, None] * spec.gravity
        np.add.at(force, i, pull)
        np.add.at(force, j, -pull)
        assert np.allclose(mesh.mass[:, None] * state.a, force, rtol=1e-3, atol=1e-4)


def test_contacts(log: Log):
    box = log.meshes["box"]
    step, time, _, *_ = contacts = box.contacts.T
    after, height, down, up = time - box.time[step.astype(int)], contacts[5], contacts[8], contacts[11]
    assert len(step) > 3 and box.contacts_lost == 0
    assert (np.diff(time) >= 0).all()
    assert (after >= -1e-9).all() and (after <= box.dt.max() + 1e-9).all()
    assert np.abs(height).max() < 1e-4
    assert (down < 0).all() and (up >= 0).all()


def test_particles_are_logged_every_frame(log: Log):
    sparks = log.particles["sparks"]
    assert np.array_equal(sparks.step, np.arange(1, FRAMES + 1))
    state = sparks.state(5)
    assert state.v is not None and len(state.x) == len(state.columns["id"]) > 20
    age = state.time - state.columns["birth"][:, 0]
    assert (age >= 0).all() and (age <= 0.2).all()
    # closed form: free fall from the origin
    assert np.allclose(state.x, age[:, None] * state.v + 0.5 * age[:, None] ** 2 * [0, 0, 9.81], atol=1e-4)
    assert np.allclose(state.columns["T"], state.columns["T0"] * np.exp(-age / 0.5)[:, None], rtol=0.5)


def test_pictures_are_the_same_without_a_log(logged: Film):
    backend.stop()
    plain = film(logged.folder.parent / "plain", None)
    assert [row["sha256"] for row in plain.run["frames"]] == [row["sha256"] for row in logged.run["frames"]]


def test_between_rows(log: Log):
    cloth = log.meshes["cloth"]
    a, b = cloth.state(10), cloth.state(11)
    t = (a.time + b.time) / 2
    # a cubic is exact for what falls
    fallen = a.x[0] + (t - a.time) * a.v[0] + 0.5 * (t - a.time) ** 2 * a.a[0]
    assert np.allclose(cloth.at(t).x[0], fallen, atol=1e-6)
    assert np.array_equal(cloth.at(b.time).x, b.x)
    sparks = log.particles["sparks"]
    early, late = sparks.state(3), sparks.state(4)
    half = sparks.at((early.time + late.time) / 2)
    shared, here, there = np.intersect1d(early.columns["id"], half.columns["id"], return_indices=True)
    assert len(shared) == len(early.x)  # who dies later still flies
    assert len(half.x) > len(early.x)  # somebody is born meanwhile
    h = half.time - early.time
    error = np.abs(half.x[there] - (early.x + h * early.v + 0.5 * h**2 * np.array([0, 0, -9.81]))[here]).max(axis=1)
    lives = np.isin(early.columns["id"][here, 0], late.columns["id"])
    assert error[lives].max() < 1e-5 and error.max() < 0.51 * 9.81 * h**2  # who dies meanwhile flies straight on


def test_chosen_steps_and_vertices(logged: Film, log: Log):
    backend.stop()
    some = film(logged.folder.parent / "some", Logging(every=7, ids="1-2,5", groups=("box",)))
    with Log(some.log) as part:
        assert list(part.groups) == ["box"]
        box, whole = part.meshes["box"], log.meshes["box"]
        assert box.ids.tolist() == [1, 2, 5]
        last = whole.step[-1]
        assert box.step.tolist() == sorted({*range(0, last, 7), last})
        for row in (0, 5, len(box) - 1):
            state, same = box.state(row), whole.state(int(box.step[row]))
            assert np.array_equal(state.x, same.x[[1, 2, 5]]) and np.array_equal(state.a, same.a[[1, 2, 5]])
        assert np.array_equal(box.energy[3], whole.energy[21])


def header(vertices: int) -> dict:
    """Return what a log is told of a mesh of vertices in a row."""
    arrays = {name: np.ones(vertices) for name in ("mass", "rest", "stiffness", "damping")}
    arrays |= {"id": np.arange(vertices), "springs": np.array([[0, 1]]), "faces": np.zeros((0, 3))}
    attributes = {"vertices": vertices, "scheme": "rk4"}
    return {"name": "two", "vertices": vertices, "kind": "f4", "attributes": attributes, "arrays": arrays}


def test_the_file_follows_what_it_is_told(tmp_path):
    writer = LogWriter(tmp_path / "log.h5", {"groups": ["two"]}, [header(2)], [])
    (sink,) = writer.sinks

    def give(first: int, count: int) -> None:
        rows = sink.take()
        rows.step[:count] = rows.time[:count] = first + np.arange(count)
        rows.state[:, :count], rows.dt[:count], rows.filled = 7.0 * first, 1.0, count
        rows.events[0, 0] = 2
        rows.events[1:3] = [[first, first + 0.6, 1] + [0.0] * 9, [first, first + 0.5, 0] + [0.0] * 9]
        sink.give(rows)

    for n in range(12):  # more blocks than there are
        give(10 * n, 10)
    sink.rewind(85, 85.0)
    writer.torn(0, 84.5, np.array([0]))
    give(85, 3)
    writer.close(complete=True)
    with Log(tmp_path / "log.h5") as log:
        two = log.meshes["two"]
        assert two.step.tolist() == list(range(88))
        assert [two.state(n).x[0, 0] for n in (0, 19, 84, 85)] == [0.0, 70.0, 560.0, 595.0]
        assert two.contacts[:, 1].tolist() == sorted(
            [10.0 * n + d for n in range(9) for d in (0.5, 0.6)] + [85.5, 85.6]
        )
        assert (two.torn(84.0).tolist(), two.torn(85.0).tolist()) == ([], [0])


def test_what_does_not_get_smaller_is_not_compressed(tmp_path):
    vertices = 4096
    noise = np.random.default_rng(0).random((40, 3, vertices), np.float32)
    calm = np.full_like(noise, 0.5)
    writer = LogWriter(tmp_path / "log.h5", {"groups": ["two"]}, [header(vertices)], [])
    (sink,) = writer.sinks

    def give(first: int, last: int) -> None:
        rows, count = sink.take(), last - first
        rows.step[:count] = rows.time[:count] = np.arange(first, last)
        rows.dt[:count], rows.filled = 1.0, count
        for n, values in enumerate((noise, calm, noise if first < 20 else calm)):
            rows.state[n, :count] = values[first:last]
        sink.give(rows)

    # chunks of 5 rows: whole ones, parts, more than one of either, rows that are taken back
    for first, last in ((0, 15), (15, 17), (17, 31), (31, 32), (32, 38)):
        give(first, last)
    sink.rewind(23, 23.0)
    give(23, 40)
    writer.close(complete=True)
    with Log(tmp_path / "log.h5") as log:
        two = log.meshes["two"]
        wanted = [noise, calm, np.concatenate([noise[:23], calm[23:]])]
        for row in range(40):
            state = two.state(row)
            for found, values in zip((state.x, state.v, state.a), wanted, strict=True):
                assert np.array_equal(found.T, values[row])
    with h5py.File(tmp_path / "log.h5") as file:
        x, v, a = (file["meshes/two"][name].id.get_storage_size() / noise.nbytes for name in "xva")
    assert v < 0.05 < 0.5 < a < 0.8 < x < 1.05


@pytest.mark.parametrize("last", [10, 13, 15, 17])
def test_rows_are_taken_back_from_the_chunk_that_was_written_last(tmp_path, last):
    """A chunk of 5 rows of noise, written as it is, or a part of one."""
    noise = np.random.default_rng(1).random((last, 3, 4096), np.float32)
    writer = LogWriter(tmp_path / "log.h5", {"groups": ["two"]}, [header(4096)], [])
    (sink,) = writer.sinks
    for first, end in ((0, last), (last - 3, last), (last - 3, last)):
        rows, count = sink.take(), end - first
        rows.step[:count] = rows.time[:count] = np.arange(first, end)
        rows.state[:, :count], rows.filled = noise[first:end], count
        sink.give(rows)
        sink.rewind(last - 3, last - 3.0)
    writer.close(complete=True)
    with Log(tmp_path / "log.h5") as log:
        two = log.meshes["two"]
        assert two.step.tolist() == list(range(last - 3))
        assert all(np.array_equal(two.state(row).a.T, noise[row]) for row in range(last - 3))


@pytest.mark.parametrize(("text", "found"), [("0-3", [0, 1, 2, 3]), ("4,1-2, 2", [1, 2, 4]), ("7", [7])])
def test_numbers(text, found):
    assert numbers(text) == found


@pytest.mark.parametrize("text", ["", "a", "3-1", "1-", "-1", "1,,2", "1.5"])
def test_no_numbers(text):
    with refused("ids"):
        numbers(text)


def test_row_ranges(log: Log):
    box = log.meshes["box"]
    assert row_range("10-20x5", box).tolist() == [10, 15, 20]
    assert row_range("7", box).tolist() == [7]
    assert len(row_range(None, box)) == len(box)
    assert row_range(f"{len(box) - 2}-", box).tolist() == [len(box) - 2, len(box) - 1]
    for text, part in (
        ("5-999999", "leaves the log"),
        ("9-3", "is empty"),
        ("x", "are needed"),
        ("1-2x0", "is empty"),
        ("", "needed"),
    ):
        with refused("range", part):
            row_range(text, box)
