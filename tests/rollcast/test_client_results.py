"""What becomes of results: data frames and pictures."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from rollcast.client import Client
from rollcast.client.testing import FakeService
from rollcast.errors import MissingExtraError, RollcastError
from rollcast.plot import OVERVIEW_PX, PANEL_PX

SIDE = 64


@pytest.fixture(scope="module")
def scene():
    with Client(transport=FakeService()) as client:
        return client.simulate("ellipsoid", seed=1, objects=2, image_size=SIDE)


@pytest.fixture(scope="module")
def forecast(scene):
    with Client(transport=FakeService(variance_px2=4)) as client:
        return client.predict(scene.frames[:4], objects=2)


def test_a_data_frame_has_a_row_for_every_step_of_every_ball(forecast):
    table = forecast.to_dataframe()
    assert list(table.columns) == [
        *("step", "time_s", "object", "color", "x_px", "y_px", "xx_px2", "xy_px2", "yy_px2"),
        *("wx_rad_s", "wy_rad_s", "wz_rad_s"),
    ]
    assert len(table) == 80
    assert table["time_s"].is_monotonic_increasing
    green = table[table["color"] == "green"]
    np.testing.assert_array_equal(green[["x_px", "y_px"]], forecast.positions[1])
    assert set(green["object"]) == {1}
    np.testing.assert_array_equal(green["time_s"], forecast.times_s)
    assert (table["xx_px2"] == 4).all()
    assert (table["xy_px2"] == 0).all()
    assert pd.api.types.is_integer_dtype(table["step"])


def test_a_data_frame_of_a_simulation(scene):
    table = scene.to_dataframe()
    assert "xx_px2" not in table.columns
    red = table[table["object"] == 0]
    np.testing.assert_array_equal(red[["x_px", "y_px"]], scene.positions[0])
    np.testing.assert_array_equal(
        red[["wx_rad_s", "wy_rad_s", "wz_rad_s"]], scene.angular_velocities[0]
    )


def test_without_pandas_it_says_what_to_install(forecast, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError) as caught:
        forecast.to_dataframe()
    assert str(caught.value) == "data frames need pandas: pip install 'rollcast[dataframe]'"
    assert isinstance(caught.value, RollcastError)


def test_the_client_alone_imports_neither_pandas_nor_the_command_line():
    code = (
        "import sys, rollcast.client, rollcast.client.testing;"
        "print(sorted({'pandas', 'typer', 'rich', 'av', 'pybullet'} & set(sys.modules)))"
    )
    printed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert printed == "[]\n"


def test_a_forecast_over_the_frames_of_its_scene(forecast, scene):
    picture = forecast.plot(scene.frames[3:])
    assert picture.size == (OVERVIEW_PX + 3 * PANEL_PX, OVERVIEW_PX)
    few = forecast.plot(scene.frames[3:], panels=2)
    assert few.size == (OVERVIEW_PX + PANEL_PX, OVERVIEW_PX)
    alone = forecast.plot([scene.frames[3]])
    assert alone.size == (OVERVIEW_PX, OVERVIEW_PX)
    # The path lies over the large picture.
    x, y = (forecast.positions[0, 20] * OVERVIEW_PX / SIDE).astype(int)
    background = Image.fromarray(scene.frames[3]).resize(alone.size)
    assert alone.getpixel((int(x), int(y))) != background.getpixel((int(x), int(y)))


def test_frames_may_be_images_cropped_and_at_their_own_times(forecast, scene):
    wide = [Image.fromarray(np.pad(frame, ((0, 0), (8, 8), (0, 0)))) for frame in scene.frames[3:6]]
    cropped = forecast.plot(wide, crop="square", times_s=[0, 0.025, 0.05])
    assert cropped.tobytes() == forecast.plot(scene.frames[3:6]).tobytes()
    # What is later than the forecast is left out.
    late = forecast.plot(scene.frames[3:5], times_s=[0, 5.0])
    assert late.size == (OVERVIEW_PX, OVERVIEW_PX)
    with Client(transport=FakeService()) as client:
        slow = client.predict(scene.frames[:4], objects=2, frame_rate=10, horizon=2)
    assert slow.plot(scene.frames[3:6]).size == (OVERVIEW_PX + PANEL_PX, OVERVIEW_PX)


@pytest.mark.parametrize(
    ("frames", "times_s", "message"),
    [
        (np.zeros((1, 32, 32, 3), np.uint8), None, "a frame is 32 x 32, the forecast is of frames"),
        (np.zeros((2, SIDE, SIDE, 3), np.uint8), [0], r"2 frames at \[0\] s"),
        (np.zeros((1, SIDE, SIDE, 3), np.uint8), [0.5], "ascending from 0"),
        (np.zeros((3, SIDE, SIDE, 3), np.uint8), [0, 0.5, 0.1], "ascending from 0"),
        ([], None, "0 frames"),
    ],
    ids=["size", "too few times", "no start", "not in order", "no frame"],
)
def test_what_cannot_be_drawn(forecast, frames, times_s, message):
    with pytest.raises(ValueError, match=message):
        forecast.plot(frames, times_s=times_s)


def test_a_true_path(scene):
    assert scene.plot().size == (OVERVIEW_PX + 3 * PANEL_PX, OVERVIEW_PX)
    with Client(transport=FakeService()) as client:
        unseen = client.simulate("hemisphere", seed=1, include_frames=False)
    with pytest.raises(ValueError, match="has no frames"):
        unseen.plot()
