"""Windows that teach a perception of any number of balls: every ball that is seen is known.

A third kind beside the paper's scenes and other appearances of them are planar scenes. Of these,
only places in the seen frames are known and that their ground is level.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from jaxtyping import Float

from rollcast.camera import BOWL_HALF_WIDTH_M, NETWORK_FRAME_SIZE, Camera, camera_for
from rollcast.simulation.appearance import CameraPose, Clutter, draw_camera, draw_sensor
from rollcast.trajectory import FIRST_FORECAST_FRAME, OBSERVED_FRAMES, Trajectory
from training.data.ball_batch import MOST_BALLS, BallBatch, BallWindow, collate
from training.data.frame_spacing import draw_spacing, earliest_start, seen_states
from training.data.painting.camera import (
    Border,
    posed_frames,
    posed_ground,
    posed_points,
    shaken,
)
from training.data.painting.clutter import clutter_mask
from training.data.painting.planar import draw_planar_scene, paint_planar_scene
from training.data.painting.restyled import draw_restyling, render_restyled, visible_pose
from training.data.painting.sensor import through_sensor
from training.data.rest_height_map import MAP_CELLS
from training.data.scene_cache import SceneCache
from training.data.seeded_stream import SeededStream
from training.data.shards import Recording
from training.data.windows import MAX_HORIZON, SceneTargets, Window, WindowMaker
from training.networks.perception import scene_constants_of

HALF = NETWORK_FRAME_SIZE / 2
STEPS = FIRST_FORECAST_FRAME + MAX_HORIZON
REMEMBERED = 2000
"""Number of windows in memory for repetition, 200 kB each."""
LEAST_WAY_PX = 0.3
"""Minimum displacement of a moving ball over the observed frames."""

POSE_STRENGTH = 1.5
"""Factor of the share of filmed windows whose camera is not the paper's (0.9 of them)."""
MIRRORED_SHARE, REPLICATED_SHARE = 0.5, 0.4
"""Share of heightfields that go on beyond their frame; of all other borders that are replicated,
as programs that scale a picture do."""

VALIDATION_SEED = 2**31
"""Seed of validation windows; training seeds are small."""

Kind = Literal["paper", "filmed", "restyled", "planar"]
KINDS: tuple[Kind, ...] = ("paper", "filmed", "restyled", "planar")


@dataclass(frozen=True)
class BallAppearanceMixture:
    """Shares of the kinds of training windows.

    Attributes
    ----------
    paper, filmed, restyled, planar
        Windows of the paper's scenes as they are, from another camera, in other appearances,
        and of planar scenes.
    """

    paper: float = 0.2
    filmed: float = 0.2
    restyled: float = 0.25
    planar: float = 0.35
    other_rates: float = 0.0
    """Share of the simulated windows whose frames have another spacing than the simulation's."""


