"""``python -m service``: serve the models of this checkout."""

import argparse
import socket
import sys


def main() -> int:
    """Serve until stopped; return the exit code."""
    # Imported here because the process that simulates imports this module again.
    import uvicorn
    from pydantic import ValidationError

    from service.app import create_app
    from service.settings import Settings

    arguments = _parser().parse_args()
    host, port = arguments.host, arguments.port
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        app = create_app(Settings())
    except ValidationError as error:
        faults = [(*fault["loc"], fault["msg"]) for fault in error.errors()]
        return _fail("; ".join(": ".join(map(str, fault)) for fault in faults))
    try:
        listener = socket.create_server((host, port), family=family)
    except OSError as error:
        reason = str(error.strerror).partition(" (")[0]
        return _fail(f"cannot listen on {host}:{port}: {reason}; --port takes another one")
    with listener:
        # Inherited by every connection; asyncio leaves it out for a listener that it has not made,
        # and answers then wait 40 ms for an acknowledgement.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        port = listener.getsockname()[1]
        print(f"Rollcast listens on http://{host}:{port} (documentation: /docs)", flush=True)
        uvicorn.Server(uvicorn.Config(app)).run(sockets=[listener])
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m service",
        description="Serve the models of this checkout. Settings are environment variables "
        "ROLLCAST_NAME, described in service/settings.py.",
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address to listen on; 0.0.0.0 opens the service to the network (default: this "
        "machine alone)",
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


def _fail(reason: str) -> int:
    print(f"rollcast: {reason}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
