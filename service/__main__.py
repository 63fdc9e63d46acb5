"""``python -m service``: serve the models of this checkout, or of the package of models."""

import argparse
import ipaddress
import os
import socket
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from service.settings import Settings


def main() -> int:
    """Serve until stopped; return the exit code."""
    # Imported here because the process that simulates imports this module again.
    from pydantic import ValidationError

    from service.settings import Settings, described

    arguments = _parser(described()).parse_args()
    host, port = arguments.host, arguments.port
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        settings = Settings()
    except ValidationError as error:
        faults = [(*fault["loc"], fault["msg"]) for fault in error.errors()]
        return _fail("; ".join(": ".join(map(str, fault)) for fault in faults))
    except ValueError as error:
        return _fail(str(error))
    if settings.keys_file is None and not settings.allow_unauthenticated and not _is_loopback(host):
        return _fail(
            f"refuses to listen on {host} without API keys. Create a key file with python -m "
            "service.auth and set ROLLCAST_KEYS_FILE=keys.json, or allow unauthenticated "
            "requests: ROLLCAST_ALLOW_UNAUTHENTICATED=true"
        )
    try:
        listener = socket.create_server((host, port), family=family)
    except OSError as error:
        reason = str(error.strerror).partition(" (")[0]
        return _fail(f"cannot listen on {host}:{port}: {reason}; choose another port with --port")
    with listener:
        port = listener.getsockname()[1]
        print(f"Rollcast listens on http://{host}:{port} (documentation: /docs)", flush=True)
        # Inherited by every connection; asyncio leaves it out for those that it has not made, and
        # answers then wait 40 ms for an acknowledgement.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return _serve(settings, listener)


def _serve(settings: "Settings", listener: socket.socket) -> int:
    from service.settings import metrics_folder

    if settings.processes > 1:
        from service.process.supervisor import supervise

        return supervise(settings, listener)
    if (folder := metrics_folder()) is not None:
        from service.observability.shared_metrics import reserve_metrics

        try:
            reserve_metrics(folder, str(os.getpid()))
        except OSError as error:
            return _fail(f"no room for metrics in {folder}: {error.strerror}")
    from service.serving.loading import begin_loading

    load = begin_loading(settings.models_dir)
    # The web framework takes as long as the models: they load meanwhile, on another core.
    from service.process.server import make_server

    make_server(settings, load).run([listener])
    return 0


def _parser(settings: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m service",
        description="Serve the models of this checkout.",
        epilog="settings are environment variables, or the same names in lower case and without\n"
        "ROLLCAST_ in the TOML file that ROLLCAST_SETTINGS_FILE names:\n\n" + settings,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address to listen on; 0.0.0.0 opens the service to the network, which needs API keys "
        "or ROLLCAST_ALLOW_UNAUTHENTICATED=true (default: loopback only)",
    )
    parser.add_argument(
        "--port",
        type=_port,
        default=8000,
        help="port to listen on, 0 for a free one (default: 8000)",
    )
    return parser


def _port(text: str) -> int:
    port = int(text)
    if not 0 <= port < 2**16:
        raise ValueError
    return port


def _is_loopback(host: str) -> bool:
    """Return whether an address, or every address of a name, is a loopback address."""
    try:
        found = socket.getaddrinfo(host, None)
    except OSError:
        return True  # listening will tell what is wrong with it
    return all(ipaddress.ip_address(address[0]).is_loopback for *_, address in found)


def _fail(reason: str) -> int:
    from service.auth.api_keys import without_tokens

    print(f"rollcast: {without_tokens(reason)}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
