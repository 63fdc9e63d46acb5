"""Work on a cluster of Ray's. Ray comes with the extra ``ray-training``; all else does without."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path

import ray
from ray import tune
from ray.train import FailureConfig, RunConfig, ScalingConfig
from ray.train.torch import TorchConfig, TorchTrainer

from training.common.settings import RUNS_VARIABLE, runs_folder
from training.data.shards import SHARDS_PER_WORKER, Makers, Shard
from training.orchestration.auto_training import Round, RoundResult

ALWAYS = -1
"""Failures after which Ray still tries again."""
STORED = "ray"
"""Folder beside the checkpoints where Ray keeps its own notes."""


def connected(address: str) -> AbstractContextManager[object]:
    """Connect to a cluster for as long as a ``with`` block lasts.

    Parameters
    ----------
    address
        Of a running cluster whose nodes have this code and reach ROLLCAST_RUNS ("auto" finds the
        one of this machine), or "local" for one that lasts as long as the work.
    """
    variables = {RUNS_VARIABLE: str(runs_folder())}
    return ray.init(address=address, log_to_driver=False, runtime_env={"env_vars": variables})


def on_ray(address: str) -> Makers:
    """Make shards as tasks of a cluster, as many at a time as it has cores.

    Another worker repeats the task of a worker or node that died.
    """

    def make(shards: Sequence[Shard]) -> Iterator[object]:
        # Workers are replaced now and then because PyBullet leaks.
        task = ray.remote(max_calls=SHARDS_PER_WORKER, max_retries=ALWAYS)(Shard.make)
        with connected(address):
            waiting = [task.remote(shard) for shard in shards]
            while waiting:
                (done,), waiting = ray.wait(waiting)
                yield ray.get(done)

    return make


def train_together(address: str, processes: int, folder: Path, run: Callable[[], float]) -> float:
    """Run a training in several processes that share its batches (``training.common.distributed``).

    When one of them dies all begin again, from the last checkpoint.

    Parameters
    ----------
    folder
        Of the training.
    run
        Runs it in one process; returns its best error where it leads.

    Returns
    -------
    float
        The best validation error, in pixels.
    """
    with connected(address):
        trainer = TorchTrainer(
            run,
            torch_config=TorchConfig(backend="gloo"),
            scaling_config=ScalingConfig(num_workers=processes),
            run_config=RunConfig(
                name="together",
                storage_path=str(folder / STORED),
                failure_config=FailureConfig(max_failures=ALWAYS),
            ),
        )
        return trainer.fit().return_value


def train_rounds(
    address: str, folder: Path, rounds: Sequence[Round], train: Callable[[Round], RoundResult]
) -> list[RoundResult]:
    """Train rounds that do not need each other, each as a trial of Ray Tune.

    Parameters
    ----------
    folder
        Of the rounds.
    train
        Trains one of them, from its last checkpoint on.

    Returns
    -------
    list
        Results of the rounds, in their order.
    """

    def trial(config: dict[str, int]) -> None:
        number = config["round"]
        tune.report({"round": number, **asdict(train(rounds[number]))})

    with connected(address):
        tuner = tune.Tuner(
            trial,
            param_space={"round": tune.grid_search(list(range(len(rounds))))},
            run_config=tune.RunConfig(
                name="auto-train",
                storage_path=str(folder / STORED),
                failure_config=tune.FailureConfig(max_failures=ALWAYS),
            ),
        )
        found = {result.metrics["round"]: result.metrics for result in tuner.fit()}
    return [
        RoundResult(found[number]["error_before_px"], found[number]["error_px"])
        for number in range(len(rounds))
    ]
