"""Names, extended scripts, settings, identity: a data scene in the place of a script."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from documents import SCRIPT, TINY, built

from tparticles import library, scene_files
from tparticles.errors import InputError
from tparticles.job import Job, Options


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with a script and a document in scenes/."""
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "tiny.py").write_text(SCRIPT)
    (tmp_path / "scenes" / "tiny.toml").write_text(TINY)
    (tmp_path / "scenes" / "plain.toml").write_text(TINY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(text: str, name: str = "film.toml") -> str:
    Path(name).write_text(text)
    return name


def refusal(scene: str, **settings: Any) -> str:
    with pytest.raises(InputError) as refused:
        library.load(scene).build(quality="final", settings=settings)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_of_a_script_and_a_document_of_one_name_the_script_is_taken(folder: Path) -> None:
    assert scene_files.names() == ["plain", "tiny"]
    assert scene_files.find("tiny").suffix == ".py"
    assert scene_files.find("plain") == folder / "scenes" / "plain.toml"
    assert scene_files.find("scenes/tiny.toml").suffix == ".toml"
    with pytest.raises(InputError, match=r"does not exist; did you mean 'scenes/plain.toml'\?"):
        scene_files.find("scenes/plain")
    with pytest.raises(InputError, match=r"unknown scene 'plan'; did you mean 'plain'\?"):
        scene_files.find("plan")


def test_outlines_run_nothing_and_go_on_past_what_is_broken(folder: Path) -> None:
    (folder / "scenes" / "data").mkdir()
    write(TINY, "scenes/data/tiny.toml")
    write("a = ", "scenes/broken.toml")
    write('extends = "tiny"\n[parameters]\nrate = 30', "scenes/slow.json".replace("json", "toml"))
    found = {outline.name: outline for outline in library.outlines()}
    assert list(found) == ["broken", "plain", "slow", "tiny", "scenes/data/tiny.toml"]
    assert "no valid TOML" in found["broken"].error
    assert (found["plain"].summary, found["plain"].parameters) == ("A tiny film.", {})
    assert (found["slow"].summary, found["slow"].parameters) == ("data (extends tiny)", {"rate": 30})
    assert found["tiny"].summary == "A tiny script."


def test_an_extension_has_the_scripts_parameters() -> None:
    scene = library.load(write('extends = "tiny"\nsummary = "Slow."\n[parameters]\nrate = 30\nnote = "5"'))
    assert (scene.name, scene.summary) == ("film", "Slow.")
    assert {name: p.default for name, p in scene.parameters.items()} == {
        "rate": 30.0,
        "count": 1,
        "note": "5",
        "seed": 1,
    }
    assert scene.values({"seed": "2"}) == {"rate": 30.0, "count": 1, "note": "5", "seed": 2}
    assert built(Path("film.toml")) == built(Path("scenes/tiny.py"), rate=30.0)
    assert built(Path("film.toml"), rate="7") == built(Path("scenes/tiny.py"), rate=7.0)
    Path("film.json").write_text(json.dumps({"extends": "tiny", "parameters": {"rate": 30}}))
    assert built(Path("film.json")) == built(Path("film.toml"))


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ('extends = "tinny"', "$.extends: unknown script 'tinny'; did you mean 'tiny'? (known: tiny)"),
        ('extends = "plain"', "$.extends: unknown script 'plain'"),
        ('extends = "../tiny"', '$.extends = "../tiny": should be the name of a script'),
        ('extends = "scenes/tiny.py"', "should be the name of a script"),
        ('extends = "/etc/passwd"', "should be the name of a script"),
        ("extends = 3", "$.extends = 3: should be"),
        ('extends = "tiny"\nduration = 3', "$.duration: a scene that extends a script has no such key"),
        ('extends = "tiny"\nparameters = 3', "$.parameters is a number: should be a table"),
        (
            'extends = "tiny"\n[parameters]\nrat = 3',
            "$.parameters.rat: scene 'tiny' has no such key; did you mean 'rate'?",
        ),
        (
            'extends = "tiny"\n[parameters]\nrate = "3"',
            "$.parameters.rate: parameter rate = 3: should be a valid number",
        ),
        ('extends = "tiny"\n[parameters]\nrate = true', "$.parameters.rate"),
        ('extends = "tiny"\n[parameters]\nrate = nan', "$.parameters.rate = nan: must be finite"),
        ('extends = "tiny"\n[parameters]\ncount = [1]', "$.parameters.count"),
        ("[parameters]\nrate = 3", "$.parameters: only a scene that extends a script has parameters"),
    ],
    ids=str,
)
def test_wrong_extensions(text: str, part: str) -> None:
    message = refusal(write(text))
    assert message.startswith(f"{Path('film.toml').resolve()}: $.")
    assert part in message


