"""Pictures of a forecast over the frames that it forecasts.

Colours are of the palette by Okabe and Ito, which colour-blind readers can distinguish, on a dark
casing that keeps them legible on any footage.
"""

from typing import Protocol, TypeAlias

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from rollcast.trajectory import STEP_TOLERANCE

OVERVIEW_PX = 720
PANEL_PX = OVERVIEW_PX // 2
"""Sides of the large picture and of the small ones beside it."""
VIDEO_PX = 480
"""Side of the pictures of a video."""
STEPS_BETWEEN_MARKS = 10
"""Along the path, where no later frame says which moments matter."""
SIGMAS = 2.0
"""Size of the ellipses, standard deviations."""

OVERSAMPLING = 2
PALETTE = ("#E69F00", "#56B4E9", "#CC79A7", "#F0E442", "#009E73")
"""Colors by object: orange, sky blue, reddish purple, yellow, bluish green."""
CASING = "#000000"
PATH_PX = 3
ELLIPSE_PX = 1
CASING_PX = 2
CROSS_PX = 7
FONT_PX = 20

RING_PX = 2
SMALLEST_RING_PX = 4
"""Radius that rings around smaller balls have."""

Rings: TypeAlias = Float[np.ndarray, "objects 3"]
"""Positions x and y, and radius, of balls, pixels of the frame."""

CIRCLE = np.stack([f(np.linspace(0, 2 * np.pi, 73)) for f in (np.cos, np.sin)])


class TruePath(Protocol):
    """Drawn attributes of a simulation, as of ``rollcast.client.Simulation``."""

    @property
    def positions(self) -> Float[np.ndarray, "objects T 2"]:
        """Pixels of the frames."""
        ...

    @property
    def times_s(self) -> Float[np.ndarray, " T"]:
        """Seconds after the first frame, or of a forecast after the last observed one."""
        ...


class ForecastPath(TruePath, Protocol):
    """Drawn attributes of a forecast, as of ``rollcast.client.Forecast``."""

    @property
    def covariances(self) -> Float[np.ndarray, "objects T 2 2"]:
        """Square pixels."""
        ...

    @property
    def step_rate(self) -> float:
        """Steps a second."""
        ...


def draw_forecast(
    frames: UInt8[np.ndarray, "frames height width 3"],
    times_s: Float[np.ndarray, " frames"],
    forecast: ForecastPath,
    rings: Rings | None = None,
) -> Image.Image:
    """Draw a forecast over the last observed frame and, where it has them, over later ones.

    The large picture is the last observed frame with the whole path; crosses and ellipses of two
    standard deviations show the forecast at the times of the later frames. Each later frame stands
    beside it with the path until then and the forecast for its own time.

    Parameters
    ----------
    frames
        RGB; the last observed frame, then any later ones.
    times_s
        Seconds after the last observed frame, of every frame: 0, then ascending.
    forecast
        In pixels of these frames.
    rings
        Where the balls were seen in the last observed frame; by default nothing is drawn there.

    Returns
    -------
    PIL.Image.Image
        RGB; of square frames 720 pixels high, wider by 360 for every two later frames. Of others
        the longer side has these pixels.

    Raises
    ------
    ValueError
        When a frame is more than half a step later than the forecast's last step.
    """
    end_s = float(forecast.times_s[-1])
    if times_s[-1] > end_s + STEP_TOLERANCE / forecast.step_rate:
        raise ValueError(f"a frame of {times_s[-1]:.3f} s, the forecast ends at {end_s:.3f} s")
    return _sheet(
        frames, times_s, forecast, f"last frame seen, forecast to +{end_s:.2f} s", forecast, rings
    )


def draw_truth(
    frames: UInt8[np.ndarray, "frames height width 3"],
    times_s: Float[np.ndarray, " frames"],
    path: TruePath,
) -> Image.Image:
    """Draw a true path over its first frame and, where it has them, over later ones.

    Parameters
    ----------
    frames
        RGB; the first one, then any later ones.
    times_s
        Seconds after the first, of every frame: 0, then ascending.
    path
        In pixels of these frames.

    Returns
    -------
    PIL.Image.Image
        As large as ``draw_forecast`` makes it.
    """
    return _sheet(frames, times_s, path, f"true path to +{float(path.times_s[-1]):.2f} s", None)


def draw_moment(
    frame: UInt8[np.ndarray, "height width 3"],
    time_s: float,
    forecast: ForecastPath,
    title: str,
    rings: Rings | None = None,
) -> Image.Image:
    """Draw a forecast over one frame: the path until then, cross and ellipse at its time.

    Parameters
    ----------
    frame
        RGB.
    time_s
        Seconds after the last observed frame; frames before it are shown as they are.
    forecast
        In pixels of the frame.
    title
        Text in the corner.
    rings
        Positions of the balls in this frame; by default no rings are drawn.

    Returns
    -------
    PIL.Image.Image
        RGB, the longer side of 480 pixels, both even.
    """
    panel = _Panel(frame, VIDEO_PX)
    panel.rings(rings)
    if time_s >= 0:
        panel.path(forecast, time_s, np.array([time_s]), forecast)
    panel.title(title)
    return panel.image()


