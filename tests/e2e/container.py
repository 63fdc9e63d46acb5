"""``python -m tests.e2e.container``: run the service as its container would, and look at it.

Runs as root of a user namespace with a network of its own (``unshare``): the service gets a user
that no file knows and every address of a network that nobody else sees. Reads a ``World`` as JSON
from the standard input, writes ``Seen`` as JSON.
"""

import fcntl
import http.client
import json
import socket
import struct
import subprocess
import sys
import time
from dataclasses import asdict, dataclass

SIOCSIFFLAGS = 0x8914
UP_AND_RUNNING = 0x41
START_S = 90
PORT = 8000


@dataclass(frozen=True)
class World:
    """What a container is started with."""

    command: list[str]
    healthcheck: list[str]
    environment: dict[str, str]
    key: str | None = None
    user: int = 123456
    """A user without a name, in the group 0, as OpenShift gives them."""


@dataclass(frozen=True)
class Seen:
    """What was seen of it."""

    healthy: bool
    without_key: int
    with_key: int
    stopped: int
    said: str


def in_container(world: World, folder: str) -> Seen:
    """Run the service in a world; called in any process of the machine."""
    done = subprocess.run(
        ["unshare", "--user", "--map-root-user", "--net", sys.executable, "-m", __name__],
        input=json.dumps(asdict(world)),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        cwd=folder,
    )
    return Seen(**json.loads(done.stdout))


def main() -> None:
    """Run inside the namespace."""
    world = World(**json.loads(sys.stdin.read()))
    with socket.socket() as any_socket:
        fcntl.ioctl(any_socket, SIOCSIFFLAGS, struct.pack("16sh", b"lo", UP_AND_RUNNING))
    user = ["unshare", "--user", f"--map-user={world.user}", "--map-group=0"]

    def start(command: list[str]) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*user, *command],
            env=world.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    service = start(world.command)
    ends, healthy = time.monotonic() + START_S, False
    while not healthy and service.poll() is None and time.monotonic() < ends:
        check = start(world.healthcheck)
        check.communicate()
        healthy = check.returncode == 0
    ready = 503
    while healthy and ready == 503 and time.monotonic() < ends:
        ready = status("/health/ready")
    without_key, with_key = (status("/models", key) if healthy else 0 for key in (None, world.key))
    service.terminate()
    said, _ = service.communicate()
    seen = Seen(healthy and ready == 200, without_key, with_key, service.returncode, said[-2000:])
    print(json.dumps(asdict(seen)))


def status(path: str, key: str | None = None) -> int:
    """Ask the service; return the status of its answer."""
    connection = http.client.HTTPConnection("127.0.0.1", PORT, timeout=10)
    headers = {} if key is None else {"Authorization": f"Bearer {key}"}
    connection.request("GET", path, headers=headers)
    return connection.getresponse().status


if __name__ == "__main__":
    main()
