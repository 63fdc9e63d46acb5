"""Still pictures of balls that are put where they are wanted, and what can be read from them."""

import numpy as np

from rollcast.camera import camera_for
from rollcast.scene import Scene
from rollcast.simulation.rendering import Renderer
from rollcast.trajectory import Trajectory

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def still(positions: np.ndarray, orientations: np.ndarray | None = None) -> Trajectory:
    """One frame of balls at rest."""
    places = np.asarray(positions, dtype=float)
    turned = np.tile(UPRIGHT, (len(places), 1)) if orientations is None else orientations
    return Trajectory(places[None], np.asarray(turned)[None], np.zeros_like(places)[None])


def picture(
    scene: Scene, positions: np.ndarray, size: int = 128, orientations: np.ndarray | None = None
) -> np.ndarray:
    """Draw one frame."""
    renderer = Renderer(scene, camera_for(scene.scenario, size))
    return renderer.render(still(positions, orientations))[0]


def empty(scene: Scene, size: int = 128) -> np.ndarray:
    """Draw the scene without its balls."""
    return picture(scene, np.empty((0, 3)), size, np.empty((0, 4)))


def centre_of(mask: np.ndarray) -> np.ndarray:
    """Centre of mass (x, y) of a mask, in pixels from the image's corner."""
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean() + 0.5, rows.mean() + 0.5])


def owners(scene: Scene, positions: np.ndarray, size: int = 128) -> np.ndarray:
    """Index of the ball that every pixel shows, of three balls; -1 for the ground.

    The balls are drawn twice, the second time each in the next one's colour: where a ball is, its
    own colour goes away.
    """
    places = np.asarray(positions, dtype=float)
    renderer = Renderer(scene, camera_for(scene.scenario, size))
    (own,) = renderer.render(still(places)).astype(int)
    (next_one,) = renderer.render(still(np.roll(places, 1, axis=0))).astype(int)
    lost = own - next_one
    return np.where(lost.max(axis=-1) > 6, lost.argmax(axis=-1), -1)
