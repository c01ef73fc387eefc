"""The page in a real browser, from a file: open, slide, blink, filter, keys, and hostile names."""

import shutil

import pages
import pytest

BROWSERS = ("chromium", "chromium-headless-shell", "chromium-browser", "google-chrome")


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    with playwright.sync_playwright() as running:
        try:
            found = running.chromium.launch(executable_path=path, args=["--no-sandbox"])
        except playwright.Error as error:
            pytest.skip(f"no Chromium starts here (apt install chromium): {str(error).splitlines()[0]}")
        yield found
        found.close()


@pytest.fixture
def page(browser, tmp_path):
    """The report, opened; what it says to the console, or asks of a network, fails the test."""
    complaints: list[str] = []
    found = browser.new_page(viewport={"width": 1200, "height": 900})
    found.on("console", lambda message: complaints.append(message.text))
    found.on("pageerror", lambda error: complaints.append(str(error)))
    found.on("request", lambda r: None if r.url.startswith(("file:", "data:")) else complaints.append(r.url))
    found.goto(pages.write(tmp_path / "a folder & more").as_uri())
    found.complaints = complaints
    yield found
    found.close()
    assert complaints == []


def card(page, name):
    return page.locator(".card", has=page.get_by_role("heading", name=name)).first


def pixel(page, stage, x):
    """Return the colour that is shown at a part of the width, halfway down."""
    import io

    from PIL import Image

    box = stage.bounding_box()
    image = Image.open(io.BytesIO(stage.screenshot())).convert("RGB")
    return image.getpixel((int(x * (box["width"] - 1)), int(box["height"] / 2)))


def test_it_opens_with_what_differs(page):
    assert page.title() == "4 of 5 frames differ"
    assert page.locator("#count").text_content() == "4 of 5 frames shown"
    assert page.locator(".card:visible").count() == 4
    assert not card(page, "as-it-was").is_visible()
    loaded = page.evaluate(
        "[...document.querySelectorAll('figure img')].every((i) => i.complete && i.naturalWidth === 64)"
    )
    assert loaded


def test_the_slider_uncovers_the_new_picture(page):
    changed = card(page, "changed")
    stage, slider = changed.locator(".stage"), changed.get_by_role("slider")
    green, red = (0, 200, 0), (200, 0, 0)
    assert (pixel(page, stage, 0.25), pixel(page, stage, 0.75)) == (green, red)
    slider.fill("90")
    assert pixel(page, stage, 0.75) == green
    slider.focus()
    page.keyboard.press("Home")
    assert pixel(page, stage, 0.25) == red
    changed.focus()
    for _ in range(10):
        page.keyboard.press("ArrowRight")
    assert slider.input_value() == "50" and pixel(page, stage, 0.25) == green


def test_it_blinks_and_stops(page):
    changed = card(page, "changed")
    stage, button = changed.locator(".stage"), changed.get_by_role("button", name="Blink")
    button.click()
    assert button.get_attribute("aria-pressed") == "true"
    seen = set()
    for _ in range(2):
        now = stage.get_attribute("data-now")
        seen.add((now, pixel(page, stage, 0.5)))
        page.wait_for_function("([stage, now]) => stage.dataset.now !== now", arg=[stage.element_handle(), now])
    assert seen == {("reference", (0, 200, 0)), ("new", (200, 0, 0))}
    changed.get_by_role("button", name="Slider").click()
    assert button.get_attribute("aria-pressed") == "false" and stage.get_attribute("data-now") is None


def test_it_filters(page):
    page.get_by_label("all", exact=True).check()
    assert page.locator(".card:visible").count() == 5
    page.get_by_label("what passes").check()
    assert page.locator(".card:visible").count() == 1 and card(page, "as-it-was").is_visible()
    page.get_by_label("what differs").check()
    page.get_by_role("searchbox").fill("Reference NEW-scene")
    assert page.locator("#count").text_content() == "1 of 5 frames shown"
    assert card(page, "new-scene").is_visible()


def test_it_needs_no_mouse(page):
    page.keyboard.press("j")
    headings = []
    for key in ("j", "j", "j", "j", "k"):
        headings.append(page.evaluate("document.activeElement.querySelector('h2').textContent.trim()"))
        page.keyboard.press(key)
    assert headings[0].endswith("changed, frame 1") and headings[3] == headings[4] == "failed broken-scene"
    page.keyboard.press("k")
    page.keyboard.press("k")
    page.keyboard.press("b")
    assert page.locator(".stage[data-view=blink]").count() == 1
    page.keyboard.press("s")
    assert page.evaluate("document.activeElement.type") == "range"
    page.keyboard.press("/")
    page.keyboard.type("jbs")
    assert page.get_by_role("searchbox").input_value() == "jbs"


def test_hostile_names_do_nothing(page):
    page.wait_for_timeout(100)
    assert page.title() == "4 of 5 frames differ"
    assert page.locator("script").count() == 1
    assert page.get_by_role("heading", name=pages.HOSTILE).count() == 1
    blocked = page.evaluate(
        "new Promise((done) => { document.addEventListener('securitypolicyviolation', () => done(true));"
        "const s = document.createElement('script'); s.textContent = 'document.title = 1'; document.body.append(s);"
        "setTimeout(() => done(document.title), 500); })"
    )
    assert blocked is True and page.title() == "4 of 5 frames differ"
    (complaint,) = page.complaints
    assert "violates the following Content Security Policy" in complaint
    page.complaints.clear()
