"""Footage that the user brings: the frames have to be the right ones, and the messages clear."""

import base64
import io
import json
import re
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, expect

from rollcast.client import Client, Simulation
from tests.browser.conftest import WIDTHS, OpenPage, figures, pixels, until_forecast
from tests.e2e.conftest import ROOT, serving

SIZE, LEFT, TOP = 240, 52, 8
"""The frames stand in a larger picture, so that there is something to crop."""


@pytest.fixture(scope="module")
def scene(address: str) -> Simulation:
    with Client(address) as client:
        return client.simulate("hemisphere", seed=7, steps=64, image_size=SIZE)


@pytest.fixture(scope="module")
def clips(scene: Simulation, tmp_path_factory) -> dict[int, Path]:
    """Videos of the scene by cameras of 40 and of 30 frames a second."""
    folder = tmp_path_factory.mktemp("clips")
    return {rate: record_video(scene, folder / f"rolling-{rate}.webm", rate) for rate in (40, 30)}


def record_video(scene: Simulation, path: Path, rate: int) -> Path:
    """Record a scene with a camera of another rate, which sees the nearest frame each time."""
    assert scene.frames is not None
    times_s = np.arange(0, len(scene.frames) / 40, 1 / rate)
    with av.open(path, "w") as container:
        stream = container.add_stream("libvpx", rate=rate)
        stream.width, stream.height, stream.pix_fmt = 320, 256, "yuv420p"
        stream.bit_rate = 8_000_000
        for time_s in times_s:
            picture = np.full((256, 320, 3), 90, np.uint8)
            nearest = min(round(time_s * 40), len(scene.frames) - 1)
            picture[TOP : TOP + SIZE, LEFT : LEFT + SIZE] = scene.frames[nearest]
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def drop(page: Page, *paths: Path) -> None:
    """Let files fall onto the page, as from a file manager."""
    kinds = {".webm": "video/webm", ".png": "image/png", ".txt": "text/plain"}
    files = [
        (path.name, kinds[path.suffix], base64.b64encode(path.read_bytes()).decode())
        for path in paths
    ]
    carried = page.evaluate_handle(
        """(files) => {
          const transfer = new DataTransfer();
          for (const [name, type, data] of files) {
            const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
            transfer.items.add(new File([bytes], name, { type }));
          }
          return transfer;
        }""",
        files,
    )
    page.dispatch_event("body", "dragover", {"dataTransfer": carried})
    expect(page.locator("#dropping")).to_be_visible()
    page.dispatch_event("body", "drop", {"dataTransfer": carried})
    expect(page.locator("#dropping")).to_be_hidden()


def crop(page: Page) -> None:
    for name, value in (("size", SIZE), ("x", LEFT), ("y", TOP)):
        page.fill(f"#crop-{name}", str(value))
        page.press(f"#crop-{name}", "Tab")


def unfold(page: Page) -> None:
    """Open the controls, which are folded on a phone."""
    if page.locator("#fold").is_visible():
        page.click("#fold")


def positions_at(scene: Simulation, times_s: np.ndarray) -> np.ndarray:
    """Positions of the first ball at times, pixels; NaN after the end."""
    known_s = np.arange(scene.positions.shape[1]) / 40
    columns = [
        np.interp(times_s, known_s, scene.positions[0, :, axis], right=np.nan) for axis in (0, 1)
    ]
    return np.stack(columns, axis=-1)


def sent_frames(page: Page) -> list[np.ndarray]:
    """Frames that the models see, as the page hands them out."""
    with page.expect_download() as download:
        page.click("#save-frames")
    with zipfile.ZipFile(download.value.path()) as archive:
        assert archive.testzip() is None
        names = sorted(name for name in archive.namelist() if name.startswith("frame-"))
        pictures = [Image.open(io.BytesIO(archive.read(name))).convert("RGB") for name in names]
    return [np.asarray(picture, float) for picture in pictures]


def decoded(path: Path) -> list[np.ndarray]:
    """The square of a clip's frames that the models see."""
    with av.open(path) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    return [frame[TOP : TOP + SIZE, LEFT : LEFT + SIZE].astype(float) for frame in frames]


def saved(page: Page) -> dict:
    with page.expect_download() as download:
        page.click("#save-json")
    return json.loads(Path(download.value.path()).read_text())


def forecast_of(page: Page) -> np.ndarray:
    page.click("#go")
    until_forecast(page)
    return np.array(saved(page)["forecasts"][0]["objects"][0]["positions"])


@pytest.fixture
def page(open_page: OpenPage, address: str) -> Page:
    page = open_page(address)
    until_forecast(page)
    return page


