"""A training that is killed at any moment, as by kill -9, ends as one that was not: to the bit."""

import random
import signal
import subprocess
import sys
import time

import torch

from tests.training.conftest import tiny
from training.common.run_folder import CHECKPOINT
from training.engine.loop import TrainerConfig
from training.engine.trainer import Trainer
from training.recipes.compact import one_ball

PACE = TrainerConfig(validate_every=4, checkpoint_seconds=0, workers=0)
KILLS = 1
PROGRAM = """
import sys
from pathlib import Path

import torch

from tests.training.engine.test_killed import train

torch.set_num_threads(1)
train(Path(sys.argv[1]))
"""


def train(folder) -> Trainer:
    trainer = Trainer(tiny(one_ball()), folder, PACE)
    trainer.run()
    return trainer


def test_a_killed_training_ends_with_the_same_weights(runs, tmp_path):
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        whole = train(tmp_path / "whole")
        chance, killed = random.Random(1), 0
        for _ in range(KILLS):
            killed += begin_and_kill(tmp_path / "killed", chance.random() / 5)
        resumed = train(tmp_path / "killed")
    finally:
        torch.set_num_threads(threads)
    assert killed > 0
    assert resumed.sequences == whole.sequences
    for one, other in ((whole.family, resumed.family), (whole.averaged(), resumed.averaged())):
        expected = one.state_dict()
        for name, value in other.state_dict().items():
            torch.testing.assert_close(value, expected[name], rtol=0, atol=0)


def begin_and_kill(folder, delay_s: float) -> bool:
    """Train in a process of its own until some time after its next checkpoint, then kill it."""
    before = checkpoint_time(folder)
    process = subprocess.Popen([sys.executable, "-c", PROGRAM, str(folder)])
    while checkpoint_time(folder) == before and process.poll() is None:
        time.sleep(0.002)
    time.sleep(delay_s)
    process.kill()
    return process.wait(60) == -signal.SIGKILL


def checkpoint_time(folder) -> int:
    path = folder / CHECKPOINT
    return path.stat().st_mtime_ns if path.exists() else 0
