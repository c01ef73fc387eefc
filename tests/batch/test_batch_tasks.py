"""Names of folders, scenes that may run, jobs.toml and batch.json: whatever somebody writes, one clean line or a task."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tparticles.batch.jobs_file import read_jobs
from tparticles.batch.record import Entry, Record, prepare_folder, read_record
from tparticles.batch.tasks import Task, check_scene, make_name, named
from tparticles.errors import InputError

odd = st.text(max_size=40) | st.sampled_from(
    ["../../etc", "a/b", ".", "..", "CON", "a" * 300, "-rf", "a\0b", "é", "x."]
)


@settings(deadline=None)  # the machine may be busy
@given(odd, st.dictionaries(odd, odd | st.floats() | st.integers(), max_size=3), st.none() | st.integers(0, 2**31))
def test_a_made_name_is_safe_and_readable(prefix: str, chosen: dict[str, object], seed: int | None) -> None:
    name = make_name(prefix, chosen, seed)
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._=+,~-]{0,119}", name)
    assert Path("out", name).resolve().parent == Path("out").resolve()


def test_names_say_the_parameters() -> None:
    assert make_name("", {"wind": "0.5", "power": 20}, 3) == "wind=0.5,power=20,seed=3"
    assert make_name("campfire", {}, None) == "campfire"
    assert make_name("", {"wind": "-1"}, None) == "wind=-1"


def test_films_that_differ_have_folders_that_differ() -> None:
    tasks = [
        Task(name=make_name("", {"note": n}, None), scene="s", settings={"note": n})
        for n in ("a/b", "a:b", "A_B", "a_b")
    ]
    names = [task.name for task in named(tasks)]
    assert len({name.casefold() for name in names}) == 4
    with pytest.raises(InputError, match="jobs 'x' and 'y' are the same"):
        named([Task(name="x", scene="s"), Task(name="y", scene="s")])


@pytest.mark.parametrize(
    "name", ["../x", "a/b", "", ".", "..", ".hidden", "-rf", "a\0b", "a" * 121, "nul", "COM1.x", "a\n"]
)
def test_a_name_that_leaves_its_folder_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="job name") as caught:
        Task(name=name, scene="s")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("scene", "allowed"),
    [
        ("campfire", True),
        ("scenes/campfire.py", True),
        ("scene.toml", True),
        ("/far/away/scene.json", True),
        ("scenes/../evil.py", False),
        ("evil.py", False),
        ("/tmp/evil.py", False),
        ("evil.txt", False),
        ("scenes/sub/evil.py", False),
        ("a\0.py", False),
    ],
)
def test_only_known_scripts_and_data_run_without_leave(scene: str, allowed: bool) -> None:
    check_scene(scene, allow_python=True)
    if allowed:
        check_scene(scene, allow_python=False)
    else:
        with pytest.raises(InputError, match="--allow-python"):
            check_scene(scene, allow_python=False)


def jobs(text: str, suffix: str = ".toml") -> tuple[int, list[Task]]:
    path = Path(f"jobs{suffix}")
    path.write_text(text)
    total, tasks = read_jobs(path)
    return total, list(tasks)


def test_a_file_of_jobs() -> None:
    total, tasks = jobs("""
        [defaults]
        quality = "preview"
        mp4 = false
        [[job]]
        scene = "dots"
        name = "windy"
        set = { rate = 2.0 }
        seed = 3
        size = "64x36"
        [[job]]
        scene = "dots"
        set = { note = "x" }
        sweep = { rate = "0:2:3", trouble = ["a", "b"] }
        seeds = "1-2"
        """)
    assert total == len(tasks) == 13
    assert tasks[0] == Task(
        name="windy",
        scene="dots",
        settings={"rate": 2.0},
        seed=3,
        options={"quality": "preview", "mp4": False, "size": (64, 36)},
    )
    assert tasks[1].name == "dots,rate=0,trouble=a,seed=1"
    assert tasks[1].settings == {"note": "x", "rate": "0", "trouble": "a"}
    assert len({task.name for task in named(tasks)}) == 13
    assert (
        jobs('{"job": [{"scene": "dots", "sweep": {"rate": [1, 2]}, "seeds": [4, 5], "zip": true}]}', ".json")[0] == 2
    )


HOSTILE = [
    ("", "at least one"),
    ("job = 3", "at least one"),
    ("[[job]]\n", r"\$\.job\[0\]\.scene is missing"),
    ('[[job]]\nscene = "s"\nname = "../../x"', "job name '../../x'"),
    ('[[job]]\nscene = "s"\nqualty = "draft"', r"unknown key in \$\.job\[0\] 'qualty'; did you mean 'quality'"),
    ('[[jobs]]\nscene = "s"', "did you mean 'job'"),
    ('[[job]]\nscene = "s"\nout = "/etc"', "unknown key"),
    ('[[job]]\nscene = "s"\nset = { x = nan }', "must be finite"),
    ('[[job]]\nscene = "s"\nseed = -1', "at least 0"),
    ('[[job]]\nscene = "s"\nseed = 1.5', r"\$\.job\[0\]\.seed is a number"),
    ('[[job]]\nscene = ["s"]', r"\$\.job\[0\]\.scene is a list: should be a text"),
    ('[[job]]\nscene = "s"\nsize = "1x"', "WIDTHxHEIGHT"),
    ('[[job]]\nscene = "s"\nseeds = "1-9999999"', "more than 1000000"),
    ('[[job]]\nscene = "s"\nsweep = { a = "0:1:9999", b = "0:1:9999" }', "at most 1000000"),
    ('[[job]]\nscene = "s"\nsweep = { a = [] }', "a: no value is given"),
    ('[[job]]\nscene = "s"\nzip = true\nsweep = { a = [1, 2], b = [1] }', "--zip pairs values"),
    ('[[job]]\nscene = "s"\nset = { a = 1 }\nsweep = { a = [1] }', "a is in set and in sweep"),
    ("a = " + "[" * 500 + "]" * 500, "nested|unknown key"),
    ("[[job]", "no valid TOML"),
]


@pytest.mark.parametrize(("text", "words"), HOSTILE)
def test_a_hostile_file_is_refused_in_one_line(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        jobs(text)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


@settings(deadline=None)  # the machine may be busy
@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(["job", "scene", "set", "sweep", "seeds", "zip", "name", "size"]), inner, max_size=4
            )
        ),
        max_leaves=12,
    )
)
def test_any_document_is_jobs_or_refused(document: object) -> None:
    for content in (document, {"job": [document]}, {"job": [{"scene": "s", "sweep": document, "set": document}]}):
        try:
            jobs(json.dumps(content), ".json")
        except InputError as error:
            assert str(error)


def test_what_is_recorded_is_read_again(tmp_path: Path) -> None:
    task = Task(name="a", scene="s", settings={"wind": 1.0}, seed=2, options={"size": (64, 36), "mp4": False})
    record = Record(tmp_path, [Entry(task, "failed", 2, 137, "killed", 1.5, 24), Entry(Task(name="b", scene="s"))])
    record.save()
    again = read_record(tmp_path)
    assert again.entries == record.entries
    assert again.status == "running"


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c.update(version=2),
        lambda c: c.update(jobs={}),
        lambda c: c["jobs"][0].update(name="../../x"),
        lambda c: c["jobs"][0].update(state="odd"),
        lambda c: c["jobs"][0].update(attempts="1"),
        lambda c: c["jobs"][0].update(options={"out": "/etc"}),
        lambda c: c["jobs"][0].update(options={"mp4": "no"}),
        lambda c: c["jobs"][0].update(seed=True),
        lambda c: c["jobs"].append(c["jobs"][0]),
        lambda c: c["jobs"].append([]),
    ],
)
def test_a_broken_record_is_refused_by_name(tmp_path: Path, change) -> None:
    record = Record(tmp_path, [Entry(Task(name="a", scene="s"))])
    record.save()
    content = json.loads((tmp_path / "batch.json").read_text())
    change(content)
    (tmp_path / "batch.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"batch\.json is broken"):
        read_record(tmp_path)


def test_a_folder_without_a_record_is_taken_up_if_only_the_record_is_missing(tmp_path: Path) -> None:
    tasks = [Task(name="a", scene="s")]
    folder = tmp_path / "o"
    for name in ("jobs", "logs"):
        (folder / name).mkdir(parents=True)
    for name in ("index.html", "contact.png", "contact-2.png"):
        (folder / name).touch()
    assert prepare_folder(folder, tasks, replace=False).counts()["waiting"] == 1
    (folder / "letter.txt").touch()
    with pytest.raises(InputError, match=r"holds contact-2\.png, contact\.png, index\.html, \.\.\. but no batch\.json"):
        prepare_folder(folder, tasks, replace=True)


@pytest.mark.parametrize("text", ["", "[", "[" * 100000, "\0", "null"])
def test_what_is_no_record_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "batch.json").write_text(text)
    with pytest.raises(InputError, match=r"batch\.json is broken"):
        read_record(tmp_path)
