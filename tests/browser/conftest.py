"""The page in a real, headless Chromium, served by the real service."""

import re
import shutil
from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import (
    Browser,
    ConsoleMessage,
    Page,
    Playwright,
    Request,
    expect,
    sync_playwright,
)

from tests.e2e.conftest import serving

DESKTOP = {"width": 1440, "height": 900}
PHONE = {"width": 390, "height": 844}
TABLET = {"width": 768, "height": 1024}
LANDSCAPE = {"width": 1024, "height": 768}
WIDTHS = [PHONE, TABLET, {"width": 1280, "height": 800}]
PATIENCE_MS = 60_000
"""Machines that run tests are busy."""

OpenPage = Callable[..., Page]


@pytest.fixture(scope="session", autouse=True)
def _patience() -> None:
    expect.set_options(timeout=PATIENCE_MS)


@pytest.fixture(scope="session")
def address() -> Iterator[str]:
    with serving() as address:
        yield address


@pytest.fixture(scope="session")
def playwright() -> Iterator[Playwright]:
    with sync_playwright() as playwright:
        yield playwright


def launch(playwright: Playwright, *args: str) -> Browser:
    path = shutil.which("chromium")
    if path is None:
        pytest.exit("these tests need a browser: apt-get install chromium", returncode=1)
    return playwright.chromium.launch(executable_path=path, args=["--no-sandbox", *args])


@pytest.fixture(scope="session")
def browser(playwright: Playwright) -> Iterator[Browser]:
    # The surface is drawn in 3D without a graphics card, too.
    browser = launch(playwright, "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    yield browser
    browser.close()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[OpenPage]:
    """Open the page of a service; what went wrong in it is found when the test is over."""
    contexts = []
    faults: list[str] = []

    def _open(address: str, fragment: str = "", **options: object) -> Page:
        context = browser.new_context(**({"viewport": DESKTOP} | options))
        context.grant_permissions(["clipboard-read", "clipboard-write"])
        context.set_default_timeout(PATIENCE_MS)
        contexts.append(context)
        page = context.new_page()

        def on_console(message: ConsoleMessage) -> None:
            # A refusal is an error to the browser, and a message to the page's user.
            if message.type in {"error", "warning"} and "Failed to load" not in message.text:
                faults.append(f"console: {message.text}")

        def on_request(request: Request) -> None:
            if not request.url.startswith((address, "blob:", "data:")):
                faults.append(f"a request leaves the origin: {request.url}")

        page.on("console", on_console)
        page.on("pageerror", lambda error: faults.append(f"not caught: {error}"))
        page.on("request", on_request)
        page.goto(f"{address}/{fragment}")
        return page

    yield _open
    for context in contexts:
        context.close()
    assert faults == []


@pytest.fixture
def page(open_page: OpenPage, address: str) -> Page:
    """The page with the forecast that it begins with, standing still at its end."""
    page = open_page(address)
    until_forecast(page)
    still(page)
    return page


def until_forecast(page: Page) -> None:
    """Wait until every model has answered."""
    expect(page.locator("#stage")).to_have_attribute("data-state", re.compile(r"^done( done)*$"))


def still(page: Page) -> None:
    """Stop the playback at its end."""
    page.click("#end")
    expect(page.locator("#play")).to_have_attribute("aria-label", "Play")
    expect(page.locator("#time")).to_have_text("+0.975 s")


def figures(page: Page, row: int = 0) -> list[str]:
    """What the table says of a forecast."""
    return page.locator("#figures tbody tr").nth(row).locator("td").all_inner_texts()


def pixels(page: Page, selector: str = "#panels canvas") -> bytes:
    """What an element looks like."""
    return page.locator(selector).first.screenshot()
