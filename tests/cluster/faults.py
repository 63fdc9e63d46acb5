"""What happens to a service that is used: a replica dies, a node dies, a model changes."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.cluster.load import MODEL, Load, Phase
from tests.cluster.nodes import REPLICAS, Nodes, wait_until
from tests.e2e.conftest import ROOT

NEW_VERSION = 9


@dataclass(frozen=True)
class Faults:
    """Phases of a load, and what became of its calls."""

    phases: list[Phase]
    accepted: int
    retried: int
    failures: list[Exception]
    answered_by: dict[str, list[str]]


def suffer(running: Nodes, load: Load, models: Path, calls: int) -> Faults:
    """Put a service under load and let every fault happen to it, one after the other.

    Parameters
    ----------
    models
        An empty folder, for the models with a new version.
    calls
        At least so many in each phase.
    """
    with_new_version(models)
    phases: list[Phase] = []

    def suffered(name: str, fault: Callable[[], None]) -> None:
        with load.phase(name) as phase:
            fault()
            load.wait_for(calls)
            running.wait_for_replicas()
        phases.append(phase)

    def node_replaced() -> None:
        running.kill_node()
        wait_until(lambda: running.running() < REPLICAS)
        load.wait_for(calls)
        running.add()

    with load:
        load.wait_for(calls // 4)  # caches are cold
        suffered("none, before the faults", lambda: None)
        suffered("kill -9 of a replica", running.replace_replica)
        suffered("kill -9 of a node, replaced later", node_replaced)
        suffered(
            f"{MODEL}@{NEW_VERSION} rolled out", lambda: running.deploy(models_dir=str(models))
        )
        suffered("none, after the faults", lambda: None)
    return Faults(phases, load.accepted, load.retried, load.failures, load.answered_by)


def with_new_version(models: Path) -> None:
    """Fill a folder with all models and a version more of one, the new default."""
    shutil.copytree(ROOT / "models", models, dirs_exist_ok=True)
    newest = models / MODEL / str(NEW_VERSION)
    shutil.copytree(models / MODEL / "1", newest)
    for folder in (models / MODEL).iterdir():
        path = folder / "manifest.json"
        manifest = json.loads(path.read_text())
        manifest["version"] = int(folder.name)
        manifest["default"] = folder == newest
        path.write_text(json.dumps(manifest))