class BallWindowMaker:
    """Maker of windows of stored simulations with the true states of every ball.

    Parameters
    ----------
    recordings, scene_cache
        Scenes of one source.
    """

    def __init__(self, recordings: Sequence[Recording], scene_cache: SceneCache | None) -> None:
        self.scenes = len(recordings)
        self._maker = WindowMaker(
            recordings, None, scene_cache, scene_targets=scene_cache is not None
        )

    def window(
        self, generator: np.random.Generator, kind: Kind, latest_start: int, spacing: float = 1.0
    ) -> BallWindow:
        """Draw a window of a random scene; ``spacing`` as in :func:`seen_states`."""
        index = int(generator.integers(self.scenes))
        start = int(generator.integers(latest_start + 1))
        start = max(start, earliest_start(spacing))
        if kind == "restyled":
            return self._restyled(generator, index, start, spacing)
        window = self.at(index, start, spacing=spacing)
        return self._filmed(generator, index, window) if kind == "filmed" else window

    def truth(self, generator: np.random.Generator, latest_start: int) -> BallWindow:
        """Draw a window of a random scene in a random symmetry, without frames."""
        index = int(generator.integers(self.scenes))
        window = self.at(index, int(generator.integers(latest_start + 1)), seen=False)
        return turned(window, int(generator.integers(4)), mirror=bool(generator.integers(2)))

    def at(self, index: int, start: int, *, seen: bool = True, spacing: float = 1.0) -> BallWindow:
        """Window of a scene as the paper shows it; ``start`` as in :func:`seen_states`."""
        as_simulated = spacing == 1
        window = self._maker.window(index, start, MAX_HORIZON, seen=seen and as_simulated)
        recording = self._maker.recording(index)
        scene = recording.scene
        camera = camera_for(scene.scenario, NETWORK_FRAME_SIZE)
        known = _known(window, scene.radius_m / camera.half_width_m, np.zeros((OBSERVED_FRAMES, 2)))
        if as_simulated:
            return known
        states = seen_states(recording.trajectory, start, spacing)
        if seen:
            known = known._replace(frames=self._maker.renderer(index).render(states))
        return _seen_at(known, states, camera, spacing)

    def _filmed(self, generator: np.random.Generator, index: int, window: BallWindow) -> BallWindow:
        """Show a window from another place, through another sensor."""
        scene = self._maker.recording(index).scene
        border = _draw_border(generator, is_bowl=scene.axis_ratio is not None)
        path = HALF + HALF * window.places.reshape(-1, 2)
        camera = draw_camera(generator, POSE_STRENGTH)
        pose = visible_pose(camera, path, bounded=border != "mirrored")
        if pose != CameraPose():
            beyond = window.frames[-1, 0, 0]
            frames = posed_frames(window.frames, pose, beyond, border)
            window = self._posed(index, window._replace(frames=frames), pose)
        return filmed(generator, window)

    def _posed(self, index: int, window: BallWindow, pose: CameraPose) -> BallWindow:
        """Transform the truth of a scene's window as a camera sees it."""
        scene = self._maker.recording(index).scene
        known = posed(window, pose, scene.radius_m)
        if scene.scenario == "heightfield":
            # Its walls are no longer where the frame ends.
            known.centres[:, OBSERVED_FRAMES:] = np.nan
        return known

    def _restyled(
        self, generator: np.random.Generator, index: int, start: int, spacing: float
    ) -> BallWindow:
        recording = self._maker.recording(index)
        scene = recording.scene
        camera = camera_for(scene.scenario, NETWORK_FRAME_SIZE)
        seen = seen_states(recording.trajectory, start, spacing)
        path = camera.project(seen.positions_m).swapaxes(0, 1).reshape(-1, 2)
        style = draw_restyling(generator, scene, path)
        shown = render_restyled(self._maker.renderer(index), scene, seen, style)
        window = self._maker.window(index, start, MAX_HORIZON, seen=False)
        still = np.zeros((OBSERVED_FRAMES, 2))
        known = _known(window, scene.radius_m / camera.half_width_m, still)
        if spacing != 1:
            known = _seen_at(known, seen, camera, spacing)
        if shown.pose != CameraPose():
            known = self._posed(index, known, shown.pose)
        known = known._replace(frames=shown.frames, places=known.places + shown.shake / HALF)
        over = _over(style.appearance.clutter)
        room = MOST_BALLS - len(known.radii)
        for _, at, size in style.resting[:room]:
            place = (posed_points(np.array(at), shown.pose) - HALF) / HALF
            visible = [_visible(over, frame, at, size) for frame in range(OBSERVED_FRAMES)]
            known = _with_resting(
                known, place, size / HALF * shown.pose.scale, np.array(visible), shown.shake
            )
        return known


def posed(window: BallWindow, pose: CameraPose, radius_m: float) -> BallWindow:
    """Transform a window's truth to a camera pose; unknown values become NaN."""

    def moved(points: np.ndarray) -> np.ndarray:
        return (posed_points(HALF + HALF * points, pose) - HALF) / HALF

    cos, sin = math.cos(pose.rotation_rad), math.sin(pose.rotation_rad)
    x, y, z = np.moveaxis(window.spins, -1, 0)
    # World y is image -y: angular velocities turn with the picture.
    spins = np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-1)
    heights = pose.scale * window.centres[..., 2:]
    scale = window.scene[0] / 5 + BOWL_HALF_WIDTH_M
    scene = scene_constants_of(scale / pose.scale, radius_m)
    if not pose.is_similarity:
        unknown = np.nan
        spins, heights, scene = spins * unknown, heights * unknown, scene * unknown
    return window._replace(
        places=moved(window.places),
        radii=window.radii * pose.scale,
        centres=np.concatenate([moved(window.centres[..., :2]), heights], axis=-1),
        spins=spins,
        ground=posed_ground(window.ground, pose),
        scene=scene,
    )


def _draw_border(generator: np.random.Generator, *, is_bowl: bool) -> Border:
    """Draw what lies beyond the paper's frame: nothing goes on there but heightfields, mirrored."""
    if not is_bowl and generator.random() < MIRRORED_SHARE:
        return "mirrored"
    return "replicated" if generator.random() < REPLICATED_SHARE else "plain"


