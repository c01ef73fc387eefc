"""Scenes written as documents: the same scene again to the last bit, and the built-in ones in both forms, pixel for pixel."""

from __future__ import annotations

import dataclasses
import json
import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import taichi as ti
from documents import FEW, SCRIPTS, TINY, TWINS, built, of_its_own
from hypothesis import given
from hypothesis import strategies as st

import tparticles as tp
from tparticles import backend, schemes
from tparticles.data_scene.files import parse
from tparticles.data_scene.read import read_scene
from tparticles.data_scene.scheme_tables import scheme_value
from tparticles.data_scene.toml import dumps
from tparticles.data_scene.write import write_scene
from tparticles.errors import InputError
from tparticles.physics.mesh_recipe import recipe
from tparticles.scene import QUALITIES

SIZE = (96, 54)
FRAMES = (1,)
EACH = pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)


def again(scene: tp.Scene) -> tp.Scene:
    """Return what the document of a scene describes, by way of TOML; JSON must say the same."""
    document = write_scene(scene)
    found = read_scene(parse(dumps(document), ".toml"))
    assert read_scene(parse(json.dumps(document), ".json")) == found
    return found


def pixels(scene: tp.Scene) -> list[np.ndarray]:
    backend.stop()
    simulation = tp.Simulation(scene, size=SIZE, arch="cpu", threads=2)
    return [frame.image.copy() for frame in simulation.frames(FRAMES)]


@EACH
def test_every_script_without_a_law_of_its_own_is_written_and_read_again(path: Path) -> None:
    if reason := of_its_own(path):
        assert " is a " in reason and "$." in reason
        pytest.skip(reason)
    for quality in QUALITIES:
        scene = built(path, quality, **FEW.get(path.stem, {}))
        found = again(scene)
        assert found == scene
        assert repr(found) == repr(scene)


@EACH
def test_a_script_and_its_document_draw_the_same_pixels(path: Path) -> None:
    if reason := of_its_own(path):
        pytest.skip(reason)
    scene = built(path, "preview", **FEW.get(path.stem, {}))
    first, second = pixels(scene), pixels(again(scene))
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
    assert max(image.max() for image in first) > 60, "black"


@EACH
def test_a_script_without_a_law_of_its_own_has_a_twin(path: Path) -> None:
    twin = path.parent / "data" / f"{path.stem}.toml"
    advice = f"tparticles describe {path.stem} --toml > scenes/data/{path.stem}.toml"
    if reason := of_its_own(path):
        assert not twin.exists(), reason
        return
    assert twin.is_file(), f"make it: {advice}"
    assert repr(built(twin)) == repr(built(path)), f"the script has changed, write it anew: {advice}"
    assert built(twin) == built(path)


def test_every_twin_has_a_script() -> None:
    assert {twin.stem for twin in TWINS} <= {path.stem for path in SCRIPTS}
    assert len(TWINS) >= 3


PATH = tp.Track(keys=((0.0, (0.0, 0.0, 0.0)), (1.0, (0.0, 0.1, 0.0))))


def unnamed(mesh: tp.Mesh) -> tp.Mesh:
    """Return the same mesh without a word of how it was made."""
    return dataclasses.replace(mesh)


def test_a_mesh_is_written_as_its_numbers() -> None:
    mesh = unnamed(tp.cloth(counts=(3, 4), size=1.0, damping=0.1).turned((1.0, 0.2, 0.0), 40.0).driven(PATH, [0, 1]))
    grid = tp.Heightfield(heights=np.linspace(0.0, 1 / 3, 6).reshape(2, 3))
    group = tp.MeshGroup(name="cloth", mesh=mesh, colliders=(grid, tp.Ball(radius=0.1)), temperature=900.0)
    scene = tiny(groups=group, scheme="velocity-verlet")
    assert again(scene) == scene
    assert again(scene).groups[0].mesh.content == mesh.content
    (row,) = write_scene(scene)["groups"]
    assert (row["kind"], row["mesh"]["mass"]) == ("MeshGroup", mesh.mass[0])
    assert "tear" not in row["mesh"], "as by default"


MESHES = (
    (lambda: tp.spring_box(size=(1, 2, 3), tear=0.1), "spring_box", ()),
    (lambda: tp.sphere_shell(subdivisions=np.int64(1)).scaled(1 / 3), "sphere_shell", ("scaled",)),
    (
        lambda: tp.cloth(counts=[3, 4]).turned((0, 1, 0), 30).pin(where=lambda x: x[:, 2] > 0.1),
        "cloth",
        ("turned", "pin"),
    ),
    (lambda: tp.lattice(counts=3).pin(where=tp.Box(low=(-1, -1, -1), high=(0, 0, 0))), "lattice", ("pin",)),
    (lambda: tp.rope(count=5).driven(PATH, range(2)).launched(spin=(0, 0, 1.5)), "rope", ("driven", "launched")),
    (
        lambda: tp.rope().joined(unnamed(tp.rope()).moved((0, 1, 0))).with_springs([[0, 32]], tear=[np.inf], rest=0.5),
        "rope",
        ("joined", "with_springs"),
    ),
)


