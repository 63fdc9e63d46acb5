"""Run folders that were written with former names of parameters."""

import pytest
import torch

from training.common.run_folder import (
    BEST,
    CHECKPOINT,
    current_name,
    read_best,
    read_whole,
    save_whole,
)

FORMER = {"eye.first.where.weight": torch.ones(2), "encoder.eye.state.0.bias": torch.zeros(1)}
CURRENT = ["perception.first.where.weight", "encoder.perception.state.0.bias"]


def test_best_weights_of_one_network_and_of_several_have_the_current_names(tmp_path):
    save_whole(tmp_path / BEST, {"weights": {"fieldnet": FORMER}, "sequences": 7})
    best = read_best(tmp_path)
    assert list(best["weights"]["fieldnet"]) == CURRENT
    assert best["sequences"] == 7
    save_whole(tmp_path / BEST, {"weights": FORMER})
    torch.testing.assert_close(read_best(tmp_path)["weights"][CURRENT[0]], torch.ones(2))


def test_a_checkpoint_loads_into_a_module_with_the_current_names(tmp_path):
    module = torch.nn.ModuleDict({"perception": torch.nn.Linear(2, 3)})
    optimiser = torch.optim.AdamW(module.parameters())
    module["perception"](torch.ones(2)).sum().backward()
    optimiser.step()
    former = {f"eye.{name}": value for name, value in module["perception"].state_dict().items()}
    state = {"module": former, "optimiser": optimiser.state_dict(), "validations": [(1, 0.5)]}
    save_whole(tmp_path / CHECKPOINT, state)
    read = read_whole(tmp_path / CHECKPOINT)
    other = torch.nn.ModuleDict({"perception": torch.nn.Linear(2, 3)})
    other.load_state_dict(read["module"])
    torch.testing.assert_close(other.state_dict(), module.state_dict())
    torch.optim.AdamW(other.parameters()).load_state_dict(read["optimiser"])
    assert read["validations"] == [(1, 0.5)]


@pytest.mark.parametrize(
    ("former", "current"),
    [
        ("rolling.doubt.0.weight", "rolling.covariance_change.0.weight"),
        ("first_doubt.bias", "first_covariance.bias"),
        ("rolling.encounters.message.2.weight", "rolling.pair_interaction.message.2.weight"),
        ("eye.first.measures.weight", "perception.first.scene_constants.weight"),
        ("eye.zoomed.look.correction.bias", "perception.zoomed.refiner.correction.bias"),
        ("eye.refiner.looks.weight", "perception.refiner.radius_and_visibility.weight"),
        ("bend.doubt.2.bias", "endpoint_correction.covariance_change.2.bias"),
        ("module.perception.eyesight", "module.perception.eyesight"),
    ],
)
def test_parts_of_names_are_renamed_as_a_whole(former, current):
    assert current_name(former) == current
    assert current_name(current) == current
