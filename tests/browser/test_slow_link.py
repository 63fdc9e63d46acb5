"""The page at the end of a slow link."""

import time

from playwright.sync_api import Browser, expect

from tests.browser.conftest import DESKTOP, PATIENCE_MS, until_forecast

BYTES_S = 50_000
LOADED_BYTES = 350_000
"""What may come before the first forecast: 7 s of the link, which leaves 3 s for the service."""


def test_the_first_forecast_needs_little(browser: Browser, address: str):
    context = browser.new_context(viewport=DESKTOP)
    context.set_default_timeout(4 * PATIENCE_MS)
    page = context.new_page()
    link = context.new_cdp_session(page)
    link.send("Network.enable")
    conditions = {
        "offline": False,
        "latency": 50,
        "downloadThroughput": BYTES_S,
        "uploadThroughput": BYTES_S,
        "connectionType": "cellular3g",
    }
    link.send("Network.emulateNetworkConditions", conditions)
    loaded = {"bytes": 0, "three": False}

    def on_data(event):
        loaded["bytes"] += event.get("encodedDataLength", 0)

    link.on("Network.loadingFinished", on_data)
    page.on(
        "request", lambda request: loaded.update(three=loaded["three"] or "three." in request.url)
    )
    begun = time.monotonic()
    page.goto(address)
    expect(page.locator("#figures tbody td").nth(4)).to_contain_text("ms", timeout=240_000)
    print(f"{loaded['bytes']} bytes, {time.monotonic() - begun:.1f} s")
    assert loaded["bytes"] < LOADED_BYTES
    assert not loaded["three"]
    until_forecast(page)
    expect(page.locator("#busy")).to_be_hidden(timeout=240_000)
    context.close()
