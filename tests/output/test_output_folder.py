from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tparticles.errors import InputError
from tparticles.output import Manifest, claim_folder, folder

OURS = ["campfire.mp4", "campfire.partial.mp4", "frames/000001.png", "frames/1000000.png", "states/000001.npz"]
FOREIGN = ["notes.txt", "other.mp4", "frames/cover.png", "frames/00001.png", "states/000001.npz.bak"]


def absent(path: Path) -> None:
    path.rmdir()


def empty(path: Path) -> None:
    pass


def leftovers(path: Path) -> None:
    (path / ".run.json.0123abcd.tmp").touch()


def run_of(scene: str, identity: str) -> Callable[[Path], None]:
    def fill(path: Path) -> None:
        Manifest(path / "run.json", {"scene": scene, "identity": identity}).finish()
        for name in [*OURS, *FOREIGN]:
            (path / name).parent.mkdir(exist_ok=True)
            (path / name).write_text(name)

    return fill


def files_without_owner(path: Path) -> None:
    for name in "abcd":
        (path / f"{name}.txt").touch()


def broken(content: str) -> Callable[[Path], None]:
    return lambda path: (path / "run.json").write_text(content) and None


def a_file(path: Path) -> None:
    path.rmdir()
    path.touch()


def manifest_is_a_folder(path: Path) -> None:
    (path / "run.json").mkdir()


KEPT, REMOVED = "kept", "removed"
STALE = "rendered with other parameters or settings, or by another version: replace it with --existing overwrite, or .* with --out"
NOT_OURS = r"holds a\.txt, b\.txt, c\.txt, \.\.\. but no run\.json, so it is not ours.*--out"
BROKEN = r"not known to be ours: .*run\.json is broken: .*--out"
POLICY = [
    (absent, KEPT, KEPT),
    (empty, KEPT, KEPT),
    (leftovers, KEPT, KEPT),
    (run_of("campfire", "now"), KEPT, KEPT),
    (run_of("campfire", "before"), STALE, REMOVED),
    (run_of("grinder", "now"), "holds scene 'grinder', not 'campfire'.*--out", "holds scene 'grinder', not 'campfire'"),
    (files_without_owner, NOT_OURS, NOT_OURS),
    (broken(""), BROKEN, BROKEN),
    (broken('{"scene": "campfire"'), BROKEN, BROKEN),
    (broken(json.dumps({"scene": "campfire"})), BROKEN, BROKEN),
    (broken(json.dumps(["campfire", "now"])), BROKEN, BROKEN),
    (manifest_is_a_folder, "not known to be ours: cannot read .*Is a dir", "not known to be ours: cannot read"),
    (a_file, "is a file: choose a folder with --out", "is a file: choose a folder with --out"),
]


@pytest.mark.parametrize("existing", ["error", "overwrite"])
@pytest.mark.parametrize(("prepare", "on_error", "on_overwrite"), POLICY)
def test_policy(tmp_path: Path, prepare, on_error: str, on_overwrite: str, existing: str) -> None:
    out = tmp_path / "out"
    out.mkdir()
    prepare(out)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    outcome = on_error if existing == "error" else on_overwrite
    if outcome in (KEPT, REMOVED):
        claim_folder(out, scene="campfire", identity="now", existing=existing)
        assert out.is_dir()
    else:
        with pytest.raises(InputError, match=outcome) as caught:
            claim_folder(out, scene="campfire", identity="now", existing=existing)
        assert "\n" not in str(caught.value)
        assert caught.value.exit_code == 2
    gone = {out / name for name in OURS} if outcome == REMOVED else set()
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == {
        path: data for path, data in before.items() if path not in gone
    }
    for left in tmp_path.rglob(".*.tmp"):
        left.unlink()


def test_what_was_claimed_may_be_claimed_again(tmp_path: Path) -> None:
    for _ in range(2):
        claim_folder(tmp_path / "a/b", scene="campfire", identity="now", existing="error")


def test_an_overwritten_run_leaves_no_empty_folders_and_still_has_its_owner(tmp_path: Path) -> None:
    Manifest(tmp_path / "run.json", {"scene": "campfire", "identity": "before"}).finish()
    for name in OURS:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    claim_folder(tmp_path, scene="campfire", identity="now", existing="overwrite")
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


@pytest.mark.parametrize("existing", ["", "overwrit", "skip"])
def test_an_unknown_policy_is_refused(tmp_path: Path, existing: str) -> None:
    with pytest.raises(InputError, match="unknown value of --existing"):
        claim_folder(tmp_path, scene="campfire", identity="now", existing=existing)


@pytest.mark.parametrize("scene", ["", ".", "..", "a/b", "../x", "a\\b", "a\0b"])
def test_a_scene_name_that_leaves_the_folder_is_refused(tmp_path: Path, scene: str) -> None:
    with pytest.raises(InputError, match="cannot name a file"):
        claim_folder(tmp_path, scene=scene, identity="now", existing="overwrite")


def test_a_folder_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"cannot write into output folder .*Not a directory"):
        claim_folder(tmp_path / "file/out", scene="campfire", identity="now", existing="error")


@pytest.mark.parametrize("name", ["x" * 300, "a\0b"])
def test_a_name_that_cannot_be_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"too long|cannot name a folder"):
        claim_folder(tmp_path / name, scene="campfire", identity="now", existing="error")


@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS, errno.ENOSPC])
def test_a_folder_that_takes_no_file_is_refused(tmp_path: Path, monkeypatch, number: int) -> None:
    def fail(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(folder, "_probe", fail)
    with pytest.raises(InputError, match=f"cannot write into output folder .*{os.strerror(number)}"):
        claim_folder(tmp_path, scene="campfire", identity="now", existing="error")


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs Linux's /proc")
@pytest.mark.parametrize("path", ["/proc/self", "/proc/self/new"])
def test_a_folder_that_not_even_root_may_write_is_refused(path: str) -> None:
    with pytest.raises(InputError, match=f"cannot write into output folder {path}: "):
        claim_folder(path, scene="campfire", identity="now", existing="error")


_CLAIM = """
import sys
from tparticles.errors import InputError
from tparticles.output import claim_folder
try:
    claim_folder(sys.argv[1] + sys.argv[2], scene="campfire", identity="now", existing="error")
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize("below", ["", "/new"])
def test_a_read_only_file_system_is_refused(tmpfs, below: str) -> None:
    done = tmpfs(_CLAIM, below, options="ro,size=64k")
    assert "Read-only file system; choose another with --out" in done.stdout, done.stderr
