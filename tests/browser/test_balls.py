"""Balls that are selected on the picture, and what the page says of them."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, Request, expect

from rollcast.client import Client
from tests.browser.conftest import OpenPage, pixels, until_forecast

SIZE = 256


@pytest.fixture(scope="module", autouse=True)
def model(address: str) -> str:
    """Name of a served model for any number of balls."""
    with Client(address) as client:
        served = [entry for entry in client.models() if entry.status == "ready"]
    names = [entry.name for entry in served if entry.max_objects is not None]
    if not names:
        pytest.skip("no model for any number of balls is served")
    return names[0]


@pytest.fixture(scope="module")
def places(address: str) -> np.ndarray:
    """Balls of the page's scene with two balls in the last seen frame, pixels."""
    with Client(address) as client:
        scene = client.simulate("ellipsoid", seed=7, num_objects=2, steps=4, image_size=SIZE)
    return scene.positions[:, 3]


@pytest.fixture
def page(open_page: OpenPage, address: str) -> Page:
    page = open_page(address, "#balls=2")
    until_forecast(page)
    page.click("#end")
    return page


def at(page: Page, place: np.ndarray) -> dict[str, float]:
    """Where a place of the frame is on the picture."""
    box = page.locator("#panels canvas").bounding_box()
    assert box is not None
    x, y = (place * box["width"] / SIZE).tolist()
    return {"x": x, "y": y}


def select(page: Page, *places: np.ndarray) -> None:
    picture = page.locator("#panels canvas")
    picture.click(position={"x": 5, "y": 5})  # shows the last seen frame
    expect(page.locator("#time")).to_have_text("+0.000 s")
    for count, place in enumerate(places, 1):
        picture.click(position=at(page, place))
        expect(page.locator("#pick-list li")).to_have_count(count)
        until_forecast(page)


SAVES_DATA = """
window.savesData = true;
Object.defineProperty(navigator, "connection", {
  get: () => ({ saveData: window.savesData }),
});
"""


def test_points_stay_on_their_ball_when_the_frames_change_size(
    open_page: OpenPage, address: str, places: np.ndarray
):
    page = open_page(address, "#balls=2")
    page.add_init_script(SAVES_DATA)
    page.reload()
    until_forecast(page)
    asked: list[Request] = []
    page.on("request", lambda it: asked.append(it) if it.url.endswith("/stream") else None)
    page.click("#end")
    select(page, places[0])
    (small,) = json.loads(asked[-1].post_data or "")["balls"]
    page.evaluate("window.savesData = false")
    page.locator("#horizon").fill("20")
    until_forecast(page)
    (large,) = json.loads(asked[-1].post_data or "")["balls"]
    assert np.allclose((large["x"], large["y"]), places[0], atol=1)
    assert np.allclose((small["x"], small["y"]), places[0] / 2, atol=1)


def test_clicks_select_balls(page: Page, places: np.ndarray, model: str):
    asked: list[Request] = []
    page.on("request", lambda it: asked.append(it) if it.url.endswith("/stream") else None)
    select(page, places[1], places[0])
    balls = json.loads(asked[-1].post_data or "")["balls"]
    assert np.allclose([(ball["x"], ball["y"]) for ball in balls], places[::-1], atol=1)
    expect(page.locator("#legend")).to_contain_text(f"auto: {model}")
    expect(page.locator("#verdict")).to_have_text("2 balls found.")
    assert "points=" in page.url
    for language, written in (("curl", '"balls": [{"x":'), ("python", "balls=[(")):
        page.check(f"#language-{language}", force=True)
        expect(page.locator("#snippet")).to_contain_text(written)


def test_a_point_is_dragged_typed_and_removed(page: Page, places: np.ndarray):
    select(page, places[0])
    before = pixels(page)
    box = page.locator("#panels canvas").bounding_box()
    assert box is not None
    begin, end = at(page, places[0]), at(page, places[1])
    page.mouse.move(box["x"] + begin["x"], box["y"] + begin["y"])
    page.mouse.down()
    page.mouse.move(box["x"] + end["x"], box["y"] + end["y"], steps=3)
    page.mouse.up()
    across = page.locator("#pick-list input").first
    expect(across).to_have_value(re.compile(rf"^{int(places[1, 0])}"))
    until_forecast(page)
    assert pixels(page) != before
    across.fill("20")
    across.press("Tab")
    expect(page.locator("#stage")).to_have_attribute("data-state", "done")
    assert "points=20%2C" in page.url
    page.click("#pick-clear")
    expect(page.locator("#pick-list li")).to_have_count(0)
    assert "points" not in page.url


def test_points_are_added_without_a_pointer(page: Page):
    page.focus("#pick-add")
    page.keyboard.press("Enter")
    expect(page.locator("#pick-list input").first).to_be_focused()
    expect(page.locator("#pick-list input").first).to_have_value(str(SIZE // 2))
    page.get_by_role("button", name="Remove ball 1").press("Enter")
    expect(page.locator("#pick-list li")).to_have_count(0)


def test_another_scene_forgets_the_points(page: Page, places: np.ndarray):
    select(page, places[0])
    page.click("#dice")
    expect(page.locator("#pick-list li")).to_have_count(0)
    until_forecast(page)


def test_an_uncertain_ball_is_grey_and_reported(page: Page, places: np.ndarray):
    def warned(route):
        answer = route.fetch()
        text = re.sub(r'"score":[0-9.]+', '"score":0.21', answer.text())
        route.fulfill(response=answer, body=text)

    select(page, places[0])
    expect(page.locator("#verdict")).to_have_attribute("data-warning", "false")
    page.route("**/predict/stream", warned)
    page.click("#go")
    expect(page.locator("#verdict")).to_have_attribute("data-warning", "true")
    expect(page.locator("#verdict")).to_have_text(
        "The ball was not surely found: the grey path may be wrong."
    )
    expect(page.locator("#notes")).to_contain_text("score 0.21; from 0.5 on a ball counts as found")


def test_footage_is_sent_whole(open_page: OpenPage, address: str, tmp_path: Path):
    from PIL import Image

    with Client(address) as client:
        frames = client.simulate("ellipsoid", seed=7, steps=12, image_size=240).frames
    files = []
    for index, frame in enumerate(frames):
        wide = np.full((240, 400, 3), 90, np.uint8)
        wide[:, 100:340] = frame
        files.append(tmp_path / f"frame{index}.png")
        Image.fromarray(wide).save(files[-1])
    page = open_page(address)
    until_forecast(page)
    page.set_input_files("#files", files)
    expect(page.locator("#whole")).to_be_checked()
    page.click(".edit-actions .primary")
    until_forecast(page)
    expect(page.locator("#verdict")).to_contain_text("Ball found.")
    page.check("#balls-0", force=True)
    until_forecast(page)
    page.click("#recrop")
    page.fill("#crop-x", "100")
    page.press("#crop-x", "Tab")
    expect(page.locator("#whole")).not_to_be_checked()
