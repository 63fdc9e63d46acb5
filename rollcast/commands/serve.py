"""``rollcast serve``: the service of a checkout, or how to get one."""

import os
import sys
from importlib.util import find_spec
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

import typer

from rollcast.commands.options import CommandError, Outcome, whole_number

HELP = """\
Serve the models of this checkout until stopped.

The package does not include the service and the models: outside a checkout, the command prints
how to start the container, and the exit code is 1. `python -m service --help` describes every
setting.

\b
Examples:
  rollcast serve
  rollcast serve --port 9000
"""
IMAGE = "rollcast-service:0.1.0"
KEYS = (
    'API keys are made with docker run --rm --user "$(id -u):$(id -g)" -v ./keys:/keys '
    f"--entrypoint python {IMAGE} -m service.auth --file /keys/keys.json add NAME"
)
CHECKOUT = Path(__file__).resolve().parents[2]


def serve(
    host: Annotated[
        str,
        typer.Option(
            metavar="HOST", help="address to listen on; 0.0.0.0 opens the service to the network"
        ),
    ] = "127.0.0.1",
    port: Annotated[
        int,
        typer.Option(
            parser=whole_number(0, 2**16 - 1), metavar="PORT", help="port, 0 for a free one"
        ),
    ] = 8000,
) -> Outcome:
    """Become the service, if it is here."""
    if is_checkout(CHECKOUT):
        python = _python(CHECKOUT)
        os.chdir(CHECKOUT)
        os.execv(python, [python, "-m", "service", "--host", host, "--port", str(port)])
    return Outcome(
        container_command(host, port),
        [
            "the service is not part of the package; start its container with the command below, "
            f"after building it in a checkout with docker build -f docker/service.Dockerfile -t "
            f"{IMAGE} ." + ("" if _is_loopback(host) else f"; {KEYS}")
        ],
        code=1,
    )


def is_checkout(root: Path) -> bool:
    """Return whether the service lies beside the package."""
    return (root / "service" / "__main__.py").is_file()


def container_command(host: str, port: int) -> str:
    """Return the command that starts the service's container.

    Where others reach it, it asks for the API keys of ./keys; that needs the user who made them.
    """
    if _is_loopback(host):
        access = "-e ROLLCAST_ALLOW_UNAUTHENTICATED=true"
    else:
        access = (
            '--user "$(id -u):$(id -g)" -v ./keys:/keys:ro -e ROLLCAST_KEYS_FILE=/keys/keys.json'
        )
    shown = f"[{host}]" if ":" in host else host
    published = f"-p {shown}:{port}:8000"
    return f"docker run --rm --read-only --tmpfs /tmp {access} {published} {IMAGE}"


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _python(root: Path) -> str:
    """Return an interpreter with the packages of the service."""
    made = root / ".venv" / "service" / "bin" / "python"
    if made.is_file():
        return str(made)
    if find_spec("fastapi") and find_spec("onnxruntime"):
        return sys.executable
    raise CommandError(
        "the service's packages are not installed; make serve installs them and serves"
    )
