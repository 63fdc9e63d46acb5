from pathlib import Path

import numpy as np
import torch
from torch.utils.data import IterableDataset

from training.data.ball_batch import collate
from training.data.ball_windows import planar_window
from training.engine.ball_trainer import LOG, BallTrainer, BallTraining
from training.networks.any_ball import AnyBallNet

TRAINING = BallTraining(batches=3, batch_size=3, warm_up=1)


class Windows(IterableDataset):
    """Batches of planar scenes."""

    def __iter__(self):
        while True:
            yield collate([planar_window(np.random.default_rng(k)) for k in range(3)])


def trained(folder: Path, batches: int) -> BallTrainer:
    torch.manual_seed(2)
    trainer = BallTrainer(AnyBallNet(), BallTraining(batches, 3, warm_up=1), folder)
    trainer.resume()
    for _ in trainer.run(Windows(), workers=0, report_every=1):
        pass
    return trainer


def test_training_changes_perception_alone_and_goes_on_where_it_stopped(tmp_path):
    torch.manual_seed(2)
    before = {name: value.clone() for name, value in AnyBallNet().state_dict().items()}
    trained(tmp_path, 2)
    after = trained(tmp_path, 3)
    assert after.batches == 3
    assert len((tmp_path / LOG).read_text().splitlines()) == 3
    moved = {n for n, v in after.network.state_dict().items() if not torch.equal(v, before[n])}
    assert any(name.startswith("eye.detector.said") for name in moved)
    assert any(name.startswith("eye.refiner.registration") for name in moved)
    assert not any(name.startswith(("rolling", "first_doubt")) for name in moved)


def test_the_loss_falls_on_what_is_seen_again_and_again(tmp_path):
    torch.manual_seed(3)
    trainer = BallTrainer(AnyBallNet(), BallTraining(40, 3, warm_up=1), tmp_path)
    batch = next(iter(Windows()))
    first = trainer._step(batch)["loss"]
    for _ in range(14):
        last = trainer._step(batch)["loss"]
    assert last < 0.8 * first
