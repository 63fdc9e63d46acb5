"""A detector and a refiner that are computed by hand: the brightest cells are balls."""

import numpy as np

CELLS = 32
RADIUS = 4 / 64


def detect(frames: np.ndarray) -> dict[str, np.ndarray]:
    """Every cell votes for its own place and is as sure as it is bright."""
    said = [_detect(each) for each in frames]
    return {name: np.stack([one[name] for one in said]) for name in said[0]}


def _detect(frames: np.ndarray) -> dict[str, np.ndarray]:
    cells = frames[-1, ..., 0].reshape(CELLS, 4, CELLS, 4).mean(axis=(1, 3)) / 255
    along = (np.arange(CELLS) + 0.5) * (2 / CELLS) - 1
    x, y = np.meshgrid(along, along)
    order = np.argsort(-cells, axis=None)[:16]
    places = np.stack([np.stack([x, y], axis=-1).reshape(-1, 2)[order]] * 4, axis=1)
    votes = np.stack([x, y] * 4 + [np.full_like(x, np.log(RADIUS)), cells, np.ones_like(x)])
    return {
        "places": places,
        "radii": np.full(16, RADIUS),
        "scores": cells.reshape(-1)[order],
        "moving": np.ones(16),
        "votes": votes,
        "ground": np.zeros((3, CELLS, CELLS)),
        "scene": np.zeros(2),
    }


def refine(patches: np.ndarray) -> dict[str, np.ndarray]:
    """Return the centre of brightness of every patch."""
    bright = np.clip(patches[:, :, 0] + 1, 0, None) + 1e-9
    along = (np.arange(32) + 0.5) / 16 - 1
    x, y = np.meshgrid(along, along)
    total = bright.sum(axis=(2, 3))
    offsets = np.stack([(bright * x).sum(axis=(2, 3)), (bright * y).sum(axis=(2, 3))], axis=-1)
    count = len(patches)
    return {
        "offsets": offsets / total[..., None],
        "log_radius": np.full(count, np.log(0.5)),
        "visible": np.where(total > 1, 8.0, -8.0),
        "log_sigmas": np.zeros((count, 2)),
        "features": np.zeros((count, 128)),
    }
