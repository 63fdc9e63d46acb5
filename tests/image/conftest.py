"""The images as `make image-test` builds and runs them, without a Docker engine."""

import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any

import pytest

from rollcast.client import Client
from tests.e2e.conftest import ROOT, said_address, serving, wait_until_ready

STORE = ROOT / ".images"
TOOLS = ("debootstrap", "buildah", "podman", "runc", "fuse-overlayfs")
SERVICE_IMAGE = "rollcast-service:test"
BASE = "docker.io/library/python:3.11-slim-bookworm"
# A network of the container's own would change that of the machine.
RUN = ("--runtime", "runc", "run", "--pull=never", "--network", "host")
HARDENED = (
    "--read-only", "--tmpfs", "/tmp", "--cap-drop", "all",
    "--security-opt", "no-new-privileges", "--ulimit", "nofile=4096:4096",
    "--ulimit", "nproc=4096:4096",
)  # fmt: skip


@dataclass(frozen=True)
class Images:
    """The store of images, and what runs them."""

    storage: str

    def podman(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run podman to its end; its exit status is the caller's matter."""
        return subprocess.run(
            [*self._podman, *arguments], stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip

    def inspect(self, name: str) -> Any:
        """What is known of an image."""
        return json.loads(self.podman("image", "inspect", name).stdout)[0]

    @contextmanager
    def serving(self, *options: str) -> Iterator[tuple[str, str]]:
        """Start the service's container, hardened; yield its name and its address."""
        command = (*options, SERVICE_IMAGE, "--host", "127.0.0.1", "--port", "0")
        with self.running(*command) as (name, output):
            address = said_address(output)
            with Client(address) as client:
                wait_until_ready(client)
            yield name, address

    @contextmanager
    def running(self, *options_image_and_command: str) -> Iterator[tuple[str, IO[str]]]:
        """Start a container, hardened; yield its name and what it says."""
        name = f"rollcast-test-{os.getpid()}-{time.monotonic_ns()}"
        started = ("--name", name, "--no-healthcheck")
        process = subprocess.Popen(
            [*self._podman, *RUN, *started, *HARDENED, *options_image_and_command],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        assert process.stdout is not None
        try:
            yield name, process.stdout
        finally:
            self.podman("rm", "--force", "--time", "5", name)
            process.communicate(timeout=30)

    @property
    def _podman(self) -> list[str]:
        return ["env", f"CONTAINERS_STORAGE_CONF={self.storage}", "podman"]


def build(name: str) -> Images:
    """Build an image of docker/; what was built before is taken from the store."""
    missing = [tool for tool in TOOLS if shutil.which(tool, path="/usr/sbin:/usr/bin") is None]
    if missing:
        pytest.fail(f"missing tools: {', '.join(missing)} (on Debian: apt-get install)")
    done = subprocess.run(
        [ROOT / "tools" / "image.sh", STORE, name],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return Images(done.stdout.strip())


@pytest.fixture(scope="session")
def service_images() -> Images:
    return build("service")


@pytest.fixture(scope="session")
def training_images() -> Images:
    return build("training")


@pytest.fixture(scope="session")
def ray_images() -> Images:
    return build("ray")


@pytest.fixture(scope="session")
def container(service_images) -> Iterator[tuple[str, str]]:
    """The service's image, serving: the container's name and the service's address."""
    with service_images.serving() as serving:
        yield serving


@pytest.fixture(scope="session")
def checkout() -> Iterator[str]:
    """The address of the server run from the checkout."""
    with serving() as address:
        yield address
