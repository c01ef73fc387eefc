"""The pytest plug-in: the fixture `tparticles_image` holds pictures of your scenes against references beside your tests.

    def test_fountain(tparticles_image):
        simulation = tp.Simulation(fountain(), size=(160, 90), arch="cpu")
        for frame in simulation.frames((1, 24)):
            tparticles_image(frame)

`pytest --tparticles-update` makes or replaces the references: look at them, and commit them. Every run of pytest imports this
module, so it imports nothing heavy before a test asks for the fixture.
"""

from __future__ import annotations

import re
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    import numpy as np

    from ..simulation import Frame
    from .tolerance import Tolerance

_OPTION = "--tparticles-update"
_FOLDER = "references"
_LONGEST = 120  # characters of a file's name


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the flag that makes references."""
    parser.getgroup("tparticles").addoption(
        _OPTION,
        action="store_true",
        help="make or replace the reference pictures of tparticles_image; refused where CI is set",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Refuse to make references where nobody looks at them."""
    if not config.getoption(_OPTION):
        return
    from ..errors import InputError
    from .check import refuse_on_ci

    try:
        refuse_on_ci()
    except InputError as error:
        raise pytest.UsageError(f"{_OPTION}: {error}") from None


class ImageCheck:
    """What the fixture is: call it with each picture of a test.

    References lie in `references/` and the module's name beside the test's file: a PNG for each picture, for a `Frame` a JSON
    file with the moments of its state too, so that a change of physics reads as one.
    """

    def __init__(self, folder: Path, test: str, scratch: Path, *, update: bool):
        self._folder, self._test, self._scratch, self._update = folder, test, scratch, update
        self._names: set[str] = set()

    def __call__(
        self, picture: Frame | np.ndarray, name: str | None = None, *, tolerance: Tolerance | None = None
    ) -> None:
        """Fail the test unless `picture` is as its reference.

        `picture`: a `Frame`, or uint8 of shape (h, w, 3). `name`: of the picture among those of the test; the frame's number, or
        a count, if it is left out. `tolerance`: another one than the usual needs its reason.
        """
        from ..errors import TparticlesError

        try:
            self._check(picture, name, tolerance)
        except TparticlesError as error:
            pytest.fail(str(error), pytrace=False)

    def _check(self, picture: Frame | np.ndarray, name: str | None, tolerance: Tolerance | None) -> None:
        from ..errors import InputError
        from .moments import moments
        from .single import Single
        from .tolerance import USUAL

        image: Any = getattr(picture, "image", picture)
        number = getattr(picture, "number", None)
        label = name or (f"frame-{number}" if number else str(len(self._names) + 1))
        if label in self._names:
            raise InputError(f"{self._test} has two pictures named '{label}': give each a name")
        self._names.add(label)
        single = Single(self._folder / f"{_file_name(f'{self._test}-{label}')}.png")
        state = moments(picture.state()) if number else None  # type: ignore[union-attr]
        verdict = single.judge(image, state, tolerance or USUAL)
        if self._update:
            if verdict.word != "same":
                single.write(image, state)
        elif not verdict.word.passes:
            kept = single.keep(image, self._scratch)
            pytest.fail(
                f"{label}: {verdict.text}; the new picture is {kept}; if it should be so: {_OPTION}", pytrace=False
            )


def _file_name(text: str) -> str:
    """Return a file's name for a test's; where something had to be replaced a checksum tells two of them apart."""
    clean = re.sub(r"[^A-Za-z0-9_.]+", "-", text).strip("-.")[:_LONGEST]
    return clean if clean == text else f"{clean}-{zlib.crc32(text.encode('utf-8', 'surrogatepass')):08x}"


@pytest.fixture
def tparticles_image(request: pytest.FixtureRequest, tmp_path: Path) -> ImageCheck:
    """Hold pictures of scenes against references; see `ImageCheck`."""
    file = Path(request.path)
    update = bool(request.config.getoption(_OPTION))
    return ImageCheck(file.parent / _FOLDER / file.stem, request.node.name, tmp_path, update=update)
