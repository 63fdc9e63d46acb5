"""Pictures of forecasts: the right pixels change and the others stay."""

from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image, ImageColor

from rollcast.plot import OVERVIEW_PX, PALETTE, PANEL_PX, draw_forecast

SIDE = 72
SCALE = OVERVIEW_PX // SIDE
GREY = 128


def forecast(objects=1, steps=41, variance=4.0):
    """Balls that roll to the right, one below the other, one pixel a step."""
    x = 20 + np.arange(steps)
    positions = np.stack([np.stack([x, np.full(steps, 30 + 20 * k)], -1) for k in range(objects)])
    covariances = np.broadcast_to(np.diag([variance, 4 * variance]), (objects, steps, 2, 2))
    return SimpleNamespace(
        positions=positions.astype(float),
        covariances=covariances,
        times_s=np.arange(steps) / 40,
        step_rate=40.0,
    )


def frames(count):
    return np.full((count, SIDE, SIDE, 3), GREY, np.uint8)


def drawn(picture, x, y, panel=None):
    """Whether something is drawn near a point of the frame, in the overview or in a panel."""
    left, top, scale = 0, 0, SCALE
    if panel is not None:
        row, column = panel
        left, top = OVERVIEW_PX + column * PANEL_PX, row * PANEL_PX
        scale = PANEL_PX // SIDE
    column, row = round(left + x * scale), round(top + y * scale)
    return bool((np.asarray(picture)[row - 1 : row + 2, column - 1 : column + 2] != GREY).any())


def test_the_overview_has_path_crosses_and_two_sigma_ellipses():
    picture = draw_forecast(frames(1), np.zeros(1), forecast())
    assert picture.size == (OVERVIEW_PX, OVERVIEW_PX)
    assert drawn(picture, 25.5, 30)  # the path
    assert not drawn(picture, 18, 30)  # not before it
    assert not drawn(picture, 62, 30 - 4)
    assert drawn(picture, 30.5, 30.5)  # a cross at step 10
    assert drawn(picture, 30 + 4, 30 + 0.2)
    assert drawn(picture, 30, 30 + 8)  # its ellipse: sigma is 2 and 4 pixels
    assert drawn(picture, 30, 30 - 8)
    assert not drawn(picture, 30, 30 + 5)
    assert not drawn(picture, 30, 30 + 11)
    pixels = np.asarray(picture)
    assert (pixels[30 * SCALE, 25 * SCALE] == ImageColor.getrgb(PALETTE[0])).all()


def test_later_frames_have_the_forecast_of_their_time():
    shown = frames(4)
    shown[2, 60:, 60:] = 250
    picture = draw_forecast(shown, np.array([0, 0.25, 0.5125, 1.0]), forecast())
    assert picture.size == (OVERVIEW_PX + 2 * PANEL_PX, OVERVIEW_PX)
    assert drawn(picture, 30, 38, panel=(0, 0))
    assert drawn(picture, 40.5, 38, panel=(0, 1))  # between two steps
    assert drawn(picture, 60, 38, panel=(1, 0))
    assert not drawn(picture, 35, 30, panel=(0, 0))  # the path ends there
    assert drawn(picture, 35, 30, panel=(0, 1))
    assert drawn(picture, 65, 65, panel=(0, 1))  # the frame itself
    assert not drawn(picture, 65, 65, panel=(0, 0))
    for x in (30, 40.5, 60):
        assert drawn(picture, x, 38)  # the overview marks the same moments


def test_every_frame_has_its_time_in_the_corner():
    picture = np.asarray(draw_forecast(frames(3), np.array([0, 0.25, 1.0]), forecast()))
    labels = [picture[:30, OVERVIEW_PX + PANEL_PX * 0 :][:, :100], picture[PANEL_PX:][:30, -360:]]
    assert all((label == 255).any() and (label == 0).any() for label in labels)
    assert (picture[:30, :200] == 255).any()


def test_balls_have_colors_of_their_own():
    picture = np.asarray(draw_forecast(frames(1), np.zeros(1), forecast(objects=2)))
    for y, color in zip((30, 50), PALETTE[:2], strict=True):
        assert (picture[y * SCALE, 25 * SCALE] == ImageColor.getrgb(color)).all()


@pytest.mark.parametrize("side", [32, 1080])
def test_frames_of_any_size_fill_the_same_picture(side):
    shown = np.full((2, side, side, 3), GREY, np.uint8)
    picture = draw_forecast(shown, np.array([0, 0.5]), forecast())
    assert isinstance(picture, Image.Image)
    assert (picture.mode, picture.size) == ("RGB", (OVERVIEW_PX + PANEL_PX, OVERVIEW_PX))


def test_one_step_is_a_forecast_too():
    draw_forecast(frames(1), np.zeros(1), forecast(steps=1))


def test_a_path_may_leave_the_frame_and_be_certain():
    path = forecast(variance=0.0)
    path.positions[0] += 1000
    picture = draw_forecast(frames(1), np.zeros(1), path)
    assert (np.asarray(picture)[100:] == GREY).all()


def test_a_frame_after_the_forecast_is_refused():
    draw_forecast(frames(2), np.array([0, 1.01]), forecast())
    with pytest.raises(ValueError, match=r"a frame of 1\.050 s, the forecast ends at 1\.000 s"):
        draw_forecast(frames(2), np.array([0, 1.05]), forecast())
