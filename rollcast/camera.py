"""The overhead camera: the only home of the world-to-image convention.

World: metres, right-handed, z towards the camera. Image: continuous pixel coordinates, x to the
right, y down, (0, 0) the top-left corner of the top-left pixel. World +y is image -y. The camera
is orthographic and looks along -z (paper, section 3.1).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

BOWL_HALF_WIDTH_M = 1.05
HEIGHTFIELD_HALF_WIDTH_M = 1.25
TABLE_HALF_WIDTH_M = 1.25
NETWORK_FRAME_SIZE = 128
"""Side in pixels of the frames that the networks see, and the unit of every published error."""


@dataclass(frozen=True)
class Camera:
    """An orthographic camera over the origin that sees a square of the world.

    Parameters
    ----------
    half_width_m
        Half the side of the visible square, in metres.
    image_size
        Side of the square image, in pixels.
    """

    half_width_m: float
    image_size: int

    @property
    def pixels_per_metre(self) -> float:
        """Scale of the image."""
        return self.image_size / (2 * self.half_width_m)

    def project(self, points_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Image position, in pixels, of points of the world, in metres."""
        x = points_m[..., 0] + self.half_width_m
        y = self.half_width_m - points_m[..., 1]
        return np.stack([x, y], axis=-1) * self.pixels_per_metre

    def unproject(
        self, positions_px: Float[np.ndarray, "*batch 2"]
    ) -> Float[np.ndarray, "*batch 2"]:
        """World x and y, in metres, of image positions, in pixels (z is lost in projection)."""
        plane = positions_px / self.pixels_per_metre
        return np.stack(
            [plane[..., 0] - self.half_width_m, self.half_width_m - plane[..., 1]], axis=-1
        )

    def pixel_centres_m(self, rows: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """World x and y of the pixel centres of some rows, two arrays [rows, image_size]."""
        centres = np.arange(self.image_size) + 0.5
        across, down = np.meshgrid(centres, centres[rows])
        plane = self.unproject(np.stack([across, down], axis=-1))
        return plane[..., 0], plane[..., 1]


def camera_for(scenario: str, image_size: int) -> Camera:
    """Return the camera of a scenario: the paper's, and one of the same kind over tables."""
    half_widths_m = {"heightfield": HEIGHTFIELD_HALF_WIDTH_M, "table": TABLE_HALF_WIDTH_M}
    return Camera(half_widths_m.get(scenario, BOWL_HALF_WIDTH_M), image_size)
