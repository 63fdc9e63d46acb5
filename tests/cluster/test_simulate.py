"""Scenes simulated on Ray: the same bytes as here, whoever dies meanwhile."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from ray.cluster_utils import Cluster

from tests.cluster.nodes import node
from tests.e2e.conftest import ROOT
from training.data.shards import SHARD_SCENES, Source, in_processes, make_missing, split_shards

SHARDS = 4


def simulate(address: str, folder: Path) -> subprocess.Popen[bytes]:
    """The command line."""
    scenes = ["hemisphere", "--split", "validation", "--scenes", str(SHARDS * SHARD_SCENES)]
    where = ["--ray", address, "--output", str(folder)]
    return subprocess.Popen(
        [sys.executable, "-m", "training", "simulate", *scenes, *where],
        cwd=ROOT,
    )


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.npz")}


def working() -> list[psutil.Process]:
    """Processes that make a shard."""
    return [
        process
        for process in psutil.process_iter(["cmdline"])
        if (process.info["cmdline"] or [""])[0].startswith("ray::make")
    ]


@pytest.fixture(scope="module")
def made_here(tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("here")
    shards = split_shards(Source("hemisphere"), "validation", SHARDS * SHARD_SCENES, str(folder))
    make_missing(shards, in_processes(2), "here")
    return contents(folder)


@pytest.mark.parametrize("cores", [1, 3])
def test_shards_are_the_same_bytes_on_any_number_of_cores(made_here, tmp_path, cores):
    cluster = Cluster(initialize_head=True, head_node_args=node(cores))
    try:
        assert simulate(cluster.address, tmp_path).wait() == 0
    finally:
        cluster.shutdown()
    assert contents(tmp_path) == made_here


def test_shards_are_the_same_bytes_after_a_worker_was_killed(made_here, tmp_path):
    cluster = Cluster(initialize_head=True, head_node_args=node(2))
    try:
        simulation = simulate(cluster.address, tmp_path)
        while not working():
            assert simulation.poll() is None
            time.sleep(0.02)
        working()[0].send_signal(signal.SIGKILL)
        assert simulation.wait() == 0
    finally:
        cluster.shutdown()
    assert contents(tmp_path) == made_here
    assert len(list(tmp_path.iterdir())) == SHARDS, "nothing unfinished is left"
