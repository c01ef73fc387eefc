"""The pytest plug-in, in a pytest of its own."""

import numpy as np
import pytest
from check_scenes import picture

from tparticles.output import encode_png
from tparticles.regression import check, single  # noqa: F401  # or each pytest of a test would import them anew

pytestmark = pytest.mark.serial  # pytest inside pytest

pytest_plugins = "pytester"

# Hypothesis would be imported anew, and rewritten, by each pytest.
ALONE = ("-p", "no:cacheprovider", "-p", "no:hypothesispytest")

TEST = """
import numpy as np
import pytest


class Frame:  # as far as the fixture looks at one
    number = 24

    def __init__(self, image, x):
        self.image, self._x = image, x

    def state(self):
        return {{"dots": {{"id": np.arange(4), "x": self._x}}}}


IMAGE = np.full((16, 24, 3), 90, np.uint8)
X = np.arange(12.0).reshape(4, 3)


@pytest.mark.parametrize("word", ["a/b", "a-b"])
def test_array(tparticles_image, word):
    tparticles_image(IMAGE + {brighter}, "first")
    tparticles_image(IMAGE)


def test_frame(tparticles_image):
    tparticles_image(Frame(IMAGE, X + {moved}))
"""


@pytest.fixture(autouse=True)
def no_ci(monkeypatch):
    monkeypatch.delenv("CI", raising=False)


@pytest.fixture
def suite(pytester):
    """Return a function that writes and runs a test suite."""

    def suite(*arguments, brighter=0, moved=0.0):
        text = TEST.format(brighter=brighter, moved=moved)
        pytester.makepyfile(test_users_film=text)
        return pytester.runpytest(*ALONE, *arguments)

    return suite


def test_references_are_asked_for_made_kept_and_compared(suite, pytester):
    missing = suite()
    missing.assert_outcomes(failed=3)
    missing.stdout.fnmatch_lines(
        ["*there is no reference *references/test_users_film/test_frame-frame-24.png*--tparticles-update"]
    )
    suite("--tparticles-update").assert_outcomes(passed=3)
    files = {path.name for path in (pytester.path / "references/test_users_film").iterdir()}
    assert len(files) == 6 and {"test_frame-frame-24.png", "test_frame-frame-24.json"} <= files
    suite().assert_outcomes(passed=3)


def test_a_change_of_picture_and_one_of_physics_read_differently(suite, pytester):
    suite("--tparticles-update")
    picture = suite(brighter=1)
    picture.assert_outcomes(failed=2, passed=1)
    picture.stdout.fnmatch_lines(
        ["*first: the picture changed: brighter by 1.0000/255 on average*the new picture is *"]
    )
    physics = suite(moved=0.5)
    physics.assert_outcomes(failed=1, passed=2)
    physics.stdout.fnmatch_lines(["*frame-24: the physics changed, the picture did not: dots: mean position*"])
    suite("--tparticles-update", moved=0.5).assert_outcomes(passed=3)
    suite(moved=0.5).assert_outcomes(passed=3)


def test_references_are_not_made_where_ci_is_set(suite, pytester, monkeypatch):
    monkeypatch.setenv("CI", "1")
    refused = pytester.runpytest(*ALONE, "--tparticles-update")
    assert refused.ret == pytest.ExitCode.USAGE_ERROR
    refused.stderr.fnmatch_lines(["*--tparticles-update: references are not updated where CI is set*"])
    assert not (pytester.path / "references").exists()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"GIF89a", "is no PNG"),
        (encode_png(np.full((16, 24, 3), 90, np.uint8), {})[:-12], "is cut"),
        (encode_png(picture(), {}), "the picture is 24x16, its reference 64x36"),
    ],
)
def test_a_reference_that_cannot_be_used_fails_in_a_line(suite, pytester, data, words):
    suite("--tparticles-update")
    (pytester.path / "references/test_users_film/test_frame-frame-24.png").write_bytes(data)
    broken = suite("-k", "frame")
    broken.assert_outcomes(failed=1, deselected=2)
    broken.stdout.fnmatch_lines([f"*frame-24: *{words}*"])


def test_what_a_test_does_wrong_is_told(pytester):
    pytester.makepyfile("""
        import numpy as np
        from tparticles.regression.tolerance import Tolerance

        def test_float(tparticles_image):
            tparticles_image(np.zeros((4, 4, 3)))

        def test_twice(tparticles_image):
            for _ in range(2):
                tparticles_image(np.zeros((4, 4, 3), np.uint8), "x")

        def test_reason(tparticles_image):
            tparticles_image(np.zeros((4, 4, 3), np.uint8), tolerance=Tolerance(tile=3.0))
    """)
    done = pytester.runpytest(*ALONE, "--tparticles-update")
    done.assert_outcomes(failed=3)
    done.stdout.fnmatch_lines(
        [
            "*a picture is uint8 of shape (h, w, 3), this is float64 (4, 4, 3)*",
            "*test_twice has two pictures named 'x': give each a name*",
            "*a tolerance with another tile needs a written reason*",
        ]
    )
