"""``rollcast serve``: the service of a checkout or of installed packages, or how to get one."""

import os
import sys
from importlib.util import find_spec
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

import typer

from rollcast.commands.options import CommandError, Outcome, whole_number

HELP = """\
Serve the models until stopped: those of this checkout, or of the package rollcast-models.

Outside a checkout, the extra serve installs what the service needs and the models. Without it, the
command prints how to start the container, and the exit code is 1. `python -m service --help`
describes every setting.

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
PACKAGES = Path(__file__).resolve().parents[2]
"""Folder of ``rollcast`` and ``service``: a checkout, or that of installed packages."""


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
    python = service_python(PACKAGES)
    if python is not None:
        if is_checkout(PACKAGES):
            os.chdir(PACKAGES)
        os.execv(python, [python, "-m", "service", "--host", host, "--port", str(port)])
    if is_checkout(PACKAGES):
        raise CommandError(
            "the service's packages are not installed; make serve installs them and serves"
        )
    return Outcome(
        container_command(host, port),
        [
            "the service's packages are not installed: pip install 'rollcast[serve]' installs them "
            "and the models. Or start the container with the command below, after building it in a "
            f"checkout with docker build -f docker/service.Dockerfile -t {IMAGE} ."
            + ("" if _is_loopback(host) else f"; {KEYS}")
        ],
        code=1,
    )


def is_checkout(root: Path) -> bool:
    """Return whether a folder is that of the project, not one of installed packages."""
    return (root / "pyproject.toml").is_file()


def service_python(root: Path) -> str | None:
    """Return an interpreter with the packages of the service, if there is one.

    Parameters
    ----------
    root
        Folder of the packages.
    """
    made = root / ".venv" / "service" / "bin" / "python"
    if made.is_file():
        return str(made)
    needed = ("service", "fastapi", "onnxruntime")
    return sys.executable if all(map(find_spec, needed)) else None


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
