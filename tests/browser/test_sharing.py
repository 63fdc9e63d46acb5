"""What is taken away from the page: files that others open, and calls that run."""

import base64
import io
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import av
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image
from playwright.sync_api import Page, expect

from tests.browser.conftest import WIDTHS, OpenPage, still, until_forecast
from tests.browser.test_access import WCAG
from tests.e2e.conftest import ROOT


def saved(page: Page, kind: str) -> tuple[str, bytes]:
    with page.expect_download() as download:
        page.click(f"#save-{kind}")
    return download.value.suggested_filename, Path(download.value.path()).read_bytes()


def test_json(page: Page):
    name, content = saved(page, "json")
    document = json.loads(content)
    assert name == "rollcast-ellipsoid-7.json"
    assert document["request"] == {"horizon": 40, "num_objects": 1, "scenario": "ellipsoid"}
    (forecast,) = document["forecasts"]
    (ball,) = forecast["objects"]
    assert np.shape(ball["positions"]) == (40, 2)
    assert np.shape(ball["covariances"]) == (40, 2, 2)
    assert np.shape(ball["angular_velocities"]) == (40, 3)
    assert ball["covariance_source"] == "predicted"
    assert forecast["model"]["name"]
    assert len(forecast["times_s"]) == 40
    assert np.shape(document["truth"][0]["positions"]) == (43, 2)


def test_png(page: Page):
    name, content = saved(page, "png")
    assert name == "rollcast-ellipsoid-7.png"
    with Image.open(io.BytesIO(content)) as image:
        assert image.format == "PNG"
        width, height = image.size
        assert width == 720
        assert height > width, "a strip below says what it shows"


def test_gif(page: Page):
    _, content = saved(page, "gif")
    with Image.open(io.BytesIO(content)) as image:
        assert image.format == "GIF"
        assert image.is_animated
        assert image.n_frames == 43
        assert image.info["duration"] == 50
        first = np.asarray(image.convert("RGB"), float)
        image.seek(42)
        last = np.asarray(image.convert("RGB"), float)
    assert np.abs(last - first).max() > 50


def test_a_video_of_two_models(page: Page):
    page.check("#models input[value=probnet]")
    page.check("#split")
    until_forecast(page)
    still(page)
    _, content = saved(page, "webm")
    with av.open(io.BytesIO(content)) as container:
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    # A browser that is busy may leave frames out.
    assert len(pictures) > 15
    height, width, _ = pictures[0].shape
    assert width > 1.5 * height, "one beside the other"
    assert np.abs(pictures[-1].astype(float) - pictures[0]).max() > 50


def copied(page: Page, language: str) -> str:
    page.check(f"#language-{language}")
    page.click("#copy")
    expect(page.locator("#copied")).to_have_text("Copied.")
    return page.evaluate("navigator.clipboard.readText()")


def run(language: str, text: str, folder: Path) -> str:
    command = ["sh", "-e", "-c", text] if language == "curl" else [sys.executable, "-c", text]
    environment = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def last_position(page: Page, forecast: int = 0) -> list[float]:
    document = json.loads(saved(page, "json")[1])
    return document["forecasts"][forecast]["objects"][0]["positions"][-1]


@pytest.mark.parametrize("final", [False, True], ids=["four frames", "a final frame, too"])
def test_curl(page: Page, tmp_path: Path, final: bool):
    if final:
        page.check("#final")
        until_forecast(page)
    run("curl", copied(page, "curl"), tmp_path)
    answer = json.loads((tmp_path / "forecast.json").read_text())
    # The page asks for larger pictures than the snippet.
    end = np.array(answer["objects"][0]["positions"][-1]) * 2
    np.testing.assert_allclose(end, last_position(page), atol=3)


def test_python_for_two_models(page: Page, tmp_path: Path):
    page.check("#models input[value=posnet]")
    until_forecast(page)
    lines = run("python", copied(page, "python"), tmp_path).splitlines()
    assert lines[0].startswith("fieldnet [[")
    assert any(line.startswith("posnet [[") for line in lines)


@pytest.mark.parametrize("language", ["curl", "python"])
def test_calls_with_footage(page: Page, address: str, tmp_path: Path, language: str):
    simulated = page.request.post(
        f"{address}/simulate",
        data={"scenario": "hemisphere", "seed": 3, "steps": 43, "image_size": 200},
    ).json()
    for index, frame in enumerate(simulated["frames"]):
        (tmp_path / f"shot-{index}.png").write_bytes(base64.b64decode(frame))
    page.set_input_files("#files", sorted(tmp_path.glob("shot-*.png")))
    page.click("#go")
    until_forecast(page)
    name, content = saved(page, "frames")
    assert name.endswith(".zip")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == [f"frame-{index}.png" for index in range(4)]
        archive.extractall(tmp_path)
    printed = run(language, copied(page, language), tmp_path)
    expected = last_position(page)
    if language == "curl":
        answer = json.loads((tmp_path / "forecast.json").read_text())
        np.testing.assert_allclose(answer["objects"][0]["positions"][-1], expected, atol=0.05)
    else:
        assert printed.startswith("fieldnet [[")


def test_the_frames_of_a_final_frame_are_five(page: Page):
    page.check("#final")
    until_forecast(page)
    _, content = saved(page, "frames")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.testzip() is None
        names = [f"frame-{index}.png" for index in range(4)]
        assert archive.namelist() == [*names, "final.png"]
        with Image.open(io.BytesIO(archive.read("final.png"))) as picture:
            assert picture.size == (256, 256)


@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda viewport: viewport["width"])
def test_the_link_is_copied(open_page: OpenPage, address: str, viewport: dict):
    page = open_page(address, "#seed=11", viewport=viewport)
    until_forecast(page)
    page.click("#copy-link")
    expect(page.locator("#link-copied")).to_have_text("The link is copied.")
    link = page.evaluate("navigator.clipboard.readText()")
    assert link == page.url
    assert "seed=11" in link


@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda viewport: viewport["width"])
def test_the_guide_is_served(open_page: OpenPage, address: str, viewport: dict):
    page = open_page(address, viewport=viewport, bypass_csp=True)
    until_forecast(page)
    page.get_by_role("link", name="Guide").click()
    expect(page.locator("h1")).to_have_text("Your own video")
    assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]
    found = Axe().run(page, options=WCAG)
    assert found.response["violations"] == [], found.generate_report()
    page.get_by_role("link", name="Troubleshooting").first.click()
    expect(page.locator("h1")).to_have_text("Troubleshooting")
    page.get_by_role("link", name="Rollcast", exact=True).click()
    until_forecast(page)
