"""Videos of discs that roll, bounce and collide over a patterned table, with the truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from rollcast.video_writer import write_video

WIDTH, HEIGHT = 240, 180
RADIUS_PX = 9.0
FRAME_RATE = 30.0
COLORS = ((220, 60, 50), (230, 200, 90), (30, 130, 60), (30, 60, 120))
"""Red, yellow, green, blue: the order of their hues."""
BALLS = len(COLORS)


@dataclass(frozen=True)
class Billiards:
    """Where discs are, frame by frame, [frames, balls, 2] in pixels, and what they look like."""

    positions_px: np.ndarray
    colors: Sequence[tuple[int, int, int]]

    def picture(self, index: int, *, light: float = 1.0, bar: bool = False) -> Image.Image:
        """Draw a frame; each disc is two-toned and turns, and throws a shadow."""
        y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
        pattern = 8 * np.sin(x / 7) * np.cos(y / 11)
        picture = np.array([200.0, 205.0, 200.0]) + pattern[..., None]
        for ball, (u, v) in enumerate(self.positions_px[index]):
            shade = np.clip(RADIUS_PX + 1 - np.hypot(x - u - 2, y - v - 2), 0, 1)[..., None]
            picture = picture * (1 - 0.25 * shade)
            turn = 0.15 * index + ball
            half = (np.cos(turn) * (x - u) + np.sin(turn) * (y - v) > 0)[..., None]
            color = np.array(self.colors[ball], float)
            disc = np.clip(RADIUS_PX + 0.5 - np.hypot(x - u, y - v), 0, 1)[..., None]
            picture = picture * (1 - disc) + disc * np.where(half, color, 0.75 * color)
        if bar:
            picture[:, 110:140] = (90, 90, 95)
        return Image.fromarray((light * picture).clip(0, 255).round().astype(np.uint8))

    def record(self, path: Path, *, flicker: float = 0.0, bar: bool = False) -> Path:
        """Write all frames as a video."""
        frames = range(len(self.positions_px))
        pictures = (
            self.picture(index, light=1 - flicker * (index % 3), bar=bar) for index in frames
        )
        write_video(path, pictures, FRAME_RATE)
        return path


def billiards(
    balls: int, frames: int, seed: int, colors: Sequence[tuple[int, int, int]] = COLORS
) -> Billiards:
    """Let equal discs bounce off the table's sides and off each other, without friction."""
    generator = np.random.default_rng(seed)
    low, high = np.array([RADIUS_PX] * 2), np.array([WIDTH, HEIGHT]) - RADIUS_PX
    grid = np.array([(u, v) for u in (45, 120, 195) for v in (45, 135)], float)
    positions = generator.permutation(grid)[:balls] + generator.uniform(-8, 8, (balls, 2))
    angles = generator.uniform(0, 2 * np.pi, balls)
    velocities = 3.5 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    way = [positions.copy()]
    for _ in range(frames - 1):
        positions = positions + velocities
        beyond = (positions < low) | (positions > high)
        velocities = np.where(beyond, -velocities, velocities)
        positions = np.where(positions < low, 2 * low - positions, positions)
        positions = np.where(positions > high, 2 * high - positions, positions)
        for one in range(balls):
            for other in range(one):
                apart = positions[one] - positions[other]
                distance = np.linalg.norm(apart)
                normal = apart / distance
                closing = (velocities[one] - velocities[other]) @ normal
                if distance < 2 * RADIUS_PX and closing < 0:
                    velocities[one] -= closing * normal
                    velocities[other] += closing * normal
        way.append(positions.copy())
    return Billiards(np.stack(way), colors[:balls])
