"""Where a ball's centre rests over every point of the frame, and how the ground leans there.

The map that the explicit-state network learns to draw (``training/networks/perception.py``) and
its truth, which is computed from a scene's exact surface.
"""

import numpy as np
from jaxtyping import Float

from rollcast.camera import NETWORK_FRAME_SIZE, Camera, camera_for
from rollcast.scene import Scene
from rollcast.surfaces import surface_of

MAP_CELLS = 32
"""Cells a side of the map."""

_POINTS_A_CELL = 5
_NOWHERE = -10.0
"""Height in metres where there is no surface: far below every ball."""


def resting_ground(scene: Scene) -> Float[np.ndarray, "3 cells cells"]:
    """Map the surface as the scene's balls feel it.

    A ball's centre rests on the upper envelope of spheres of its radius around the surface's
    points: z(x, y) = max over |u| <= r of h(x + u_x, y + u_y) + sqrt(r^2 - |u|^2).

    Returns
    -------
    Image x and y of the unit normal of the centre's surface, and its height less the radius in
    halves of the frame, at the centres of the cells, rows from top to bottom. Cells that no ball
    can rest over are NaN.
    """
    camera = camera_for(scene.scenario, NETWORK_FRAME_SIZE)
    step = 2 * camera.half_width_m / (MAP_CELLS * _POINTS_A_CELL)
    reach = int(scene.radius_m / step) + 1
    heights = _heights(scene, camera, step, reach)
    # World y falls down the rows, so the second gradient is that of image y with its sign turned.
    down, right = np.gradient(heights, step)
    normal_z = 1 / np.sqrt(1 + right**2 + down**2)
    middle = slice(_POINTS_A_CELL // 2, None, _POINTS_A_CELL)
    ground = np.stack([-right * normal_z, -down * normal_z, heights / camera.half_width_m])
    ground = ground[:, middle, middle]
    return np.where(ground[2] > _NOWHERE / 2, ground, np.nan).astype(np.float32)


def _heights(scene: Scene, camera: Camera, step: float, reach: int) -> np.ndarray:
    """Height of a resting ball's centre less its radius, metres, on a fine grid of the frame."""
    points = round(2 * camera.half_width_m / step)
    along = (np.arange(-reach, points + reach) + 0.5) * step - camera.half_width_m
    x, y = np.meshgrid(along, -along)
    surface = surface_of(scene).height_and_normal(x, y)[0]
    surface = np.where(np.isnan(surface), _NOWHERE, surface).astype(np.float32)
    envelope = np.full((points, points), -np.inf, dtype=np.float32)
    raised = np.empty_like(envelope)
    for row in range(-reach, reach + 1):
        for column in range(-reach, reach + 1):
            left = scene.radius_m**2 - (row**2 + column**2) * step**2
            if left < 0:
                continue
            rows = slice(reach + row, reach + row + points)
            columns = slice(reach + column, reach + column + points)
            np.add(surface[rows, columns], np.float32(np.sqrt(left)), out=raised)
            np.maximum(envelope, raised, out=envelope)
    return envelope - scene.radius_m
