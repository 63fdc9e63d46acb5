"""``python -m service``: serve the models of this checkout."""

import argparse
import ipaddress
import socket
import sys


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
    if settings.keys_file is None and not settings.anonymous and not _is_loopback(host):
        return _fail(
            f"will not listen on {host} without API keys, for others may reach it. Name a file of "
            "keys (python -m service.keys makes it): ROLLCAST_KEYS_FILE=keys.json. Or let "
            "everybody ask: ROLLCAST_ANONYMOUS=true"
        )
    try:
        listener = socket.create_server((host, port), family=family)
    except OSError as error:
        reason = str(error.strerror).partition(" (")[0]
        return _fail(f"cannot listen on {host}:{port}: {reason}; --port takes another one")
    with listener:
        port = listener.getsockname()[1]
        print(f"Rollcast listens on http://{host}:{port} (documentation: /docs)", flush=True)
        from service.loading import begin_loading

        load = begin_loading(settings.models_dir)
        # The web framework takes as long as the models: they load meanwhile, on another core.
        from service.server import serve

        serve(settings, listener, load)
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
        "or ROLLCAST_ANONYMOUS=true (default: this machine alone)",
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
    """Whether an address, or every address of a name, is this machine's own."""
    try:
        found = socket.getaddrinfo(host, None)
    except OSError:
        return True  # listening will tell what is wrong with it
    return all(ipaddress.ip_address(address[0]).is_loopback for *_, address in found)


def _fail(reason: str) -> int:
    print(f"rollcast: {reason}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
