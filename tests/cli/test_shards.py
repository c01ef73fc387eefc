"""One film by several shards: whatever their number, it is the film of one process, to the bit."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import ROOT, SAME_BACKEND, Run, Write, command, run_process, write_scene

from tparticles.output import read_manifest
from tparticles.systems.population import Share

# Two groups, one of two emitters; deaths, so that slots are used again; streaks, so that velocities count.
PARTS = {
    "duration": "1.5",
    "births": "tp.Rate(rate=300.0)",
    "emitter": ", lifetime=tp.Spread(mean=0.2, variance=0.1)",
    "groups": """(group, tp.Group(
            name="sparks",
            system=tp.Newtonian(forces=(tp.Gravity(),)),
            emitters=tuple(
                tp.Emitter(name=name, births=tp.Rate(rate=r), temperature=tp.Spread(mean=1500.0, variance=99.0), size=0.1)
                for name, r in (("left", 100.0), ("right", 33.0))
            ),
            cooling=tp.Exponential(time=1.0),
        ))""",
}
RENDER = ("render", "tiny.py", "--quiet")


def rows(folder: Path) -> list[dict[str, Any]]:
    """Return the rows of a film, hashes of the pixels included, without the times that they took."""
    run = read_manifest(folder / "run.json")
    assert (run["status"], run["error"]) == ("done", None)
    return [{name: value for name, value in row.items() if name != "ms"} for row in run["frames"]]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, kernel_cache: None) -> Path:
    """The film of all particles, by one process."""
    folder = tmp_path_factory.mktemp("whole")
    write_scene(folder / "tiny.py", **PARTS)
    assert run_process(*RENDER, "--states", "--out", "o", *SAME_BACKEND, folder=folder).code == 0
    return folder / "o"


def check_same(folder: Path, whole: Path, *, states: bool = False) -> None:
    assert rows(folder) == rows(whole)
    assert (folder / "tiny.mp4").read_bytes() == (whole / "tiny.mp4").read_bytes()
    assert sorted(path.name for path in folder.iterdir()) == ["frames", "run.json", *["states"] * states, "tiny.mp4"]
    for path in sorted((whole / "states").iterdir()) if states else ():
        with np.load(path) as ones, np.load(folder / "states" / path.name) as others:
            assert sorted(ones) == sorted(others)
            for name in ones:
                assert ones[name].dtype == others[name].dtype and len(ones[name]) > 1
                assert ones[name].tobytes() == others[name].tobytes(), (path.name, name)


def test_two_processes_and_one_that_merges(scene: Write, whole: Path, tmp_path: Path) -> None:
    scene(**PARTS)
    result = run_process(*RENDER[:-1], "--out", "o", "--shards", "2", "--states")
    assert result.code == 0, result
    check_same(tmp_path / "o", whole, states=True)
    assert "2 shards on " in result.err and "MiB" in result.err


def test_three_pieces_on_machines_of_their_own(scene: Write, run: Run, whole: Path, tmp_path: Path) -> None:
    scene(**PARTS)
    shards = (*RENDER, "--out", "o", "--shards", "3", "--shard")
    for k in (2, 1):
        assert run(*shards, k).code == 0
    assert sorted(path.name for path in (tmp_path / "o/shards").iterdir()) == ["1-of-3", "2-of-3"]
    without = "film is refused: it holds no states; render it with --states"
    run(*shards, "merge", "--states").refused(2, without)
    (tmp_path / "o/states").rmdir()
    run(*shards, "merge").refused(1, "shards/3-of-3/000001.film is missing: render it with --shard 3")
    assert run(*shards, "3").code == 0
    damaged = tmp_path / "o/shards/2-of-3/000004.film"
    os.truncate(damaged, damaged.stat().st_size - 1)
    run(*shards, "merge").refused(2, "2-of-3/000004.film is refused: it is cut or damaged")
    assert len(list((tmp_path / "o/frames").iterdir())) == 3  # what was whole is done, and not asked for again
    assert run(*shards, "2", "--resume").code == 0
    assert run(*shards, "merge", "--resume").code == 0
    check_same(tmp_path / "o", whole)


def test_more_shards_than_particles(scene: Write, run: Run, tmp_path: Path) -> None:
    scene(births="tp.Burst(count=2)", preroll="0.0", duration="0.1")
    render = (*RENDER, "--no-mp4", "--frames", "2")
    assert run(*render, "--out", "one").code == 0
    alive = []
    for k in range(1, 5):
        result = run("render", "tiny.py", *render[3:], "--out", "o", "--shards", "4", "--shard", k, "--quiet", "--json")
        alive.append(result.json["frames"][0]["alive"])
    assert alive == [1, 1, 0, 0]
    assert run(*render, "--out", "o", "--shards", "4", "--shard", "merge").code == 0
    assert rows(tmp_path / "o") == rows(tmp_path / "one")


def test_a_killed_merger_ends_its_shards_and_is_resumed(scene: Write, whole: Path, tmp_path: Path) -> None:
    scene(**PARTS)
    options = ("--out", "o", "--shards", "2", "--checkpoint-every", "4f")
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command(*RENDER, *options), env=environment)
    deadline = time.monotonic() + 90
    while len(list(tmp_path.glob("o/frames/0*.png"))) < 10:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.001)
    process.send_signal(signal.SIGKILL)
    process.wait()
    result = run_process(*RENDER, *options, "--resume")
    assert result.code == 0, result
    assert "resumed at frame" in result.err
    check_same(tmp_path / "o", whole)


def test_what_a_shard_fails_with_is_told(scene: Write, tmp_path: Path) -> None:
    scene(law="ti.Vector([1.0, 0.0, 0.0]) / ti.max(0.1 - t, 0.0)")
    result = run_process(*RENDER, "--out", "o", "--shards", "2", "--scheme", "rk4")
    line = result.refused(1, "shard ", "its state is not finite")
    assert "frame 3" in line
    assert read_manifest(tmp_path / "o/run.json")["status"] == "failed"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--shard", "1"), "--shard 1: of how many? Give --shards N"),
        (("--workers", "2"), "--workers 2: of how many? Give --shards N"),
        (("--shards", "3", "--shard", "4"), "--shard 4: a number from 1 to 3, or merge, is needed"),
        (("--shards", "3", "--shard", "0"), "--shard 0: a number from 1 to 3"),
        (("--shards", "3", "--shard", "x"), "--shard x: a number from 1 to 3"),
        (("--shards", "99999"), "--shards 99999: 1 to 10000 are allowed"),
        (("--shards", "2", "--resume", "--no-png"), "leave out --no-png"),
    ],
)
def test_what_cannot_be_is_refused(
    scene: Write, run: Run, tmp_path: Path, options: tuple[str, ...], message: str
) -> None:
    scene()
    run(*RENDER, "--out", "o", *options).refused(2, message)
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("count", [1, 2, 3, 7, 100])
@pytest.mark.parametrize(("first", "born"), [(0, 0), (0, 1), (5, 2), (17, 50), (2, 200)])
def test_each_birth_is_of_one_share(count: int, first: int, born: int) -> None:
    from tparticles.physics.emitters import Births

    births = Births(first, born, None, 0)  # type: ignore[arg-type]
    for emitter in (0, 1, 5):
        dealt = []
        for index in range(count):
            share = Share(index, count)
            own, n = share.of(births, emitter)
            dealt += range(own, own + n * count, count)
            assert n <= share.room(born, 1) and n in (born // count, -(-born // count))
        assert sorted(dealt) == list(range(first, first + born))
