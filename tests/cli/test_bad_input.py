"""Bad input: one clear line on stderr, the right exit code, a clean stdout, and nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest

SIZE = ("WIDTHxHEIGHT", "1920x1080", "16384")
NO_RANGE = ("is no range such as 1-240, 1-240x2 or 7",)
LEAVES = ("leaves the film, which has frames 1-6",)
RATE = ("a number or a fraction such as 30000/1001",)
BOUNDS = ("must be above 0 and at most 1000",)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        *((("--size", s), SIZE) for s in ("0x0", "100000x1", "1920", "-1x5", "64X36", "axb", "64x36x2", "", "1e3x4")),
        (("--size", "63x36"), ("63x36", "62x36 or 64x36", "--no-mp4")),
        (("--size", "63x35"), ("62x34 or 64x36",)),
        (("--size", "1x1"), ("2x2",)),
        (("--size", "16384x16384"), ("too large for an MP4, take 16384x16128 or less", "--no-mp4")),
        *((("--fps", f), BOUNDS) for f in ("0", "-1", "1e9", "0/5", "1e-300")),
        *((("--fps", f), RATE) for f in ("nan", "abc", "1/0", "inf", "", "1e999999999", "24 fps")),
        (("--fps", "23.976023976"), ("did you mean 24000/1001?",)),
        (("--fps", "2"), ("duration = 0.25 s is shorter than one frame at 2 fps",)),
        *((("--frames", f), NO_RANGE) for f in ("", "x", "1-3x", "-3", "1,", "1.5", "1-2-3", "2x2", "１")),
        *((("--frames", f), LEAVES) for f in ("0-2", "7", "1-99", "7-", "0")),
        (("--frames", "5-3"), ("is empty, 3 comes before 5",)),
        (("--frames", "1-3,5-4"), ("'5-4' is empty",)),
        (("--frames", "1-3x0"), ("has step 0",)),
        (("--scheme", "rk5"), ("unknown scheme 'rk5'", "did you mean 'rk4'?", "euler", "midpoint")),
        (("--set", "ratte=1"), ("no parameter 'ratte'", "did you mean 'rate'?", "known: note, rate, seed")),
        (("--set", "rate=fast"), ("parameter rate = fast", "should be a valid number", "(float)")),
        (("--set", "rate=true"), ("should be a valid number",)),
        (("--set", "rate="), ("should be a valid number",)),
        (("--set", "seed=1.5"), ("should be a valid integer", "(int)")),
        (("--set", "rate=nan"), ("parameter rate = nan", "must be finite")),
        (("--set", "rate=1e999"), ("must be finite",)),
        (("--set", "rate"), ("--set rate", "name=value")),
        (("--set", "=1"), ("name=value",)),
        (("--set", "rate=1", "--set", "rate=2"), ("--set rate is given twice",)),
        (("--set", "seed=1", "--seed", "2"), ("seed is given twice",)),
        (("--set", "rate=-1"), ("tiny.py:10: `", "Rate.rate = -1.0", "greater than or equal to 0")),
        (("--seed", "-1"), ("--seed", "-1", "x>=0")),
        (("--seed", "abc"), ("--seed", "abc", "integer")),
        (("--threads", "0"), ("--threads", "0", "x>=1")),
        (("--precision", "f16"), ("unknown precision 'f16'", "f32, f64")),
        (("--quality", "best"), ("unknown quality 'best'", "draft, final, preview")),
        (("--arch", "cudda"), ("unknown arch 'cudda'", "did you mean 'cuda'?")),
        (("--existing", "maybe"), ("'maybe'", "error, overwrite")),
        (("--no-png", "--no-mp4"), ("nothing to write",)),
        (("--out", ""), ("--out is empty",)),
        (("--out", "tiny.py"), ("tiny.py is a file",)),
        (("--out", "tiny.py/x"), ("cannot write into output folder tiny.py/x", "Not a directory")),
        (("--out", "/proc/nowhere/x"), ("cannot write into output folder /proc/nowhere/x", "--out")),
        (("--frame", "1"), ("No such option '--frame'", "'--frames'")),
        (("again",), ("unexpected extra argument (again)",)),
    ],
    ids=lambda value: " ".join(value)[:30] if isinstance(value, tuple) else "",
)
def test_a_bad_option_is_refused_in_one_line(run, scene, tmp_path: Path, arguments, parts) -> None:
    scene()
    before = sorted(tmp_path.rglob("*"))
    run("render", "tiny.py", *arguments).refused(2, *parts)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_bad_command_is_refused_in_one_line(run) -> None:
    run("rendr", "campfire").refused(2, "No such command 'rendr'", "'render'")
    run("render").refused(2, "render: ", "Missing argument 'SCENE'")
    run("--nope").refused(2, "--nope")


def test_describe_refuses_as_render_does(run, scene) -> None:
    scene()
    run("describe", "nope").refused(2, "unknown scene 'nope'")
    run("describe", "tiny.py", "--set", "ratte=1").refused(2, "did you mean 'rate'?")
    run("describe", "tiny.py", "--quality", "best").refused(2, "unknown quality 'best'")
    run("describe", "tiny.py", "--precision", "f16").refused(2, "unknown precision 'f16'")


def test_an_unknown_scene_names_the_nearest(run, scene, tmp_path: Path) -> None:
    (tmp_path / "scenes").mkdir()
    scene("scenes/campfire")
    run("render", "campfier").refused(2, "unknown scene 'campfier'; did you mean 'campfire'? (known: campfire)")
    run("render", "./scenes/campfire").refused(2, "did you mean './scenes/campfire.py'?")
    run("render", "x/none.py").refused(2, "scene file 'x/none.py' does not exist")
    run("render", "").refused(2, "unknown scene ''")
    run("render", "a" * 300).refused(2, "cannot be read: File name too long")
    (tmp_path / "folder.py").mkdir()
    run("render", "folder.py").refused(2, "'folder.py' is a folder")


def test_an_unknown_scene_says_where_it_was_looked_for(run, tmp_path: Path) -> None:
    run("render", "campfire").refused(
        2, f"unknown scene 'campfire': there is no folder {tmp_path}/scenes; give the path"
    )
    (tmp_path / "scenes").mkdir()
    run("render", "campfire").refused(2, f"unknown scene 'campfire': no scene is in {tmp_path}/scenes; give the path")


@pytest.mark.parametrize("file", ["a.txt", "./a", "a.PY", "x/.py", "x/a.txt"])
@pytest.mark.parametrize("command", ["render", "describe"])
def test_a_file_of_another_kind_is_no_scene(run, tmp_path: Path, command: str, file: str) -> None:
    (tmp_path / "x").mkdir()
    (tmp_path / file).write_text("def scene(quality): pass\n")
    run(command, file).refused(2, f"'{file}' is no scene: a .py, .toml or .json file, or a name")


SCRIPTS = {
    "syntax": (b"import os\ndef scene(quality, *:\n", ("t.py:2: `def scene(quality, *:`: invalid syntax",)),
    "exception": (b"x = 1\ny = x / 0\n", ("t.py:2: `y = x / 0`: ZeroDivisionError: division by zero",)),
    "in scene()": (
        b"def scene(quality):\n    return deep()\ndef deep():\n    raise KeyError('gone')\n",
        ("t.py:4: `raise KeyError('gone')`: KeyError: 'gone'",),
    ),
    "no message": (b"def scene(quality):\n    raise ValueError\n", ("t.py:2: `raise ValueError`: ValueError",)),
    "many lines": (b"raise ValueError('a\\nb')\n", ("ValueError: a b",)),
    "import": (b"import nothing_here\n", ("t.py:1: `import nothing_here`: ModuleNotFoundError",)),
    "exit": (b"raise SystemExit(0)\n", ("t.py:1: `raise SystemExit(0)`: SystemExit: 0",)),
    "exit in scene()": (b"import sys\ndef scene(quality):\n    sys.exit()\n", ("t.py:3: `sys.exit()`: SystemExit",)),
    "recursion": (b"def scene(q):\n    return scene(q)\n", ("t.py:2: `return scene(q)`: RecursionError",)),
    "not UTF-8": (b"# caf\xe9\ndef scene(quality): pass\n", ("t.py:1: ", "(0xe9)", "save it as UTF-8")),
    "late not UTF-8": (b"import os\n\n\nx = 'caf\xe9'\n", ("t.py:4: ", "(0xe9)", "save it as UTF-8")),
    "encoding": (b"# coding: klingon\n", ("t.py: unknown encoding: klingon",)),
    "NUL": (b"x = 1\0\n", ("t.py: source code", "null bytes")),
    "empty": (b"", ("t.py: a scene script defines `def scene(quality, *, name=default, ...) -> Scene`",)),
    "a number": (b"scene = 3\n", ("a scene script defines `def scene(",)),
    "a builtin": (b"scene = print\n", ("t.py", "`quality` as its first argument")),
    "no quality": (b"def scene(): pass\n", ("`quality` as its first argument",)),
    "positional": (b"def scene(quality, wind=1): pass\n", ("parameter 'wind'", "keyword-only", "have a default")),
    "no default": (b"def scene(quality, *, wind): pass\n", ("parameter 'wind'", "keyword-only", "have a default")),
    "any number": (b"def scene(*quality): pass\n", ("`quality` as its first argument",)),
    "any names": (b"def scene(quality, **wind): pass\n", ("parameter 'wind'",)),
    "annotation": (b"def scene(quality, *, a: 'Nope' = 1): pass\n", ("signature of scene()", "NameError: name 'Nope'")),
    "returns 3": (b"def scene(quality):\n    return 3\n", ("must return a tparticles.Scene, not int",)),
    "returns nothing": (b"def scene(quality):\n    pass\n", ("must return a tparticles.Scene, not NoneType",)),
    "asynchronous": (b"async def scene(quality):\n    pass\n", ("must return a tparticles.Scene, not coroutine",)),
    "starts Taichi": (b"import taichi as ti\nti.init(arch=ti.cpu)\n", ("t.py:2: `ti.init(arch=ti.cpu)`", "--arch")),
    "resets Taichi": (b"import taichi as ti\ndef scene(q):\n    ti.reset()\n", ("t.py:3: `ti.reset()`", "--arch")),
}


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_broken_script_is_shown_by_its_own_line(run, tmp_path: Path, name: str) -> None:
    source, parts = SCRIPTS[name]
    (tmp_path / "t.py").write_bytes(source)
    run("render", "t.py").refused(2, *parts)
    assert [p.name for p in tmp_path.iterdir()] == ["t.py"]


@pytest.mark.skipif("__import__('os').getuid() == 0", reason="root may read everything")
def test_an_unreadable_script_is_refused(run, scene) -> None:
    scene().chmod(0)
    run("render", "tiny.py").refused(2, "tiny.py cannot be read: Permission denied")


LOOK_AT_ITSELF = (
    "tp.Camera(position=tp.Track(keys=((0.0, (0.0, -5.0, 0.0)), (0.25, (0.0, 0.0, 0.0)))), target=(0.0, 0.0, 0.0))"
)
SCENES = {
    "negative rate": (
        {"births": "tp.Rate(rate=-1.0)"},
        ("tiny.py:10: `emitters=", "Rate.rate = -1.0: should be greater than or equal to 0"),
    ),
    "NaN rate": ({"births": "tp.Rate(rate=float('nan'))"}, ("tiny.py:10", "Rate.rate = nan", "finite")),
    "negative keyed rate": (
        {"births": "tp.Rate(rate=((0.0, 1.0), (1.0, -5.0)))"},
        ("tiny.py:10", "Rate.rate[1][1] = -5.0: should be greater"),
    ),
    "rate of text": (
        {"births": "tp.PerFrame(mean='9')"},
        ("PerFrame.mean = '9': should be a number, or a list of (time, value)",),
    ),
    "negative lifetime": ({"emitter": ", lifetime=-1.0"}, ("tiny.py:10", "emitter 'emitter'", "lifetime", "-1")),
    "zero lifetime": ({"emitter": ", lifetime=tp.Spread(mean=1.0, variance=1.0)"}, ("lifetime", "0")),
    "NaN wind": (
        {"system": "tp.Advected(flow=tp.Uniform(wind=(0.0, float('nan'), 0.0)))"},
        ("tiny.py:9", "Uniform.wind[1] = nan", "finite"),
    ),
    "no duration": ({"duration": "0.0"}, ("Scene.duration = 0.0", "greater than 0")),
    "negative duration": ({"duration": "-1.0"}, ("Scene.duration = -1.0",)),
    "NaN duration": ({"duration": "float('nan')"}, ("Scene.duration = nan", "finite")),
    "short duration": ({"duration": "0.01"}, ("0.01 s is shorter than one frame at 24 fps",)),
    "endless duration": ({"duration": "1e300"}, ("1e+300 s", "more than 10000000 frames")),
    "nothing to emit": ({"births": "tp.Rate(rate=0.0)"}, ("tiny.py:10", "emitter 'emitter' has nothing to emit")),
    "no burst": ({"births": "()"}, ("emitter 'emitter' has nothing to emit",)),
    "empty burst": ({"births": "tp.Burst(count=0)"}, ("Burst.count = 0",)),
    "empty window": ({"emitter": ", start=2.0, stop=1.0"}, ("stop = 1 s must be after start = 2 s",)),
    "no emitter": (
        {"groups": "tp.Group(name='a', system=group.system, emitters=(), appearance=group.appearance)"},
        ("Group.emitters = (): at least 1 is needed",),
    ),
    "no group": ({"groups": "()"}, ("Scene.groups = ()", "at least 1")),
    "two of one name": ({"groups": "(group, group)"}, ("two groups are named 'dots'",)),
    "camera at itself": (
        {"camera": "tp.Camera(position=(1.0, 1.0, 1.0), target=(1.0, 1.0, 1.0))"},
        ("tiny.py:14", "the camera looks at itself: position and target are both (1, 1, 1)"),
    ),
    "camera comes to itself": ({"camera": LOOK_AT_ITSELF}, ("the camera looks at itself at t = 0.25 s",)),
    "camera up": ({"camera": "tp.Camera(position=(0.0, 0.0, 5.0), target=(0.0, 0.0, 0.0))"}, ("parallel to the view",)),
    "camera of text": (
        {"camera": "tp.Camera(position=(0.0, 'a', 5.0), target=(0.0, 0.0, 0.0))"},
        ("tiny.py:14", "Camera.position[1] = 'a'"),
    ),
    "camera typo": ({"camera": "tp.Camera(position=(0.0, 1.0, 5.0), target=(0.0, 0.0, 0.0), fovv=3.0)"}, ("'fovv'",)),
    "field of view": (
        {"camera": "tp.Camera(position=(0.0, 1.0, 5.0), target=(0.0, 0.0, 0.0), fov=200.0)"},
        ("fov", "200"),
    ),
    "no camera": ({"camera": "None"}, ("Scene.camera = None",)),
    "no picture": (
        {"more": ", background=tp.Picture(path='none.png')"},
        ("background 'none.png' cannot be read: No such file or directory",),
    ),
    "picture of text": ({"more": ", background=tp.Picture(path='tiny.py')"}, ("background 'tiny.py' cannot be read",)),
    "picture folder": (
        {"more": ", background=tp.Picture(path='.')"},
        ("background '.' cannot be read: Is a directory",),
    ),
    "size": ({"size": "(0, 36)"}, ("Scene.size[0] = 0",)),
    "odd size": ({"size": "(65, 36)"}, ("64x36 or 66x36",)),
    "scheme": ({"more": ", scheme='rk5'"}, ("tiny.py:13", "unknown scheme 'rk5'; did you mean 'rk4'?")),
    "fps": ({"more": ", fps=0"}, ("fps = 0: must be above 0",)),
    "typo": ({"more": ", durration=3"}, ("no parameter 'durration'; did you mean 'duration'?",)),
    "step": ({"more": ", steps=tp.Fixed(dt=0.0)"}, ("Fixed.dt = 0.0", "greater than 0")),
    "tiny step": ({"more": ", steps=tp.Fixed(dt=1e-12)"}, ("steps of 1e-12 s",)),
    "too many": ({"births": "tp.Rate(rate=1e12)"}, ("particles",)),
    "no law": ({"head": "class Odd: pass", "system": "tp.Advected(flow=Odd())"}, ("tiny.py:9", "has no velocity")),
    "law without @ti.func": (
        {"head": "class Odd:\n    def velocity(self, t, x): return x", "system": "tp.Advected(flow=Odd())"},
        ("tiny.py:10: `system=", "Advected.flow: Odd.velocity is no @ti.func"),
    ),
    "force without @ti.func": (
        {"head": "class Odd:\n    def acceleration(self, t, x, v): return x", "system": "tp.Newtonian(forces=Odd())"},
        ("tiny.py:10: `system=", "Newtonian.forces: Odd.acceleration is no @ti.func"),
    ),
    "law of other arguments": (
        {"head": "class Odd:\n    @ti.func\n    def velocity(self, x): return x", "system": "tp.Advected(flow=Odd())"},
        ("tiny.py:11: `system=", "Odd.velocity must take (self, t, x), not (self, x)"),
    ),
    "no system": ({"system": "3"}, ("tiny.py:7", "Group.system = 3")),
    "law without bound": ({"law": "x", "more": ", steps=tp.StabilityLimit()"}, ("Odd has no jacobian_bound",)),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_wrong_scene_is_shown_by_its_own_line(run, scene, tmp_path: Path, name: str) -> None:
    parts, said = SCENES[name]
    scene(**parts)
    run("render", "tiny.py").refused(2, *said)
    assert [p.name for p in tmp_path.iterdir()] == ["tiny.py"]


LAWS = {
    "unknown name": (
        "nothing * x",
        ("tiny.py:8: `return nothing * x`: TaichiNameError", 'Name "nothing" is not defined'),
    ),
    "wrong size": ("ti.Vector([1.0, 2.0]) + x", ("tiny.py:8: `return ti.Vector([1.0, 2.0]) + x`: TaichiTypeError",)),
    "a number": ("x[0]", ("group 'dots': Odd.velocity must return a vector of 3, not a number",)),
    "a constant": ("3.0", ("group 'dots': Odd.velocity must return a vector of 3, not a number",)),
    "a vector of 2": ("ti.Vector([x[0], t])", ("Odd.velocity must return a vector of 3, not one of shape (2,)",)),
    "a tuple": ("x[0], x[1]", ("Odd.velocity must return a vector of 3, not one of shape (2,)",)),
    "nothing": ("None", ("Odd.velocity must return a vector of 3, not nothing",)),
}


@pytest.mark.parametrize("name", LAWS)
def test_a_law_that_does_not_compile_is_shown_by_its_own_line(run, scene, name: str) -> None:
    law, said = LAWS[name]
    scene(law=law)
    run("render", "tiny.py", "--no-mp4", "--quiet").refused(2, *said)


def test_a_force_that_returns_a_number_is_named(run, scene) -> None:
    head = "class Odd:\n    @ti.func\n    def acceleration(self, t, x, v):\n        return x.norm()"
    mesh = "tp.MeshGroup(name='net', mesh=tp.rope(), forces=Odd(), scheme='velocity-verlet')"
    for parts in ({"system": "tp.Newtonian(forces=Odd())"}, {"groups": mesh}):
        scene(head=head, **parts)
        said = ": Odd.acceleration must return a vector of 3, not a number"
        run("render", "tiny.py", "--no-mp4", "--quiet", "--existing", "overwrite").refused(2, said)


def test_a_law_that_divides_by_zero_while_it_is_compiled_makes_no_noise(process, scene) -> None:
    scene(law="x * ti.sqrt(-1.0) if t > 0.1 else x * 0.0")
    process("render", "tiny.py", "--no-mp4", "--quiet").refused(1, "frame 3, group 'dots': particle 0", "not finite")


def test_a_law_that_returns_nan_names_frame_group_and_particle(process, scene, tmp_path: Path) -> None:
    scene(law="x / (x[0] - x[0]) if t > 0.1 else x * 0.0")
    process("render", "tiny.py", "--no-mp4", "--quiet").refused(1, "frame 3, group 'dots': particle 0", "not finite")
    assert sorted(p.name for p in (tmp_path / "renders/tiny/frames").iterdir()) == ["000001.png", "000002.png"]


def test_an_overflow_names_emitter_and_number(run, scene) -> None:
    parts = "name='dots', system=group.system, emitters=group.emitters, appearance=group.appearance"
    scene(groups=f"tp.Group({parts}, capacity=2)")
    said = ("group 'dots', emitter 'emitter'", "the capacity is 2", "raise Group.capacity to 30 or leave it out")
    run("render", "tiny.py", "--no-mp4", "--quiet").refused(1, *said)
    scene(groups=f"tp.Group({parts}, capacity=30)")
    assert run("render", "tiny.py", "--no-mp4", "--quiet").code == 0


def test_a_named_architecture_never_falls_back(run, scene, tmp_path: Path) -> None:
    scene()
    line = run("render", "tiny.py", "--arch", "vulkan", "--precision", "f64").refused(
        3, "arch 'vulkan' is not available"
    )
    assert "use --arch cpu or --arch auto" in line
    assert [p.name for p in tmp_path.iterdir()] == ["tiny.py"]


def test_a_missing_ffmpeg_is_told_before_anything_is_written(run, scene, tmp_path: Path, monkeypatch) -> None:
    scene()
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nowhere/ffmpeg")
    said = ("/nowhere/ffmpeg: No such file or directory", 'pip install "imageio[ffmpeg]"', "--no-mp4")
    run("render", "tiny.py").refused(3, *said)
    assert [p.name for p in tmp_path.iterdir()] == ["tiny.py"]


def test_failures_are_json_where_json_is_asked_for(run, scene) -> None:
    scene()
    for arguments, code in (
        (("--threads", "0"), 2),
        (("--scheme", "rk5"), 2),
        (("--arch", "vulkan", "--precision", "f64"), 3),
    ):
        result = run("render", "tiny.py", "--json", *arguments)
        assert result.json == {
            "status": "failed",
            "error": result.err.strip().removeprefix("error: "),
            "exit_code": code,
        }
        assert result.code == code
