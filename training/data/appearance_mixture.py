"""Appearances of training windows: the paper's, others of its scenes, planar scenes."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.scene import Scene
from rollcast.simulation.appearance import CameraPose
from rollcast.simulation.recording import TEST_START
from rollcast.trajectory import OBSERVED_FRAMES
from training.data.painting.camera import posed_ground, posed_points
from training.data.painting.planar import draw_planar_scene, paint_planar_scene
from training.data.painting.restyled import draw_restyling, render_restyled
from training.data.rest_height_map import MAP_CELLS
from training.data.shards import Recording
from training.data.windows import Guidance, SceneTargets, Window, WindowAppearance, WindowMaker
from training.networks.perception import scene_constants_of

PROMPT_ERROR_PX = 2.5
"""Largest distance of a prompt from the ball's centre; of large balls, half of their radius."""

VALIDATION_SCENES = 200
VALIDATION_STREAM = 2
"""Additional seed of validation appearances; training seeds are single numbers."""

KINDS: tuple[Literal["paper", "restyled", "planar"], ...] = ("paper", "restyled", "planar")


@dataclass(frozen=True)
class AppearanceMixture:
    """Shares of the kinds of training windows, and of windows with a prompt.

    Attributes
    ----------
    paper, restyled, planar
        Windows of the paper's scenes as the paper has them, in other appearances, and planar ones.
    prompted_scenes, prompted_planar
        Share of the windows with a prompt.
    """

    paper: float = 0.40
    restyled: float = 0.24
    planar: float = 0.36
    prompted_scenes: float = 0.15
    prompted_planar: float = 0.5

    def draw(self, generator: np.random.Generator) -> WindowAppearance:
        """Draw the appearance of a window."""
        shares = np.array([self.paper, self.restyled, self.planar])
        kind = KINDS[generator.choice(3, p=shares / shares.sum())]
        share = self.prompted_planar if kind == "planar" else self.prompted_scenes
        return WindowAppearance(
            kind, bool(generator.random() < share), int(generator.integers(2**31))
        )

    def window(
        self, appearance: WindowAppearance, maker: WindowMaker, index: int, start: int, horizon: int
    ) -> Window:
        """Make a window, with guidance."""
        generator = np.random.default_rng(appearance.seed)
        if appearance.kind == "planar":
            return planar_window(generator, horizon, prompted=appearance.prompted)
        if appearance.kind == "restyled":
            window = restyled_window(generator, maker, index, start, horizon)
        else:
            window = maker.window(index, start, horizon)
            shake = np.zeros((OBSERVED_FRAMES, 2))
            window = window._replace(guidance=_unprompted(window, shake, _radius_px(maker, index)))
        return _prompted(generator, window) if appearance.prompted else window


def other_appearances(
    recordings: Mapping[str, Sequence[Recording]], horizon: int
) -> dict[str, list[Window]]:
    """Windows without prompts for validation: scenes in fixed other appearances, planar scenes.

    Parameters
    ----------
    recordings
        Scenes by the name of their source.
    """
    windows: dict[str, list[Window]] = {}
    for name, of_source in recordings.items():
        maker = WindowMaker(of_source, final_step=None)
        windows[f"{name}-restyled"] = [
            restyled_window(_of_validation(index), maker, index, _test_start(scene), horizon)
            for index, scene in enumerate(recording.scene for recording in of_source)
        ]
    windows["planar"] = [
        planar_window(_of_validation(number), horizon, prompted=False)
        for number in range(VALIDATION_SCENES)
    ]
    return windows


def _of_validation(number: int) -> np.random.Generator:
    return np.random.default_rng([VALIDATION_STREAM, number])


def _test_start(scene: Scene) -> int:
    return TEST_START[scene.scenario]


def planar_window(generator: np.random.Generator, horizon: int, *, prompted: bool) -> Window:
    """Draw and paint a planar scene; unknown values are NaN."""
    scene = draw_planar_scene(generator, prompted=prompted)
    painted = paint_planar_scene(scene)
    positions = np.full((1, horizon, 2), np.nan)
    positions[0, 0] = painted.path[-1]
    centres = np.full((1, OBSERVED_FRAMES - 1 + horizon, 3), np.nan)
    centres[0, :OBSERVED_FRAMES, :2] = painted.path * (2 / NETWORK_FRAME_SIZE) - 1
    window = Window(
        painted.frames,
        positions,
        np.full((1, horizon, 3), np.nan),
        SceneTargets(centres, np.full((3, MAP_CELLS, MAP_CELLS), np.nan), np.full(2, np.nan)),
    )
    guidance = _unprompted(window, painted.shake, scene.balls[0].radius)
    window = window._replace(guidance=guidance)
    return _prompted(generator, window) if prompted else window


