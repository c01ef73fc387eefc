"""`list`, `describe`, `schemes`, `doctor`, help, and how progress is shown."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest
from commands import ROOT, Run, command

from tparticles import __version__, schemes
from tparticles.schemes import Op, OpKind, Scheme, Stability


def loaded(*arguments: str) -> set[str]:
    """Run a command in a process of its own and return the modules it has loaded."""
    code = "import sys\nfrom tparticles.cli import main\ntry: main()\nfinally: print(*sys.modules, file=sys.stderr)"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code, *arguments], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(done.stderr.split())


@pytest.mark.parametrize("arguments", [(), ("--help",), ("render", "--help"), ("--version",), ("list",), ("schemes",)])
def test_quick_commands_do_not_load_taichi(scene, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    (tmp_path / "scenes").mkdir()
    scene("scenes/tiny")
    modules = loaded(*arguments)
    assert "taichi" not in modules
    if "schemes" not in arguments:
        assert "numpy" not in modules


def test_a_job_knows_nothing_of_the_command_line() -> None:
    code = "import sys, tparticles.job; print('click' in sys.modules, 'rich' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout == "False False\n"


def test_the_module_is_the_program() -> None:
    done = subprocess.run([sys.executable, "-m", "tparticles", "--version"], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"tparticles, version {__version__}\n")


def test_without_a_command_the_help_is_shown(run: Run) -> None:
    result = run("--help")
    assert result.code == 0
    for name in ("render", "list", "describe", "schemes", "doctor", "Exit codes: 0 done"):
        assert name in result.out


def test_help_names_every_option(run: Run) -> None:
    text = run("render", "--help").out
    options = "out frames fps size quality set seed scheme precision arch threads png no-png mp4 no-mp4 states existing json quiet"
    for option in options.split():
        assert f"--{option}" in text
    assert "null" in run("schemes", "--help").out
    assert max(map(len, text.splitlines())) <= 110


def test_list_goes_on_past_a_broken_scene(run: Run, scene, tmp_path: Path) -> None:
    (tmp_path / "scenes").mkdir()
    scene("scenes/tiny")
    (tmp_path / "scenes/broken.py").write_text("def scene(quality, *:\n")
    (tmp_path / "scenes/binary.py").write_bytes(b"x = '\xff'\n")
    (tmp_path / "scenes/empty.py").write_text("")
    (tmp_path / "scenes/_shared.py").write_text("x = 1\n")
    (tmp_path / "scenes/folder.py").mkdir()
    result = run("list")
    assert (result.code, result.err) == (0, "")
    lines = result.out.splitlines()
    assert re.fullmatch(r"binary +error: .*binary\.py:1: a byte that is no UTF-8 .*", lines[0])
    assert re.fullmatch(r"broken +error: .*broken\.py:1: invalid syntax", lines[1])
    assert re.fullmatch(r"empty +error: .*empty\.py: a scene script defines .*", lines[2])
    assert re.fullmatch(r"folder +error: .*folder\.py cannot be read: Is a directory", lines[3])
    assert lines[4:] == ["tiny         A tiny film.", "             rate=60.0 seed=1 note="]
    listed = {row["name"]: row for row in run("list", "--json").json}
    assert list(listed) == ["binary", "broken", "empty", "folder", "tiny"]
    assert listed["tiny"] == {
        "name": "tiny",
        "summary": "A tiny film.",
        "parameters": {"rate": 60.0, "seed": 1, "note": ""},
        "error": None,
    }
    assert listed["broken"]["error"].endswith("broken.py:1: invalid syntax")


def test_list_of_nothing(run: Run) -> None:
    result = run("list")
    assert (result.code, result.out) == (0, "")
    assert result.err.startswith("no scenes in /")
    assert run("list", "--json").json == []


def test_describe_shows_parameters_and_bytes_per_particle(run: Run, scene) -> None:
    scene()
    text = run("describe", "tiny.py", "--set", "rate=24", "--quality", "draft").out
    assert "tiny: A tiny film." in text
    assert "rate = 24.0 (float, default 60.0)" in text
    assert "seed = 1 (int)" in text
    assert re.search(r"24 bytes per particle \(.*x:12.*\)", text)
    found = run("describe", "tiny.py", "--set", "rate=24", "--quality", "draft", "--json").json
    (group,) = found["groups"]
    assert (group["name"], group["births"], group["bytes_per_particle"]) == ("dots", 12, 24)
    assert group["bytes_per_particle"] == sum(group["attributes"].values())
    assert found["parameters"]["rate"] == {"type": "float", "default": 60.0, "value": 24.0}
    assert (found["frames"], found["fps"], found["size"], found["scheme"]) == (6, "24", [64, 36], "rk4")
    doubles = run("describe", "tiny.py", "--precision", "f64", "--quality", "draft", "--json").json
    assert doubles["groups"][0]["bytes_per_particle"] == 36


def test_describe_keeps_what_a_scene_prints_off_stdout(process: Run, scene) -> None:
    scene(head="print('hello')")
    result = process("describe", "tiny.py", "--json")
    assert result.json["scene"] == "tiny"
    assert result.err == "hello\n"


def test_what_scenes_and_kernels_print_stays_off_stdout(process: Run, scene) -> None:
    head = "print('hello')\nclass Odd:\n    @ti.func\n    def velocity(self, t, x):\n        print('kernel')\n        return x\n"
    scene(head=head, system="tp.Advected(flow=Odd())")
    result = process("render", "tiny.py", "--json", "--quiet", "--no-mp4", "--frames", "1")
    assert (result.code, result.json["status"]) == (0, "done")
    assert "hello" in result.err and "kernel" in result.err


FIELDS = {"name", "order", "evaluations", "real_limit", "imaginary_limit", "a_stable", "l_stable", "needs"}


def test_schemes_are_listed(run: Run) -> None:
    listed = {row["name"]: row for row in run("schemes", "--json").json}
    assert list(listed) == list(schemes.CATALOGUE)
    assert all(set(row) == FIELDS for row in listed.values())
    assert (listed["rk4"]["order"], listed["rk4"]["evaluations"]) == (4, 4)
    assert listed["rk4"]["real_limit"] == pytest.approx(2.785293563405282)
    assert listed["beeman"]["needs"] == ["equal steps", "second-order system"]
    lines = run("schemes").out.splitlines()
    assert max(map(len, lines)) <= 120
    assert lines[0].split() == ["scheme", "order", "stages", "evals", "real", "imag", "stable", "SSP", "needs"]
    rows = {line.split()[0]: line for line in lines[: lines.index("sources")] if line.startswith("  ")}
    assert set(rows) == set(listed)
    assert re.fullmatch(r"  tvd-rk3 +3 +3 +3 +2\.5127 +1\.7321 +- +1\.0000 +-", rows["tvd-rk3"])
    assert re.fullmatch(r"  tr-bdf2 +2 +3 +2 +inf +inf +L +2\.4142 +-", rows["tr-bdf2"])
    assert re.fullmatch(r"  trapezoidal +2 +2 +1 +inf +inf +A +2\.0000 +-", rows["trapezoidal"])
    assert rows["yoshida4"].endswith("  second-order system, velocity-free forces")
    sources = " ".join(" ".join(lines[lines.index("sources") :]).split())
    assert all(" ".join(scheme.reference.split()) in sources for scheme in schemes.CATALOGUE.values())


def test_an_infinite_limit_is_null_in_json(run: Run, monkeypatch) -> None:
    ops = (Op(OpKind.EVALUATE, slope=0), Op(OpKind.COMBINE, weights=(1.0,)))
    # backward Euler's stability function: 1 / (1 - z)
    stable = Scheme(name="stable", order=1, ops=ops, slopes=1, stability=Stability(numerator=(1,), denominator=(1, -1)))
    monkeypatch.setattr(schemes, "CATALOGUE", {"stable": stable})
    (row,) = run("schemes", "--json").json
    assert (row["real_limit"], row["imaginary_limit"], row["a_stable"], row["l_stable"]) == (None, None, True, True)
    lines = run("schemes").out.splitlines()
    assert re.fullmatch(r"  stable +1 +1 +1 +inf +inf +L +- +-", lines[2])
    assert "sources" not in lines


def test_one_scheme_is_shown_with_its_program_and_starter(run: Run) -> None:
    text = run("schemes", "milne").out
    facts = {line[2:17].strip(): line[19:] for line in text.splitlines() if line[:2] == "  "}
    assert (facts["order"], facts["evaluations"], facts["needs"]) == ("4", "2 a step", "equal steps")
    assert facts["source"].startswith("W. E. Milne")
    program, _, started = text.partition("starter for the first 3 steps: rk4")
    assert "    z = z0 + dt (4/3 k0 + 1/3 k1 - k3 + 1/3 k6)\n" in program
    assert "    k9 = f(t + dt, z)\n    z = z0 + dt (1/6 k0 + 1/3 k7 + 1/3 k8 + 1/6 k9)\n" in started
    assert [row["name"] for row in run("schemes", "milne", "--json").json] == ["milne"]
    for name in schemes.CATALOGUE:
        assert max(map(len, run("schemes", name).out.splitlines())) <= 120


def test_an_unknown_scheme_is_told_the_nearest_one(run: Run) -> None:
    result = run("schemes", "rk5")
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith("error: unknown scheme 'rk5'; did you mean 'rk4'?")
    assert run("schemes", "rk5", "--json").json["exit_code"] == 2


def test_doctor_tells_what_there_is(run: Run, monkeypatch) -> None:
    found = run("doctor", "--json").json
    assert {"tparticles", "python", "taichi", "ffmpeg", "cpu", "cuda", "vulkan", "kernel cache", "disk free"} <= set(
        found
    )
    assert found["kernel cache"].startswith(os.environ["TPARTICLES_CACHE"])
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nowhere/ffmpeg")
    text = run("doctor")
    assert text.code == 0
    assert re.search(r"^ffmpeg +missing: .*/nowhere/ffmpeg", text.out, re.MULTILINE)


def test_progress_is_a_bar_on_a_terminal_only(scene, tmp_path: Path) -> None:
    scene()
    master, terminal = pty.openpty()
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "100"}
    arguments = command("render", "tiny.py", "--no-mp4", "--frames", "1-3")
    with subprocess.Popen(arguments, env=environment, stdout=subprocess.PIPE, stderr=terminal, text=True) as running:
        os.close(terminal)
        shown = b""
        while True:
            try:
                chunk = os.read(master, 4096)
            except OSError:  # the terminal's other end is closed
                break
            if not chunk:
                break
            shown += chunk
        out = running.communicate(timeout=60)[0]
    os.close(master)
    assert running.returncode == 0
    assert re.fullmatch(r"3 frames in [\d.]+ s: renders/tiny/frames\n", out)
    assert b"\x1b[" in shown and b"tiny (compiling)" in shown
    assert b"3/3" in shown and b"alive" in shown and b" left" not in shown, "too few frames tell how long it takes"
