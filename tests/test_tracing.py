"""The quick tracer traces what Taichi's own does: the same kernels, the same errors."""

# pyright: reportInvalidTypeForm=false, reportAttributeAccessIssue=false, reportUndefinedVariable=false

import contextlib
import inspect
import os
import subprocess
import sys

import pytest
import taichi as ti

import tparticles as tp
from tparticles import tracing

RUN = """
import taichi as ti
{own}
import tparticles as tp
from tparticles.library import load
film = load("campfire").build(quality="preview", settings={{}})
for frame in tp.Simulation(film, size=(32, 18), arch="cpu", threads=1).frames([1]):
    pass
"""
OWN = """
from tparticles import tracing
assert all(vars(owner)[name] is not value for owner, name, value in tracing._TAICHIS)
tracing.replace(tracing._TAICHIS)
"""


def kernels(folder, own):
    """Render a frame in a process of its own; return the names of the kernels in its cache, hashes of what was traced."""
    environment = {**os.environ, "TPARTICLES_CACHE": str(folder)}
    subprocess.run([sys.executable, "-c", RUN.format(own=own)], env=environment, check=True)
    return {path.name for path in folder.rglob("*.tic")}


def test_the_same_kernels_are_traced(tmp_path):
    ours, taichis = kernels(tmp_path / "ours", ""), kernels(tmp_path / "taichis", OWN)
    assert ours == taichis and len(ours) > 10


@ti.func
def doubled(x):
    return 2 * x


@ti.func
def multi_line(
    x,  # with a bracket, and its end where the function could end
):
    text = """
def not_a_function():
"""
    # fmt: off
    # a comment at the margin:
    # does not end it, nor does a bracket
    y = (
x
    ) + len(text)
    # fmt: on
    return y


class Owner:
    @ti.func
    def method(self, x):
        return x

    @property
    def after(self):
        return 1


@ti.func
def last(x):
    return doubled(doubled(x))


@pytest.mark.parametrize(
    "function", [doubled, multi_line, Owner.method, last, tp.CurlNoise.velocity_pass, tp.Box.sample]
)
def test_sources_are_those_that_inspect_finds(function):
    lines, first, _ = tracing._source_lines(function.func.func)
    wanted, at = inspect.getsourcelines(function.func.func)
    assert ("".join(lines).rstrip(), first) == ("".join(wanted).rstrip(), at)


def test_a_function_may_be_inlined_in_itself_and_in_many_kernels(cpu):
    @ti.func
    def power(x, n: ti.template()):
        result = x
        if ti.static(n > 1):
            result = x * power(x + 0.0, n - 1)
        return result

    @ti.kernel
    def cube(x: float) -> float:
        return power(doubled(x), 3)

    @ti.kernel
    def square(x: float) -> float:
        return power(x, 2)

    assert (cube(1.5), square(3.0), last_of(1.0)) == (27.0, 9.0, 4.0)


@ti.kernel
def last_of(x: float) -> float:
    return last(x)


def test_errors_name_file_line_and_source(cpu):
    @ti.kernel
    def wrong() -> float:
        return doubled(no_such_name)  # noqa: F821

    line = inspect.getsourcelines(wrong)[1] + 2
    with pytest.raises(
        ti.TaichiNameError, match=rf'File ".*test_tracing.py", line {line}, in wrong:\n +return doubled'
    ):
        wrong()
    with pytest.raises(ti.TaichiNameError, match="no_such_name"):
        wrong()  # the same again: nothing is left of the first


TYPED = """import taichi as ti
from tparticles import backend
_ = backend.start(arch="cpu")
@ti.kernel
def answer() -> ti.i32:
    return 42

print("the answer:", answer())
exit()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="an interpreter is typed into through a pseudo-terminal")
def test_a_kernel_may_be_typed_into_an_interpreter():
    import pty

    ours, theirs = pty.openpty()
    process = subprocess.Popen([sys.executable, "-q"], stdin=theirs, stdout=theirs, stderr=theirs, close_fds=True)
    os.close(theirs)
    os.write(ours, TYPED.encode())
    said = b""
    with contextlib.suppress(OSError):  # how Linux says that the other end is closed
        while more := os.read(ours, 4096):
            said += more
    os.close(ours)
    assert process.wait(60) == 0
    assert "the answer: 42" in said.decode()