def filmed(generator: np.random.Generator, window: BallWindow) -> BallWindow:
    """Return a window as another sensor shows it, shaken."""
    sensor = draw_sensor(generator)
    shake = np.asarray(sensor.shake)
    frames = through_sensor(shaken(window.frames, shake), sensor)
    return window._replace(frames=frames, places=window.places + shake / HALF)


def planar_window(generator: np.random.Generator) -> BallWindow:
    """Draw and paint a planar scene of one to eight balls."""
    scene = draw_planar_scene(generator, prompted=True)
    painted = paint_planar_scene(scene)
    paths = np.array([ball.path for ball in scene.balls])
    radii = np.array([ball.radius for ball in scene.balls])
    over = _over(scene.appearance.clutter)
    centres = np.full((len(paths), STEPS, 3), np.nan)
    centres[:, :OBSERVED_FRAMES, :2] = paths / HALF - 1
    ground = np.zeros((3, MAP_CELLS, MAP_CELLS))
    ground[2] = np.nan
    visible = [
        [_visible(over, frame, at, radius) for frame, at in enumerate(path)]
        for path, radius in zip(paths.tolist(), radii.tolist(), strict=True)
    ]
    return BallWindow(
        painted.frames,
        (paths + painted.shake) / HALF - 1,
        radii / HALF,
        np.array(visible),
        _moving(paths),
        centres,
        np.full((len(paths), MAX_HORIZON, 3), np.nan),
        ground,
        np.full(2, np.nan),
    )


def _known(window: Window, radius: float, shake: Float[np.ndarray, "seen 2"]) -> BallWindow:
    assert isinstance(window.scene_targets, SceneTargets)
    centres, ground, scene = window.scene_targets
    places = centres[:, :OBSERVED_FRAMES, :2]
    return BallWindow(
        window.frames,
        places + shake / HALF,
        np.full(len(centres), radius),
        (np.abs(places) <= 1).all(axis=-1).astype(float),
        _moving(HALF * places),
        np.array(centres),
        window.angular_velocities,
        np.asarray(ground, np.float32),
        scene,
    )


def _seen_at(window: BallWindow, states: Trajectory, camera: Camera, spacing: float) -> BallWindow:
    """Return a window whose seen frames show other states; ``centres`` stay the simulation's."""
    places = camera.project(states.positions_m).swapaxes(0, 1) / HALF - 1
    return window._replace(
        places=places,
        visible=(np.abs(places) <= 1).all(axis=-1).astype(float),
        moving=_moving(HALF * places),
        spacing=spacing,
    )


def _moving(paths_px: Float[np.ndarray, "balls seen 2"]) -> Float[np.ndarray, " balls"]:
    ways = np.linalg.norm(paths_px - paths_px[:, -1:], axis=-1).max(axis=1)
    return (ways > LEAST_WAY_PX).astype(float)


def _with_resting(
    window: BallWindow,
    place: Float[np.ndarray, "2"],
    radius: float,
    visible: Float[np.ndarray, " seen"],
    shake: Float[np.ndarray, "seen 2"],
) -> BallWindow:
    """Add a ball at rest, of which no future is known: nothing was there in the simulation."""
    if np.abs(place).max() > 1:
        return window
    centres = np.full((1, STEPS, 3), np.nan)
    centres[:, :OBSERVED_FRAMES, :2] = place
    unknown = np.full((1, MAX_HORIZON, 3), np.nan)
    return window._replace(
        places=np.concatenate([window.places, (place + shake / HALF)[None]]),
        radii=np.append(window.radii, radius),
        visible=np.concatenate([window.visible, visible[None]]),
        moving=np.append(window.moving, 0.0),
        centres=np.concatenate([window.centres, centres]),
        spins=np.concatenate([window.spins, unknown]),
    )


def _over(clutter: Sequence[Clutter]) -> list[Clutter]:
    """Things that are painted over the balls and hide them."""
    return [thing for thing in clutter if thing.kind in ("hand", "cue")]


def _visible(over: Sequence[Clutter], frame: int, at: Sequence[float], radius: float) -> float:
    """Share of a ball that nothing hides in a frame, and that lies within it."""
    x, y = at
    along = np.arange(NETWORK_FRAME_SIZE) + 0.5
    disc = np.hypot(along[None, :] - x, along[:, None] - y) <= max(radius, 0.8)
    whole = max(math.pi * radius**2, 1.0)
    shown = disc.astype(np.float32)
    for thing in over:
        shown = shown * (1 - clutter_mask(thing, frame))
    return min(float(shown.sum()) / whole, 1.0)


