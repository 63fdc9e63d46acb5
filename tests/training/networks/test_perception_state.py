"""The convolutional state that begins with the outputs of trained perception."""

from dataclasses import replace

import pytest
import torch

from tests.training.conftest import SCENES, tiny
from training.engine.loop import TrainerConfig
from training.engine.trainer import Trainer
from training.engine.warm_start import Initial, load_fitting
from training.export.export import export_run
from training.export.load import load_exported
from training.networks.fieldnet import Ball, FieldNet, seen_state
from training.networks.perception_state import (
    InitialState,
    PerceptionStateFamily,
    perception_state_family,
)
from training.networks.recurrent import State
from training.networks.task import Task
from training.recipes.perception_init import (
    perception_init_one_ball,
    perception_init_one_ball_interpolation,
)

FRAMES = torch.randint(
    0, 256, (2, 5, 128, 128, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(3)
)
PACE = TrainerConfig(validate_every=4, checkpoint_seconds=1000, workers=0)


def family(frames: int = 4, objects: int = 1, **options: bool) -> PerceptionStateFamily:
    torch.manual_seed(7)
    variant, final_step = ("posnet", None) if frames == 4 else ("interpnet", 39)
    made = perception_state_family({"it": variant}, Task(objects, final_step, **options))
    assert isinstance(made, PerceptionStateFamily)
    return made.eval()


def unsettled_field_net() -> FieldNet:
    """FieldNet whose weights that begin at zero have some of any size."""
    torch.manual_seed(2)
    network = FieldNet(Task()).eval()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.02 * torch.randn(parameter.shape))
    return network


def sight(objects: int = 1, batch: int = 2, *, final: bool = False) -> InitialState:
    """Balls of any state over any ground."""
    generator = torch.Generator().manual_seed(5)
    ground = 0.3 * torch.randn(batch, 3, 32, 32, generator=generator)
    numbers = 0.2 * torch.randn(batch, objects, 14, generator=generator)
    finals = torch.rand(batch, objects, 2, generator=generator) - 0.5
    return InitialState(State(ground, numbers), finals if final else None)


@pytest.mark.parametrize("frames", [4, 5])
def test_frames_and_what_is_read_of_them_give_the_same_forecast(frames):
    networks = family(frames)
    seen = FRAMES[:, :frames]
    with torch.inference_mode():
        made = networks(seen, 5)["it"]
        perceived = networks.encoder.perception(FRAMES[:, :4])
        state = seen_state(perceived, torch.zeros_like(perceived.centres))
        finals = networks.encoder.perception.at_rest(FRAMES[:, 4]) if frames == 5 else None
        again = networks.forecast_from(InitialState(state, finals), 5)["it"]
    torch.testing.assert_close(made.positions, again.positions)
    torch.testing.assert_close(made.angular_velocities, again.angular_velocities)
    assert (made.final_positions is None) == (frames == 4)


def test_a_state_knows_ground_ball_and_final_place():
    """Whatever a forecast depends on changes s_0."""
    spread = family(5).encoder.spread
    known = sight(final=True)
    assert known.finals is not None
    with torch.inference_mode():
        plain = spread(known)
        ball = Ball.unpacked(known.state.p)
        others = {
            "ground": known._replace(state=State(known.state.s + 0.1, known.state.p)),
            "final": known._replace(finals=known.finals + 0.1),
        } | {
            part: known._replace(
                state=State(
                    known.state.s, ball._replace(**{part: getattr(ball, part) + 0.1}).packed()
                )
            )
            for part in ("centre", "velocity", "spin", "scene_constants")
        }
        for part, other in others.items():
            assert not torch.allclose(spread(other), plain, atol=1e-3), part


@pytest.mark.parametrize("interaction", [False, True])
def test_balls_may_change_places(interaction):
    networks = family(objects=2, interaction=interaction)
    with torch.no_grad():
        for parameter in networks.parameters():
            parameter.add_(0.02 * torch.randn(parameter.shape))
    known = sight(objects=2)
    swapped = InitialState(State(known.state.s, known.state.p.flip(1)), None)
    with torch.inference_mode():
        made = networks.forecast_from(known, 6)["it"].positions
        other = networks.forecast_from(swapped, 6)["it"].positions
        alone = networks.forecast_from(
            InitialState(State(known.state.s, known.state.p[:, :1]), None), 6
        )["it"]
    torch.testing.assert_close(made.flip(1), other)
    same = torch.allclose(alone.positions[:, 0], made[:, 0], atol=1e-4)
    assert same != interaction


def test_two_balls_begin_as_one_ball_twice():
    """Weights of one ball, widened for two: what there is of the other ball counts nothing yet."""
    one, two = family(objects=1), family(objects=2)
    with torch.no_grad():
        for parameter in one.parameters():
            parameter.add_(0.02 * torch.randn(parameter.shape))
    load_fitting(two.networks()["it"], one.networks()["it"].state_dict())
    known = sight(objects=2)
    with torch.inference_mode():
        together = two.forecast_from(known, 6)["it"].positions
        for ball in range(2):
            part = InitialState(State(known.state.s, known.state.p[:, ball : ball + 1]), None)
            alone = one.forecast_from(part, 6)["it"].positions
            torch.testing.assert_close(together[:, ball : ball + 1], alone)


@pytest.mark.parametrize("base", [perception_init_one_ball, perception_init_one_ball_interpolation])
def test_it_goes_all_the_way(runs, tmp_path, base):
    recipe = replace(tiny(base()), sequences=16, members=base().members[-1:])
    if recipe.task.frames == 5:
        recipe = replace(recipe, task=Task(final_step=3))
    taught = Initial("fieldnet", unsettled_field_net().state_dict(), 100)
    Trainer(recipe, tmp_path, PACE, [taught]).run()
    export_run(recipe, tmp_path, tmp_path, 1, SCENES, workers=1)
    manifest, network = load_exported(tmp_path / recipe.members[0].name / "1")
    assert (manifest.preset, manifest.frames) == ("perception_init", recipe.task.frames)
    assert manifest.training["sequences"] == 116
    with torch.inference_mode():
        forecast = network(torch.zeros(1, recipe.task.frames, 128, 128, 3, dtype=torch.uint8), 3)
    assert forecast.positions.shape == (1, 1, 3, 2)