def restyled_window(
    generator: np.random.Generator, maker: WindowMaker, index: int, start: int, horizon: int
) -> Window:
    """Render a window of a scene with one ball in another appearance; truth follows the camera."""
    recording = maker.recording(index)
    scene = recording.scene
    seen = recording.trajectory.window(start, OBSERVED_FRAMES)
    path = camera_for(scene.scenario, NETWORK_FRAME_SIZE).project(seen.positions_m)[:, 0]
    style = draw_restyling(generator, scene, path)
    shown = render_restyled(maker.renderer(index), scene, seen, style)
    window = maker.window(index, start, horizon, seen=False)._replace(frames=shown.frames)
    if shown.pose != CameraPose():
        window = posed(window, shown.pose)
        if scene.axis_ratio is None:  # its walls are no longer where they were
            window.positions[:, 1:] = np.nan
    radius = shown.pose.scale * _radius_px(maker, index)
    return window._replace(guidance=_unprompted(window, shown.shake, radius))


def posed(window: Window, pose: CameraPose) -> Window:
    """Transform a window's truth to a camera pose; hidden values become NaN."""
    positions = posed_points(window.positions, pose)
    spins, scene_targets = _turned_spins(window.angular_velocities, pose), window.scene_targets
    if scene_targets is not None:
        scene_targets = _posed_scene_targets(scene_targets, pose)
    if not pose.is_similarity:
        spins = np.full_like(spins, np.nan)
    return Window(window.frames, positions, spins, scene_targets)


def _posed_scene_targets(scene_targets: SceneTargets, pose: CameraPose) -> SceneTargets:
    half = NETWORK_FRAME_SIZE / 2
    flat = (posed_points(half + half * scene_targets.centres[..., :2], pose) - half) / half
    heights = pose.scale * scene_targets.centres[..., 2:]
    ground = posed_ground(np.asarray(scene_targets.ground, np.float32), pose)
    if not pose.is_similarity:
        return SceneTargets(
            np.concatenate([flat, np.full_like(heights, np.nan)], axis=-1),
            ground,
            np.full(2, np.nan),
        )
    half_width, radius = lengths_of(scene_targets.scene_constants)
    constants = scene_constants_of(half_width / pose.scale, radius)
    return SceneTargets(np.concatenate([flat, heights], axis=-1), ground, constants)


def _turned_spins(
    spins: Float[np.ndarray, "objects steps 3"], pose: CameraPose
) -> Float[np.ndarray, "objects steps 3"]:
    """Turn angular velocities, in world axes, with the picture: world y is image -y."""
    cos, sin = math.cos(pose.rotation_rad), math.sin(pose.rotation_rad)
    x, y, z = np.moveaxis(spins, -1, 0)
    return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-1)


def _radius_px(maker: WindowMaker, index: int) -> float:
    scene = maker.recording(index).scene
    return scene.radius_m * camera_for(scene.scenario, NETWORK_FRAME_SIZE).pixels_per_metre


def _unprompted(window: Window, shake: np.ndarray, radius_px: float) -> Guidance:
    objects = len(window.positions)
    return Guidance(np.full((objects, 2), np.nan), shake, np.full(objects, radius_px))


def _prompted(generator: np.random.Generator, window: Window) -> Window:
    """Add a prompt for every ball: its place in the last seen frame, and an error."""
    assert window.guidance is not None
    now = window.positions[:, 0]
    largest = np.maximum(PROMPT_ERROR_PX, window.guidance.radii / 2)[:, None]
    error = largest * np.sqrt(generator.random((len(now), 1)))
    angle = generator.uniform(-math.pi, math.pi, len(now))
    prompts = now + error * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return window._replace(guidance=window.guidance._replace(prompts=prompts))


def lengths_of(constants: Float[np.ndarray, "2"]) -> tuple[float, float]:
    """Half-width of the view and radius of the ball, metres, from the constants of SceneTargets."""
    usual = scene_constants_of(0.0, 0.0)
    scale = scene_constants_of(1.0, 1.0) - usual
    half_width, radius = ((constants - usual) / scale).tolist()
    return half_width, radius
