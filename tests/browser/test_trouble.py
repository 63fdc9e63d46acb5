"""What the page says when the service refuses, is full, or is gone."""

import re
import subprocess
import threading

import httpx2
import pytest
from playwright.sync_api import Page, Route, expect

from rollcast.client import Client
from tests.browser.conftest import OpenPage, until_forecast
from tests.e2e.conftest import (
    ROOT,
    SERVICE_PYTHON,
    said_address,
    start_service,
    stop_service,
    wait_until_ready,
)

SEEDS = {
    "negative": ("-1", "-1", "greater than or equal to 0"),
    "a fraction": ("1.5", "1.5", "integer"),
    "a word": ("seven", '"seven"', "integer"),
    "none": ("", "null", "required"),
}


@pytest.mark.parametrize("case", SEEDS)
def test_a_wrong_value(page: Page, case: str):
    typed, value, expected = SEEDS[case]
    page.fill("#seed", typed)
    page.press("#seed", "Enter")
    message = page.locator("#messages")
    expect(message.locator("h2")).to_have_text("A value is invalid (422)")
    cells = message.locator("td")
    expect(cells.nth(0)).to_have_text("seed")
    expect(cells.nth(1)).to_have_text(value)
    expect(cells.nth(2)).to_contain_text(expected)
    expect(page.locator("#seed")).to_have_attribute("aria-invalid", "true")
    page.fill("#seed", "12")
    page.press("#seed", "Enter")
    until_forecast(page)
    assert message.inner_text() == ""
    assert page.locator("#seed").get_attribute("aria-invalid") is None


def test_a_model_that_has_gone(open_page: OpenPage):
    process, address = start_service()
    try:
        with Client(address) as client:
            wait_until_ready(client)
        page = open_page(address, "#models=probnet")
        until_forecast(page)
        httpx2.post(f"{address}/v2/repository/models/probnet/unload").raise_for_status()
        page.click("#go")
        message = page.locator("#messages")
        expect(message).to_contain_text("The model is not served (503)")
        expect(message.get_by_role("button", name="Try again")).to_be_visible()
        httpx2.post(f"{address}/v2/repository/models/probnet/load").raise_for_status()
        message.get_by_role("button", name="Try again").click()
        until_forecast(page)
    finally:
        stop_service(process)


def test_a_full_queue(open_page: OpenPage):
    process, address = start_service(
        ROLLCAST_INFERENCE_QUEUE="0", ROLLCAST_INFERENCE_THREADS="1", ROLLCAST_MAX_BATCH="1"
    )
    enough = threading.Event()
    try:
        with Client(address) as client:
            wait_until_ready(client)
            scene = client.simulate("ellipsoid", seed=7, steps=4)
        page = open_page(address)
        until_forecast(page)

        def crowd() -> None:
            with Client(address, retries=0) as client:
                while not enough.is_set():
                    try:
                        client.predict(scene.frames, horizon=1000)
                    except Exception as error:
                        assert "queue" in str(error).lower(), error  # noqa: PT017

        crowded = [threading.Thread(target=crowd) for _ in range(6)]
        for thread in crowded:
            thread.start()
        message = page.locator("#messages")
        for _ in range(20):
            page.click("#go")
            page.wait_for_timeout(300)
            if "The queue is full" in message.inner_text():
                break
        expect(message).to_contain_text("The queue is full (429)")
        expect(message).to_contain_text(re.compile(r"Asking again in 1 s|Try again"))
        enough.set()
        for thread in crowded:
            thread.join()
        again = message.get_by_role("button", name="Try again")
        page.wait_for_timeout(1500)
        if again.is_visible():
            again.click()
        until_forecast(page)
        expect(message).to_have_text("")
    finally:
        enough.set()
        stop_service(process)


def test_a_lost_service_that_comes_back(open_page: OpenPage):
    process, address = start_service()
    with Client(address) as client:
        wait_until_ready(client)
    page = open_page(address)
    until_forecast(page)
    process.kill()
    process.communicate()
    page.click("#dice")
    expect(page.locator("#messages")).to_contain_text("The service is lost")
    expect(page.locator("#messages")).to_contain_text("Is it still running at 127.0.0.1:")
    expect(page.locator("#health")).to_have_text("service lost")
    again = subprocess.Popen(
        [SERVICE_PYTHON, "-m", "service", "--port", address.rsplit(":", 1)[1]],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    try:
        assert again.stdout is not None
        assert said_address(again.stdout) == address
        expect(page.locator("#health")).to_have_text("ready")
        until_forecast(page)
        expect(page.locator("#messages")).to_have_text("")
    finally:
        stop_service(again)


def test_a_connection_that_breaks_off(page: Page):
    page.route("**/predict/stream", lambda route: route.fulfill(
        content_type="text/event-stream",
        body='event: step\ndata: {"step": 0, "time_s": 0, "objects": []}\n\n',
    ))  # fmt: skip
    page.click("#go")
    expect(page.locator("#messages")).to_contain_text("broke off in the middle of a forecast")
    page.unroute("**/predict/stream")
    page.get_by_role("button", name="Try again").click()
    until_forecast(page)


def test_an_error_in_the_stream(page: Page):
    page.route("**/predict/stream", lambda route: route.fulfill(
        content_type="text/event-stream",
        body='event: error\ndata: {"type": "/problems/forecast-diverged", "title": '
        '"The forecast diverges", "status": 422, "detail": "It left every bound at step 3"}\n\n',
    ))  # fmt: skip
    page.click("#go")
    expect(page.locator("#messages h2")).to_have_text("The forecast diverges (422)")
    expect(page.locator("#messages")).to_contain_text("It left every bound at step 3.")
    page.get_by_role("button", name="Dismiss").click()
    expect(page.locator("#messages")).to_have_text("")


def test_a_service_that_is_still_loading(page: Page):
    page.route("**/health/ready", lambda route: route.fulfill(
        status=503, content_type="application/json", body='{"status": "loading"}'
    ))  # fmt: skip
    page.reload()
    expect(page.locator("#busy")).to_have_text("The service is loading its models …")
    expect(page.locator("#health")).to_have_text("loading models")
    page.unroute("**/health/ready")
    until_forecast(page)
    expect(page.locator("#busy")).to_be_hidden()


def test_a_service_behind_a_prefix(open_page: OpenPage, address: str):
    page = open_page(address)
    until_forecast(page)
    beyond = []

    def strip(route: Route) -> None:
        beyond.append(route.request.url)
        route.continue_(url=route.request.url.replace("/some/prefix/", "/"))

    page.route("**/some/prefix/**", strip)
    page.goto("about:blank")  # what the first page still asks for is not meant
    page.on("request", lambda request: beyond.append(request.url))
    page.goto(f"{address}/some/prefix/")
    until_forecast(page)
    own = (f"{address}/some/prefix/", "blob:", "data:")
    assert not [url for url in beyond if not url.startswith(own)]
    assert any(url.endswith("/predict/stream") for url in beyond)
    expect(page.locator("#snippet")).to_contain_text("/some/prefix/simulate")
