"""The commands on logs: pictures, graphs, exports, a killed run, and what is wrong with a request."""

from __future__ import annotations

import csv
import io
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import FRAMES, Film, pixels

from tparticles import backend
from tparticles.cli import main
from tparticles.errors import RunError
from tparticles.log.read import Log
from tparticles.log.sink import LogWriter

ROOT = Path(__file__).parents[2]


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]):
    """Return a function that runs a command; it returns exit code, stdout and stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        backend.stop()
        capfd.readouterr()
        with pytest.raises(SystemExit) as left:
            main([str(a) for a in arguments])
        captured = capfd.readouterr()
        return int(left.value.code or 0), captured.out, captured.err

    return run


def test_a_replay_shows_the_same_pictures(run, logged: Film, tmp_path: Path):
    out = tmp_path / "frames"
    code, said, _ = run("replay", logged.log, "--out", out, "--threads", 2)
    assert code == 0 and "13 pictures" in said
    for frame in range(1, FRAMES + 1):
        # the replay begins at t = 0
        assert pixels(out / f"{frame + 1:06d}.png") == pixels(logged.folder / f"frames/{frame:06d}.png"), frame


def test_slow_motion_and_another_camera_and_look(run, logged: Film, tmp_path: Path):
    film = tmp_path / "slow.mp4"
    code, said, _ = run(
        "replay", logged.log, "--range", "20-40", "--speed", "0.2", "--camera", "0,-4,2", "--set", "width=0.1", "--size", "64x36",
        "--out", film,
    )  # fmt: skip
    assert code == 0 and film.stat().st_size > 500
    assert "10 pictures" in said or "11 pictures" in said


def test_one_step(run, logged: Film, tmp_path: Path):
    for name, more in (("a", ()), ("b", ("--fov", 20))):
        assert run("replay", logged.log, "--step", 30, "--out", tmp_path / f"{name}.png", *more)[0] == 0
    shown = [pixels(tmp_path / f"{name}.png") for name in "ab"]
    assert len(set(shown)) == 2


def test_plots(run, logged: Film, tmp_path: Path):
    code, said, _ = run(
        "plot", logged.log, "--of", "energy,x,force,speed", "--ids", "0-2", "--out", tmp_path / "box.svg"
    )
    assert code == 0 and "steps of 'box'" in said and b"<svg" in (tmp_path / "box.svg").read_bytes()
    code, *_ = run(
        "plot", logged.log, "--group", "sparks", "--of", "x,T", "--ids", "10-20", "--out", tmp_path / "sparks.png"
    )
    assert code == 0 and (tmp_path / "sparks.png").read_bytes().startswith(b"\x89PNG")


def exported(run, logged: Film, path: Path, kind: str, *options: Any) -> Path:
    code, _, error = run("export", logged.log, "--to", kind, "--out", path, *options)
    assert (code, error) == (0, "")
    return path


def test_folders_may_be_called_as_they_like(run, logged: Film, tmp_path: Path):
    assert run("replay", logged.log, "--range", "1-1", "--out", tmp_path / "run.2", "--size", "64x36")[0] == 0
    (tmp_path / "a.vtu").mkdir()
    exported(run, logged, tmp_path / "a.vtu", "ply", "--range", "1-1")


def test_tables(run, logged: Film, log: Log, tmp_path: Path):
    state = log.meshes["box"].state(4)
    rows = list(
        csv.DictReader(io.StringIO(exported(run, logged, tmp_path / "a.csv", "csv", "--range", "2-6x2").read_text()))
    )
    assert len(rows) == 3 * 8
    mine = [row for row in rows if row["step"] == "4"]
    assert np.allclose([[float(row[c]) for c in ("x", "y", "z")] for row in mine], state.x)
    assert np.allclose(
        [[float(row[c]) for c in ("fx", "fy", "fz")] for row in mine], state.a * log.meshes["box"].mass[:, None]
    )
    energies = list(csv.DictReader(io.StringIO((tmp_path / "a-energy.csv").read_text())))
    assert np.isclose(float(energies[1]["kinetic"]), log.meshes["box"].energy[4, 0])
    with np.load(exported(run, logged, tmp_path / "a.npz", "npz", "--group", "cloth")) as arrays:
        assert arrays["x"].shape == (len(log.meshes["cloth"]), 20, 3)
        assert np.array_equal(arrays["v"][7], log.meshes["cloth"].state(7).v)
    with np.load(exported(run, logged, tmp_path / "b.npz", "npz", "--group", "sparks")) as arrays:
        assert arrays["count"].sum() == len(arrays["x"]) and len(arrays["frame"]) == FRAMES


@pytest.mark.parametrize("kind", ["ply", "vtu"])
@pytest.mark.parametrize("group", ["box", "sparks"])
def test_meshes_for_others(run, logged: Film, log: Log, tmp_path: Path, kind: str, group: str):
    meshio = pytest.importorskip("meshio")
    folder = exported(run, logged, tmp_path / "out", kind, "--group", group, "--range", "2-4x2")
    unit = log.groups[group].unit
    files = sorted(folder.glob(f"*.{kind}"))
    assert [file.name for file in files] == [f"{unit}-00000{n}.{kind}" for n in (2, 4)]
    found, state = meshio.read(files[1]), log.groups[group].state(4 if group == "box" else 3)
    assert np.allclose(found.points, state.x)
    assert "id" in found.point_data
    if kind == "vtu":
        assert np.allclose(found.point_data["v"], state.v)
        assert "timestep" in (folder / "out.pvd").read_text()


@pytest.mark.parametrize("group", ["box", "cloth", "sparks"])
def test_usd_opens_with_ids_velocities_widths_and_colours(run, logged: Film, log: Log, tmp_path: Path, group: str):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    path = exported(run, logged, tmp_path / "a.usdc", "usd", "--group", group, "--range", "2-8x3")
    stage = Usd.Stage.Open(str(path))
    points = UsdGeom.Points(stage.GetDefaultPrim())
    times = points.GetPointsAttr().GetTimeSamples()
    assert len(times) == 3 and UsdGeom.GetStageUpAxis(stage) == "Z"
    logged_group = log.groups[group]
    state = logged_group.state(int(np.flatnonzero(logged_group.step == 5)[0]))
    assert np.isclose(times[1], state.time * 24)
    at = times[1]
    assert np.allclose(points.GetPointsAttr().Get(at), state.x)
    assert np.allclose(points.GetVelocitiesAttr().Get(at), state.v)
    ids = np.arange(len(state.x)) if group != "sparks" else state.columns["id"][:, 0]
    assert np.array_equal(points.GetIdsAttr().Get(at), ids)
    widths, colors = np.array(points.GetWidthsAttr().Get(at)), np.array(points.GetDisplayColorAttr().Get(at))
    assert widths.shape == (len(state.x),) and (widths > 0).all()
    assert colors.shape == (len(state.x), 3) and (colors >= 0).all() and (colors <= 1).all() and colors.max() > 0.1
    assert points.GetDisplayColorPrimvar().GetInterpolation() == "vertex"


def test_the_log_of_a_killed_run_opens(run, logged: Film, log: Log, tmp_path: Path):
    out = tmp_path / "out"
    arguments = [
        "render",
        str(logged.script),
        "--log",
        "--out",
        str(out),
        "--arch",
        "cpu",
        "--threads",
        "2",
        "--no-mp4",
        "--quiet",
    ]
    # as long as there is nobody to see it end: it stops behind its tenth frame
    held = (
        "import time, tparticles.simulation as s; do = s.Simulation.advance_to\n"
        "def slow(self, n, **k):\n    if n > 10: time.sleep(600)\n    r = do(self, n, **k); time.sleep(0.2); return r\n"
        "s.Simulation.advance_to = slow\nfrom tparticles.cli import main; main()"
    )
    process = subprocess.Popen([sys.executable, "-c", held, *arguments], env=os.environ | {"PYTHONPATH": str(ROOT)})
    until = time.monotonic() + 100
    while not (out / "frames/000010.png").is_file() and time.monotonic() < until:
        assert process.poll() is None
        time.sleep(0.05)
    process.kill()
    process.wait()
    while True:  # the writer may have some rows left
        with Log(out / "log.unfinished.h5") as killed:
            count = len(killed.meshes["cloth"])
            if count > 20 or time.monotonic() > until:
                break
        time.sleep(0.1)
    with Log(out / "log.unfinished.h5") as killed:
        assert not killed.complete
        for name, mesh in killed.meshes.items():
            assert len(mesh) > 20, name
            assert np.array_equal(mesh.step, np.arange(len(mesh)))
            for row in (0, len(mesh) - 1):
                assert np.array_equal(mesh.state(row).x, log.meshes[name].state(row).x)
        assert len(killed.particles["sparks"]) >= 9
    code, *_ = run("replay", out / "log.unfinished.h5", "--step", 20, "--out", tmp_path / "a.png")
    assert code == 0 and (tmp_path / "a.png").is_file()


BAD = (
    (("replay", "nothing.h5"), "does not exist"),
    (("replay", "{script}"), "no log of tparticles"),
    (("replay", "{folder}"), "did you mean"),
    (("replay", "{log}", "--step", "99999"), "leaves the log"),
    (("replay", "{log}", "--range", "1-"), "exists"),
    (("replay", "{log}", "--step", "3", "--out", "a.mp4"), "--step"),
    (("replay", "{log}", "--out", "x.gif"), "--out x.gif: a .mp4, a .png of a --step, or a folder is written, and no .gif"),
    (("replay", "{log}", "--out", "x.MP4"), "and no .MP4"),
    (("replay", "{log}", "--size", "33x17", "--out", "y.mp4"), "34x18 (or a folder of pictures: --out FOLDER)"),
    (("replay", "{log}", "--speed", "0"), "--speed"),
    (("replay", "{log}", "--camera", "1,2"), "X,Y,Z"),
    (("replay", "{log}", "--set", "widht=2", "--out", "a.mp4"), "did you mean 'width'"),
    (("plot", "{log}", "--of", "enrgy"), "did you mean 'energy'"),
    (("plot", "{log}", "--of", "v", "--ids", "8"), "not in the log, which has 0-7"),
    (("plot", "{log}", "--ids", "x", "--out", "a.png"), "ids 'x'"),
    (("plot", "{log}", "--group", "bax", "--out", "a.png"), "did you mean 'box'"),
    (("plot", "{log}", "--out", "a.jpg"), ".svg"),
    (("plot", "{log}", "--range", "5-5", "--out", "a.png"), "one step of 'box' makes no graph over time: two are needed"),
    (("export", "{log}", "--to", "uds"), "did you mean 'usd'"),
    (("export", "{log}", "--to", "usd", "--out", "a.obj"), ".usda"),
    (("export", "{log}", "--to", "npz", "--out", "a.csv"), "--out a.csv: npz is written, a file, and no .csv"),
    (("export", "{log}", "--to", "csv", "--out", "a.npz"), "csv is written"),
    (("export", "{log}", "--to", "vtu", "--out", "a.vtu"), "--out a.vtu: vtu is written, into a folder, and no .vtu"),
    (("export", "{log}", "--to", "csv", "--out", "no/where.csv"), "no folder"),
    (("render", "{script}", "--log-every", "2"), "without --log"),
    (("render", "{script}", "--log", "--log-group", "bux", "--out", "o"), "did you mean 'box'"),
    (("render", "{script}", "--log", "--log-ids", "5,900", "--log-group", "box", "--out", "o"), "vertices 0-7"),
    (("render", "{script}", "--log", "--shards", "2", "--out", "o"), "take --log-group box --log-group cloth"),
    (("render", "{script}", "--log", "--log-group", "bax", "--shards", "2", "--out", "o"), "did you mean 'box'"),
    (("render", "{script}", "--log", "--log-group", "box", "--shards", "2", "--shard", "2", "--out", "o"), "--shard 2"),
    (("render", "{script}", "--log", "--shards", "2", "--shard", "merge", "--out", "o"), "where you merge"),
)  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "part"), BAD, ids=lambda value: None if isinstance(value, str) else " ".join(value)
)
def test_bad_input_is_one_line(run, logged: Film, tmp_path: Path, monkeypatch, arguments, part):
    monkeypatch.chdir(tmp_path)
    if part == "exists":
        (logged.folder / "replay.mp4").write_bytes(b"mine")
    places = {"log": logged.log, "folder": logged.folder, "script": logged.script}
    code, out, error = run(*(argument.format(**places) for argument in arguments))
    assert (code, out) == (2, "")
    assert not list(tmp_path.iterdir())
    (line,) = error.splitlines()
    assert line.startswith("error: ") and part in line


def test_missing_libraries_and_other_versions(run, logged: Film, tmp_path: Path, monkeypatch):
    import h5py

    path = tmp_path / "new.h5"
    path.write_bytes(logged.log.read_bytes())
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 99
    assert "version 99" in run("plot", path)[2]
    with h5py.File(tmp_path / "other.h5", "w"):
        pass
    assert "no log of tparticles" in run("plot", tmp_path / "other.h5")[2]
    for extra, arguments in (
        ("log", ("plot", logged.log, "--out", tmp_path / "a.png")),
        ("export", ("export", logged.log, "--to", "usd", "--out", tmp_path / "a.usd")),
        ("export", ("export", logged.log, "--to", "vtu", "--out", tmp_path / "vtu")),
    ):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, {"log": "h5py"}.get(extra, "pxr" if "usd" in arguments else "meshio"), None)
            code, _, error = run(*arguments)
        assert code == 2 and f"pip install 'tparticles[{extra}]'" in error


def test_a_changed_script_is_refused(run, logged: Film, tmp_path: Path):
    before = logged.script.read_text()
    try:
        logged.script.write_text(before + "\n# another\n")
        code, _, error = run("replay", logged.log, "--step", 3, "--out", tmp_path / "a.png")
        assert code == 2 and "--changed" in error
        assert run("replay", logged.log, "--step", 3, "--out", tmp_path / "a.png", "--changed")[0] == 0
    finally:
        logged.script.write_text(before)


def test_a_log_that_cannot_be_written(tmp_path: Path):
    log = LogWriter(tmp_path / "no/log.h5", {}, [], [])
    with pytest.raises(RunError, match=r"cannot write .*no/log\.h5"):
        log.close(complete=True)


def test_blender_opens_the_points(run, logged: Film, tmp_path: Path):
    bpy = pytest.importorskip("bpy", reason="Blender's Python module (pip install bpy) is not installed")
    path = exported(run, logged, tmp_path / "a.usdc", "usd", "--range", "2-8x3")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=str(path))
    found = bpy.data.objects["box"]
    assert found.type in ("POINTCLOUD", "MESH")
    assert {"velocity", "id", "displayColor", "radius"} <= set(found.data.attributes.keys())
    assert len(found.data.attributes["position"].data) == 8


def test_a_full_disk_is_told_in_one_line(logged: Film, tmp_path: Path):
    small = tmp_path / "small"
    small.mkdir()
    # the mount lives and dies with the shell's own name space
    shell = f'mount -t tmpfs -o size=200k none "{small}" || exit 77; exec "$@"'
    render = [
        sys.executable,
        "-m",
        "tparticles",
        "render",
        logged.script,
        "--out",
        small / "o",
        "--no-mp4",
        "--log",
        "--quiet",
    ]
    done = subprocess.run(
        ["unshare", "--map-root-user", "--mount", "sh", "-c", shell, "sh", *map(str, render)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip(f"cannot mount a tmpfs: {done.stderr.strip()}")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: cannot write") and "No space left on device" in line
