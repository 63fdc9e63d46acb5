"""Effects of camera sensor and compression on the frames of a window, 8-bit RGB."""

import functools
import math

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from rollcast.simulation.appearance import Sensor
from training.data.painting.ground import SIZE

Frames = UInt8[np.ndarray, "frames size size 3"]

_LEVELS = np.arange(256, dtype=np.float32) / 255
_NOISE_SIDE = 512


def through_sensor(frames: Frames, sensor: Sensor) -> Frames:
    """Return the frames as a sensor and its file show them; shake and shutter belong to others."""
    generator = np.random.default_rng(sensor.seed)
    made = [
        _developed(frame, sensor, flicker, generator)
        for frame, flicker in zip(frames, _flicker(sensor, len(frames)), strict=True)
    ]
    match sensor.codec:
        case "jpeg":
            made = [_jpeg(frame, sensor.quality) for frame in made]
        case "video":
            made = _video(made, sensor.quality)
        case _:
            pass
    return np.stack(made)


def _flicker(sensor: Sensor, frames: int) -> tuple[float, ...]:
    return (*sensor.flicker, *(1.0,) * frames)[:frames]


def _developed(
    frame: np.ndarray, sensor: Sensor, flicker: float, generator: np.random.Generator
) -> np.ndarray:
    if sensor.vignette or sensor.reflection:
        frame = _shaded(frame, sensor)
    if sensor.blur:
        frame = cv2.GaussianBlur(frame, (0, 0), sensor.blur)
    if sensor.sharpening:
        soft = cv2.GaussianBlur(frame, (0, 0), 1.0)
        frame = cv2.addWeighted(frame, 1 + sensor.sharpening, soft, -sensor.sharpening, 0)
    if sensor.saturation != 1 or sensor.hue_rad:
        frame = cv2.transform(frame, _color_matrix(sensor.saturation, sensor.hue_rad))
    frame = _tones(frame, sensor, flicker)
    if sensor.noise:
        frame = _noisy(frame, sensor, generator)
    return frame


def _shaded(frame: np.ndarray, sensor: Sensor) -> np.ndarray:
    along = np.arange(SIZE, dtype=np.float32) + 0.5
    light = np.ones((SIZE, SIZE), np.float32)
    if sensor.vignette:
        middle = (along - SIZE / 2) / (SIZE / 2)
        light -= sensor.vignette / 2 * (middle[None, :] ** 2 + middle[:, None] ** 2)
    shaded = frame * light[..., None]
    if sensor.reflection:
        x, y = sensor.reflection_at
        squared = (along[None, :] - x) ** 2 + (along[:, None] - y) ** 2
        shaded += 255 * sensor.reflection * np.exp(-squared / (2 * 14.0**2))[..., None]
    return np.clip(shaded, 0, 255).astype(np.uint8)


def _color_matrix(saturation: float, hue_rad: float) -> Float[np.ndarray, "3 3"]:
    """Scale colours away from grey and turn them about the grey axis."""
    grey = np.full((3, 3), 1 / 3)
    cos, sin = math.cos(hue_rad), math.sin(hue_rad) / math.sqrt(3)
    cross = np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]])
    turned = cos * (np.eye(3) - grey) + sin * cross
    return grey + saturation * turned


def _tones(frame: np.ndarray, sensor: Sensor, flicker: float) -> np.ndarray:
    plain = sensor.gamma == 1 and sensor.contrast == 1 and sensor.offset == 0
    gains = flicker * np.asarray(sensor.gains)
    if plain and np.all(gains == 1):
        return frame
    table = np.clip(_LEVELS[:, None] * gains, 0, 1) ** sensor.gamma
    table = (table - 0.5) * sensor.contrast + 0.5 + sensor.offset
    table = np.clip(np.round(255 * table), 0, 255).astype(np.uint8)
    return cv2.LUT(frame, table[:, None])


@functools.cache
def _noise_bank() -> Float[np.ndarray, "side side 3"]:
    """Return unit noise to cut pieces from: drawing it anew would cost more than all else."""
    shape = (_NOISE_SIDE, _NOISE_SIDE, 3)
    return np.random.default_rng(0).standard_normal(shape, dtype=np.float32)


def _noisy(frame: np.ndarray, sensor: Sensor, generator: np.random.Generator) -> np.ndarray:
    size = SIZE // sensor.noise_cell
    row, column = generator.integers(_NOISE_SIDE - size, size=2)
    noise = _noise_bank()[row : row + size, column : column + size]
    if sensor.noise_cell > 1:
        noise = cv2.resize(noise, (SIZE, SIZE), interpolation=cv2.INTER_LINEAR)
    return np.clip(frame + sensor.noise * noise, 0, 255).astype(np.uint8)


def _jpeg(frame: np.ndarray, quality: int) -> np.ndarray:
    _, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert decoded is not None
    return decoded


def _video(frames: list[np.ndarray], quality: int) -> list[np.ndarray]:
    """Like H.264: blocks that hardly change are repeated, changes are coded coarsely."""
    shown = [_jpeg(frames[0], min(quality + 20, 95))]
    threshold = 2 + (100 - quality) / 12
    for frame in frames[1:]:
        change = frame.astype(np.int16) - shown[-1]
        coded = _jpeg(np.clip(change // 2 + 128, 0, 255).astype(np.uint8), quality)
        blocks = np.abs(change).reshape(SIZE // 8, 8, SIZE // 8, 8, 3).mean(axis=(1, 3, 4))
        changed = (blocks > threshold).repeat(8, axis=0).repeat(8, axis=1)[..., None]
        decoded = shown[-1] + 2 * (coded.astype(np.int16) - 128) * changed
        shown.append(np.clip(decoded, 0, 255).astype(np.uint8))
    return shown
