"""How far to trust a forecast: said and drawn on the picture, and in what is exported."""

import io
import json
import re
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, Route, expect

from tests.browser.conftest import WIDTHS, OpenPage, pixels, still, until_forecast

BEYOND = "After 0.97 s the forecast goes beyond its training: the dashed path may be far off."


def exported(page: Page, kind: str) -> bytes:
    with page.expect_download() as download:
        page.click(f"#save-{kind}")
    return Path(download.value.path()).read_bytes()


def heights(page: Page) -> dict[str, int]:
    """Heights of a picture, an animation and a video of the same widths."""
    found = {}
    for kind in ("png", "gif"):
        with Image.open(io.BytesIO(exported(page, kind))) as image:
            found[kind] = image.height
    with av.open(io.BytesIO(exported(page, "webm"))) as container:
        found["webm"] = next(container.decode(video=0)).height
    return found


def without_score(route: Route) -> None:
    """Answer as a model that has not found its ball does."""
    answer = route.fetch()
    route.fulfill(response=answer, body=re.sub(r'"score":[0-9.]+', '"score":0.2', answer.text()))


@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda viewport: viewport["width"])
def test_a_horizon_beyond_the_training_is_dashed_and_told(
    open_page: OpenPage, address: str, viewport: dict
):
    page = open_page(address, "#horizon=80", viewport=viewport)
    until_forecast(page)
    page.click("#end")
    expect(page.locator("#time")).to_have_text("+1.975 s")
    expect(page.locator("#verdict")).to_have_text(BEYOND)
    expect(page.locator("#verdict")).to_have_attribute("data-warning", "true")
    # The figures stand behind a line that is opened on demand.
    expect(page.locator("#notes")).to_be_hidden()
    page.click("#notes-title")
    expect(page.locator("#notes")).to_contain_text(re.compile("horizon of 80 steps exceeds the 40"))
    # Without an ellipse for the moment, hiding ellipses changes the earlier ones alone.
    page.uncheck("#truth")
    shown = picture_of(page)
    page.uncheck("#ellipses")
    page.wait_for_timeout(300)
    changed = np.abs(shown - picture_of(page)).max(axis=-1) > 8
    assert changed.any(), "the trained steps have ellipses"
    assert not changed[around(page, -1)].any(), "the last step has none"


def picture_of(page: Page) -> np.ndarray:
    with Image.open(io.BytesIO(pixels(page))) as image:
        return np.asarray(image.convert("RGB"), int)


def around(page: Page, step: int) -> tuple[slice, slice]:
    """Pixels of the screen around a step of the forecast."""
    (forecast,) = json.loads(exported(page, "json"))["forecasts"]
    x, y = forecast["objects"][0]["positions"][step]
    side = page.locator("#panels canvas").bounding_box()["width"]
    column, row = (round(value * side / 256) for value in (x, y))
    return slice(max(row - 6, 0), row + 6), slice(max(column - 6, 0), column + 6)


def test_within_the_training_nothing_is_said(page: Page):
    expect(page.locator("#verdict")).to_have_text("")
    expect(page.locator("#notes-panel")).to_be_hidden()


def test_the_chart_and_the_picture_name_one_end_of_training_at_another_rate(
    open_page: OpenPage, address: str
):
    """A model that is told the rate was trained for seconds, not for steps."""
    page = open_page(address, "#models=any-ball&horizon=40")
    until_forecast(page)
    still(page)
    trained = page.evaluate(
        """async () => {
          const { trainedSteps } = await import(new URL('static/app/models.js', location.href));
          const entries = [{ name: 'm', version: 1, frame_rate_hz: 40, frame_rates_hz: [15, 125] },
            { name: 'f', version: 1, frame_rate_hz: 40 }];
          const at = (name, rate) => trainedSteps(entries,
            { model: { name, version: 1, trained_horizon: 40 }, frame_rate: rate });
          return [at('m', 40), at('m', 30), at('m', 60), at('f', 30)];
        }"""
    )
    # As the service has it: 1 + int(39 / (40 / rate)).
    assert trained == [40, 30, 59, 40]


def test_an_uncertain_ball_has_no_ellipse(open_page: OpenPage, address: str):
    page = open_page(address, "#models=any-ball")
    until_forecast(page)
    still(page)
    page.wait_for_timeout(200)
    sure = pixels(page)
    page.uncheck("#ellipses")
    page.wait_for_timeout(200)
    assert pixels(page) != sure
    page.check("#ellipses")
    page.route("**/predict/stream", without_score)
    page.click("#go")
    expect(page.locator("#verdict")).to_contain_text("not surely found: the grey path")
    still(page)
    page.wait_for_timeout(200)
    unsure = pixels(page)
    page.uncheck("#ellipses")
    page.wait_for_timeout(200)
    assert pixels(page) == unsure, "there was no ellipse to hide"


def test_exports_carry_the_verdict(open_page: OpenPage, address: str):
    page = open_page(address, "#horizon=20")
    until_forecast(page)
    expect(page.locator("#verdict")).to_have_text("")
    silent = heights(page)
    page.fill("#horizon", "60")
    expect(page.locator("#verdict")).to_have_text(BEYOND)
    until_forecast(page)
    told = heights(page)
    for kind, height in silent.items():
        assert told[kind] > height, f"{kind} has lines for the verdict"
