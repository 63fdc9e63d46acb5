"""A camera in the browser: Chromium takes a video of the simulator for a webcam's picture."""

import base64
import io
import json
import re
import shutil
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import av
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image
from playwright.sync_api import Browser, Page, Playwright, Request, expect

from rollcast.client import Client, Simulation
from tests.browser.conftest import PHONE, OpenPage, launch, until_forecast
from tests.browser.test_access import WCAG
from tests.e2e.conftest import ROOT, serving

WIDTH, HEIGHT, LEFT = 320, 240, 60
"""The camera's pictures; the scene fills a square of them."""
RATE_HZ = 5
"""Rate of the camera and of the model: the world is slow, and so are machines that run tests."""
BITS, BLOCK, GREY = 8, 12, 90
"""Blocks at the left border that say which picture it is; so faint that no model sees a ball."""
MOST_STEPS = 16
"""Age of a forecast, in steps, up to which its ring has to lie on the ball."""
ORANGE = np.array([0xE6, 0x9F, 0x00])
OTHER_NAME = "rollcast.example"


@pytest.fixture(scope="module")
def slow(tmp_path_factory) -> Iterator[str]:
    """A service whose model was trained, as it says, on a camera as slow as this one."""
    folder = tmp_path_factory.mktemp("models")
    shutil.copytree(ROOT / "models/any-ball/1", folder / "any-ball/1")
    file = folder / "any-ball/1/manifest.json"
    told = json.loads(file.read_text()) | {"frame_rate_hz": float(RATE_HZ), "default": True}
    file.write_text(json.dumps(told))
    with serving(ROLLCAST_MODELS_DIR=str(folder)) as address:
        yield address


@pytest.fixture(scope="module")
def scene(slow: str) -> Simulation:
    with Client(slow) as client:
        return client.simulate("hemisphere", seed=3, start_step=250, steps=100, image_size=HEIGHT)


@pytest.fixture(scope="module")
def video(scene: Simulation, tmp_path_factory) -> Path:
    """The scene as Chromium's fake camera reads it: without losses, to its end and back again."""
    path = tmp_path_factory.mktemp("camera") / "rolling.y4m"
    assert scene.frames is not None
    with path.open("wb") as file:
        file.write(f"YUV4MPEG2 W{WIDTH} H{HEIGHT} F{RATE_HZ}:1 Ip A1:1 C420jpeg\n".encode())
        there = list(enumerate(scene.frames))
        for index, frame in there + there[::-1]:  # no jump where it begins again
            picture = np.full((HEIGHT, WIDTH, 3), GREY, np.uint8)
            picture[:, LEFT : LEFT + HEIGHT] = frame
            for bit in range(BITS):
                rows = slice(bit * BLOCK, (bit + 1) * BLOCK)
                picture[rows, :BLOCK] = GREY + 6 * (2 * (index >> bit & 1) - 1)
            yuv = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format="yuv420p")
            file.write(b"FRAME\n" + yuv.to_ndarray().tobytes())
    return path


def with_cameras(playwright: Playwright, device: str, *more: str) -> Browser:
    """Launch a browser with fake cameras, as quick as a busy machine allows."""
    fake = f"--use-fake-device-for-media-stream{device}"
    return launch(playwright, "--disable-gpu", "--disable-3d-apis", fake, *more)


@pytest.fixture(scope="module")
def browser(playwright: Playwright, video: Path) -> Iterator[Browser]:
    """A browser with a camera, which no page may use before it was allowed."""
    browser = with_cameras(
        playwright,
        "",
        f"--use-file-for-fake-video-capture={video}",
        f"--host-resolver-rules=MAP {OTHER_NAME} 127.0.0.1",
    )
    yield browser
    browser.close()


SPY = """() => {
  window.opened = [];
  const devices = navigator.mediaDevices;
  if (!devices) return;
  const open = devices.getUserMedia.bind(devices);
  devices.getUserMedia = async (wanted) => {
    const stream = await open(wanted);
    window.opened.push(...stream.getTracks());
    return stream;
  };
}"""

OpenCamera = Callable[..., Page]


@pytest.fixture
def open_camera(open_page: OpenPage, slow: str) -> OpenCamera:
    """Open the page with its camera chosen, but not started."""

    def _open(at: str = slow, *, allowed: bool = True, **options: object) -> Page:
        page = open_page(at, **({"viewport": {"width": 900, "height": 760}} | options))
        if allowed:
            page.context.grant_permissions(["camera"])
        page.evaluate(SPY)
        expect(page.locator("#health")).to_have_text("ready")
        if page.locator("#fold").is_visible():
            page.click("#fold")
        page.check("#source-camera", force=True)
        page.fill("#horizon", "120")
        page.dispatch_event("#horizon", "change")
        expect(page.locator("#stage-title")).to_have_text("Live from the camera")
        return page

    return _open


