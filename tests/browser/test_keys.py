"""A service that asks for an API key, in the browser."""

import subprocess
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

from rollcast.client import Client
from tests.browser.conftest import OpenPage, until_forecast
from tests.browser.test_access import WCAG
from tests.e2e.conftest import ROOT, SERVICE_PYTHON, start_service, stop_service, wait_until_ready


@pytest.fixture
def guarded(tmp_path: Path):
    """Address of a service that asks for a key, and the key."""
    file = tmp_path / "keys.json"
    made = subprocess.run(
        [SERVICE_PYTHON, "-m", "service.auth", "--file", file, "add", "page"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    process, address = start_service(ROLLCAST_KEYS_FILE=str(file))
    with Client(address) as client:
        wait_until_ready(client)
    yield address, made.stdout.strip()
    stop_service(process)


def test_a_key_is_asked_for_once_and_kept_for_the_tab(open_page: OpenPage, guarded):
    address, token = guarded
    page = open_page(address, bypass_csp=True)
    dialog = page.locator("#key-dialog")
    expect(dialog).to_be_visible()
    expect(page.locator("#key")).to_be_focused()
    found = Axe().run(page, options=WCAG)
    assert found.response["violations"] == [], found.generate_report()
    page.fill("#key", token[:-1])
    page.press("#key", "Enter")
    expect(page.locator("#key-reason")).to_contain_text("unknown")
    expect(dialog).to_be_visible()
    page.fill("#key", token)
    page.get_by_role("button", name="Use it").click()
    until_forecast(page)
    expect(dialog).to_be_hidden()
    page.reload()
    until_forecast(page)
    expect(dialog).to_be_hidden()


def test_without_a_key_the_refusal_is_shown(open_page: OpenPage, guarded):
    address, _ = guarded
    page = open_page(address)
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#messages")).to_contain_text("401")
