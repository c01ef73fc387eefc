"""The page as text: whole in itself, failures first, nothing hostile gets through, and what is missing is told."""

import base64
import hashlib
import io
import re
import sys
from html.parser import HTMLParser

import numpy as np
import pages
import pytest
from PIL import Image

from tparticles.errors import InputError
from tparticles.regression import report as reporting


class Elements(HTMLParser):
    """All elements with their attributes, and the text within each kind."""

    def __init__(self, text):
        super().__init__()
        self.found, self.text, self.stack = [], {}, []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "input"):
            self.stack.append(tag)

    def handle_endtag(self, tag):
        while self.stack and self.stack.pop() != tag:
            pass

    def handle_data(self, data):
        if self.stack:
            self.text.setdefault(self.stack[-1], []).append(data)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return pages.write(tmp_path_factory.mktemp("page") / "report").read_text()


@pytest.fixture(scope="module")
def elements(page):
    return Elements(page)


def sha(text):
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def test_nothing_comes_from_elsewhere_and_no_other_script_may_run(page, elements):
    (policy,) = [a["content"] for tag, a in elements.found if tag == "meta" and a.get("http-equiv")]
    assert policy.startswith("default-src 'none'; img-src data:;") and "unsafe" not in policy
    (style,), (script,) = elements.text["style"], elements.text["script"]
    assert f"'{sha(style)}'" in policy and f"'{sha(script)}'" in policy
    sources = [a.get("src") or "" for tag, a in elements.found if tag in ("img", "script", "link", "iframe")]
    assert all(source == "" or source.startswith("data:image/png;base64,") for source in sources)
    assert "http:" not in page and "https:" not in page


def test_hostile_names_stay_text(page, elements):
    assert [tag for tag, _ in elements.found].count("script") == 1
    assert not any(name.startswith("on") or name == "style" for _, a in elements.found for name in a)
    assert all(a["src"] != "x" for tag, a in elements.found if tag == "img" and "src" in a)
    assert page.count("&lt;/script&gt;") >= 4 and "{{7*7}}" in page


def test_failures_come_first_with_their_pictures_numbers_and_the_command(page, elements):
    names = re.findall(r'<span class="word">(\w+)</span>', page)
    assert names == ["different", "different", "missing", "failed", "same"]
    kinds = [a["data-kind"] for tag, a in elements.found if tag == "figure"]
    assert kinds[:4] == ["reference", "new", "difference", "flip"]
    assert "4 of 5 frames need a look" in page and "references/unused is used by no scene" in page
    assert "<code>tparticles check --update -- changed</code>" in page
    assert '<th scope="row">wind</th><td>0.25</td>' in page and "100.000%" in page


def test_pictures_in_the_page_are_the_pictures(elements):
    images = [a["src"] for tag, a in elements.found if tag == "img" and "src" in a]
    reference, new, amplified, flip = (
        np.asarray(Image.open(io.BytesIO(base64.b64decode(source.partition(",")[2])))) for source in images[:4]
    )
    assert np.array_equal(reference, pages.plain()) and np.array_equal(new, pages.red())
    assert (amplified == (255, 255, 0)).all() and flip.shape == new.shape and flip.mean() > 50


def test_without_flip_the_page_says_so_and_without_jinja2_a_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    text = pages.write(tmp_path / "page").read_text()
    assert "No perceptual difference: pip install &#39;tparticles[regression]&#39; brings NVIDIA FLIP." in text
    assert 'data-kind="flip"' not in text
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(InputError, match=r"--report needs jinja2: pip install 'tparticles\[regression\]'"):
        reporting.Report(tmp_path / "page")


def test_a_folder_that_cannot_be_written_is_told_before_anything_is_rendered(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file/page", reporting.Path("/proc/page")):
        with pytest.raises(InputError, match="choose another with --report"):
            reporting.Report(folder)