@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda viewport: viewport["width"])
@pytest.mark.parametrize(("rate", "within_px"), [(40, 4.0), (30, 12.0)])
def test_a_dropped_video(
    open_page: OpenPage, address: str, scene: Simulation, clips, rate, within_px, viewport
):
    page = open_page(address, viewport=viewport)
    until_forecast(page)
    unfold(page)
    drop(page, clips[rate])
    expect(page.locator("#footage-name")).to_contain_text(f"rolling-{rate}.webm: 320 × 256, 1.6")
    assert page.input_value("#spacing") == ""
    expect(page.locator("#spacing-hint")).to_contain_text("the model is told their rate: 15 to 125")
    crop(page)
    positions = forecast_of(page)
    document = saved(page)
    assert document["request"]["frame_rate"] == pytest.approx(rate, rel=0.02)
    times_s = 3 / rate + np.arange(40) / rate
    truth = positions_at(scene, times_s)
    errors = np.linalg.norm(positions - truth, axis=-1)
    assert np.nanmean(errors[:20]) < within_px, errors
    assert "blended" not in page.locator("#notes").inner_text()
    expect(page.locator("#horizon-text")).to_have_text(
        re.compile(rf"40 steps, {40 / rate:.1f}\d? s")
    )
    # Every frame is one that the camera took.
    for sent, taken in zip(sent_frames(page), decoded(clips[rate])[:4], strict=True):
        assert np.abs(sent - taken).mean() < 3
    assert figures(page)[0] == "–", "nobody knows the truth"
    # The footage goes on under the forecast.
    page.click("#first")
    first = pixels(page)
    page.click("#end")
    expect(page.locator("#badge")).to_contain_text(f"+{39 / rate:.3f} s")
    assert pixels(page) != first
    expect(page.locator("#surface-note")).to_contain_text("The ground of your footage is unknown")


@pytest.fixture(scope="module")
def setups(tmp_path_factory) -> Iterator[str]:
    """A service with a committed model that passes for one of a set-up, and as itself."""
    folder = tmp_path_factory.mktemp("models")
    shutil.copytree(ROOT / "models" / "fieldnet" / "1", folder / "fieldnet" / "1")
    about = {"colors": ["#ff8800"], "crop": [LEFT, TOP, SIZE]}
    for name, rate in (("table", 40.0), ("slow", 20.0)):
        shutil.copytree(ROOT / "models" / "fieldnet" / "1", folder / name / "1")
        file = folder / name / "1" / "manifest.json"
        told = json.loads(file.read_text())
        told |= {"name": name, "scenarios": ["footage"], "frame_rate_hz": rate, "setup": about}
        file.write_text(json.dumps(told))
    with serving(ROLLCAST_MODELS_DIR=str(folder)) as address:
        yield address


def test_the_model_of_a_set_up_says_how_it_is_filmed(
    open_page: OpenPage, setups: str, scene: Simulation, clips
):
    page = open_page(setups)
    until_forecast(page)
    expect(page.locator("#models")).not_to_contain_text("table")
    drop(page, clips[40])
    expect(page.locator("#models")).to_contain_text("own set-up")
    assert page.input_value("#crop-size") == "256", "auto is none of a set-up"
    page.check('#models input[value="table"]', force=True)
    page.uncheck('#models input[value="auto"]', force=True)
    expect(page.locator("#crop-size")).to_have_value(str(SIZE))
    assert (page.input_value("#crop-x"), page.input_value("#crop-y")) == (str(LEFT), str(TOP))
    errors = np.linalg.norm(forecast_of(page) - scene.positions[0, 3:43], axis=-1)
    assert errors[:20].mean() < 4, errors
    expect(page.locator("#legend .ball")).to_have_css("background-color", "rgb(255, 136, 0)")
    page.check('#models input[value="slow"]', force=True)
    page.uncheck('#models input[value="table"]', force=True)
    expect(page.locator("#spacing")).to_have_value("50")
    expect(page.locator("#spacing-hint")).to_contain_text("20 frames a second")
    expect(page.locator("#horizon-text")).to_have_text("40 steps, 2.00 s")


def test_where_it_starts(page: Page, scene: Simulation, clips):
    drop(page, clips[40])
    crop(page)
    page.fill("#start", "0.5")
    expect(page.locator("#start-text")).to_have_text("0.500 s")
    positions = forecast_of(page)
    errors = np.linalg.norm(positions - scene.positions[0, 23:63], axis=-1)
    assert errors[:10].mean() < 4, errors
    page.click("#recrop")
    expect(page.locator("#stage-title")).to_contain_text("Choose where it begins")
    page.fill("#start", "1.58")
    page.click("#go")
    expect(page.locator("#messages")).to_contain_text("Start earlier")