def start(page: Page) -> None:
    page.click("#camera-start")
    expect(page.locator("#badge")).to_have_text(re.compile(r"^\d+ ms behind$"))


def live_tracks(page: Page) -> int:
    return page.evaluate("opened.filter(({ readyState }) => readyState === 'live').length")


def shown(page: Page) -> tuple[np.ndarray, float]:
    """The picture of one moment, with whatever is drawn over it, and the forecast's step there."""
    data, step = page.locator("#panels canvas").evaluate(
        "(canvas) => [canvas.toDataURL(), canvas.dataset.step]"
    )
    with Image.open(io.BytesIO(base64.b64decode(data.partition(",")[2]))) as image:
        return np.asarray(image.convert("RGB")), float(step)


def index_of(picture: np.ndarray) -> int:
    """Which frame of the video a picture shows."""
    scale = len(picture) / WIDTH
    top = (len(picture) - HEIGHT * scale) / 2
    rows = (top + (np.arange(BITS) + 0.5) * BLOCK * scale).astype(int)
    bits = picture[rows, int(BLOCK / 2 * scale)].mean(axis=-1) > GREY
    return int((bits << np.arange(BITS)).sum())


def ring(picture: np.ndarray, near: np.ndarray) -> tuple[float, float]:
    """Find the ring near a place of the frame: how far away it is, and how much of it is there."""
    scale = len(picture) / WIDTH
    top = (len(picture) - HEIGHT * scale) / 2
    orange = np.abs(picture.astype(int) - ORANGE).sum(axis=-1) < 60
    for axis, shift in product((0, 1), (1, -1, 2)):  # lines are thin
        orange = orange | np.roll(orange, shift, axis)
    angles = np.arange(0, 2 * np.pi, np.pi / 24)
    offsets = np.stack(np.meshgrid(np.arange(-24, 25, 2), np.arange(-24, 25, 2)), -1).reshape(-1, 2)
    best = (0.0, 0.0)
    for radius in np.arange(14, 34):
        circle = radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        places = (near + offsets[:, None] + circle) * scale + [0, top]
        columns, rows = np.clip(places, 0, len(picture) - 1).astype(int).transpose(2, 0, 1)
        parts = orange[rows, columns].mean(axis=-1)
        if parts.max() > best[1]:
            offset = offsets[parts.argmax()]
            best = (float(np.hypot(*offset)), float(parts.max()))
    return best


def test_the_ring_lies_on_the_ball(open_camera: OpenCamera, scene: Simulation):
    page = open_camera()
    page.uncheck("#ellipses")
    start(page)
    expect(page.locator("#legend")).to_contain_text("auto: ")
    expect(page.locator("#verdict")).to_contain_text("all found.")
    offsets = []
    deadline_s = time.monotonic() + 120
    while len(offsets) < 10 and time.monotonic() < deadline_s:
        picture, step = shown(page)
        offset, part = ring(picture, scene.positions[0, index_of(picture)] + [LEFT, 0])
        if part > 0.8 and 0 < step < MOST_STEPS:
            offsets.append(offset)
        page.wait_for_timeout(200)
    assert len(offsets) == 10
    # A third of the ball's radius.
    assert np.median(offsets) < 8, offsets


def test_one_request_at_a_time(open_camera: OpenCamera):
    page = open_camera()
    going, most, count = 0, 0, 0

    def begun(request: Request) -> None:
        nonlocal going, most, count
        if request.url.endswith("/predict"):
            going, count = going + 1, count + 1
            most = max(most, going)

    def ended(request: Request) -> None:
        nonlocal going
        if request.url.endswith("/predict"):
            going -= 1

    page.on("request", begun)
    page.on("requestfinished", ended)
    page.on("requestfailed", ended)
    start(page)
    while count < 5:
        page.wait_for_timeout(100)
    assert most == 1
    page.click("#camera-stop")
    assert live_tracks(page) == 0
    expect(page.locator("#camera-start")).to_be_focused()
    page.wait_for_timeout(300)
    before = count
    page.wait_for_timeout(700)
    assert (count, going) == (before, 0)


def test_leaving_releases_the_camera(open_camera: OpenCamera):
    page = open_camera()
    start(page)
    assert live_tracks(page) == 1
    page.check("#source-scene", force=True)
    until_forecast(page)
    assert live_tracks(page) == 0
    expect(page.locator(".live-actions")).to_be_hidden()


def test_points_of_a_scene_are_given_up(open_page: OpenPage, slow: str):
    page = open_page(slow, "#points=120,130")
    until_forecast(page)
    page.check("#source-camera", force=True)
    expect(page.locator("#stage-title")).to_have_text("Live from the camera")
    expect(page.locator("#picks")).to_be_hidden()
    assert "points" not in page.url
    page.check("#source-scene", force=True)
    until_forecast(page)


