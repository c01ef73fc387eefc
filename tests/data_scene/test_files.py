"""Hostile files: each is refused in one clear line, quickly, whatever is in it."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from documents import SCRIPT, TINY

from tparticles import library
from tparticles.data_scene.files import parse, read_text
from tparticles.errors import InputError


def refusal(text: str, suffix: str = ".toml") -> str:
    start = time.process_time()
    with pytest.raises(InputError) as refused:
        parse(text, suffix)
    assert time.process_time() - start < 5.0
    message = str(refused.value)
    assert "\n" not in message and len(message) < 400
    return message


MANY = 400_000


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("a = 1\na = 2", "no valid TOML"),
        ("[a]\n[a]", "no valid TOML"),
        ("a = nan", "$.a = nan: must be finite"),
        ("[a]\nb = [1, inf]", "$.a.b[1] = inf: must be finite"),
        ("a = 1e999", "$.a = inf: must be finite"),
        ("a = 99999999999999999999", "$.a: an integer of more than 64 bits"),
        (f"a = {'9' * 5000}", "no valid TOML"),
        ("a = 2020-01-01", "$.a is a date: a scene has no use for it"),
        ("a = 2020-99-01", "no valid TOML"),
        ("a = 07:32:00", "$.a is a time"),
        (f"a = {'[' * MANY}", "nested"),
        (f"a = {'[' * 30}{']' * 30}", "nested more than 24 deep"),
        (f"a = {'{b = ' * 30}1{'}' * 30}", "nested more than 24 deep"),
        (f"{'.'.join('a' * 40)} = 1", "a key of more than 32 dotted parts"),
        (f"{'.'.join('a' * MANY)} = 1", "a key of more than 32 dotted parts"),
        ('["b c"' + '."b c"' * MANY + "]", "a key of more than 32 dotted parts"),
        ("a" * 2 * MANY, "no valid TOML"),
        ('"' + "a" * 2 * MANY, "no valid TOML"),
        ("\0\1\2", "no valid TOML"),
        ("import os", "no valid TOML"),
    ],
    ids=lambda text: text[:24],
)
def test_hostile_toml(text: str, part: str) -> None:
    assert part in refusal(text)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ('{"a": 1, "b": {"c": 1, "c": 2}}', "key 'c' is given twice in one object"),
        ('{"a": NaN}', "NaN is no JSON: numbers must be finite"),
        ('{"a": -Infinity}', "-Infinity is no JSON"),
        ('{"a": [1, 1e999]}', "$.a[1] = inf: must be finite"),
        (f'{{"a": {"9" * 5000}}}', "no valid JSON"),
        ('{"a": 99999999999999999999}', "$.a: an integer of more than 64 bits"),
        ("[" * MANY, "nested"),
        ('{"a":' * MANY, "nested"),
        ("[1]", "$ is a list: a scene is a table"),
        ("3", "$ is a number"),
        ("null", "$ is a null"),
        ("", "no valid JSON"),
        ('{"a": 1', "no valid JSON"),
        ("{'a': 1}", "no valid JSON"),
        (r'{"a": {"b": "\ud800"}}', "$.a.b: half a character (a lone surrogate)"),
        (r'{"\ud800": 1}', "$: a key with half a character (a lone surrogate)"),
    ],
    ids=lambda text: text[:24],
)
def test_hostile_json(text: str, part: str) -> None:
    assert part in refusal(text, ".json")


@pytest.mark.parametrize(
    "line",
    ["[[a]]\n", "[a]\n", "a = 1\n", "a{} = {{b = 1}}\n", "# comment\n", "x.y{} = [1.5, 2.5]\n", "\n", "[a.b{}.c]\n"],
)
def test_a_large_file_is_read_or_refused_in_seconds(line: str) -> None:
    text = ""
    while len(text) < 1 << 17:
        text += "".join(line.format(i) for i in range(len(text), len(text) + 1000))
    start = time.process_time()
    try:
        parse(text, ".toml")
    except InputError as error:
        assert "\n" not in str(error)
    assert time.process_time() - start < 10.0


def test_files_that_are_no_documents(tmp_path: Path) -> None:
    def refused(path: Path) -> str:
        with pytest.raises(InputError) as error:
            library.load(str(path))
        assert "\n" not in str(error.value)
        return str(error.value)

    large = tmp_path / "large.toml"
    with large.open("wb") as file:
        file.truncate(1 << 40)
    assert "is larger than" in refused(large)
    binary = tmp_path / "binary.json"
    binary.write_bytes(b'{"a": "\n\xff\xfe"}')
    assert "binary.json:2: a byte that is no UTF-8 (0xff)" in refused(binary)
    os.mkfifo(pipe := tmp_path / "pipe.toml")
    assert "does not exist" in refused(pipe)
    with pytest.raises(InputError, match="is no regular file"):
        read_text(pipe)
    (tmp_path / "folder.toml").mkdir()
    assert "is a folder" in refused(tmp_path / "folder.toml")
    assert "does not exist" in refused(tmp_path / "none.toml")
    (tmp_path / "wrong.toml").write_text("a = ")
    assert refused(tmp_path / "wrong.toml").startswith(f"{tmp_path / 'wrong.toml'}: no valid TOML: ")
    (tmp_path / "bom.toml").write_bytes(b"\xef\xbb\xbf" + TINY.encode())
    assert library.load(str(tmp_path / "bom.toml")).build(quality="final", settings={}).frame_count == 6


def test_a_script_in_the_clothes_of_a_document_does_not_run(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(SCRIPT + "\nopen('ran', 'w')\n")
    with pytest.raises(InputError, match="no valid TOML"):
        library.load(str(path))
    assert not (tmp_path / "ran").exists()
