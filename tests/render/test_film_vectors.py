"""What the compiler makes of the film's inner loops: losing vector instructions halves the speed and changes no picture."""

import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import pytest

DRAW = """
from tparticles import backend
from tparticles.render.film import Dots, Film
backend.start(arch="cpu", threads=1)
film, dots = Film(64, 48, capacity=1), Dots(2)
film.add(dots, dots.upload([20.0, 30.0], 20.0, sigma=[0.6, 3.0], energy=[1.0, 1.0, 1.0]))
assert film.sums().any()
"""


def wide_enough() -> bool:
    """Whether this processor has vectors of four i64 (AVX2)."""
    cpuinfo = Path("/proc/cpuinfo")
    return platform.machine() == "x86_64" and cpuinfo.exists() and " avx2 " in cpuinfo.read_text()


@pytest.mark.skipif(not wide_enough(), reason="only x86-64 with AVX2 has the instructions that are looked for")
def test_light_is_added_by_vectors(tmp_path: Path) -> None:
    environment = os.environ | {
        "TI_PRINT_KERNEL_ASM": "1",
        "TPARTICLES_CACHE": str(tmp_path / "cache"),
        "PYTHONPATH": str(Path(__file__).parents[2]),
    }
    subprocess.run([sys.executable, "-c", DRAW], env=environment, cwd=tmp_path, check=True, timeout=300)
    texts = [path.read_text() for path in tmp_path.glob("*.s")]
    (text,) = [text for text in texts if "_add_round" in text]
    added = re.findall(r"\bvpaddq\s.*[yz]mm", text)
    # A row of a small dot has 16 values, one of a wide dot 24, at 4 or 8 a register; two sums each, see `splat.rounded`.
    assert len(added) >= 4 + 6
    assert not re.search(r"\bv?cvttss2si\s+\S+, %r(?:[a-z]{2}|\d+)\b", text)  # a float to an i64, one after the other
    assert not re.search(r"\baddq\s+%r\w+, \d*\(%r\w+,%r\w+,8\)", text)  # one value after the other
