"""The panel of a scene's parameters, and tables."""

import re

import numpy as np
from playwright.sync_api import Page, expect

from rollcast.client import Client
from tests.browser.conftest import OpenPage, pixels, still, until_forecast


def test_parameters_are_those_of_the_simulated_scene(page: Page):
    before = pixels(page)
    page.click("#scene-panel summary")
    expect(page.locator("#scene-axis_ratio")).to_be_visible()
    expect(page.locator("#scene-noise_scale")).to_be_hidden()
    expect(page.locator("#scene-ball_friction")).to_be_hidden()
    with page.expect_request("**/simulate") as asked:
        page.fill("#scene-radius_m", "0.1")
        page.press("#scene-radius_m", "Tab")
    assert asked.value.post_data_json["scene"] == {"radius_m": 0.1}
    until_forecast(page)
    with page.expect_request("**/simulate") as asked:
        page.check("#scene-white")
    assert asked.value.post_data_json["textured"] is False
    until_forecast(page)
    still(page)
    assert pixels(page) != before
    expect(page.locator("#scene-count")).to_have_text("2 fixed")
    assert "scene=radius_m%3D0.1%3Bwhite" in page.url
    expect(page.locator("#snippet")).to_contain_text('"radius_m":0.1')
    page.check("input[name=language][value=python]", force=True)
    expect(page.locator("#snippet")).to_contain_text('textured=False, scene={"radius_m":0.1}')
    page.click("#scene-reset")
    until_forecast(page)
    expect(page.locator("#scene-radius_m")).to_have_value("")
    assert "scene=" not in page.url


def test_an_address_brings_its_parameters(open_page: OpenPage, address: str):
    page = open_page(address, "#scene=friction%3D0.2%3Bdamping%3D7%3Brubbish%3Bwhite")
    until_forecast(page)
    expect(page.locator("#scene-count")).to_have_text("2 fixed")
    expect(page.locator("#scene-friction")).to_have_value("0.2")
    expect(page.locator("#scene-damping")).to_have_value("")


def test_a_number_out_of_range_is_not_asked_for(page: Page):
    page.click("#scene-panel summary")
    page.fill("#scene-radius_m", "3")
    page.press("#scene-radius_m", "Tab")
    expect(page.locator("#scene-radius_m")).to_have_attribute("aria-invalid", "true")
    expect(page.locator("#scene-count")).to_have_text("")


def test_what_has_no_scene_is_said_at_its_control(page: Page):
    page.click("#scene-panel summary")
    page.fill("#scene-axis_ratio", "0.4")
    page.press("#scene-axis_ratio", "Tab")
    expect(page.locator("#messages")).to_contain_text(re.compile("axis_ratio|radius"))


def test_a_table_is_simulated_and_forecast(page: Page, address: str):
    page.check("#scenario-table")
    expect(page.locator("#stage-title")).to_have_text("Table, 1 ball, seed 7")
    until_forecast(page)
    still(page)
    assert page.locator("#messages").inner_text() == ""
    with Client(address) as client:
        scene = client.simulate("table", seed=7, steps=43, image_size=256)
        forecast = client.predict(scene.frames[:4], horizon=40, num_objects=1)
    error = np.linalg.norm(forecast.positions[0, -1] - scene.positions[0, 42])
    expect(page.locator("#figures tbody td").first).to_have_text(f"{error:.1f} px")
