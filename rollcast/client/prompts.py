"""Points that say which balls are meant, as a user has them."""

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from pydantic import ValidationError

from rollcast.errors import InvalidArgumentError
from rollcast.footage import PictureCrop
from rollcast.schemas import BallPrompt

BallPoint: TypeAlias = BallPrompt | Sequence[float] | np.ndarray
"""A point of the last observed frame in pixels: (x, y), (x, y, radius) or a ``BallPrompt``."""
BallPoints: TypeAlias = Sequence[BallPoint] | np.ndarray
"""Points of several balls in order, or an array [balls, 2] or [balls, 3]; a radius that is NaN is
unknown."""
EXPECTED = "expected (x, y), (x, y, radius) or a BallPrompt, in pixels"


def prompts_of(balls: BallPoints) -> list[BallPrompt]:
    """Return points as prompts.

    Raises
    ------
    InvalidArgumentError
        When one is no point, or all of them are one.
    """
    if isinstance(balls, BallPrompt | str | bytes):
        raise InvalidArgumentError(f"balls is {balls!r}, expected a list such as [(x, y)]")
    try:
        points = list(balls)
    except TypeError as error:
        expected = "expected a list such as [(x, y)]"
        raise InvalidArgumentError(f"balls is {balls!r}, {expected}") from error
    if points and all(isinstance(point, int | float | np.number) for point in points):
        raise InvalidArgumentError(f"balls is the one point {points}, expected a list: [(x, y)]")
    return [_prompt(f"balls[{index}]", point) for index, point in enumerate(points)]


def moved(prompts: Sequence[BallPrompt], crop: PictureCrop) -> list[BallPrompt]:
    """Return prompts of whole pictures as prompts of a crop of them."""
    return [
        prompt.model_copy(update={"x": prompt.x - crop.x, "y": prompt.y - crop.y})
        for prompt in prompts
    ]


def _prompt(name: str, point: BallPoint) -> BallPrompt:
    if isinstance(point, BallPrompt):
        return point
    try:
        numbers = np.asarray(point, float)
        if numbers.shape not in ((2,), (3,)):
            raise InvalidArgumentError(f"{name} is {point!r}, {EXPECTED}")
        x, y, radius = (*map(float, numbers), math.nan)[:3]
        return BallPrompt(x=x, y=y, radius=None if math.isnan(radius) else radius)
    except (TypeError, ValueError) as error:  # ValidationError is a ValueError
        reason = error.errors()[0]["msg"] if isinstance(error, ValidationError) else EXPECTED
        raise InvalidArgumentError(f"{name} is {point!r}: {reason}") from error
