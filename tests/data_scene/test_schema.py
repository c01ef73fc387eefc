"""The JSON Schema, and hostile documents: what is not refused in one line is a scene."""

from __future__ import annotations

import copy
from typing import Any

import jsonschema
import pytest
from documents import TINY, TWINS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tparticles.data_scene import files
from tparticles.data_scene.files import parse
from tparticles.data_scene.read import read_scene
from tparticles.data_scene.schema import schema
from tparticles.errors import InputError
from tparticles.scene import Scene

SCHEMA = schema()
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)
MESH = parse(TINY, ".toml") | {
    "groups": {
        "kind": "MeshGroup",
        "name": "cloth",
        "mesh": {"kind": "cloth", "counts": [3, 3], "then": [{"kind": "pin", "vertices": [0, 2]}]},
        "colliders": {"kind": "Ball", "radius": 0.4},
    }
}
DOCUMENTS = [*(parse(path.read_text(), ".toml") for path in TWINS), MESH, parse(TINY, ".toml")]


def test_it_is_a_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert not words(SCHEMA) - WORDS, "a word that no validator knows constrains nothing"


WORDS = {
    "$schema",
    "title",
    "description",
    "type",
    "properties",
    "required",
    "additionalProperties",
    "const",
    "default",
}
WORDS |= {"anyOf", "oneOf", "items", "prefixItems", "minItems", "maxItems", "minimum", "maximum", "exclusiveMinimum"}
WORDS |= {"exclusiveMaximum", "enum", "pattern", "$ref", "$defs"}


def words(node: Any) -> set[str]:
    """Return the keywords of a schema, not the names of what it describes."""
    if isinstance(node, list):
        return set().union(*map(words, node))
    if not isinstance(node, dict):
        return set()
    found = set(node)
    for key, value in node.items():
        if key in ("properties", "$defs"):
            found |= set().union(*map(words, value.values()))
        elif key not in ("default", "const", "enum"):
            found |= words(value)
    return found


@pytest.mark.parametrize("document", DOCUMENTS, ids=[*(path.stem for path in TWINS), "mesh", "tiny"])
def test_it_admits_the_scenes_that_there_are(document: dict[str, Any]) -> None:
    VALIDATOR.validate(document)


def test_it_admits_extensions() -> None:
    VALIDATOR.validate({"extends": "campfire", "parameters": {"wind": 2}, "summary": "Windy."})


@pytest.mark.parametrize(
    "change",
    [
        {"duratoin": 3},
        {"look": {"ev": 400}},
        {"look": {"tone": "filmc"}},
        {"scheme": "rk5"},
        {"scheme": {"kind": "bdf"}},
        {"groups": [{"name": "x"}]},
        {"steps": {"dt": 0.1}},
        {"steps": {"kind": "Fixed", "dt": 0}},
        {"extends": "campfire"},
        {"camera": {"position": [0, 0], "target": [0, 0, 0]}},
        {"background": {"kind": "Fixed", "dt": 1}},
    ],
    ids=str,
)
def test_it_refuses_what_the_program_refuses(change: dict[str, Any]) -> None:
    document = DOCUMENTS[-1] | change
    assert not VALIDATOR.is_valid(document)
    with pytest.raises(InputError):
        read_scene(document)


def outcome(document: Any) -> Scene | str:
    """Return the scene of a document or why it is refused; any other exception is a bug."""
    try:
        files.check(document)
        return read_scene(document)
    except InputError as error:
        text = str(error)
        assert text and "\n" not in text and len(text) < 2000
        return text


NUMBERS = [0, -1, 1, 10**12, 2**63, 1e308, -0.0, float("nan"), float("inf")]
TEXTS = ["", "x", "1/2", "1/0", "rk4", "30000/1001", "CurlNoise", "\ud800", "a\0b", "\n", "../../x"]
LISTS = [[], [0], [[]], [1, 2, 3], [[0, 1], [1, 2]], [None], [{"kind": "Gravity"}]]
odd = st.sampled_from([None, True, *NUMBERS, *TEXTS, *LISTS, {}, {"kind": "Uniform"}, {"kind": "Track"}])
values = st.recursive(
    odd | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


def places(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [path, *(place for key, item in inner for place in places(item, (*path, key)))]


@st.composite
def mutations(draw: st.DrawFn) -> dict[str, Any]:
    """A valid document with up to three values replaced, left out or added."""
    document = copy.deepcopy(draw(st.sampled_from(DOCUMENTS)))
    for _ in range(draw(st.integers(1, 3))):
        *way, last = draw(st.sampled_from(places(document)[1:]))
        place: Any = document
        for part in way:
            place = place[part]
        action = draw(st.sampled_from(["replace", "drop", "add", "swap"]))
        if action == "replace":
            place[last] = copy.deepcopy(draw(values))
        elif action == "drop":
            del place[last]
        elif action == "add" and isinstance(place, dict):
            known = [name for one in SCHEMA["$defs"].values() for name in one["properties"]]
            place[draw(st.sampled_from(known) | st.text(max_size=8))] = copy.deepcopy(draw(values))
        elif action == "swap":
            *other, end = draw(st.sampled_from(places(document)[1:]))
            source: Any = document
            for part in other:
                source = source[part]
            place[last] = copy.deepcopy(source[end])
        if len(places(document)) < 3:
            break
    return document


@settings(max_examples=250, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(mutations())
def test_a_document_with_slips_is_a_scene_or_refused(document: dict[str, Any]) -> None:
    found = outcome(document)
    if isinstance(found, Scene):
        assert VALIDATOR.is_valid(document), "the schema refuses what the program takes"


@settings(max_examples=100, deadline=None)
@given(st.dictionaries(st.sampled_from(["groups", "camera", "look", "scheme", "steps"]) | st.text(max_size=5), values))
def test_any_json_is_a_scene_or_refused(document: dict[str, Any]) -> None:
    assert isinstance(outcome(document), str | Scene)


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=60) | st.text(alphabet="[]{}=\".#\n\\u0a1,_-+e'", max_size=60), st.sampled_from(files.SUFFIXES))
def test_any_text_is_a_document_or_refused(text: str, suffix: str) -> None:
    try:
        assert isinstance(parse(text, suffix), dict)
    except InputError as error:
        assert str(error) and "\n" not in str(error)
