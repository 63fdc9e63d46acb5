"""What is not run is validated by those who know its schema, without a network."""

import subprocess
import sys
from pathlib import Path

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


def test_kubernetes():
    said = judged(
        "kubernetes-validate", "--strict", *sorted((DOCKER / "kubernetes").glob("*.yaml"))
    )
    for kind in ("deployment", "service", "poddisruptionbudget", "horizontalpodautoscaler"):
        assert f"passed for resource {kind}/rollcast" in said
