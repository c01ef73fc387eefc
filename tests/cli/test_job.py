"""Jobs, on which batches stand: what makes two renders the same one, scripts and their text, and what a job refuses."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import ROOT, Run, Write
from PIL import Image

import tparticles as tp
from tparticles import library
from tparticles.describe import toml
from tparticles.errors import InputError
from tparticles.job import Job, Options
from tparticles.shoot import merged

PNG = {"mp4": False}


def identity(path: Path, **options: object) -> str:
    return Job(str(path), Options(**PNG | options)).identity  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "options",
    [
        {"frames": "2-4"},
        {"settings": {"rate": "60"}},
        {"settings": {"rate": 60.0}},
        {"seed": 1},
        {"fps": "24/1"},
        {"size": (64, 36)},
        {"out": Path("elsewhere")},
        {"threads": 1},
        {"states": True},
        {"mp4": True},
    ],
    ids=str,
)
def test_what_changes_no_picture_changes_no_identity(scene: Write, options: dict[str, object]) -> None:
    path = scene()
    assert identity(path, **options) == identity(path)


def test_drag_too_stiff_for_the_usual_steps_is_refused_in_every_quality(scene: Write) -> None:
    path = scene(system="tp.Newtonian(forces=(tp.Gravity(), tp.Drag(time=1e-4)))")
    for quality in ("draft", "final"):
        film = Job(str(path), Options(**PNG, quality=quality)).scene  # type: ignore[arg-type]
        with pytest.raises(InputError, match=r"velocities relax at .* use StabilityLimit"):
            tp.Simulation(film, size=(64, 36), arch="cpu")


def test_what_steps_a_film_whose_script_does_not_say(scene: Write, tmp_path: Path) -> None:
    path = scene()
    text = path.read_text()

    def stepped(path: Path, **options: object) -> tuple[str, object]:
        found = Job(str(path), Options(**PNG | options)).scene  # type: ignore[arg-type]
        return found.scheme.name, found.steps

    usual, chosen = ("rk4", tp.Fixed(dt=1 / 96)), ("abm5-pec", tp.PixelTolerance(px=0.5))
    assert (stepped(path), stepped(path, quality="draft")) == (chosen, usual)
    assert stepped(path, scheme="rk4") == usual  # which fits any scheme
    assert identity(path, quality="draft", scheme="rk4") == identity(path, quality="draft")
    mesh = 'tp.MeshGroup(name="box", mesh=tp.spring_box().moved((0, 0, 2)){})'
    for own, found in (
        ("", usual),
        (", steps=tp.Fixed(dt=1 / 240)", usual),
        (', scheme="rk4", steps=tp.Fixed(dt=1 / 240)', chosen),
    ):
        assert stepped(scene("boxes", groups=f"(group, {mesh.format(own)})")) == found
    for said in ('scheme="rk4"', "steps=tp.Fixed(dt=1 / 96)", 'clamp="slide32"'):
        said_path = tmp_path / "said.py"
        said_path.write_text(text.replace("return tp.Scene(", f"return tp.Scene({said}, "))
        assert stepped(said_path) == usual
        data = tmp_path / "said.toml"
        if "clamp" not in said:
            data.write_text(toml(str(said_path), settings={}, quality="final"))
            assert stepped(data) == usual


@pytest.mark.parametrize(
    "options",
    [
        {"settings": {"rate": 61.0}},
        {"settings": {"note": "x"}},
        {"seed": 2},
        {"fps": 25},
        {"size": (66, 36)},
        {"scheme": "euler"},
        {"precision": "f64"},
        {"quality": "draft"},
    ],
    ids=str,
)
def test_what_changes_the_pictures_changes_the_identity(scene: Write, options: dict[str, object]) -> None:
    path = scene()
    assert identity(path, **options) != identity(path)


def test_another_text_or_place_of_a_script(scene: Write, tmp_path: Path) -> None:
    first = identity(scene())
    (tmp_path / "moved").mkdir()
    assert identity(scene("moved/tiny")) == first
    assert identity(scene(head="# another text")) != first


def test_what_a_script_reads_is_part_of_the_identity(scene: Write, tmp_path: Path) -> None:
    (tmp_path / "wind.txt").write_text("1.0")
    head = "from pathlib import Path\nwind = float(Path('wind.txt').read_text())"
    path = scene(head=head, system="tp.Advected(flow=tp.Uniform(wind=(wind, 0.0, 0.0)))")
    first = identity(path)
    assert identity(path) == first
    (tmp_path / "wind.txt").write_text("2.0")
    assert identity(path) != first


def test_a_background_is_part_of_the_identity(scene: Write, tmp_path: Path) -> None:
    path = scene(more=", background=tp.Picture(path='sky.png')")
    found = set()
    for value in (0, 200, 0):
        Image.fromarray(np.full((4, 4, 3), value, np.uint8)).save(tmp_path / "sky.png")
        found.add(identity(path))
    assert len(found) == 2


def test_the_identity_is_the_same_in_any_process(scene: Write) -> None:
    paths = [str(scene(law="x")), *(str(p) for p in sorted((ROOT / "scenes").glob("*.py")))]
    code = "import sys; from tparticles.job import *; [print(Job(p, Options()).identity) for p in sys.argv[1:]]"
    runs = [
        subprocess.run(
            [sys.executable, "-c", code, *paths],
            env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    ]
    assert runs[0] == runs[1]
    assert len(set(runs[0].split())) == len(paths)


def test_a_script_edited_within_a_second_is_the_new_one(scene: Write) -> None:
    path = scene(head="x = 1")
    before = path.stat()
    assert vars(sys.modules[library.load(str(path)).function.__module__])["x"] == 1
    scene(head="x = 2")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    script = library.load(str(path))
    assert vars(sys.modules[script.function.__module__])["x"] == 2
    assert not list(path.parent.rglob("__pycache__"))


def test_the_text_that_was_run_decides_the_identity(scene: Write) -> None:
    path = scene()
    job = Job(str(path), Options(mp4=False))
    path.write_text("")
    assert job.script.source.startswith('"""A tiny film."""')
    assert job._identity() == job.identity


def test_a_part_of_a_film_has_a_name_of_its_own(scene: Write) -> None:
    path = scene()
    names = {
        f: Job(str(path), Options(frames=f)).film_path.name
        for f in ("1-", "1-6", "1-3,4-6", "1-2", "1,2", "1-5x2", "3")
    }
    assert names["1-"] == names["1-6"] == names["1-3,4-6"] == "tiny.mp4"
    assert names["1-2"] == names["1,2"] == "tiny.frames-1-2.mp4"
    assert (names["1-5x2"], names["3"]) == ("tiny.frames-1-5x2.mp4", "tiny.frames-3.mp4")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"quality": "best"}, "unknown quality 'best'"),
        ({"arch": "metal"}, "unknown arch 'metal'"),
        ({"precision": "f16"}, "unknown precision 'f16'"),
        ({"threads": 0}, "threads = 0"),
        ({"mp4": False, "png": False}, "nothing to write"),
        ({"size": (0, 5)}, r"Scene\.size\[0\] = 0"),
        ({"settings": {"rate": True}}, "valid number"),
        ({"frames": ""}, "is no range"),
    ],
)
def test_a_job_refuses_what_the_command_line_would(scene: Write, options: dict[str, object], said: str) -> None:
    path = scene()
    with pytest.raises(InputError, match=said):
        Job(str(path), Options(**options))  # type: ignore[arg-type]


def test_a_picture_too_large_for_the_machine_is_refused(scene: Write, monkeypatch) -> None:
    monkeypatch.setattr(os, "sysconf", lambda name: {"SC_PHYS_PAGES": 2**18, "SC_PAGE_SIZE": 4096}[name])
    with pytest.raises(InputError, match=r"16384x16384: that takes 17\.5 GiB, this machine has 1\.0 GiB"):
        Job(str(scene()), Options(size=(16384, 16384), mp4=False))


def test_groups_are_merged_into_one_table() -> None:
    a = {"id": np.array([1, 2]), "x": np.ones((2, 3)), "v": np.zeros((2, 3))}
    b = {"id": np.array([7]), "x": np.full((1, 3), 5.0)}
    table = merged({"a": a, "b": b})
    assert table["groups"].tolist() == ["a", "b"]
    assert table["group"].tolist() == [0, 0, 1]
    assert table["id"].tolist() == [1, 2, 7]
    assert table["x"].shape == table["v"].shape == (3, 3)
    assert np.isnan(table["v"][2]).all()


PARAMETERS = """
from __future__ import annotations
from typing import Annotated, Literal
from pydantic import Field