def test_settings_of_a_plain_document_are_paths() -> None:
    path = Path(write(TINY))
    rate = "groups[0].emitters[0].births.rate"
    scene = built(
        path, **{rate: "200", "look.ev": ".5", "groups[0].name": "x", "camera.position": "0,-6,0", "fps": "24/1"}
    )
    assert scene.groups[0].emitters[0].births.rate == ((0.0, 200.0),)
    assert (scene.look.ev, scene.groups[0].name, scene.camera.position) == (0.5, "x", (0.0, -6.0, 0.0))
    assert built(path, **{f"$.{rate}": 60}) == built(path)
    assert built(path, **{rate: "[[0, 1], [1, 2]]"}).groups[0].emitters[0].births.rate == ((0.0, 1.0), (1.0, 2.0))
    assert library.load(str(path)).values({rate: "200"}) == {rate: 200}


@pytest.mark.parametrize(
    ("path", "value", "part"),
    [
        ("rate", "3", "$.rate: Scene has no such key"),
        ("look.evv", "3", "$.look.evv: Look has no such key; did you mean 'ev'?"),
        ("groups[1].name", "x", "$.groups is a list of 1, counted from 0: it has no item [1]"),
        ("groups.name", "x", "$.groups is a list and has no key 'name'"),
        ("groups[0][1]", "x", "$.groups[0] is a table: it has no item [1]"),
        ("seed.x", "1", "$.seed is a number and has no key 'x'"),
        ("look.ev", "nan", '$.look.ev = "nan": should be a valid number'),
        ("look.ev", "1e999", '$.look.ev = "1e999": should be a valid number'),
        ("look.ev", float("nan"), "$.look.ev = nan: must be finite"),
        ("seed", "9" * 400, "$.seed"),
        ("look.ev", "[" * 5000, "$.look.ev"),
        ("look.ev", "0" * 20_000, "a value of more than 10000 characters"),
        ("look..ev", "1", "--set look..ev: a path such as look.ev"),
        ("groups[-1]", "1", "--set groups[-1]: a path"),
        ("look.ev; import os", "1", "a path such as"),
        ("a." * 40 + "a", "1", "a path such as"),
    ],
    ids=lambda text: str(text)[:20],
)
def test_wrong_settings(path: str, value: Any, part: str) -> None:
    assert part in refusal(write(TINY), **{path: value})


def identity(scene: str, **settings: Any) -> str:
    return Job(scene, Options(mp4=False, settings=settings)).identity


def test_the_identity_covers_document_settings_and_extended_script(folder: Path) -> None:
    write(TINY)
    first = identity("film.toml")
    assert identity("film.toml") == identity("film.toml", **{}) == first
    assert identity("film.toml", **{"look.ev": "8"}) != first
    write(TINY.replace("rate = 60", "rate = 61"))
    assert identity("film.toml") != first
    write('extends = "tiny"', "extended.toml")
    before = identity("extended.toml")
    assert identity("extended.toml", rate="61") != before
    (folder / "scenes" / "tiny.py").write_text(SCRIPT + "# another text\n")
    assert identity("extended.toml") != before


def test_the_manifest_names_the_document_and_what_is_set(folder: Path) -> None:
    write(TINY)
    header = Job("film.toml", Options(mp4=False, settings={"look.ev": "8"}, seed=5)).header()
    assert (header["scene"], header["script"]) == ("film", str(folder / "film.toml"))
    assert (header["parameters"], header["seed"]) == ({"look.ev": 8}, 5)
    write('extends = "tiny"\n[parameters]\nrate = 30')
    header = Job("film.toml", Options(mp4=False, seed=5)).header()
    assert header["parameters"] == {"rate": 30.0, "count": 1, "note": "", "seed": 5}
