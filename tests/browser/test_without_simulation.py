"""The page of a service without PyBullet."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from rollcast.client import Client
from tests.browser.conftest import OpenPage
from tests.browser.test_footage import crop, drop, forecast_of, record_video
from tests.e2e.conftest import start_service, stop_service, wait_until_ready
from tests.e2e.test_without_simulation import COMMANDS


@pytest.fixture
def other_address() -> Iterator[str]:
    process, address = start_service(command=COMMANDS["hidden"])
    with Client(address) as client:
        wait_until_ready(client)
    yield address
    stop_service(process)


def test_it_offers_footage_instead(
    open_page: OpenPage, address: str, other_address: str, tmp_path: Path
):
    page = open_page(other_address)
    message = page.locator("#messages")
    expect(message.locator("h2")).to_have_text("Simulation is not installed (501)")
    expect(message).to_contain_text("Simulations require PyBullet")
    expect(page.locator("#source-scene")).to_be_disabled()
    expect(page.get_by_text("Simulation (not installed)")).to_be_visible()
    expect(page.locator("#source-footage")).to_be_checked()
    expect(page.locator("#busy")).to_be_hidden()
    with Client(address) as client:
        scene = client.simulate("hemisphere", seed=7, steps=64, image_size=240)
    drop(page, record_video(scene, tmp_path / "rolling.webm", 40))
    crop(page)
    assert forecast_of(page).shape == (40, 2)
    expect(message).to_have_text("")
