"""What every training shares: convergence, and Ctrl-C."""

import os
import signal
from collections.abc import Iterator

import pytest
import torch
from torch import nn

from training.common.run_folder import CHECKPOINT
from training.engine.loop import (
    Optimisation,
    TrainerConfig,
    TrainingLoop,
    TrainingStoppedError,
    converged,
)
from training.objectives.schedules import Cosine


class Line(TrainingLoop[int]):
    """Fits one number to 3; the process gets Ctrl-C while batch ``interrupted`` is computed."""

    def __init__(self, folder, interrupted: int | None = None) -> None:
        torch.manual_seed(1)
        module = nn.Linear(1, 1)
        optimisation = Optimisation(
            100, 1, lambda groups: torch.optim.Adam(groups, 0.1), Cosine, average_decay=0.9
        )
        config = TrainerConfig(validate_every=10, checkpoint_seconds=1e9)
        super().__init__(module, module.parameters(), optimisation, folder, config)
        self.interrupted = interrupted
        self.begun: list[int] = []

    def _stream(self) -> Iterator[int]:
        return iter(range(self.batches, 1000))

    def _loss(self, batch: int, progress: float) -> torch.Tensor:
        self.begun.append(batch)
        if batch == self.interrupted:
            os.kill(os.getpid(), signal.SIGINT)
        return (self.module(torch.ones(1)) - 3).square().sum()

    def _errors(self):
        error = float((self.averaged()(torch.ones(1)) - 3).abs().detach())
        return error, {"validation/error": error}

    def _best_weights(self):
        return {"weights": self.averaged().state_dict()}


def test_ctrl_c_keeps_the_batch_that_was_begun_and_goes_on_from_it(tmp_path):
    usual = signal.getsignal(signal.SIGINT)
    whole = Line(tmp_path / "whole")
    whole.run()
    stopped = Line(tmp_path / "stopped", interrupted=29)
    with pytest.raises(TrainingStoppedError, match="after 30 of 100 batches"):
        stopped.run()
    assert signal.getsignal(signal.SIGINT) is usual
    resumed = Line(tmp_path / "stopped")
    resumed.run()
    assert resumed.begun == list(range(30, 100))
    # Batch 30 ends with a validation, which the stop came before.
    assert resumed.validations == whole.validations
    for one, other in zip(whole.module.parameters(), resumed.module.parameters(), strict=True):
        assert torch.equal(one, other)
    assert (tmp_path / "stopped" / CHECKPOINT).exists()


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ([8, 6, 5, 4, 3.95], True),
        ([8, 6, 5, 4, 3.9], False),
        ([8, 6, 5, 4, 4.5], True),
        ([8], None),
        ([], None),
    ],
    ids=["fell by 1.25 %", "fell by 2.5 %", "rose", "one validation", "none"],
)
def test_a_training_has_converged_when_its_last_fifth_gained_little(errors, expected):
    validations = [(100 * (index + 1), error) for index, error in enumerate(errors)]
    assert converged(validations) is expected
