"""Lists of an answer as arrays whose shapes have been checked."""

from collections.abc import Sequence

import numpy as np


def checked(name: str, values: object, shape: tuple[int, ...]) -> np.ndarray:
    """Return numbers as an array.

    Raises
    ------
    ValueError
        When they do not have this shape.
    """
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} has gaps or rows of different lengths") from error
    require(array.shape == shape, f"{name} has the shape {array.shape}, expected {shape}")
    return array


def checked_times(name: str, values: Sequence[float]) -> np.ndarray:
    """Return times, which must ascend."""
    times_s = checked(name, values, (len(values),))
    require(bool((np.diff(times_s) > 0).all()), f"{name} does not ascend")
    return times_s


def require(condition: bool, message: str) -> None:
    """Raise ValueError unless a condition of a consistent answer holds."""
    if not condition:
        raise ValueError(message)
