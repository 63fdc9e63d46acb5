"""A simulated scene: every control, and the figures that it leads to."""

import re

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from rollcast.client import Client
from tests.browser.conftest import OpenPage, figures, pixels, still, until_forecast


def test_the_page_begins_with_a_forecast(page: Page):
    expect(page.locator("#stage-title")).to_have_text("Ellipsoid, 1 ball, seed 7")
    expect(page.locator("#legend")).to_contain_text("auto: ")
    expect(page.locator("#health")).to_have_text("ready")
    expect(page.locator("#strip li")).to_have_text(["t = −3", "t = −2", "t = −1", "t = 0"])
    assert page.locator("#messages").inner_text() == ""


def test_the_figures_are_those_of_the_service(page: Page, address: str):
    with Client(address) as client:
        scene = client.simulate("ellipsoid", seed=7, steps=43, image_size=256)
        forecast = client.predict(scene.frames[:4], horizon=40, scenario="ellipsoid", num_objects=1)
    errors = np.linalg.norm(forecast.positions[0] - scene.positions[0, 3:43], axis=-1)
    radii = np.sqrt(-2 * np.log(0.05)) * np.linalg.det(forecast.covariances[0]) ** 0.25
    error, radius, _, mean, _ = figures(page)
    assert error == f"{errors[-1]:.1f} px"
    assert radius == f"{radii[-1]:.1f} px"
    assert mean == f"{errors.mean():.1f} px"


@pytest.mark.parametrize("scenario", ["hemisphere", "heightfield"])
def test_scenarios(page: Page, scenario: str):
    before = pixels(page), pixels(page, "#surface")
    page.check(f"#scenario-{scenario}")
    expect(page.locator("#stage-title")).to_contain_text(scenario.capitalize())
    until_forecast(page)
    still(page)
    assert pixels(page) != before[0]
    assert pixels(page, "#surface") != before[1]
    expect(page.locator("#surface-note")).to_have_text("")


def test_seeds(page: Page):
    page.fill("#seed", "11")
    page.press("#seed", "Enter")
    expect(page.locator("#stage-title")).to_contain_text("seed 11")
    until_forecast(page)
    page.click("#dice")
    expect(page.locator("#stage-title")).not_to_contain_text("seed 11")
    until_forecast(page)
    assert re.search(r"seed=\d+", page.url)


def test_several_balls(page: Page):
    page.check("#balls-3")
    expect(page.locator("#stage-title")).to_contain_text("3 balls")
    until_forecast(page)
    expect(page.locator("#models")).to_contain_text("fieldnet-3")
    page.check("#scenario-hemisphere")
    # Models for a fixed number of balls know several in ellipsoids only.
    expect(page.locator("#balls-3")).to_be_checked()
    expect(page.locator("#stage-title")).to_have_text(
        re.compile("hemisphere, 3 balls", re.IGNORECASE)
    )
    until_forecast(page)
    expect(page.locator("#models")).to_contain_text("any-ball")
    expect(page.locator("#models")).not_to_contain_text("fieldnet-3")


def test_models_side_by_side(page: Page):
    for model in ("probnet", "posnet"):
        page.check(f"#models input[value={model}]")
        until_forecast(page)
    expect(page.locator("#models input[value=dispnet]")).to_be_disabled()
    still(page)
    expect(page.locator("#figures tbody tr")).to_have_count(3)
    assert figures(page, 1)[0] != figures(page, 2)[0]
    page.check("#split")
    expect(page.locator("#panels canvas")).to_have_count(3)
    page.uncheck("#models input[value=auto]")
    until_forecast(page)
    expect(page.locator("#panels canvas")).to_have_count(2)
    page.uncheck("#models input[value=posnet]")
    until_forecast(page)
    expect(page.locator("#panels canvas")).to_have_count(1)
    page.locator("#models input[value=probnet]").click()
    expect(page.locator("#models input[value=probnet]")).to_be_checked()


def test_the_horizon(page: Page):
    page.fill("#horizon", "60")
    expect(page.locator("#horizon-text")).to_have_text("60 steps, 1.50 s")
    until_forecast(page)
    page.click("#end")
    expect(page.locator("#time")).to_have_text("+1.475 s")
    expect(page.locator("#notes")).to_contain_text("trained")


