"""Documents are read as they should, and what is wrong with one is said in a line that begins with its path."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest
from documents import SCRIPT, TINY, tiny

import tparticles as tp
from tparticles import schemes
from tparticles.data_scene import kinds
from tparticles.data_scene.files import parse
from tparticles.data_scene.read import read_scene
from tparticles.errors import InputError


def refusal(document: dict[str, Any]) -> str:
    with pytest.raises(InputError) as refused:
        read_scene(document)
    text = str(refused.value)
    assert "\n" not in text and "pydantic" not in text
    return text


def test_a_document_describes_what_a_script_does() -> None:
    space: dict[str, Any] = {}
    exec(SCRIPT, space)
    scene = read_scene(parse(TINY, ".toml"))
    assert scene == space["scene"]("final")
    assert repr(scene) == repr(space["scene"]("final"))


def test_short_forms() -> None:
    scene = read_scene(
        tiny(
            groups__0__emitters={"births": [{"count": 1e3}], "size": [0.02, 0.01], "lifetime": {"mean": 1}},
            groups__0__system__flow=[{"kind": "Uniform"}, {"kind": "Plume", "power": 20}],
            fps="30000/1001",
            camera__position={"keys": [[0, [0, -5, 0]], [1, [1, -5, 0]]]},
        )
    )
    (emitter,) = scene.groups[0].emitters
    assert emitter.births == (tp.Burst(count=1000),)
    assert emitter.size == tp.Spread(mean=0.02, variance=0.01)
    assert emitter.lifetime == tp.Spread(mean=1.0)
    assert scene.groups[0].system.flow == tp.Uniform() + tp.Plume(power=20.0)
    assert scene.fps == Fraction(30000, 1001)
    assert scene.camera.position == tp.Track(keys=((0.0, (0.0, -5.0, 0.0)), (1.0, (1.0, -5.0, 0.0))))


def test_several_forces() -> None:
    forces = [{"kind": "Gravity"}, {"kind": "Drag", "time": 0.5, "flow": {"kind": "Uniform", "wind": [1, 0, 0]}}]
    system = read_scene(tiny(groups__0__system={"kind": "Newtonian", "forces": forces})).groups[0].system
    assert system.forces == (tp.Gravity(), tp.Drag(time=0.5, flow=tp.Uniform(wind=(1.0, 0.0, 0.0))))


GROUP = "$.groups[0]"
RATE = f"{GROUP}.emitters[0].births.rate"


@pytest.mark.parametrize(
    ("changes", "start", "part"),
    [
        ({"groups__0__emitters__0__births__rate": -1}, f"{RATE} = -1: should be greater than or equal to 0", ""),
        ({"groups__0__emitters__0__births__rate": "60"}, f'{RATE} = "60": should be a', "list"),
        ({"groups__0__emitters__0__births__rate": True}, f"{RATE} = true: should be a", ""),
        ({"groups__0__emitters__0__births__rate": [[0, 1], [1, -2]]}, f"{RATE}[1][1] = -2: should be", ""),
        ({"groups__0__emitters__0__births__kind": "Rat"}, f"{GROUP}.emitters[0].births.kind", "did you mean 'Rate'?"),
        ({"groups__0__emitters__0__births__kind": "Gravity"}, f"{GROUP}.emitters[0].births.kind", "PerFrame, Rate or"),
        ({"groups__0__emitters__0__births__kind": 3}, f"{GROUP}.emitters[0].births.kind = 3: should be", ""),
        ({"groups__0__emitters__0__births": {"rate": 3}}, f"{GROUP}.emitters[0].births.kind is missing", "Rate"),
        ({"groups__0__emitters__0__births": 3}, f"{GROUP}.emitters[0].births = 3: should be a table of kind", "Burst"),
        ({"groups__0__emitters__0__sise": 3}, f"{GROUP}.emitters[0].sise: Emitter has no such key", "mean 'size'?"),
        ({"groups__0__emitters": []}, f"{GROUP}: Group.emitters", "at least 1"),
        ({"groups__0__emitters": [3]}, f"{GROUP}.emitters[0] = 3: should be a table of kind Emitter", ""),
        ({"groups__0__name": 3}, f"{GROUP}.name = 3: should be a valid text", ""),
        ({"groups__0__system__flow": {"kind": "CurlNoice"}}, f"{GROUP}.system.flow.kind", "did you mean 'CurlNoise'?"),
        ({"groups__0__system__flow": []}, f"{GROUP}.system.flow: an empty list is no flow", ""),
        ({"groups__0__system__flow": [{"kind": "ABC", "A": None}]}, f"{GROUP}.system.flow[0].A = null: should be", ""),
        ({"groups__0__lifetme": 3}, f"{GROUP}.lifetme: Group has no such key", "known: name"),
        ({"groups": []}, "$: Scene.groups", "at least 1"),
        ({"groups": 3}, "$.groups = 3: should be a table of kind Group", ""),
        ({"camera__position": [0, 0]}, "$.camera.position", "table of kind Track"),
        ({"camera__position": [0, "a", 0]}, '$.camera.position[1] = "a": should be a number', ""),
        ({"camera": [1, 2, 3]}, "$.camera = [1, 2, 3]: should be a table of kind Camera", ""),
        ({"look": {"tone": "filmc"}}, '$.look.tone = "filmc": should be', "did you mean 'filmic'?"),
        ({"look": {"ev": 400}}, "$.look.ev = 400: should be less than or equal to 40", ""),
        ({"look": {"dither": "yes"}}, '$.look.dither = "yes": should be a valid boolean', ""),
        ({"fps": "fast"}, "$.fps: fps = fast: a number or a fraction", ""),
        ({"fps": True}, "$.fps: fps = True", ""),
        ({"size": [64.5, 36]}, "$.size[0] = 64.5: should be a valid integer", ""),
        ({"seed": -1}, "$.seed = -1: should be greater than", ""),
        ({"scheme": "rk5"}, "$.scheme: unknown scheme 'rk5'; did you mean 'rk4'?", ""),
        ({"scheme": 4}, "$.scheme = 4: should be the name of a scheme", "table of kind adams"),
        ({"clamp": "slide"}, '$.clamp = "slide": should be', "did you mean 'slide32'?"),
        ({"summary": 3}, "$.summary = 3: should be a text, not a number", ""),
        ({"duratoin": 3}, "$.duratoin: Scene has no such key; did you mean 'duration'?", ""),
        ({"odd key": 3}, '$."odd key": Scene has no such key', ""),
        ({"duration": 0.01}, "$: duration = 0.01 s is shorter than one frame", ""),
        (
            {"groups__0__emitters__0__velocity": {"angle": 5}},
            f"{GROUP}: group 'dots', emitter 'emitter'",
            "no velocity",
        ),
    ],
    ids=str,
)
def test_errors_begin_with_their_path(changes: dict[str, Any], start: str, part: str) -> None:
    text = refusal(tiny(**changes))
    assert text.startswith(start), text
    assert part in text


def test_what_is_missing() -> None:
    document = tiny()
    del document["camera"]["target"]
    assert refusal(document).startswith("$.camera.target is missing")
    del document["camera"]
    assert refusal(document) == "$.camera is missing: Scene needs camera"
    assert refusal({}).startswith("$.groups is missing: Scene needs groups and camera")


HEUN = {"kind": "runge_kutta", "name": "mine", "a": [[], [1]], "b": ["1/2", "1/2"]}


def test_schemes_by_coefficients() -> None:
    def of(table: Any) -> schemes.Scheme:
        return read_scene(tiny(scheme=table)).scheme

    assert of(HEUN) == schemes.runge_kutta([[], [1]], [Fraction(1, 2)] * 2, name="mine")
    adams = {"kind": "adams", "name": "mine", "explicit": [1.5, -0.5], "starter": "midpoint"}
    assert of(adams) == schemes.adams([1.5, -0.5], name="mine", starter=schemes.get("midpoint"))
    assert of(adams | {"starter": HEUN}).starter == of(HEUN)
    assert of({"kind": "bdf", "name": "mine", "steps": 2}) == schemes.bdf(2, name="mine")
    assert of({"kind": "modified_euler", "alpha": "2/3"}) == schemes.modified_euler(Fraction(2, 3))
    forces = {"kind": "Newtonian", "forces": {"kind": "Gravity"}}
    table = {"kind": "splitting", "name": "mine", "kicks": [0.5, 0.5], "drifts": [1]}
    scene = read_scene(tiny(scheme=table, groups__0__system=forces))
    assert scene.scheme == schemes.splitting([0.5, 0.5], [1], name="mine")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"b": ["1/2", "1/0"]}, "$.scheme.b[1] = \"1/0\": should be a number or a fraction such as '1/6'"),
        ({"b": [0.5, 0.6]}, "$.scheme: scheme 'mine': b must sum to 1"),
        ({"a": [[0] * 17] * 17}, "$.scheme.a[0]"),
        ({"a": 3}, "$.scheme.a = 3: should be a valid list"),
        ({"order": 3}, "$.scheme: scheme 'mine': claimed order 3"),
        ({"bb": 3}, "$.scheme.bb: runge_kutta has no such key; did you mean 'b'?"),
        ({"kind": "runge-kutta"}, '$.scheme.kind = "runge-kutta": should be adams, bdf'),
        ({"name": "system('x')"}, "$.scheme"),
    ],
    ids=str,
)
def test_wrong_coefficients(change: dict[str, Any], text: str) -> None:
    document = tiny(scheme=HEUN | change)
    if "system" in str(change):
        assert read_scene(document).scheme.name == "system('x')", "a name is a text, and nothing runs"
    else:
        assert refusal(document).startswith(text)


def test_a_picture_lies_below_the_working_folder(tmp_path, monkeypatch) -> None:
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    for name in ("sky.png", "../secret.png"):
        (tmp_path / "work" / name).write_bytes(b"x")
    (tmp_path / "work" / "link.png").symlink_to(tmp_path / "secret.png")
    assert read_scene(tiny(background={"kind": "Picture", "path": "sky.png"})).background == tp.Picture(path="sky.png")
    for path in ("../secret.png", "/etc/passwd", "link.png", str(tmp_path / "work" / "sky.png")):
        assert "leaves the working folder" in refusal(tiny(background={"kind": "Picture", "path": path}))
    for path in (".", "none.png", "a\0b", "x" * 5000):
        assert refusal(tiny(background={"kind": "Picture", "path": path})).startswith("$.background: path ")


def test_no_key_is_called_kind() -> None:
    todo: list[Any] = [tp.Scene]
    seen: set[Any] = set()
    while todo:
        maker = todo.pop()
        if maker not in seen:
            seen.add(maker)
            slots = kinds.kind(maker).slots
            assert "kind" not in slots
            todo += [m for slot in slots.values() for m in (*slot.single, *slot.listed)]
    names = [maker.__name__ for maker in seen]
    assert len(set(names)) == len(names) > 30


CLOTH: dict[str, Any] = {
    "kind": "cloth",
    "counts": [4, 4],
    "size": 2,
    "then": [
        {"kind": "turned", "axis": [1, 0, 0], "degrees": 90},
        {"kind": "moved", "offset": [0, 0, 1]},
        {"kind": "pin", "where": {"kind": "Box", "low": [-2, -2, 1.9], "high": [2, 2, 2.1]}},
        {"kind": "driven", "path": {"keys": [[0, [0, 0, 0]], [1, [0, 1, 0]]]}, "vertices": [0, 1]},
    ],
}


def mesh(table: dict[str, Any], **more: Any) -> dict[str, Any]:
    return tiny(groups=[{"kind": "MeshGroup", "name": "cloth", "mesh": table, **more}])


def test_a_mesh_by_its_builder_and_what_is_done_to_it() -> None:
    ball = {"kind": "Ball", "radius": 0.5}
    scene = read_scene(mesh(CLOTH, colliders=ball, scheme="velocity-verlet", steps={"kind": "StabilityLimit"}))
    made = tp.cloth(counts=(4, 4), size=2.0).turned((1.0, 0.0, 0.0), 90.0).moved((0.0, 0.0, 1.0))
    made = made.pin(where=tp.Box(low=(-2.0, -2.0, 1.9), high=(2.0, 2.0, 2.1)))
    made = made.driven(tp.Track(keys=((0.0, (0.0, 0.0, 0.0)), (1.0, (0.0, 1.0, 0.0)))), [0, 1])
    (group,) = scene.groups
    assert group.mesh == made
    assert 0 < group.mesh.pinned.sum() < 16
    assert (group.colliders, group.forces) == ((tp.Ball(radius=0.5),), (tp.Gravity(),))


@pytest.mark.parametrize(
    ("table", "start"),
    [
        (CLOTH | {"counts": [4]}, "$.groups[0].mesh.counts"),
        (CLOTH | {"counts": [1, 4]}, "$.groups[0].mesh: "),
        (CLOTH | {"counts": [10**6, 10**6]}, "$.groups[0].mesh: 1000000000000 vertices, at most 16777216 are allowed"),
        ({"kind": "rope", "count": 10**12}, "$.groups[0].mesh: 1000000000000 vertices"),
        (CLOTH | {"then": [{"kind": "pinn"}]}, '$.groups[0].mesh.then[0].kind = "pinn": should be moved, turned'),
        (CLOTH | {"then": [{"kind": "pin", "vertices": [99]}]}, "$.groups[0].mesh.then[0]: "),
        (CLOTH | {"then": [{"kind": "pin", "vertices": "all"}]}, '$.groups[0].mesh.then[0].vertices = "all"'),
        (CLOTH | {"then": [{"kind": "moved"}]}, "$.groups[0].mesh.then[0].offset is missing"),
        (CLOTH | {"then": 3}, "$.groups[0].mesh.then = 3: should be a table of kind"),
        ({"kind": "Mesh", "x": [[0, 0, 0], [1]]}, "$.groups[0].mesh.x = [[0, 0, 0], [1]]: the rows of an array"),
        ({"kind": "Mesh", "x": "x"}, '$.groups[0].mesh.x = "x": should be numbers'),
        ({"kind": "Mesh", "x": [[0, 0, 0]], "springs": [[0, 1]]}, "$.groups[0].mesh: "),
        ({"counts": [4, 4]}, "$.groups[0].mesh.kind is missing: should be cloth, lattice"),
    ],
    ids=str,
)
def test_wrong_meshes(table: dict[str, Any], start: str) -> None:
    assert refusal(mesh(table)).startswith(start)