def turned(window: BallWindow, quarter_turns: int, *, mirror: bool) -> BallWindow:
    """Transform a window by one of the square's symmetries (:class:`Symmetry`)."""
    frames = np.rot90(window.frames, quarter_turns, axes=(1, 2))
    ground = np.rot90(window.ground, quarter_turns, axes=(1, 2))
    places, centres, spins = window.places, window.centres, window.spins
    for _ in range(quarter_turns):
        places = np.stack([places[..., 1], -places[..., 0]], axis=-1)
        centres = np.stack([centres[..., 1], -centres[..., 0], centres[..., 2]], axis=-1)
        spins = np.stack([-spins[..., 1], spins[..., 0], spins[..., 2]], axis=-1)
        ground = np.stack([ground[1], -ground[0], ground[2]])
    if mirror:
        frames, ground = (
            frames[:, :, ::-1],
            ground[:, :, ::-1] * np.array([-1, 1, 1])[:, None, None],
        )
        places, centres = places * np.array([-1, 1]), centres * np.array([-1, 1, 1])
        spins = spins * np.array([1, -1, -1])
    return window._replace(
        frames=frames, ground=ground, places=places, centres=centres, spins=spins
    )


@dataclass(frozen=True)
class BallSource:
    """A source of simulated scenes with its share among them."""

    maker: BallWindowMaker
    share: float
    latest_start: int


class BallStream(SeededStream[BallBatch]):
    """Endless batches of windows for networks that follow any number of balls.

    Parameters
    ----------
    sources
        Simulated scenes; those with several balls are restyled alike.
    repeats
        Number of times that a window occurs, in different symmetries, within consecutive batches:
        painting a window takes a fifth of the time of a training step on it.
    """

    def __init__(
        self,
        sources: Sequence[BallSource],
        mixture: BallAppearanceMixture,
        batch_size: int,
        seed: int,
        first_batch: int,
        repeats: int = 1,
    ) -> None:
        super().__init__(seed, first_batch)
        self._sources = sources
        self._mixture = mixture
        self._batch_size = batch_size
        self._fresh = max(batch_size // repeats, 1)
        self._drawn = lru_cache(REMEMBERED if repeats > 1 else 1)(self._draw)

    def _batch(self, generator: np.random.Generator, number: int) -> BallBatch:
        return collate([self._turned(index, generator) for index in self._chosen(number)])

    def _chosen(self, number: int) -> list[int]:
        """Return the numbers of the windows of a batch: new ones and repeated ones."""
        first = number * self._fresh
        fresh = range(first, first + self._fresh)
        generator = np.random.default_rng([self._seed, number, 1])
        earliest = max(first - REMEMBERED // 2, 0)
        again = generator.integers(earliest, fresh.stop, self._batch_size - self._fresh)
        return [*fresh, *again.tolist()]

    def _turned(self, index: int, generator: np.random.Generator) -> BallWindow:
        turns, mirror = int(generator.integers(4)), bool(generator.integers(2))
        return turned(self._drawn(index), turns, mirror=mirror)

    def _draw(self, index: int) -> BallWindow:
        return self.draw(np.random.default_rng([self._seed, index, 2]))

    def draw(self, generator: np.random.Generator) -> BallWindow:
        """Draw a window."""
        mixture = self._mixture
        shares = np.array([mixture.paper, mixture.filmed, mixture.restyled, mixture.planar])
        kind = KINDS[generator.choice(len(KINDS), p=shares / shares.sum())]
        if kind == "planar":
            return planar_window(generator)
        shares = np.array([source.share for source in self._sources])
        source = self._sources[generator.choice(len(shares), p=shares / shares.sum())]
        others = mixture.other_rates > 0 and generator.random() < mixture.other_rates
        spacing = draw_spacing(generator) if others else 1.0
        return source.maker.window(generator, kind, source.latest_start, spacing)


def validation_windows(sources: Sequence[BallSource], count: int) -> list[BallWindow]:
    """Draw windows to validate with: the mixture of training, of scenes that it does not see.

    Parameters
    ----------
    sources
        Scenes of the validation split.
    """
    stream = BallStream(sources, BallAppearanceMixture(), count, VALIDATION_SEED, 0)
    return [stream.draw(np.random.default_rng([VALIDATION_SEED, index])) for index in range(count)]