def test_the_square_is_dragged(page: Page, clips):
    drop(page, clips[40])
    canvas = page.locator("#panels canvas.cropping")
    expect(canvas).to_be_visible()
    expect(page.locator("#crop-size")).to_have_value("256")
    box = canvas.bounding_box()
    assert box is not None
    scale = box["width"] / 320
    top = box["y"] + (box["height"] - 256 * scale) / 2

    def drag(start: tuple[float, float], end: tuple[float, float]) -> None:
        page.mouse.move(box["x"] + start[0] * scale, top + start[1] * scale)
        page.mouse.down()
        page.mouse.move(box["x"] + end[0] * scale, top + end[1] * scale)
        page.mouse.up()

    drag((160, 128), (180, 128))
    expect(page.locator("#crop-x")).to_have_value("52")
    drag((52, 256), (116, 192))
    expect(page.locator("#crop-size")).to_have_value("192")
    expect(page.locator("#crop-x")).to_have_value("116")
    page.fill("#crop-x", "9999")
    page.press("#crop-x", "Tab")
    expect(page.locator("#crop-x")).to_have_value("128")


def test_images(page: Page, address: str, scene: Simulation, tmp_path: Path):
    assert scene.frames is not None
    paths = [tmp_path / f"frame-{index}.png" for index in range(43)]
    for path, frame in zip(paths, scene.frames, strict=False):
        Image.fromarray(frame).save(path)
    # Sorted as people sort: frame-2 before frame-10.
    page.check("#source-footage")
    expect(page.locator("#stage-title")).to_contain_text("Bring a video")
    page.set_input_files("#files", sorted(paths))
    expect(page.locator("#footage-name")).to_contain_text("43 images, frame-0.png to frame-42.png")
    positions = forecast_of(page)
    with Client(address) as client:
        asked = client.predict(scene.frames[:4], horizon=40, num_objects=1)
    np.testing.assert_allclose(positions, asked.positions[0], rtol=0, atol=0.05)
    page.fill("#image-rate", "80")
    page.press("#image-rate", "Tab")
    expect(page.locator("#footage-name")).to_contain_text("0.53 s")
    page.click("#go")
    until_forecast(page)
    page.click("#end")
    expect(page.locator("#badge")).to_contain_text("no footage")


def test_a_spacing_that_the_models_do_not_know(page: Page, clips):
    drop(page, clips[40])
    crop(page)
    page.fill("#spacing", "50")
    page.press("#spacing", "Tab")
    page.click("#go")
    until_forecast(page)
    document = saved(page)
    assert document["request"]["frame_rate"] == pytest.approx(20)
    assert document["forecasts"][0]["model"]["name"] == "any-ball", "which is told the rate"
    page.check('#models input[value="fieldnet"]')
    page.uncheck('#models input[value="auto"]')
    expect(page.locator("#spacing")).to_have_value("25")
    page.fill("#spacing", "50")
    page.press("#spacing", "Tab")
    page.click("#go")
    until_forecast(page)
    expect(page.locator("#notes")).to_contain_text("20 a second and fieldnet@1 was trained on 40")
    page.fill("#spacing", "30")
    page.press("#spacing", "Tab")
    page.click("#go")
    until_forecast(page)
    expect(page.locator("#notes")).to_contain_text("they are blended from those before and after")


def test_a_final_frame_of_footage(page: Page, clips):
    drop(page, clips[40])
    crop(page)
    page.check("#final")
    page.click("#go")
    until_forecast(page)
    expect(page.locator("#strip li")).to_have_count(5)
    expect(page.locator("#legend")).to_contain_text("fieldnet-interpolation")


def image(size: tuple[int, int]) -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", size).save(buffer, "PNG")
    return buffer.getvalue()


UNUSABLE = {
    "text": ({"notes.txt": b"x"}, "neither images nor a video"),
    "three images": ({f"{i}.png": image((64, 64)) for i in range(3)}, "Four images are needed"),
    "no image": ({f"{i}.png": b"x" for i in range(4)}, "0.png cannot be read as an image"),
    "no video": ({"broken.webm": b"x"}, "cannot decode broken.webm"),
    "sizes differ": (
        {f"{i}.png": image((64, 64 + i)) for i in range(4)},
        "1.png is 64 × 65, the first image 64 × 64",
    ),
}


@pytest.mark.parametrize("case", UNUSABLE)
def test_unusable_footage(page: Page, tmp_path: Path, case: str):
    files, said = UNUSABLE[case]
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    drop(page, *(tmp_path / name for name in files))
    if case == "sizes differ":
        page.click("#go")
    expect(page.locator("#messages")).to_contain_text(said)
    expect(page.locator("#messages h2")).to_have_text("This footage cannot be used")
