"""The README's own scene and its own claims."""

import re
from pathlib import Path

from tparticles import cli, library

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_the_scene_of_the_readme_builds(tmp_path):
    script = next(block for block in re.findall(r"```python\n(.*?)```", README, re.S) if "def scene(" in block)
    (tmp_path / "fountain.py").write_text(script)
    scene = library.load(str(tmp_path / "fountain.py")).build(quality="preview", settings={"rate": "100"})
    assert scene.frame_count == 96 and scene.groups[0].name == "sparks"


def test_the_commands_of_the_readme_exist():
    commands = "|".join(name for name in cli.cli.commands if name != "study")  # a group, with options of its own
    for command, words in re.findall(rf"tparticles ({commands})\b([^`|\n]*)", README):
        known = {option for p in cli.cli.commands[command].params for option in (*p.opts, *p.secondary_opts)}
        assert set(re.findall(r"--[a-z0-9-]+", words)) <= known | {"--help"}


def test_every_picture_of_the_readme_is_there():
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+)\)", README)
    assert pictures and all((ROOT / picture).is_file() for picture in pictures)