def scene(quality, *, a=1, b=None, c: Literal["x", "y"] = "x", d: Annotated[float, Field(gt=0)] = 1.0) -> Nowhere:
    pass
"""


def test_parameters_take_their_type_from_annotation_or_default(tmp_path: Path) -> None:
    (tmp_path / "t.py").write_text(PARAMETERS)
    script = library.load("t.py")
    assert {n: p.type_name for n, p in script.parameters.items()} == {
        "a": "int",
        "b": "Any",
        "c": "Literal['x', 'y']",
        "d": "float",
    }
    assert script.values({"b": "[1]", "c": "y"}) == {"a": 1, "b": [1], "c": "y", "d": 1.0}
    with pytest.raises(InputError, match=r"scene 't': parameter d = -1: should be greater than 0 \(float\)"):
        script.settings({"d": "-1"})


def test_an_outline_needs_no_run(tmp_path: Path) -> None:
    (tmp_path / "t.py").write_text(
        '"""Words.\n\nMore."""\nRATE = 2\nraise SystemExit\ndef scene(q, *, a=RATE, b=(1, 2)): pass\n'
    )
    found = library.outline(tmp_path / "t.py")
    assert (found.summary, found.parameters, found.error) == ("Words.", {"a": "RATE", "b": (1, 2)}, "")
    (tmp_path / "t.py").write_text("from elsewhere import film as scene\n")
    assert library.outline(tmp_path / "t.py").error == ""
    (tmp_path / "t.py").write_text("(" * 2000)
    assert "t.py" in library.outline(tmp_path / "t.py").error


MESHES = '''"""Two boxes."""
import tparticles as tp


def scene(quality):
    def box(name, **options):
        mesh = tp.spring_box(stiffness=1e4).moved((0, 0, 2))
        return tp.MeshGroup(name=name, mesh=mesh, steps=tp.Fixed(dt=1 / 240), **options)

    return tp.Scene(
        groups=(box("stiff", scheme="sdirk2"), box("plain")), scheme="midpoint", duration=0.5, size=(64, 36),
        camera=tp.Camera(position=(0, -6, 1), target=(0, 0, 1)),
    )
'''


def test_run_json_tells_each_mesh_s_scheme_and_what_its_solver_did(tmp_path: Path) -> None:
    path, told = tmp_path / "boxes.py", []
    path.write_text(MESHES)
    job = Job(str(path), Options(out=tmp_path / "out", frames="1-2", scheme="rk4", arch="cpu", **PNG))  # type: ignore[arg-type]
    run = job.run(tell=told.append)
    assert {name: mesh["scheme"] for name, mesh in run["meshes"].items()} == {"stiff": "sdirk2", "plain": "rk4"}
    assert all("Fixed" in mesh["steps"] for mesh in run["meshes"].values())
    for row in run["frames"]:
        ((name, solves),) = row["solves"].items()
        assert name == "stiff" and solves["method"] in ("direct", "cg") and "CG iterations" in solves["why"]
        # two stages a step, ten steps
        assert solves["newton"] >= 20 and 0 <= solves["residual"] <= 0.1
    assert told == ["--scheme rk4 is not for group 'stiff', which has a scheme of its own: sdirk2"]
    with Image.open(tmp_path / "out/frames/000001.png") as picture:
        assert picture.text["Scheme"] == "rk4, stiff: sdirk2"  # type: ignore[attr-defined]


def test_it_is_said_once_which_solver_implicit_stages_take(run: Run, tmp_path: Path) -> None:
    (tmp_path / "boxes.py").write_text(MESHES)
    command = ("render", "boxes.py", "--no-mp4", "--existing", "overwrite", "--frames", "1-2")
    assert run(*command).err.count("boxes: group 'stiff': implicit stages by the ") == 1
    assert run(*command, "--quiet").err == ""
