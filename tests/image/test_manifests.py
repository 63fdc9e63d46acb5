"""What is not run is validated by those who know its schema, without a network."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.e2e.conftest import ROOT

TOOLS = Path(sys.executable).parent
DOCKER = ROOT / "docker"


def judged(tool: str, *arguments: str | Path) -> str:
    done = subprocess.run(
        [TOOLS / tool, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_dockerfiles():
    files = sorted(DOCKER.glob("*.Dockerfile"))
    assert len(files) == 2
    judged("hadolint", *files)


def test_compose():
    resolved = judged("docker-compose", "-f", DOCKER / "compose.yaml", "config")
    for line in resolved.splitlines():
        if "host_ip" in line:
            assert "127.0.0.1" in line  # nothing listens beyond this machine
    assert resolved.count("host_ip") == 3


CORE = ("deployment", "service", "networkpolicy")
SEVERAL = ("poddisruptionbudget", "horizontalpodautoscaler")
"""Kinds of clusters with several replicas."""


@pytest.mark.parametrize(("overlay", "kinds"), [("local", CORE), ("production", CORE + SEVERAL)])
def test_kubernetes(tmp_path, overlay: str, kinds: tuple[str, ...]):
    folder = DOCKER / "kubernetes/overlays" / overlay
    done = subprocess.run(["kubectl", "kustomize", folder], capture_output=True, check=True)
    documents = list(yaml.safe_load_all(done.stdout))
    # The kinds of operators are not Kubernetes' own.
    known = [one for one in documents if "monitoring.coreos.com" not in one["apiVersion"]]
    path = tmp_path / "rendered.yaml"
    path.write_text(yaml.safe_dump_all(known))
    said = judged("kubernetes-validate", "--strict", path)
    for kind in kinds:
        assert f"passed for resource {kind}/rollcast" in said
    assert len(known) == len(kinds)


def test_every_manifest_says_who_may_ask():
    """Without one of the two the service would not listen to others."""
    deployment = next(yaml.safe_load_all((DOCKER / "kubernetes/base/rollcast.yaml").read_text()))
    runtime = next(yaml.safe_load_all((DOCKER / "kubernetes" / "kserve.yaml").read_text()))
    compose = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    containers = (
        *deployment["spec"]["template"]["spec"]["containers"],
        *runtime["spec"]["containers"],
    )
    given = [
        *({one["name"] for one in container["env"]} for container in containers),
        set(compose["services"]["service"]["environment"]),
    ]
    assert all(names & {"ROLLCAST_KEYS_FILE", "ROLLCAST_ALLOW_UNAUTHENTICATED"} for names in given)


def test_pods_of_kserve_and_ray(tmp_path):
    """What stands inside other people's kinds is a pod, as Kubernetes knows it."""
    runtime = next(yaml.safe_load_all((DOCKER / "kubernetes" / "kserve.yaml").read_text()))
    cluster = yaml.safe_load((DOCKER / "kubernetes" / "ray.yaml").read_text())["spec"]
    groups = cluster["rayClusterConfig"]
    pods = {
        "kserve": {key: runtime["spec"][key] for key in ("containers", "volumes")},
        "head": groups["headGroupSpec"]["template"]["spec"],
        "worker": groups["workerGroupSpecs"][0]["template"]["spec"],
    }
    for name, spec in pods.items():
        path = tmp_path / f"{name}.yaml"
        pod = {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": name}, "spec": spec}
        path.write_text(yaml.safe_dump(pod))
        assert f"passed for resource pod/{name}" in judged("kubernetes-validate", "--strict", path)
