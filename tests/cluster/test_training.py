"""Training on Ray: as in one process, whoever dies meanwhile, and rounds side by side."""

import signal
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests.training.common.test_distributed import PACE, Noted
from tests.training.conftest import tiny
from training.common.run_folder import CHECKPOINT
from training.orchestration.auto_training import Line, Round, RoundResult
from training.orchestration.ray_backend import train_rounds, train_together
from training.recipes.compact import one_ball

BATCHES = 60


def train(folder: Path) -> float:
    """Train in one process, or in one of several; keep the loss of every batch."""
    recipe = replace(tiny(one_ball()), sequences=BATCHES * 4)
    trainer = Noted(recipe, folder, replace(PACE, checkpoint_seconds=0))
    error = trainer.run()
    first = trainer.batches - len(trainer.losses)
    np.savez(folder / f"losses-{time.monotonic_ns()}", first=first, losses=trainer.losses)
    return error


def losses(folder: Path) -> list[tuple[int, np.ndarray]]:
    """What was kept, with the number of its first batch."""
    kept = [np.load(path) for path in folder.glob("losses-*.npz")]
    return [(int(one["first"]), one["losses"]) for one in kept]


def workers() -> list[psutil.Process]:
    return [
        process
        for process in psutil.process_iter(["cmdline"])
        if "TrainWorker" in (process.info["cmdline"] or [""])[0]
    ]


@pytest.fixture(scope="module")
def alone(tmp_path_factory) -> tuple[float, np.ndarray]:
    folder = tmp_path_factory.mktemp("alone")
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("ROLLCAST_RUNS", str(folder))
        error = train(folder)
    ((_, curve),) = losses(folder)
    return error, curve


@pytest.fixture
def runs(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("ROLLCAST_RUNS", str(tmp_path))
    return tmp_path


def test_two_workers_learn_as_one(alone, runs):
    error = train_together("local", 2, runs, partial(train, runs))
    for first, curve in losses(runs):
        assert first == 0
        np.testing.assert_allclose(curve, alone[1], rtol=1e-2)
    assert error == pytest.approx(alone[0], rel=1e-2)


def test_training_goes_on_after_a_worker_was_killed(alone, runs):
    killed: list[int] = []

    def kill() -> None:
        while not (runs / CHECKPOINT).exists() or len(workers()) < 2:
            time.sleep(0.05)
        victim = workers()[0]
        victim.send_signal(signal.SIGKILL)
        killed.append(victim.pid)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    train_together("local", 2, runs, partial(train, runs))
    assert killed
    for first, curve in losses(runs):
        assert first > 0, "it began anew"
        np.testing.assert_allclose(curve, alone[1][first:], rtol=1e-2)


def outcome(chosen: Round) -> RoundResult:
    (chosen.folder / "here").write_text("trained")
    return RoundResult(None, 10.0 + chosen.number)


def test_rounds_are_trained_side_by_side(runs):
    recipe = tiny(one_ball())
    rounds = [Round(Line(recipe), number, runs / str(number), recipe) for number in range(3)]
    for one in rounds:
        one.folder.mkdir()
    outcomes = train_rounds("local", runs, rounds, outcome)
    assert outcomes == [RoundResult(None, 10.0), RoundResult(None, 11.0), RoundResult(None, 12.0)]
    assert all((one.folder / "here").exists() for one in rounds)