def test_the_last_seconds(open_camera: OpenCamera):
    page = open_camera()
    start(page)
    page.wait_for_timeout(2000)
    with page.expect_download() as download:
        page.click("#camera-save")
    assert re.match(r"camera-[\d-]+T[\d-]+\.webm$", download.value.suggested_filename)
    with av.open(download.value.path()) as container:
        pictures = [one.to_ndarray(format="rgb24") for one in container.decode(video=0)]
    assert len(pictures) > 4, "a browser that is busy may leave frames out"
    assert pictures[0].shape == (HEIGHT, WIDTH, 3)
    page.wait_for_timeout(1500)
    page.click("#camera-use")
    expect(page.locator("#footage-name")).to_contain_text(f"{WIDTH} × {HEIGHT}")
    expect(page.locator("#source-footage")).to_be_checked()
    assert live_tracks(page) == 0


def test_requests_follow_the_choices(open_camera: OpenCamera):
    page = open_camera()
    start(page)
    with page.expect_response("**/predict") as answered:
        pass
    forecast = answered.value.json()
    assert forecast["frame_rate"] == pytest.approx(RATE_HZ, rel=0.06)
    assert forecast["frame_size"] == [WIDTH, HEIGHT]
    assert [len(ball["positions"]) for ball in forecast["objects"]] == [120]
    page.check("#balls-2", force=True)
    page.fill("#horizon", "20")
    page.dispatch_event("#horizon", "change")
    page.wait_for_event(
        "response",
        lambda it: (
            it.url.endswith("/predict")
            and [len(ball["positions"]) for ball in it.json()["objects"]] == [20, 20]
        ),
    )


def told(page: Page, text: str) -> None:
    expect(page.locator("#camera-said")).to_contain_text(text)
    expect(page.locator("#camera-said")).to_have_attribute("data-error", "true")


def test_a_refused_permission_is_told(open_camera: OpenCamera):
    page = open_camera(allowed=False)
    page.click("#camera-start")
    told(page, "The camera was not allowed.")
    page.context.grant_permissions(["camera"])
    start(page)
    expect(page.locator("#camera-said")).to_have_text("")


def test_an_insecure_address_is_told(browser: Browser, slow: str):
    other = slow.replace("127.0.0.1", OTHER_NAME)
    page = browser.new_page()  # which warns of more headers that need https
    page.goto(other)
    page.check("#source-camera", force=True)
    page.click("#camera-start")
    told(page, f"only over https or on localhost, and {other} is neither")
    page.context.close()


def test_a_missing_camera_is_told(playwright: Playwright, slow: str):
    browser = with_cameras(playwright, "=device-count=0")
    try:
        context = browser.new_context()
        context.grant_permissions(["camera"])
        page = context.new_page()
        page.goto(slow)
        page.check("#source-camera", force=True)
        page.click("#camera-start")
        told(page, "No camera was found.")
    finally:
        browser.close()


def test_a_camera_that_is_unplugged(open_camera: OpenCamera):
    page = open_camera()
    start(page)
    page.evaluate("opened.at(-1).dispatchEvent(new Event('ended'))")
    told(page, "The camera was disconnected.")
    assert live_tracks(page) == 0
    start(page)


def test_an_overloaded_service_is_told(open_camera: OpenCamera):
    with serving(ROLLCAST_REQUESTS_PER_MINUTE="20") as limited:
        page = open_camera(limited)
        start(page)
        told(page, "The service is overloaded: ")
        expect(page.locator("#camera-said")).to_contain_text(re.compile(r"Next attempt in \d+ s"))
        assert live_tracks(page) == 1, "the picture goes on"
        page.click("#camera-stop")
        expect(page.locator("#camera-said")).to_have_text("")


