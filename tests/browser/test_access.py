"""For everybody: keyboards, screen readers, little light, small screens, little trust."""

import re
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image
from playwright.sync_api import Page, expect

from tests.browser.conftest import DESKTOP, PHONE, WIDTHS, OpenPage, until_forecast

WCAG = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]}}


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("viewport", [DESKTOP, PHONE], ids=["desktop", "phone"])
@pytest.mark.parametrize("state", ["forecast", "footage", "refusal"])
def test_wcag(open_page: OpenPage, address: str, scheme: str, viewport: dict, state: str):
    # Axe brings its own script, which the page's policy would not let in.
    page = open_page(
        address,
        "#models=auto,probnet,posnet&layout=split",
        color_scheme=scheme,
        viewport=viewport,
        bypass_csp=True,
    )
    until_forecast(page)
    if viewport == PHONE:
        page.click("#fold")
    if state == "footage":
        page.check("#source-footage")
        expect(page.locator("#stage-title")).to_contain_text("Bring a video")
    if state == "refusal":
        page.fill("#seed", "-1")
        page.press("#seed", "Enter")
        expect(page.locator("#messages")).to_contain_text("A value is invalid")
    page.wait_for_timeout(300)
    found = Axe().run(page, options=WCAG)
    assert found.response["violations"] == [], found.generate_report()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda viewport: viewport["width"])
def test_wcag_of_every_state(
    open_page: OpenPage, address: str, tmp_path: Path, scheme: str, viewport: dict
):
    page = open_page(
        address, "#models=any-ball&horizon=60", color_scheme=scheme, viewport=viewport,
        bypass_csp=True,
    )  # fmt: skip
    until_forecast(page)
    page.click("#end")
    expect(page.locator("#verdict")).to_have_attribute("data-warning", "true")
    page.click("#notes-title")
    accessible(page, "a verdict that warns, with its figures")
    page.click("#zoom-in")
    accessible(page, "a zoomed picture")
    if page.locator("#fold").is_visible():
        page.click("#fold")
    page.click("#scene-panel summary")
    accessible(page, "the open panel of the scene")
    page.click("#pick-add")
    expect(page.locator("#pick-list li")).to_have_count(1)
    until_forecast(page)
    accessible(page, "a chosen point")
    page.check("#scenario-table", force=True)
    expect(page.locator("#stage-title")).to_contain_text("Table")
    until_forecast(page)
    accessible(page, "a table")
    page.check("#source-footage", force=True)
    page.click("#go")
    expect(page.locator("#messages")).to_contain_text("no footage yet")
    accessible(page, "a reason")
    files = [tmp_path / f"frame{index}.png" for index in range(6)]
    for index, file in enumerate(files):
        picture = Image.new("RGB", (160, 90), (60, 90, 60))
        picture.paste((230, 230, 230), (20 + 8 * index, 40, 32 + 8 * index, 52))
        picture.save(file)
    page.set_input_files("#files", files)
    expect(page.locator("#stage-title")).to_contain_text("Choose where it begins")
    accessible(page, "the crop of footage")
    page.fill("#crop-size", "80")
    page.press("#crop-size", "Tab")
    accessible(page, "a square of footage")


def accessible(page: Page, state: str) -> None:
    page.wait_for_timeout(300)
    found = Axe().run(page, options=WCAG)
    assert found.response["violations"] == [], f"{state}: {found.generate_report()}"


@pytest.mark.parametrize("width", [320, 390, 700, 1000, 1300])
def test_nothing_is_wider_than_the_screen(open_page: OpenPage, address: str, width: int):
    page = open_page(address, viewport={"width": width, "height": 800})
    until_forecast(page)
    if page.locator("#fold").is_visible():
        page.click("#fold")
    wide = page.evaluate(
        """() => [...document.querySelectorAll('body *')]
          .filter((element) => !element.closest('.table-box, .hidden, .skip, pre, .strip, svg'))
          .filter((element) => element.getBoundingClientRect().right > innerWidth + 0.5)
          .map((element) => element.outerHTML.slice(0, 80))"""
    )
    assert wide == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_keys(page: Page):
    page.focus("#screen")
    time = page.locator("#time")
    page.keyboard.press("Home")
    expect(time).to_have_text("−0.075 s")
    page.keyboard.press("ArrowRight")
    expect(time).to_have_text("−0.050 s")
    page.keyboard.press("Shift+ArrowRight")
    expect(time).to_have_text("+0.200 s")
    page.keyboard.press("End")
    expect(time).to_have_text("+0.975 s")
    page.keyboard.press("ArrowLeft")
    expect(time).to_have_text("+0.950 s")
    page.keyboard.press("Home")
    page.keyboard.press(" ")
    expect(page.locator("#play")).to_have_attribute("aria-label", "Pause")
    page.keyboard.press(" ")
    expect(page.locator("#play")).to_have_attribute("aria-label", "Play")


def test_everything_is_reached_with_the_tab_key(page: Page):
    page.evaluate("document.activeElement.blur()")
    reached = set()
    for _ in range(80):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.id || document.activeElement.className"))
    wanted = {
        "skip", "theme", "source-scene", "scenario-ellipsoid", "seed", "dice", "balls-1", "horizon",
        "final", "go", "screen", "play", "scrub", "speed", "ellipses", "truth", "surface",
        "surface-reset", "save-json", "save-png", "save-gif", "save-webm", "save-frames",
        "copy-link", "language-curl", "copy", "snippet", "zoom-in",
    }  # fmt: skip
    assert wanted <= reached
    page.focus("#scenario-ellipsoid")
    page.keyboard.press("ArrowRight")
    until_forecast(page)
    expect(page.locator("#stage-title")).to_contain_text("Heightfield")


def test_the_theme(page: Page):
    def ground() -> str:
        return page.evaluate("getComputedStyle(document.body).backgroundColor")

    light = ground()
    page.click("#theme")
    assert ground() == light
    page.click("#theme")
    dark = ground()
    assert dark != light
    page.reload()
    until_forecast(page)
    assert ground() == dark
    page.click("#theme")
    assert ground() == light


def test_a_wish_for_less_motion(open_page: OpenPage, address: str):
    page = open_page(address, reduced_motion="reduce")
    until_forecast(page)
    expect(page.locator("#time")).to_have_text("+0.975 s")
    expect(page.locator("#play")).to_have_attribute("aria-label", "Play")


def test_a_page_without_3d(open_page: OpenPage, address: str):
    page = open_page(address, "#seed=8")
    page.add_init_script("HTMLCanvasElement.prototype.getContext = ((original) => function (kind, "
        "...rest) { return kind.startsWith('webgl') ? null : original.call(this, kind, ...rest); })"
        "(HTMLCanvasElement.prototype.getContext)")  # fmt: skip
    page.reload()
    until_forecast(page)
    expect(page.locator("#surface-note")).to_contain_text("This browser shows no 3D")


def test_the_policy_lets_nothing_else_in(page: Page, address: str):
    policy = page.request.get(f"{address}/").headers["content-security-policy"]
    assert "unsafe" not in policy
    assert re.search(r"default-src 'self'(;|$)", policy)
    assert page.evaluate("(() => { try { return eval('1'); } catch { return 'refused'; } })()") in {
        "refused",
        1,  # what the tests themselves evaluate is let in by some browsers
    }