@pytest.mark.parametrize(
    ("make", "builder", "changes"), MESHES, ids=lambda value: value if isinstance(value, str) else ""
)
def test_a_built_mesh_is_written_by_its_builder(make, builder: str, changes: tuple[str, ...]) -> None:
    mesh = make()
    scene = tiny(groups=tp.MeshGroup(name="mesh", mesh=mesh), scheme="velocity-verlet")
    assert again(scene) == scene
    (row,) = write_scene(scene)["groups"]
    assert row["mesh"]["kind"] == builder and "x" not in row["mesh"]
    assert tuple(change["kind"] for change in row["mesh"].get("then", ())) == changes


def test_a_builder_that_would_make_another_mesh_is_not_named() -> None:
    size = np.array([1.0, 2.0])
    scene = tiny(groups=tp.MeshGroup(name="cloth", mesh=tp.cloth(counts=3, size=size)), scheme="velocity-verlet")
    recipe(scene.groups[0].mesh)[0][1]["size"][:] = 5.0
    (row,) = write_scene(scene)["groups"]
    assert "x" in row["mesh"]
    assert again(scene) == scene


def test_a_mesh_that_tears_in_places() -> None:
    mesh = tp.Mesh(x=[[0, 0, 0], [1, 0, 0], [2, 0, 0]], springs=[[0, 1], [1, 2]], tear=[np.inf, 0.1], mass=[1, 2, 3])
    scene = tiny(groups=tp.MeshGroup(name="rope", mesh=mesh), scheme="velocity-verlet")
    assert again(scene) == scene
    (row,) = write_scene(scene)["groups"]
    assert row["mesh"]["tear"] == ["inf", 0.1]
    assert "rest" not in row["mesh"], "as drawn"


class Breeze:
    @ti.func
    def velocity(self, t, x):
        return x


class MyUniform(tp.Uniform):
    pass


def tiny(**changes: object) -> tp.Scene:
    return dataclasses.replace(read_scene(parse(TINY, ".toml")), **changes)


@pytest.mark.parametrize("law", [Breeze(), MyUniform(), tp.Uniform() + Breeze()], ids=["own", "derived", "in a sum"])
def test_a_law_of_the_scenes_own_is_named(law: object) -> None:
    (group,) = tiny().groups
    scene = tiny(groups=dataclasses.replace(group, system=tp.Advected(flow=law)))
    with pytest.raises(
        InputError, match=r"^\$\.groups\[0\]\.system\.flow(\[1\])? is a \w+, the scene's own, and not one of"
    ):
        write_scene(scene)


@pytest.mark.parametrize("name", schemes.CATALOGUE)
def test_schemes_are_written_by_name_or_by_coefficients(name: str) -> None:
    scheme = schemes.CATALOGUE[name]
    assert scheme_value(scheme, "$") == name
    mine = dataclasses.replace(scheme, name="mine")
    if name in ("velocity-verlet", "beeman", "crenshaw", "milne", "semi-implicit-euler"):
        with pytest.raises(InputError, match=r"^\$\.scheme: scheme 'mine' is no coefficients"):
            scheme_value(mine, "$.scheme")
        return
    table = scheme_value(mine, "$")
    assert table["kind"] in ("adams", "bdf", "runge_kutta", "splitting")
    forces = {"kind": "Newtonian", "forces": {"kind": "Gravity"}}
    document = parse(TINY, ".toml")
    document["groups"][0]["system"] = forces
    document["scheme"] = parse(dumps({"scheme": table}), ".toml")["scheme"]
    assert read_scene(document).scheme == mine


def test_a_starter_of_its_own_is_written_too() -> None:
    scheme = schemes.adams([Fraction(3, 2), Fraction(-1, 2)], name="mine", starter=schemes.get("rk4"))
    assert scheme_value(scheme, "$")["starter"] == "rk4"
    assert again(tiny(scheme=scheme)).scheme == scheme


numbers = st.floats(-1e6, 1e6, allow_subnormal=False)  # Taichi's kernels leave the processor without smaller ones
positive = st.floats(1e-6, 1e6)


@given(st.tuples(numbers, numbers, numbers), positive, st.text(max_size=20), positive, st.integers(0, 2**62))
def test_numbers_and_texts_come_back_to_the_last_bit(
    wind: tuple[float, float, float], size: float, name: str, duration: float, seed: int
) -> None:
    emitter = tp.Emitter(name=name or "x", births=tp.Burst(count=10), size=size)
    (group,) = tiny().groups
    system = tp.Advected(flow=tp.Uniform(wind=wind) + tp.Vortex(circulation=wind[0]))
    group = dataclasses.replace(group, name=name, system=system, emitters=emitter)
    try:
        name.encode()
        scene = tiny(groups=group, duration=duration, seed=seed)
    except (InputError, UnicodeEncodeError):
        return
    found = again(scene)
    assert repr(found) == repr(scene)
    assert math.copysign(1, found.groups[0].system.flow.flows[0].wind[0]) == math.copysign(1, wind[0])


@given(
    st.recursive(
        st.booleans() | st.integers(-(2**62), 2**62) | numbers | st.text(st.characters(exclude_categories=["Cs"])),
        lambda inner: (
            st.lists(inner, max_size=6)
            | st.dictionaries(st.text(st.characters(exclude_categories=["Cs"]), max_size=12), inner, max_size=6)
        ),
        max_leaves=40,
    ).map(lambda value: {"value": value})
)
def test_any_document_comes_back_from_its_toml(document: dict[str, object]) -> None:
    found = parse(dumps(document), ".toml")
    assert json.dumps(found, sort_keys=True) == json.dumps(document, sort_keys=True)
