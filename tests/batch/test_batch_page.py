"""The page of films in a real browser, from a file: films load and nothing else does, whatever the names are."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tparticles.batch import gallery
from tparticles.batch.record import Entry, Record
from tparticles.batch.tasks import Task
from tparticles.output import Mp4, OutputFrame, PngSequence

BROWSERS = ("chromium", "chromium-headless-shell", "chromium-browser", "google-chrome")
EVIL = '"><script>document.title="evil"</script><img src=x onerror=alert(1)>'

# The width of a film, or what is wrong with it; the width of its poster.
LOADED = """v => new Promise(done => {
    v.onloadeddata = () => done(v.videoWidth);
    v.onerror = () => done(v.error.message);
    v.preload = "auto";
    v.load();
})"""
POSTER = """v => new Promise(done => {
    const image = new Image();
    image.onload = () => done(image.width);
    image.onerror = () => done(0);
    image.src = v.poster;
})"""


@pytest.fixture
def record(tmp_path: Path) -> Record:
    """A batch of two films, one without pictures, and a failure, in a folder with an awkward name."""
    folder = tmp_path / "a night's & <b>batch</b> #1?"
    entries = [
        Entry(Task(name="wind=0.5,seed=1", scene="s", settings={"note": EVIL}), "done", frames=6),
        Entry(Task(name="only~film", scene="s", seed=3), "done", frames=6),
        Entry(Task(name="bad", scene="s"), "failed", 3, 1, f"NaN {EVIL}"),
    ]
    for entry, with_pictures in zip(entries, (True, False), strict=False):
        out = folder / "jobs" / entry.task.name
        out.mkdir(parents=True)
        film, pictures = Mp4(out / "s.mp4", fps=Fraction(24), size=(64, 36)), PngSequence(out / "frames")
        for number in range(1, 7):
            frame = OutputFrame(number, np.full((36, 64, 3), (200, 40 * number, 20), np.uint8))
            film.write(frame)
            if with_pictures:
                pictures.write(frame)
        film.close()
    record = Record(folder, entries)
    gallery.show(record)
    return record


def test_the_sheet_shows_pictures_films_and_failures(record: Record) -> None:
    with Image.open(record.folder / gallery.SHEET_NAME) as image:
        sheet = np.asarray(image.convert("RGB")).astype(int)
    middles = [sheet[8 + 81, 8 + i * 296 + 144] for i in range(3)]
    assert np.abs(middles[0] - (200, 160, 20)).max() <= 2  # the fourth of six
    assert abs(middles[1][0] - 200) < 12 and middles[1][2] < 40  # from the film
    assert tuple(middles[2]) == gallery._BACK
    assert (sheet[8:170, 8 + 2 * 296 :] == gallery._PALE).all(axis=2).sum() > 300  # its frame and its error


def test_a_still_that_is_no_picture_is_left_out(record: Record) -> None:
    folder = record.out("wind=0.5,seed=1")
    (folder / "frames/000004.png").write_bytes(b"no picture")
    assert gallery.still(folder) is None
    assert gallery.show(record)[0].is_file()


def test_many_films_take_several_sheets(tmp_path: Path) -> None:
    record = Record(tmp_path, [Entry(Task(name=f"seed={i}", scene="s", seed=i)) for i in range(101)])
    assert [path.name for path in gallery.show(record)] == ["contact.png", "contact-2.png", "index.html"]


def test_a_folder_whose_name_is_no_text(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"\xff\n<b>")
    folder.mkdir()
    gallery.show(Record(folder, [Entry(Task(name="a", scene="s"))]))
    assert "\\udcff\n&lt;b&gt;</h1>" in (folder / gallery.PAGE_NAME).read_text()


@pytest.fixture
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    with playwright.sync_playwright() as running:
        try:
            found = running.chromium.launch(executable_path=path, args=["--no-sandbox"])
        except playwright.Error as error:
            pytest.skip(f"no Chromium starts here (apt install chromium): {str(error).splitlines()[0]}")
        yield found
        found.close()


def test_the_page_opens_from_a_file(record: Record, browser: Any) -> None:
    complaints: list[str] = []
    page = browser.new_page()
    page.on("console", lambda message: complaints.append(message.text))
    page.on("request", lambda r: None if r.url.startswith("file:") else complaints.append(r.url))
    page.goto((record.folder / gallery.PAGE_NAME).as_uri())
    assert page.title() == record.folder.name
    assert page.locator("video").count() == 2 and page.locator("li").count() == 3
    assert EVIL in page.locator("li").nth(0).text_content()
    assert EVIL in page.locator(".failed").text_content()
    for i in (0, 1):
        assert page.locator("video").nth(i).evaluate(LOADED) == 64
    assert page.locator("video").first.evaluate(POSTER) == 64
    assert page.evaluate("document.scripts.length") == 0
    assert complaints == []