def _sheet(
    frames: UInt8[np.ndarray, "frames height width 3"],
    times_s: Float[np.ndarray, " frames"],
    path: TruePath,
    title: str,
    uncertainty: ForecastPath | None,
    rings: Rings | None = None,
) -> Image.Image:
    """Put a large picture of the whole path and small ones of later frames on one sheet."""
    marks_s = times_s[1:] if len(times_s) > 1 else path.times_s[::STEPS_BETWEEN_MARKS][1:]
    columns = len(frames) // 2
    overview = _Panel(frames[0], OVERVIEW_PX)
    overview.rings(rings)
    width, height = overview.size
    sheet = Image.new("RGB", (width + columns * (width // 2), height))
    overview.path(path, float(path.times_s[-1]), marks_s, uncertainty)
    overview.title(title)
    sheet.paste(overview.image(), (0, 0))
    for index, (frame, time_s) in enumerate(zip(frames[1:], times_s[1:], strict=True)):
        panel = _Panel(frame, PANEL_PX)
        panel.path(path, float(time_s), np.array([time_s]), uncertainty)
        panel.title(f"+{time_s:.2f} s")
        row, column = divmod(index, columns)
        sheet.paste(panel.image(), (width + column * (width // 2), row * (height // 2)))
    return sheet


class _Panel:
    """One frame, enlarged or reduced, that is drawn on in pixels of the frame."""

    def __init__(self, frame: UInt8[np.ndarray, "height width 3"], side_px: int) -> None:
        height, width = frame.shape[:2]
        scale = side_px / max(height, width)
        # Halves of it are whole and even, as encoders of videos want them.
        parts = [max(4 * round(scale * side / 4), 4) for side in (width, height)]
        self.size = (parts[0], parts[1])
        """Width and height of the picture, pixels."""
        self._scale = scale * OVERSAMPLING
        self._canvas = Image.fromarray(frame).resize(
            (OVERSAMPLING * parts[0], OVERSAMPLING * parts[1]), Image.Resampling.BICUBIC
        )
        self._draw = ImageDraw.Draw(self._canvas)

    def path(
        self,
        path: TruePath,
        until_s: float,
        marks_s: Float[np.ndarray, " marks"],
        uncertainty: ForecastPath | None,
    ) -> None:
        """Draw every object's path until a time, crosses and, of a forecast, ellipses at some."""
        for index, positions in enumerate(path.positions):
            color = PALETTE[index % len(PALETTE)]
            until = positions[path.times_s <= until_s]
            self._line(np.vstack([until, _at(until_s, path.times_s, positions)]), color, PATH_PX)
            for mark_s in marks_s:
                position = _at(mark_s, path.times_s, positions)
                if uncertainty is not None:
                    covariance = _at(mark_s, path.times_s, uncertainty.covariances[index])
                    self._line(_ellipse(position, covariance), color, ELLIPSE_PX)
                self._cross(position, color)

    def rings(self, rings: Rings | None) -> None:
        """Draw where balls were seen."""
        for index, (x, y, radius) in enumerate([] if rings is None else rings.tolist()):
            line = CIRCLE.T * max(radius, SMALLEST_RING_PX * OVERSAMPLING / self._scale) + (x, y)
            self._line(line, PALETTE[index % len(PALETTE)], RING_PX)

    def title(self, text: str) -> None:
        """Write into the upper left corner."""
        font = ImageFont.load_default(FONT_PX * OVERSAMPLING)
        margin = FONT_PX * OVERSAMPLING // 4
        left, top, right, bottom = self._draw.textbbox((2 * margin, 2 * margin), text, font)
        box = (left - margin, top - margin, right + margin, bottom + margin)
        self._draw.rectangle(box, fill="black")
        self._draw.text((2 * margin, 2 * margin), text, "white", font)

    def image(self) -> Image.Image:
        """Return the finished picture."""
        return self._canvas.reduce(OVERSAMPLING)

    def _line(self, points: Float[np.ndarray, "points 2"], color: str, width_px: int) -> None:
        corners = [(float(x), float(y)) for x, y in points * self._scale]
        for line_color, width in ((CASING, width_px + CASING_PX), (color, width_px)):
            self._draw.line(corners, line_color, width * OVERSAMPLING, joint="curve")

    def _cross(self, position: Float[np.ndarray, " 2"], color: str) -> None:
        arm = CROSS_PX * OVERSAMPLING / self._scale
        for direction in (np.array([arm, arm]), np.array([arm, -arm])):
            self._line(np.stack([position - direction, position + direction]), color, PATH_PX)


def _at(
    time_s: float, times_s: Float[np.ndarray, " T"], values: Float[np.ndarray, "T *axes"]
) -> Float[np.ndarray, " *axes"]:
    """Return values at a time between steps."""
    step = np.interp(time_s, times_s, np.arange(len(times_s)))
    before, after = int(np.floor(step)), int(np.ceil(step))
    return values[before] + (step - before) * (values[after] - values[before])


def _ellipse(
    centre: Float[np.ndarray, " 2"], covariance: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "points 2"]:
    variances, axes = np.linalg.eigh(covariance)
    return centre + (axes * (SIGMAS * np.sqrt(np.maximum(variances, 0))) @ CIRCLE).T
