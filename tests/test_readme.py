"""The README's own scene and its own claims."""

import re
from pathlib import Path

import tparticles as tp
from tparticles import cli, library

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


SCENE, LAW = re.findall(r"```python\n(.*?)```", README.split("## A scene in 20 lines")[1].split("\n## ")[0], re.S)[:2]


def drift(script, path):
    """Return how far to the side the sparks of a script are after a second, on average [m]."""
    path.write_text(script)
    scene = library.load(str(path)).build(quality="preview", settings={"rate": "100"})
    assert scene.frame_count == 96 and scene.groups[0].name == "sparks"
    (frame,) = tp.Simulation(scene, size=(64, 36), arch="cpu").frames([24])
    assert frame.image.max() > 60, "black"
    return frame.state()["sparks"]["x"][:, 0].mean()


def test_the_scene_of_the_readme_has_no_more_lines_than_it_says():
    assert len(SCENE.splitlines()) <= 20


def test_the_scene_of_the_readme_runs_and_so_does_the_law(tmp_path):
    law, plain = re.findall(r"`(tp\.Drag\([^`]*\))`", README)[:2]
    assert "def scene(" in SCENE and SCENE.count(plain) == 1
    head, body = SCENE.split("def scene(")
    windy = f"{head}{LAW}\n\ndef scene({body.replace(plain, law)}"
    assert abs(drift(SCENE, tmp_path / "fountain.py")) < 0.1
    assert drift(windy, tmp_path / "windy.py") > 0.2


def test_the_commands_of_the_readme_exist():
    commands = "|".join(name for name in cli.cli.commands if name != "study")  # a group, with options of its own
    for command, words in re.findall(rf"tparticles ({commands})\b([^`|\n]*)", README):
        known = {option for p in cli.cli.commands[command].params for option in (*p.opts, *p.secondary_opts)}
        assert set(re.findall(r"--[a-z0-9-]+", words)) <= known | {"--help"}


def test_every_picture_of_the_readme_is_there():
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+)\)", README)
    assert pictures and all((ROOT / picture).is_file() for picture in pictures)