def test_a_final_frame(page: Page):
    without = float(figures(page)[3].removesuffix(" px"))
    page.check("#final")
    until_forecast(page)
    expect(page.locator("#strip li").last).to_have_text("t = 39, final")
    expect(page.locator("#horizon")).to_be_disabled()
    expect(page.locator("#models")).to_contain_text("interpnet")
    expect(page.locator("#final-hint")).to_contain_text("step 39")
    assert float(figures(page)[3].removesuffix(" px")) != without
    page.uncheck("#final")
    until_forecast(page)
    expect(page.locator("#strip li")).to_have_count(4)


@pytest.mark.parametrize("option", ["ellipses", "truth"])
def test_what_is_drawn(page: Page, option: str):
    before = pixels(page)
    page.uncheck(f"#{option}")
    page.wait_for_timeout(200)
    assert pixels(page) != before
    page.check(f"#{option}")
    page.wait_for_timeout(200)
    assert pixels(page) == before


def test_time(page: Page):
    page.click("#first")
    expect(page.locator("#badge")).to_have_text("seen 1 of 4")
    expect(page.locator("#time")).to_have_text("−0.075 s")
    page.click("#forth")
    expect(page.locator("#badge")).to_have_text("seen 2 of 4")
    page.fill("#scrub", "23")
    expect(page.locator("#time")).to_have_text("+0.500 s")
    expect(page.locator("#scrub")).to_have_attribute("aria-valuetext", "step 20, +0.500 s")
    page.click("#back")
    expect(page.locator("#time")).to_have_text("+0.475 s")
    page.select_option("#speed", "1")
    page.click("#play")
    expect(page.locator("#play")).to_have_attribute("aria-label", "Pause")
    expect(page.locator("#time")).to_have_text("+0.975 s")
    expect(page.locator("#play")).to_have_attribute("aria-label", "Play")


def test_the_chart_is_clicked(page: Page):
    box = page.locator("#chart .u-over").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    expect(page.locator("#time")).to_have_text(re.compile(r"^\+0\.(475|5)"))


def test_the_surface_is_turned(page: Page):
    before = pixels(page, "#surface")
    page.focus("#surface")
    page.keyboard.press("ArrowLeft")
    page.wait_for_timeout(300)
    turned = pixels(page, "#surface")
    assert turned != before
    box = page.locator("#surface").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 180, box["y"] + 130)
    page.mouse.up()
    page.wait_for_timeout(300)
    assert pixels(page, "#surface") != turned


def test_the_address_brings_a_forecast_back(page: Page, open_page: OpenPage, address: str):
    page.check("#scenario-heightfield")
    until_forecast(page)
    page.check("#models input[value=probnet]")
    until_forecast(page)
    again = open_page(address, page.url.removeprefix(f"{address}/"))
    until_forecast(again)
    expect(again.locator("#stage-title")).to_have_text("Heightfield, 1 ball, seed 7")
    expect(again.locator("#models input[value=probnet]")).to_be_checked()


def test_it_streams(page: Page):
    sent = []
    page.on("request", lambda request: sent.append(request.url.rsplit("/", 1)[-1]))
    page.click("#go")
    until_forecast(page)
    assert "stream" in sent
    assert "predict" not in sent


def test_a_step_is_there_before_the_next_one_has_come(page: Page):
    """The body comes in pieces that end anywhere, in the middle of a letter, too."""
    steps = page.evaluate(
        """async () => {
          const { predictStream } = await import(new URL('static/app/api.js', location.href));
          const text = 'event: step\\ndata: {"step": 0, "é": 1}\\r\\n\\r\\n'
            + 'event: step\\ndata: {"step": 1}\\n\\nevent: done\\ndata: {}\\n\\n';
          const bytes = new TextEncoder().encode(text);
          let send;
          const body = new ReadableStream({ start: (controller) => { send = controller; } });
          const original = window.fetch;
          window.fetch = async () => new Response(body);
          const events = predictStream({}, new AbortController().signal);
          const seen = [];
          const first = events.next();
          const accent = bytes.indexOf(0xc3) + 1;
          send.enqueue(bytes.slice(0, accent));
          send.enqueue(bytes.slice(accent, 50));
          seen.push((await first).value.step);
          send.enqueue(bytes.slice(50));
          send.close();
          for await (const event of events) seen.push(event.step ?? 'done');
          window.fetch = original;
          return seen;
        }"""
    )
    assert steps == [{"step": 0, "é": 1}, {"step": 1}, "done"]
