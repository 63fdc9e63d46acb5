"""Every click leads somewhere: into sight, to a forecast, or to a reason why it has no effect."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, Request, expect

from rollcast.client import Client
from tests.browser.conftest import LANDSCAPE, PHONE, WIDTHS, OpenPage, until_forecast
from tests.browser.test_footage import unfold
from tests.e2e.conftest import ROOT, serving

SIDE, LEFT, TOP = 240, 60, 0
WIDTH = 400
MOST = 8


@pytest.fixture(scope="module")
def images(address: str, tmp_path_factory) -> list[Path]:
    """Frames of a scene in wider pictures."""
    folder = tmp_path_factory.mktemp("images")
    with Client(address) as client:
        frames = client.simulate("ellipsoid", seed=7, steps=60, image_size=SIDE).frames
    paths = []
    for index, frame in enumerate(frames):
        wide = np.full((SIDE, WIDTH, 3), 90, np.uint8)
        wide[:, LEFT : LEFT + SIDE] = frame
        paths.append(folder / f"frame{index}.png")
        Image.fromarray(wide).save(paths[-1])
    return paths


@pytest.fixture(scope="module")
def ball(address: str) -> np.ndarray:
    """Place of the ball in the last of the first four pictures, pixels."""
    with Client(address) as client:
        scene = client.simulate("ellipsoid", seed=7, steps=4, image_size=SIDE)
    return scene.positions[0, 3] + [LEFT, TOP]


def click_at(page: Page, place: np.ndarray) -> None:
    """Click on a place of the pictures, which are wider than high."""
    side = page.locator("#panels canvas").bounding_box()["width"]
    scale = side / WIDTH
    x, y = place * scale
    page.locator("#panels canvas").click(
        position={"x": x, "y": y + (side - SIDE * scale) / 2},
    )


def bring(page: Page, images: list[Path]) -> None:
    until_forecast(page)
    unfold_if_folded(page)
    page.check("#source-footage", force=True)
    page.set_input_files("#files", images)
    expect(page.locator("#stage-title")).to_contain_text("Choose where it begins")


def forecast(page: Page, images: list[Path]) -> None:
    bring(page, images)
    page.click(".edit-actions .primary")
    until_forecast(page)
    expect(page.locator("#busy")).to_be_hidden()


def test_on_a_phone_the_picture_comes_into_sight(open_page: OpenPage, address: str, images):
    page = open_page(address, viewport=PHONE)
    bring(page, images)
    expect(page.locator("#stage-title")).to_be_in_viewport()
    expect(page.locator("#panels canvas")).to_be_in_viewport(ratio=0.8)
    page.click(".edit-actions .primary")
    until_forecast(page)
    expect(page.locator("#panels canvas")).to_be_in_viewport(ratio=0.8)


COVERED = """() => {
  const hidden = [];
  const kinds = 'input:not([type=file]), button, summary, select';
  const controls = document.querySelectorAll(`#controls :is(${kinds})`);
  for (const control of controls) {
    const label = control.closest('label');
    const shown = label && getComputedStyle(control).opacity === '0' ? label : control;
    if (!shown.getClientRects().length) continue;
    const { left, top, width, height } = shown.getBoundingClientRect();
    const [x, y] = [left + width / 2, top + height / 2];
    if (y < 0 || y >= innerHeight || x < 0 || x >= innerWidth) continue;
    const found = document.elementFromPoint(x, y);
    if (!found || !(shown.contains(found) || found.contains(shown) || label?.contains(found))) {
      hidden.push(`${control.id || control.value} under ${found?.id || found?.tagName}`);
    } else if (found.closest('#go') && control.id !== 'go') hidden.push(control.id);
  }
  return hidden;
}"""


@pytest.mark.parametrize("viewport", [*WIDTHS, LANDSCAPE], ids=lambda viewport: viewport["width"])
@pytest.mark.parametrize("source", ["scene", "footage"])
def test_no_control_covers_another(
    open_page: OpenPage, address: str, images, viewport: dict, source: str
):
    page = open_page(address, viewport=viewport)
    if source == "footage":
        bring(page, images)
    else:
        until_forecast(page)
        unfold(page)
        page.click("#scene-panel summary")
    height = page.evaluate("document.documentElement.scrollHeight")
    for top in range(0, height, viewport["height"] // 3):
        page.evaluate("(top) => scrollTo({ top, behavior: 'instant' })", top)
        assert page.evaluate(COVERED) == []


@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda viewport: viewport["width"])
def test_clicks_without_an_effect_say_why(
    open_page: OpenPage, address: str, images, ball, viewport: dict
):
    page = open_page(address, viewport=viewport)
    until_forecast(page)
    expect(page.locator("#view-hint")).to_have_text("Side by side needs a second model.")
    unfold(page)
    page.check("#source-footage", force=True)
    page.click("#go")
    said = page.locator("#messages")
    expect(said).to_contain_text("There is no footage yet")
    page.set_input_files("#files", images)
    expect(said).to_have_text("")
    page.click("#pick-add")
    expect(said).to_contain_text("press Forecast first")
    page.click(".edit-actions .primary")
    until_forecast(page)
    expect(page.locator("#view-hint")).to_contain_text("Only simulations have a true path.")
    page.click("#end")
    click_at(page, ball)  # shows the last seen frame
    expect(page.locator("#time")).to_have_text("+0.000 s")
    page.locator("#panels canvas").click(position={"x": 100, "y": 6})
    expect(said).to_contain_text("That is beside the frame")
    for count in range(1, MOST + 1):
        page.click("#pick-add")
        expect(page.locator("#pick-list li")).to_have_count(count)
    page.click("#pick-add")
    expect(said).to_contain_text("8 balls are the most")
    expect(page.locator("#pick-list li")).to_have_count(MOST)
    click_at(page, ball)
    expect(said).to_contain_text("8 balls are the most")


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Iterator[str]:
    """A service without a model for any number of balls."""
    folder = tmp_path_factory.mktemp("models")
    for name in ("fieldnet", "fieldnet-2"):
        shutil.copytree(ROOT / "models" / name / "1", folder / name / "1")
    with serving(ROLLCAST_MODELS_DIR=str(folder)) as address:
        yield address


def test_without_a_model_that_takes_points_a_click_says_so(open_page: OpenPage, plain: str):
    page = open_page(plain)
    until_forecast(page)
    page.locator("#panels canvas").click(position={"x": 100, "y": 100})
    expect(page.locator("#messages")).to_contain_text("none is served here")
    page.get_by_role("button", name="Dismiss").click()
    expect(page.locator("#messages")).to_have_text("")


@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda viewport: viewport["width"])
def test_numbers_of_balls_that_have_no_model_are_explained(
    open_page: OpenPage, plain: str, viewport: dict
):
    page = open_page(plain, viewport=viewport)
    until_forecast(page)
    unfold(page)
    expect(page.locator("#balls-hint")).to_have_text("No model for 3 balls is served.")
    expect(page.locator("#balls-3")).to_be_disabled()
    page.check("#scenario-hemisphere", force=True)
    expect(page.locator("#balls-hint")).to_have_text(
        "For 2 balls there are models of the ellipsoid alone. No model for 3 balls is served."
    )
    until_forecast(page)


def test_a_browser_that_records_nothing_says_so(open_page: OpenPage, address: str):
    page = open_page(address)
    page.add_init_script("delete window.MediaRecorder")
    page.reload()
    until_forecast(page)
    expect(page.locator("#save-webm")).to_be_disabled()
    expect(page.locator("#webm-hint")).to_have_text(
        "This browser records no WebM; GIF shows the same."
    )


@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda viewport: viewport["width"])
def test_four_to_eight_balls_of_footage(open_page: OpenPage, address: str, images, viewport: dict):
    page = open_page(address, viewport=viewport)
    until_forecast(page)
    unfold_if_folded(page)
    for balls in range(4, MOST + 1):
        expect(page.locator(f"#balls-{balls}")).to_be_hidden()
    forecast(page, images)
    asked: list[Request] = []
    page.on("request", lambda it: asked.append(it) if it.url.endswith("/stream") else None)
    for balls in (4, MOST):
        unfold_if_folded(page)
        page.check(f"#balls-{balls}", force=True)
        expect(page.locator("#models")).to_contain_text("any-ball")
        expect(page.locator("#stage")).to_have_attribute("data-state", re.compile("done|failed"))
        if page.locator("#stage").get_attribute("data-state") == "failed":
            # The pictures show a single ball: how many are found at all is told.
            expect(page.locator("#messages")).to_contain_text("the balls that are found")
    assert len(asked) == 2
    assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]
    unfold_if_folded(page)
    page.check("#source-scene", force=True)
    expect(page.locator("#balls-1")).to_be_checked()
    until_forecast(page)


def unfold_if_folded(page: Page) -> None:
    if not page.locator("#controls-body").is_visible():
        page.click("#fold")


READS = """() => {
  window.reads = 0;
  const read = window.createImageBitmap;
  window.createImageBitmap = (...given) => {
    if (given[0] instanceof File) window.reads += 1;
    return read(...given);
  };
}"""


def test_frames_are_taken_out_of_footage_once(open_page: OpenPage, address: str, images, ball):
    page = open_page(address)
    until_forecast(page)
    page.evaluate(READS)
    forecast(page, images)
    read = page.evaluate("reads")
    assert read >= 43
    page.click("#end")
    click_at(page, ball)
    expect(page.locator("#time")).to_have_text("+0.000 s")
    click_at(page, ball)
    expect(page.locator("#pick-list li")).to_have_count(1)
    until_forecast(page)
    expect(page.locator("#busy")).to_be_hidden()
    page.click("#go")
    until_forecast(page)
    expect(page.locator("#busy")).to_be_hidden()
    assert page.evaluate("reads") == read, "another forecast takes the frames that are there"
    # A longer one reads on from where the one before ended.
    page.fill("#horizon", "50")
    expect(page.locator("#horizon-text")).to_contain_text("50 steps")
    until_forecast(page)
    expect(page.locator("#busy")).to_be_hidden()
    assert read < page.evaluate("reads") < read + 30


@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda viewport: viewport["width"])
def test_points_survive_another_start_and_another_crop(
    open_page: OpenPage, address: str, images, ball, viewport: dict
):
    page = open_page(address, viewport=viewport)
    forecast(page, images)
    page.click("#end")
    click_at(page, ball)
    expect(page.locator("#time")).to_have_text("+0.000 s")
    click_at(page, ball)
    across = page.locator("#pick-list input").first
    expect(page.locator("#pick-list li")).to_have_count(1)
    until_forecast(page)
    x = float(across.input_value())
    assert abs(x - ball[0]) < 1.5
    page.click("#recrop")
    page.fill("#start", "0.025")
    expect(page.locator("#pick-list li")).to_have_count(1)
    page.click(".edit-actions .primary")
    until_forecast(page)
    assert float(across.input_value()) == pytest.approx(x, abs=0.11)
    expect(page.locator("#verdict")).to_contain_text("Ball found.")
    page.click("#recrop")
    page.fill("#crop-size", str(SIDE))
    page.press("#crop-size", "Tab")
    page.fill("#crop-x", str(LEFT))
    page.press("#crop-x", "Tab")
    page.click(".edit-actions .primary")
    until_forecast(page)
    assert float(across.input_value()) == pytest.approx(x - LEFT, abs=0.3)
