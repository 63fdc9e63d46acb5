"""Clusters of Ray on this machine: six logical cores on some nodes, six replicas in all."""

import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import psutil
import ray
from ray import serve
from ray.cluster_utils import Cluster

from service.process.ray_serve import Replica

REPLICAS = 6
APPLICATION = "rollcast"
REPLICA_PROCESS = f"ray::ServeReplica:{APPLICATION}:{APPLICATION}"
"""How Ray names the process of a replica; what it is at follows."""
OBJECT_STORE_BYTES = 80 * 2**20
WAIT_S = 180


@dataclass
class Nodes:
    """The nodes, and the address of the proxy on the first of them."""

    cluster: Cluster
    address: str
    cores: int
    """Of each node."""

    def deploy(self, **settings: Any) -> None:
        """Serve, or roll out other settings; return once every replica has them."""
        deployment = Replica.options(num_replicas=REPLICAS, autoscaling_config=None)
        serve.run(deployment.bind(settings), name=APPLICATION, route_prefix="/")
        self.wait_for_replicas()

    def add(self) -> None:
        """Add a node."""
        self.cluster.add_node(**node(self.cores))

    def replicas(self) -> list[psutil.Process]:
        """The processes of all replicas."""
        return [
            process
            for process in psutil.process_iter(["cmdline"])
            if (process.info["cmdline"] or [""])[0].startswith(REPLICA_PROCESS)
        ]

    def replace_replica(self) -> None:
        """kill -9 of a replica, at work if there is one; return once another has begun to start."""
        before = self.replicas()
        at_work = max(before, key=lambda one: len(one.info["cmdline"][0]))
        at_work.send_signal(signal.SIGKILL)
        wait_until(lambda: bool(set(self.replicas()) - set(before)))

    def kill_node(self) -> None:
        """kill -9 of everything that runs on one of the nodes without the proxy."""
        lost = min(self.cluster.worker_nodes, key=lambda one: one.node_id)
        started = [one.process.pid for kind in lost.all_processes.values() for one in kind]
        processes = [psutil.Process(pid) for pid in started]
        processes += [child for one in processes for child in one.children(recursive=True)]
        assert {one.pid for one in self.replicas()} & {one.pid for one in processes}
        for process in processes:
            process.send_signal(signal.SIGKILL)
        self.cluster.remove_node(lost, allow_graceful=False)

    def running(self) -> int:
        """Replicas that serve as they should."""
        application = serve.status().applications[APPLICATION]
        (deployment,) = application.deployments.values()
        return deployment.replica_states.get("RUNNING", 0)

    def wait_for_replicas(self) -> None:
        """Wait until all replicas serve."""
        wait_until(lambda: self.running() == REPLICAS)


def wait_until(reached: Callable[[], bool]) -> None:
    deadline = time.monotonic() + WAIT_S
    while not reached():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def node(cores: int) -> dict[str, Any]:
    """What a node is started with."""
    return {"num_cpus": cores, "object_store_memory": OBJECT_STORE_BYTES}


@contextmanager
def nodes(number: int) -> Iterator[Nodes]:
    """Start a cluster and the service on it; stop both."""
    cores = REPLICAS // number
    cluster = Cluster(
        initialize_head=True, head_node_args={**node(cores), "include_dashboard": False}
    )
    try:
        for _ in range(number - 1):
            cluster.add_node(**node(cores))
        ray.init(address=cluster.address, log_to_driver=False, logging_level="error")
        port = free_port()
        serve.start("HeadOnly", {"host": "127.0.0.1", "port": port})
        started = Nodes(cluster, f"http://127.0.0.1:{port}", cores)
        started.deploy()
        yield started
        serve.shutdown()
    finally:
        ray.shutdown()
        cluster.shutdown()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]
