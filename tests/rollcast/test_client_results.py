"""What becomes of results: data frames and pictures."""

import io
import subprocess
import sys

import av
import numpy as np
import pandas as pd
import pytest
from PIL import Image

from rollcast.client import Client, Forecast
from rollcast.client.testing import FakeService
from rollcast.errors import MissingExtraError, RollcastError
from rollcast.plot import OVERVIEW_PX, PANEL_PX, VIDEO_PX
from rollcast.schemas import PredictResponse

SIDE = 64


@pytest.fixture(scope="module")
def scene():
    with Client(transport=FakeService()) as client:
        return client.simulate("ellipsoid", seed=1, num_objects=2, image_size=SIDE)


@pytest.fixture(scope="module")
def forecast(scene):
    with Client(transport=FakeService(variance_px2=4)) as client:
        return client.predict(scene.frames[:4], num_objects=2)


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
        slow = client.predict(scene.frames[:4], num_objects=2, frame_rate=10, horizon=2)
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


@pytest.mark.parametrize("suffix", ["png", "JPG", "webp"])
def test_a_forecast_is_saved_as_a_picture(forecast, scene, tmp_path, suffix):
    path = tmp_path / f"forecast.{suffix}"
    forecast.save(path, scene.frames[3:])
    with Image.open(path) as picture:
        assert picture.size == (OVERVIEW_PX + 3 * PANEL_PX, OVERVIEW_PX)
    forecast.save(str(path))
    with Image.open(path) as picture:
        assert picture.size == (OVERVIEW_PX, OVERVIEW_PX)


@pytest.mark.parametrize("suffix", ["mp4", "gif"])
def test_a_forecast_is_saved_as_a_video_of_every_step(forecast, scene, tmp_path, suffix):
    path = tmp_path / f"forecast.{suffix}"
    forecast.save(path, scene.frames[3:13])
    with av.open(path) as container:
        pictures = [picture.to_ndarray(format="rgb24") for picture in container.decode(video=0)]
    assert len(pictures) == 40
    assert {picture.shape for picture in pictures} == {(VIDEO_PX, VIDEO_PX, 3)}
    # The ball of the frames is where it was in the last of them.
    x, y = (scene.positions[0, 12] * VIDEO_PX / SIDE).astype(int)
    assert pictures[-1][y, x, 0] > 150 > pictures[0][y, x, 0]
    # Without frames the path is drawn on a plain ground.
    forecast.save(path)
    with av.open(path) as container:
        last = [picture.to_ndarray(format="rgb24") for picture in container.decode(video=0)][-1]
    x, y = (forecast.positions[0, 39] * VIDEO_PX / SIDE).astype(int)
    assert last[y - 8 : y + 8, x - 8 : x + 8].max() > 150
    assert last[VIDEO_PX - 8 :, :8].max() < 60


def test_a_forecast_is_saved_as_json_that_makes_it_again(forecast, tmp_path):
    path = tmp_path / "forecast.json"
    forecast.save(path)
    again = Forecast.from_response(PredictResponse.model_validate_json(path.read_text()))
    assert path.read_text() == forecast.to_json() + "\n"
    for name in ("positions", "covariances", "ellipse50_radii", "angular_velocities", "times_s"):
        np.testing.assert_array_equal(getattr(again, name), getattr(forecast, name))
    assert (again.colors, again.model, again.warnings) == (
        forecast.colors,
        forecast.model,
        forecast.warnings,
    )
    assert again.frame_size == forecast.frame_size


def test_a_forecast_is_saved_as_the_rows_of_its_data_frame(forecast, tmp_path):
    forecast.save(tmp_path / "forecast.csv")
    pd.testing.assert_frame_equal(
        pd.read_csv(tmp_path / "forecast.csv"),
        forecast.to_dataframe(),
        check_dtype=False,
    )


def test_a_forecast_is_saved_as_nothing_else(forecast, tmp_path):
    with pytest.raises(ValueError, match=r"ends in '\.txt', expected one of \.png"):
        forecast.save(tmp_path / "forecast.txt")
    assert list(tmp_path.iterdir()) == []


def test_notebooks_show_a_forecast(forecast):
    with Image.open(io.BytesIO(forecast._repr_png_())) as picture:
        assert picture.size == (OVERVIEW_PX, OVERVIEW_PX)
        assert len(set(picture.convert("L").tobytes())) > 10, "the path is drawn"


def test_numbers_of_numpy_are_numbers(scene):
    service = FakeService()
    with Client(transport=service) as client:
        again = client.simulate(
            "ellipsoid",
            seed=np.int64(1),
            num_objects=np.uint8(2),
            steps=np.int32(5),
            image_size=np.int64(SIDE),
            textured=np.bool_(False),
            scene={"radius_m": np.float32(0.1), "positions_m": np.zeros((2, 3))},
        )
        forecast = client.predict(
            again.frames[:4], horizon=np.int64(7), num_objects=np.int8(2), frame_rate=np.float32(20)
        )
    assert forecast.positions.shape == (2, 7, 2)
    assert forecast.frame_rate == 20
    assert service.requests[0].fields["seed"] == 1
    assert service.requests[0].fields["scene"]["positions_m"] == [[0, 0, 0], [0, 0, 0]]
    assert service.requests[1].fields["horizon"] == "7"
