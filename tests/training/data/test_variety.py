"""Whatever ``/simulate`` can be asked for is in the training."""

import numpy as np
import pytest

from rollcast.scene import SCENARIOS, Scene
from rollcast.schemas import NAMES_OF_A_SCENE, SceneParameters, SimulateRequest
from rollcast.simulation.sampling import draw_scene, scene_generator
from training.data.appearance_mixture import AppearanceMixture
from training.data.painting.restyled import draw_restyling
from training.data.shards import Source, Variety
from training.recipes.appearance import APPEARANCE_DATA

SEEDS = range(1_000_000, 1_000_150)

OUT_OF_SIGHT = {"steps", "include_frames", "include_surface", "image_size"}
"""Fields of a request that change what is answered, not what a model sees of it: frames are resized
to the networks' size."""

NOT_ONE_BALL = {"num_objects", "ball_friction", "ball_restitution", "mass_ratios"}
"""Several balls have recipes of their own."""

WIDE_ENOUGH: dict[str, tuple[float, float]] = {
    "radius_m": (0.035, 0.245),
    "axis_ratio": (0.45, 0.98),
    "noise_scale": (0.22, 0.68),
    "rotation_rad": (-3.0, 3.0),
    "noise_offset_m": (-2.0, 2.0),
    "light_position_m": (-2.3, 3.5),
    "positions_m": (-0.9, 0.9),
    "velocities_m_s": (-8.0, 8.0),
    "orientations_xyzw": (-0.9, 0.9),
    "friction": (0.08, 0.95),
    "rolling_resistance": (0.01, 0.14),
    "damping": (0.005, 0.19),
    "spins_rad_s": (-35, 35),
    "slope": (-0.055, 0.055),
    "walls_m": (-0.9, 0.9),
    "wall_friction": (0.05, 0.18),
    "wall_restitution": (0.6, 0.9),
}
"""What training has to reach at both ends, of every field that is a number or several. Turned by
pi a scene is all that it can be; landscapes are alike everywhere."""


def candidates(source: Source) -> list[Scene]:
    """Scenes of a source before any is rejected: that takes no simulation."""
    scenes = []
    for seed in SEEDS:
        fixed = dict(source.parameters)
        if source.variety is not None:
            fixed |= dict(source.variety.override(source.scenario, seed).parameters)
        generator = scene_generator(source.scenario, 1, seed)
        scenes.append(draw_scene(source.scenario, 1, seed, generator, fixed, lambda _: True))
    return scenes


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return [scene for part in APPEARANCE_DATA for scene in candidates(part.source)]


@pytest.mark.parametrize(
    "field", sorted(SceneParameters.model_fields.keys() - NAMES_OF_A_SCENE - NOT_ONE_BALL)
)
def test_every_parameter_of_a_scene_is_varied(scenes, field):
    values = [getattr(scene, field) for scene in scenes if getattr(scene, field) is not None]
    low, high = WIDE_ENOUGH[field]
    numbers = np.concatenate([np.ravel(value) for value in values])
    assert numbers.min() <= low, field
    assert numbers.max() >= high, field


@pytest.mark.parametrize(
    "field",
    sorted(SimulateRequest.model_fields.keys() - OUT_OF_SIGHT - NOT_ONE_BALL - {"scene"}),
)
def test_every_field_of_a_request_is_varied(scenes, field):
    """A new field that no training source varies fails here."""
    varied = {
        "scenario": {scene.scenario for scene in scenes} == set(SCENARIOS),
        "seed": len({scene.seed for scene in scenes}) == len(SEEDS),
        "start_step": min(part.latest_start for part in APPEARANCE_DATA) >= 100,
        "textured": white_share(scenes) > 0.05,
    }
    assert varied[field], field


def white_share(scenes: list[Scene]) -> float:
    """Share of restyled windows whose ball is the white one that ``textured=False`` gives."""
    generator = np.random.default_rng(0)
    path = np.full((4, 2), 64.0)
    balls = [draw_restyling(generator, scene, path).ball for scene in scenes[:200]]
    assert AppearanceMixture().restyled > 0.2
    return float(np.mean([ball is not None and set(ball.colors) == {(1, 1, 1)} for ball in balls]))


def test_speeds_are_slower_and_faster_than_the_papers():
    for scenario in ("hemisphere", "ellipsoid", "heightfield"):
        speeds = [Variety().override(scenario, seed).speed for seed in SEEDS]
        assert min(speeds) < 0.6
        assert max(speeds) > (2 if scenario == "heightfield" else 1.1)
        assert 0.3 < np.mean(np.array(speeds) == 1) < 0.7


def test_variety_is_a_function_of_the_seed():
    one, other = (Variety().override("ellipsoid", 7) for _ in range(2))
    assert one == other
    assert one != Variety().override("ellipsoid", 8)


def test_a_bowl_is_never_too_narrow_for_its_ball():
    for seed in SEEDS:
        drawn = dict(Variety().override("ellipsoid", seed).parameters)
        assert drawn["radius_m"] <= drawn["axis_ratio"] ** 2 + 1e-9


def test_variety_leaves_nothing_to_be_fixed_beside_it():
    with pytest.raises(ValueError, match="variety draws"):
        Source("hemisphere", radius_m=0.1, variety=Variety())
    assert Source("hemisphere", variety=Variety()).name == "hemisphere-1-varied"
