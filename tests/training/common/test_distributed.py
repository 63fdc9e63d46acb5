"""Two processes that train together end as one that trains alone."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import distributed, multiprocessing

from tests.training.conftest import tiny
from training.common.distributed import (
    Share,
    average_value,
    is_main_process,
    main_process_first,
    share,
)
from training.common.run_folder import CHECKPOINT
from training.engine.loop import TrainerConfig
from training.engine.trainer import Trainer
from training.recipes.compact import one_ball
from training.recipes.field import field_one_ball_rolling
from training.recipes.perception_init import perception_init_one_ball

PACE = TrainerConfig(validate_every=4, checkpoint_seconds=1e9, workers=0)
PROCESSES = 2
RECIPES = {
    "shared state": one_ball,
    "true states and replayed features": field_one_ball_rolling,
    "perception-initialised state": perception_init_one_ball,
}


class Noted(Trainer):
    """Keeps the loss of every batch."""

    def __init__(self, *arguments) -> None:
        super().__init__(*arguments)
        self.losses: list[float] = []

    def _step(self, batch, progress):
        loss = super()._step(batch, progress)
        self.losses.append(loss)
        return loss


def train(name: str, folder: Path) -> Noted:
    torch.set_num_threads(1)
    trainer = Noted(tiny(RECIPES[name]()), folder, PACE)
    trainer.run()
    return trainer


def join(rank: int, work, folder: Path, *arguments) -> None:
    distributed.init_process_group(
        "gloo", init_method=f"file://{folder / 'meeting'}", rank=rank, world_size=PROCESSES
    )
    work(rank, folder, *arguments)
    distributed.destroy_process_group()


def together(work, folder: Path, *arguments) -> None:
    multiprocessing.spawn(join, (work, folder, *arguments), nprocs=PROCESSES)


def flat(weights: dict[str, torch.Tensor]) -> torch.Tensor:
    return torch.cat([value.flatten().float() for value in weights.values()])


def train_a_share(rank: int, folder: Path, name: str) -> None:
    trainer = train(name, folder / "run")
    np.save(folder / f"{rank}.npy", trainer.losses)
    torch.save(trainer.family.state_dict(), folder / f"{rank}.pt")


@pytest.mark.parametrize("name", RECIPES)
def test_two_end_as_one(name, runs, tmp_path):
    alone = train(name, tmp_path / "alone")
    together(train_a_share, tmp_path, name)
    losses = [np.load(tmp_path / f"{rank}.npy") for rank in range(PROCESSES)]
    np.testing.assert_array_equal(losses[0], losses[1])
    np.testing.assert_allclose(losses[0], alone.losses, rtol=1e-3)
    weights = [torch.load(tmp_path / f"{rank}.pt") for rank in range(PROCESSES)]
    for key, value in weights[0].items():
        torch.testing.assert_close(value, weights[1][key], rtol=0, atol=0)
    one, both = (flat(weights) for weights in (alone.family.state_dict(), weights[0]))
    # The optimiser makes steps of almost one length of every gradient, be it ever so small.
    assert (both - one).norm() < 1e-2 * one.norm()


def write_roles(rank: int, folder: Path) -> None:
    assert is_main_process() == (rank == 0)
    assert share() == Share(rank, PROCESSES)
    assert average_value(float(rank)) == 0.5
    path = folder / "made"
    made = main_process_first(lambda: path.exists() or path.write_text("by the main process"))
    assert (made is True) == (rank != 0)


def test_the_main_process_goes_first(tmp_path):
    together(write_roles, tmp_path)


def test_one_process_is_alone():
    assert is_main_process()
    assert average_value(3.0) == 3.0
    assert list(share().of(5)) == [0, 1, 2, 3, 4]


def test_a_batch_that_cannot_be_shared_is_refused():
    with pytest.raises(ValueError, match="5 windows of a batch cannot be divided among 2"):
        Share(0, 2).of(5)


def test_a_checkpoint_of_one_is_gone_on_with_by_two(runs, tmp_path):
    """As after a worker was killed, with another number of workers."""
    alone = train("shared state", tmp_path / "alone")
    half = Noted(tiny(one_ball()), tmp_path / "run", PACE)
    half._config = TrainerConfig(validate_every=4, checkpoint_seconds=0, workers=0)

    class EnoughError(Exception):
        pass

    def stop(batch, progress, step=half._step):
        if half.batches == 5:
            raise EnoughError
        return step(batch, progress)

    half._step = stop
    with pytest.raises(EnoughError):
        half.run()
    assert (tmp_path / "run" / CHECKPOINT).exists()
    together(train_a_share, tmp_path, "shared state")
    np.testing.assert_allclose(np.load(tmp_path / "0.npy"), alone.losses[5:], rtol=1e-3)
