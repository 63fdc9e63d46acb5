"""Detected or prompted balls, between the pixels of a request and the square of a model."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.kinematics import KinematicForecast, kinematic_forecast, mean_slopes
from rollcast.patches import Letterbox
from rollcast.scene import BallColor
from rollcast.schemas import BallPrompt, SeenBall
from service.errors import InvalidValueError
from service.inference.ball_predictor import BallPredictor, FoundBalls
from service.inference.rollout import ForecastArrays

SURE = 0.5
"""Minimum score of a ball without a warning."""
UNCERTAIN_RADII = 0.5
"""Maximum standard deviation of a ball's position, in its radii, without a warning."""


MIN_RADIUS = 0.1
"""Smallest radius of a prompt, pixels."""

LEVEL_STEPS = 20
"""Steps of the model over which the ground under a ball's path has to be level."""
HALF = NETWORK_FRAME_SIZE / 2


class RequestBalls:
    """The balls of one request.

    Parameters
    ----------
    model
        Model that finds the balls.
    frames
        Frames of the request.
    prompts
        Points of the last frame, or None.
    objects
        Number of balls, or None.
    spacing
        Time between two frames, in steps of the model.
    steps
        Times of the forecast's steps after the last frame, in frames.

    Raises
    ------
    InvalidValueError
        When a prompt lies outside the frames, or fewer balls than requested are found.
    """

    def __init__(
        self,
        model: BallPredictor,
        frames: UInt8[np.ndarray, "4 height width 3"],
        prompts: Sequence[BallPrompt] | None,
        objects: int | None,
        spacing: float,
        steps: Float[np.ndarray, " T"],
    ) -> None:
        self.box = Letterbox(*frames.shape[1:3])
        points, radii = (None, None) if prompts is None else _points(prompts, self.box)
        self.found: FoundBalls = model.find(frames, points, radii, objects, spacing)
        self._last = frames[-1]
        source = model.manifest.kinematic
        assert source is not None
        self._level_slope = source.level_slope
        # Changes of velocity are random: their variances add up.
        self._acceleration_ratio = source.acceleration_ratio * math.sqrt(spacing)
        level_steps = math.ceil(LEVEL_STEPS / spacing)
        path = self._path(np.concatenate([np.arange(level_steps), steps]))
        self._level_path = path.positions[:, :level_steps]
        self._kinematic = KinematicForecast(
            path.positions[:, level_steps:], path.covariances[:, level_steps:]
        )

    @property
    def count(self) -> int:
        """Number of balls."""
        return len(self.found.balls)

    @property
    def origin(self) -> tuple[float, float]:
        """Origin of the frame in the square, in pixels of the frame."""
        side = self.box.side
        return (side - self.box.width) / 2, (side - self.box.height) / 2

    def kinematic(self, network: ForecastArrays, first_step: int) -> ForecastArrays:
        """Return the kinematic forecast of the steps of the network's, pixels of 128.

        Like the network's, its errors are heavy-tailed: the covariances hold 95 % of them, and the
        network's radius, smaller than a Gaussian's, half.
        """
        steps = slice(first_step, first_step + network.positions.shape[2])
        return network.having(
            positions=self._kinematic.positions[None, :, steps].astype(np.float32),
            covariances=self._kinematic.covariances[None, :, steps].astype(np.float32),
        )

    def _path(self, steps: Float[np.ndarray, " T"]) -> KinematicForecast:
        """Return the kinematic forecast at times in frames after the last one."""
        balls = self.found.balls
        places, sigmas = HALF + HALF * balls.places, HALF * np.exp(balls.log_sigmas)
        return kinematic_forecast(places, sigmas, self._acceleration_ratio, steps)

    @property
    def on_level_ground(self) -> list[bool]:
        """True for balls whose kinematic path lies on level ground, according to the model."""
        slopes = mean_slopes(self.found.said["ground"][0], self._level_path / HALF - 1)
        return (slopes < self._level_slope).tolist()

    @property
    def scores(self) -> list[float]:
        """Confidence of presence of each ball."""
        return [round(score, 4) for score in self.found.balls.scores.tolist()]

    @property
    def seen(self) -> list[list[SeenBall]]:
        """Each ball in each observed frame, pixels."""
        places = self.box.pixels(self.found.balls.places)
        radii = self.found.balls.radii * (self.box.side / 2)
        return [
            [SeenBall(x=x, y=y, radius=radius) for x, y in path]
            for path, radius in zip(places.tolist(), radii.tolist(), strict=True)
        ]

    @property
    def colors(self) -> list[BallColor]:
        """Mean colour of the middle of each ball in the last frame."""
        return [self._color(path[-1]) for path in self.seen]

    @property
    def warnings(self) -> list[list[str]]:
        """Reasons to trust the forecast of each ball less."""
        balls = self.found.balls
        spreads = np.exp(balls.log_sigmas[:, 0]) / balls.radii
        return [
            _warnings(path[-1], score, spread)
            for path, score, spread in zip(
                self.seen, balls.scores.tolist(), spreads.tolist(), strict=True
            )
        ]

    def _color(self, ball: SeenBall) -> BallColor:
        height, width = self._last.shape[:2]
        reach = max(ball.radius / 2, 0.5)
        low_x, low_y = (
            int(np.clip(at - reach, 0, n - 1)) for at, n in ((ball.x, width), (ball.y, height))
        )
        high_x, high_y = int(ball.x + reach) + 1, int(ball.y + reach) + 1
        part = self._last[low_y : max(high_y, low_y + 1), low_x : max(high_x, low_x + 1)]
        red, green, blue = part.reshape(-1, 3).mean(axis=0).round().astype(int).tolist()
        return f"#{red:02x}{green:02x}{blue:02x}"


def _points(
    prompts: Sequence[BallPrompt], box: Letterbox
) -> tuple[Float[np.ndarray, "balls 2"], Float[np.ndarray, " balls"]]:
    """Prompts as points of the square, and their radii in its halves."""
    for index, prompt in enumerate(prompts):
        if not (0 <= prompt.x <= box.width and 0 <= prompt.y <= box.height):
            expected = f"a point of the frames of {box.width} x {box.height} pixels"
            raise InvalidValueError.at(f"balls[{index}]", [prompt.x, prompt.y], expected)
        if prompt.radius is not None and not MIN_RADIUS <= prompt.radius <= box.side:
            expected = f"{MIN_RADIUS:g} to {box.side:g} pixels, the longer side of the frames"
            raise InvalidValueError.at(f"balls[{index}].radius", prompt.radius, expected)
    pixels = np.array([(prompt.x, prompt.y) for prompt in prompts], float)
    radii = np.array([np.nan if p.radius is None else p.radius for p in prompts], float)
    return box.points(pixels), radii / (box.side / 2)


def _warnings(ball: SeenBall, score: float, spread: float) -> list[str]:
    where = f"({ball.x:.1f}, {ball.y:.1f})"
    if score < SURE:
        return [
            f"Uncertain detection of a ball at {where}: the score of {score:.2f} is below {SURE}. "
            "The forecast may follow another object."
        ]
    if spread > UNCERTAIN_RADII:
        return [
            f"The position of the ball at {where} has a standard deviation of {spread:.2g} radii: "
            "the forecast may have large errors."
        ]
    return []