@pytest.mark.parametrize("width", [390, 768, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_is_accessible(open_camera: OpenCamera, width: int, scheme: str):
    viewport = {"width": width, "height": PHONE["height"]}
    page = open_camera(viewport=viewport, color_scheme=scheme, bypass_csp=True)
    page.focus("#camera-start")
    page.keyboard.press("Enter")
    expect(page.locator("#camera-stop")).to_be_focused()
    expect(page.locator("#badge")).to_have_text(re.compile("behind"))
    for button in ("stop", "save", "use"):
        expect(page.locator(f"#camera-{button}")).to_be_in_viewport()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    found = Axe().run(page, options=WCAG)
    assert found.response["violations"] == [], found.generate_report()
    page.keyboard.press("Enter")
    expect(page.locator("#camera-start")).to_be_focused()


@pytest.mark.parametrize("width", [390, 768, 1280])
def test_another_camera_is_chosen(playwright: Playwright, slow: str, width: int):
    browser = with_cameras(playwright, "=device-count=2")
    try:
        context = browser.new_context(viewport={"width": width, "height": PHONE["height"]})
        context.grant_permissions(["camera"])
        page = context.new_page()
        page.goto(slow)
        page.evaluate(SPY)
        expect(page.locator("#health")).to_have_text("ready")
        if page.locator("#fold").is_visible():
            page.click("#fold")
        page.check("#source-camera", force=True)
        expect(page.locator("#camera-device-field")).to_be_hidden()
        page.click("#camera-start")
        choice = page.locator("#camera-device")
        expect(choice).to_be_visible()
        names = choice.locator("option").all_inner_texts()
        assert len(names) == len(set(names)) == 2
        first = choice.input_value()
        (other,) = {one.get_attribute("value") for one in choice.locator("option").all()} - {first}
        choice.select_option(other)
        device = "opened.at(-1).getSettings().deviceId"
        until(page, f"opened.length === 2 && {device} === {json.dumps(other)}")
        expect(choice).to_have_value(other)
        assert live_tracks(page) == 1, "the camera before is released"
    finally:
        browser.close()


def until(page: Page, condition: str) -> None:
    """Wait for a condition; the page's policy keeps Playwright from doing so in the page."""
    deadline_s = time.monotonic() + 120
    while not page.evaluate(condition):
        assert time.monotonic() < deadline_s, condition
        page.wait_for_timeout(100)


FAST_HZ = 30
BARS = 8


@pytest.fixture(scope="module")
def fast_video(tmp_path_factory) -> Path:
    """A camera of 30 pictures a second: dark and light bars count its pictures."""
    path = tmp_path_factory.mktemp("fast") / "bars.y4m"
    with path.open("wb") as file:
        file.write(f"YUV4MPEG2 W{WIDTH} H{HEIGHT} F{FAST_HZ}:1 Ip A1:1 C420jpeg\n".encode())
        for index in range(1 << BARS):
            gray = index ^ (index >> 1)  # of two pictures in a row one bar differs
            bars = [235 if gray >> bar & 1 else 16 for bar in range(BARS)]
            luma = np.repeat(np.array(bars, np.uint8), WIDTH // BARS)[None].repeat(HEIGHT, axis=0)
            chroma = np.full(2 * (WIDTH // 2) * (HEIGHT // 2), 128, np.uint8)
            file.write(b"FRAME\n" + luma.tobytes() + chroma.tobytes())
    return path


KEEP_FORMS = """() => {
  window.sent = [];
  const ask = window.fetch;
  window.fetch = async (url, init) => {
    if (String(url).endsWith('/predict') && init?.body instanceof FormData) {
      const files = await Promise.all(init.body.getAll('frames').map(async (file) => {
        const bytes = new Uint8Array(await file.arrayBuffer());
        return btoa(String.fromCharCode(...bytes));
      }));
      window.sent.push({ rate: Number(init.body.get('frame_rate')), files });
    }
    return ask(url, init);
  };
}"""


def is_blended(data: str) -> bool:
    """Whether a bar is neither dark nor light: two pictures are faded into each other."""
    with Image.open(io.BytesIO(base64.b64decode(data))) as image:
        grey = np.asarray(image.convert("L"), float)
    bars = grey[20:-20].reshape(-1, BARS, WIDTH // BARS)[:, :, 10:-10].mean(axis=(0, 2))
    return bool(((bars > 60) & (bars < 195)).any())


@pytest.mark.parametrize("width", [390, 768, 1280])
def test_pictures_of_a_camera_are_sent_as_they_were_taken(
    playwright: Playwright, address: str, fast_video: Path, width: int
):
    """At 30 a second, while models of the simulated world expect 40."""
    file = f"--use-file-for-fake-video-capture={fast_video}"
    browser = with_cameras(playwright, f"=fps={FAST_HZ}", file)
    try:
        context = browser.new_context(viewport={"width": width, "height": PHONE["height"]})
        context.grant_permissions(["camera"])
        page = context.new_page()
        page.goto(address)
        expect(page.locator("#health")).to_have_text("ready")
        page.evaluate(SPY)
        page.evaluate(KEEP_FORMS)
        if page.locator("#fold").is_visible():
            page.click("#fold")
        page.check("#source-camera", force=True)
        start(page)
        until(page, "sent.length >= 8")
        sent = page.evaluate("sent")
    finally:
        browser.close()
    # A machine that is busy leaves pictures out, and says so with a lower rate.
    assert np.median([one["rate"] for one in sent]) <= 1.1 * FAST_HZ
    blended = [is_blended(file) for one in sent for file in one["files"]]
    assert np.mean(blended) < 0.25, "a camera at 30 a second is blended in most frames for 40"
