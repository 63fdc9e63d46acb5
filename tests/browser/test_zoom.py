"""Zoom and pan of the picture; points are still where they are clicked."""

import io
import json

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, expect

from rollcast.client import Client
from tests.browser.conftest import WIDTHS, OpenPage, pixels, until_forecast

SIZE = 256


@pytest.fixture(params=WIDTHS, ids=lambda viewport: viewport["width"])
def page(request, open_page: OpenPage, address: str) -> Page:
    page = open_page(address, viewport=request.param, has_touch=request.param["width"] < 800)
    until_forecast(page)
    page.click("#end")
    return page


def box(page: Page) -> dict[str, float]:
    found = page.locator("#panels canvas").bounding_box()
    assert found is not None
    return found


def view(page: Page) -> dict[str, float]:
    return json.loads(page.locator("#panels").get_attribute("data-view") or "")


def test_buttons_and_keys_zoom_and_reset(page: Page):
    whole = pixels(page)
    expect(page.locator("#zoom-out")).to_be_disabled()
    page.click("#zoom-in")
    assert view(page) == {"zoom": 1.5, "x": pytest.approx(1 / 6), "y": pytest.approx(1 / 6)}
    page.wait_for_timeout(200)
    assert pixels(page) != whole
    page.click("#zoom-reset")
    page.wait_for_timeout(200)
    assert pixels(page) == whole
    page.focus("#screen")
    page.keyboard.press("+")
    page.keyboard.press("+")
    page.keyboard.press("d")
    assert view(page)["zoom"] == pytest.approx(2.25)
    assert view(page)["x"] > view(page)["y"]
    page.keyboard.press("-")
    page.keyboard.press("0")
    assert view(page) == {"zoom": 1, "x": 0, "y": 0}


def test_what_is_shown_is_the_enlarged_part(page: Page):
    page.uncheck("#ellipses")
    page.wait_for_timeout(200)
    before = read(page)
    page.locator("#panels canvas").dblclick(position={"x": 40, "y": 40})
    assert view(page)["zoom"] == 2
    page.wait_for_timeout(200)
    after = read(page)
    side = len(before)
    left, top = (round(view(page)[axis] * side) for axis in "xy")
    part = Image.fromarray(before[top : top + side // 2, left : left + side // 2])
    expected = np.asarray(part.resize(after.shape[1::-1]), float)
    # Lines keep their widths and edges are sharper; buttons and sentences are not zoomed.
    inner = (slice(60, -60), slice(60, -120))
    assert np.median(np.abs(after[inner] - expected[inner])) < 12


def read(page: Page) -> np.ndarray:
    with Image.open(io.BytesIO(pixels(page))) as image:
        return np.asarray(image.convert("RGB"))


def test_a_double_click_selects_no_ball(page: Page):
    page.locator("#panels canvas").dblclick(position={"x": 60, "y": 60})
    expect(page.locator("#pick-list li")).to_have_count(0)
    assert view(page)["zoom"] == 2
    page.click("#zoom-reset")


def test_a_click_on_a_zoomed_picture_selects_the_ball_there(page: Page, address: str):
    with Client(address) as client:
        place = client.simulate("ellipsoid", seed=7, steps=4, image_size=SIZE).positions[0, 3]
    page.locator("#panels canvas").click(position={"x": 5, "y": box(page)["height"] / 2})
    expect(page.locator("#time")).to_have_text("+0.000 s")
    there = box(page)
    side = there["width"]
    page.mouse.move(*(there["xy"[axis]] + place[axis] / SIZE * side for axis in (0, 1)))
    page.keyboard.down("Control")
    page.mouse.wheel(0, -100)  # as a pinch on a trackpad
    page.keyboard.up("Control")
    shown = view(page)
    assert shown["zoom"] == pytest.approx(np.e, rel=0.01)
    at = [(place[axis] / SIZE - shown["xy"[axis]]) * shown["zoom"] * side for axis in (0, 1)]
    page.mouse.wheel(0, 50)
    assert view(page) == shown, "the wheel alone scrolls the page"
    page.locator("#panels canvas").click(position={"x": at[0], "y": at[1]})
    expect(page.locator("#pick-list li")).to_have_count(1)
    until_forecast(page)
    typed = [float(field.input_value()) for field in page.locator("#pick-list input").all()]
    np.testing.assert_allclose(typed, place, atol=1)
    expect(page.locator("#verdict")).to_contain_text("Ball found.")


def test_a_drag_moves_the_zoomed_picture_and_selects_nothing(page: Page):
    page.click("#zoom-in")
    page.click("#zoom-in")
    before = view(page)
    there = box(page)
    x, y = there["x"] + there["width"] / 2, there["y"] + there["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y + 30, steps=4)
    page.mouse.up()
    assert view(page)["x"] < before["x"]
    assert view(page)["y"] < before["y"]
    expect(page.locator("#pick-list li")).to_have_count(0)


def test_two_fingers_zoom(page: Page):
    if not page.evaluate("navigator.maxTouchPoints"):
        pytest.skip("a screen that is not touched")
    page.locator("#panels canvas").scroll_into_view_if_needed()
    there = box(page)
    x, y = there["x"] + there["width"] / 2, there["y"] + there["height"] / 2
    screen = page.context.new_cdp_session(page)

    def touch(kind: str, *apart: float) -> None:
        points = [{"x": x + sign * apart[0], "y": y} for sign in (-1, 1)] if apart else []
        screen.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", 30)
    for apart in (40, 50, 60):
        touch("touchMove", apart)
    touch("touchEnd")
    assert view(page)["zoom"] == pytest.approx(2, rel=0.1)
    expect(page.locator("#pick-list li")).to_have_count(0)
