"""The command line of the service."""

import ipaddress
import os
import socket
from typing import Annotated

import typer
from pydantic import ValidationError

from service.auth.api_keys import without_tokens
from service.settings import (
    CPU_PROVIDER,
    Settings,
    described,
    keep_products_on_one_thread,
    metrics_folder,
)

SETTINGS = """\
Settings are environment variables, or the same names in lower case and without ROLLCAST_ in the
TOML file that ROLLCAST_SETTINGS_FILE names:
"""


def application() -> typer.Typer:
    """Return the command, whose help describes every setting."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    app.command(
        epilog=f"{SETTINGS}\n\b\n{described()}",
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    )(serve)
    return app


def serve(
    host: Annotated[
        str,
        typer.Option(
            metavar="HOST",
            help="address to listen on; 0.0.0.0 opens the service to the network, which requires "
            "API keys or ROLLCAST_ALLOW_UNAUTHENTICATED=true",
        ),
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(metavar="PORT", min=0, max=2**16 - 1, help="port, 0 for a free one")
    ] = 8000,
) -> None:
    """Serve the models of this checkout until stopped."""
    keep_products_on_one_thread()
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        settings = Settings()
    except ValidationError as error:
        faults = [(*fault["loc"], fault["msg"]) for fault in error.errors()]
        raise _failure("; ".join(": ".join(map(str, fault)) for fault in faults)) from error
    except ValueError as error:
        raise _failure(str(error)) from error
    if settings.keys_file is None and not settings.allow_unauthenticated and not _is_loopback(host):
        raise _failure(
            f"refuses to listen on {host} without API keys. Create a key file with python -m "
            "service.auth and set ROLLCAST_KEYS_FILE=keys.json, or allow unauthenticated "
            "requests: ROLLCAST_ALLOW_UNAUTHENTICATED=true"
        )
    try:
        listener = socket.create_server((host, port), family=family)
    except OSError as error:
        reason = str(error.strerror).partition(" (")[0]
        raise _failure(
            f"cannot listen on {host}:{port}: {reason}; choose another port with --port"
        ) from error
    with listener:
        port = listener.getsockname()[1]
        typer.echo(f"Rollcast listens on http://{host}:{port} (documentation: /docs)")
        # Inherited by every connection. asyncio does not set it with a listener that it has
        # not created, and responses then wait 40 ms for an acknowledgement.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            code = _serve(settings, listener)
        except KeyboardInterrupt:  # uvicorn raises the signal again after it has stopped
            code = 0
        raise typer.Exit(code)


def _serve(settings: Settings, listener: socket.socket) -> int:
    if settings.execution_provider != CPU_PROVIDER:
        from service.inference.onnx_runtime import check_provider

        try:
            check_provider(settings.execution_provider)
        except ValueError as error:
            raise _failure(str(error)) from error
    if settings.processes > 1:
        from service.process.supervisor import supervise

        return supervise(settings, listener)
    if (folder := metrics_folder()) is not None:
        from service.observability.shared_metrics import reserve_metrics

        try:
            reserve_metrics(folder, str(os.getpid()))
        except OSError as error:
            raise _failure(f"no room for metrics in {folder}: {error.strerror}") from error
    from service.serving.loading import begin_loading

    load = begin_loading(settings.models_dir, settings.execution_provider)
    # The web framework takes as long as the models: they load meanwhile, on another core.
    from service.process.server import make_server

    make_server(settings, load).run([listener])
    return 0


def _is_loopback(host: str) -> bool:
    """Return whether an address, or every address of a name, is a loopback address."""
    try:
        found = socket.getaddrinfo(host, None)
    except OSError:
        return True  # listening reports the error
    return all(ipaddress.ip_address(address[0]).is_loopback for *_, address in found)


def _failure(reason: str) -> typer.Exit:
    """Print the reason of a failure; return the exception that ends the command."""
    typer.echo(f"rollcast: {without_tokens(reason)}", err=True)
    return typer.Exit(1)
