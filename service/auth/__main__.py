"""``python -m service.auth``: make, list and remove API keys."""

import argparse
import sys
from datetime import date
from pathlib import Path

from service.auth.api_keys import SCOPES, Key, KeyFile, digest, exclusively, new_token


def main() -> int:
    """Run one command; return the exit code."""
    arguments = _parser().parse_args()
    path: Path = arguments.file
    try:
        with exclusively(path):
            known = KeyFile.read(path) if path.exists() else KeyFile()
            return arguments.run(arguments, known, path)
    except (OSError, ValueError) as error:
        print(f"rollcast: {path}: {error}", file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m service.auth",
        description="Create, list and remove the API keys in a key file. A service with "
        "ROLLCAST_KEYS_FILE=FILE requires one of them (Authorization: Bearer KEY) and reloads "
        "the file when it changes.",
    )
    parser.add_argument("--file", type=Path, required=True, help="key file (JSON)")
    commands = parser.add_subparsers(required=True)
    add = commands.add_parser(
        "add", help="create a key and print it once; the file stores only its hash"
    )
    add.add_argument("name", help="name of the key: letters, digits, dot, dash, underscore")
    add.add_argument(
        "--scope", dest="scopes", action="append", choices=SCOPES,
        help="forecast (default), manage (load and unload models), metrics; repeat it for several",
    )  # fmt: skip
    add.add_argument(
        "--expires",
        type=date.fromisoformat,
        metavar="YYYY-MM-DD",
        help="last day on which the key is valid",
    )
    add.set_defaults(run=_add)
    listed = commands.add_parser("list", help="list names, scopes and expiry")
    listed.set_defaults(run=_list)
    remove = commands.add_parser(
        "remove", help="remove a key; the service rejects it within a second"
    )
    remove.add_argument("name")
    remove.set_defaults(run=_remove)
    return parser


def _add(arguments: argparse.Namespace, known: KeyFile, path: Path) -> int:
    if any(key.name == arguments.name for key in known.keys):
        return _fail(f"{path} has a key {arguments.name!r} already")
    token = new_token()
    key = Key(
        name=arguments.name,
        sha256=digest(token),
        scopes=tuple(dict.fromkeys(arguments.scopes or ("forecast",))),
        expires=arguments.expires,
    )
    KeyFile(keys=(*known.keys, key)).write(path)
    print(token)
    return 0


def _list(_: argparse.Namespace, known: KeyFile, __: Path) -> int:
    for key in known.keys:
        until = "" if key.expires is None else f", until {key.expires}"
        print(f"{key.name}: {', '.join(key.scopes)}{until}")
    return 0


def _remove(arguments: argparse.Namespace, known: KeyFile, path: Path) -> int:
    kept = tuple(key for key in known.keys if key.name != arguments.name)
    if len(kept) == len(known.keys):
        return _fail(f"{path} has no key {arguments.name!r}")
    KeyFile(keys=kept).write(path)
    return 0


def _fail(reason: str) -> int:
    print(f"rollcast: {reason}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
