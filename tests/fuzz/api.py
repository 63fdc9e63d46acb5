"""``make fuzz-api``: schemathesis with all its checks on every route of the real service.

Twice: as everybody, and with a key of a service that asks for one.

Exits with 1 when a check failed, when an answer was 500 or when there were too few cases.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from rollcast.client import Client
from service.auth.api_keys import Key, KeyFile, digest, new_token
from tests.e2e.conftest import ROOT, start_service, stop_service, wait_until_ready

LEAST_CASES = 5000
SCHEMATHESIS = ROOT / ".venv/test/bin/schemathesis"
CONFIGURATION = Path(__file__).with_name("schemathesis.toml")
MOST_PIXELS = 2**18
"""Of a simulation: the bodies that are made up would mostly ask for very long ones."""


def statuses(report: Path) -> Counter[int]:
    """Count the answers of a run by their status."""
    found: Counter[int] = Counter()

    def look(node: object) -> None:
        if isinstance(node, dict):
            if isinstance(node.get("status_code"), int) and "headers" in node:
                found[node["status_code"]] += 1
            for value in node.values():
                look(value)
        elif isinstance(node, list):
            for value in node:
                look(value)

    for line in report.read_text().splitlines():
        look(json.loads(line))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--examples", type=int, default=250, help="of every route, at most")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "keys.json"
        token = new_token()
        key = Key(name="all", sha256=digest(token), scopes=("forecast", "manage", "metrics"))
        KeyFile(keys=(key,)).write(file)
        open_to_all = well(given.examples)
        guarded = well(given.examples, token, ROLLCAST_KEYS_FILE=str(file))
    return 0 if open_to_all and guarded else 1


def well(examples: int, token: str | None = None, **settings: str) -> bool:
    """Try a service with some settings; return whether every check passed."""
    limit = str(MOST_PIXELS)
    process, address = start_service(ROLLCAST_MAX_SIMULATED_PIXELS=limit, **settings)
    shown = () if token is None else ("--header", f"Authorization: Bearer {token}")
    try:
        with Client(address, api_key=token) as client:
            wait_until_ready(client)
        with tempfile.TemporaryDirectory() as scratch:
            report = Path(scratch) / "report.ndjson"
            command = [
                *(SCHEMATHESIS, "--config-file", CONFIGURATION, "run", f"{address}/openapi.json"),
                *(
                    "--checks",
                    "all",
                    "--max-examples",
                    str(examples),
                    "--continue-on-failure",
                ),
                *("--generation-deterministic", "--request-timeout", "60", "--warnings", "off"),
                *("--report", "ndjson", "--report-ndjson-path", report),
                *shown,
            ]
            ended = subprocess.run(command, cwd=scratch, check=False)
            told = statuses(report)
    finally:
        alive = process.poll() is None
        stop_service(process)
    cases = told.total()
    print(f"{cases} answers: {dict(sorted(told.items()))}")
    return ended.returncode == 0 and alive and cases >= LEAST_CASES and not told[500]


if __name__ == "__main__":
    sys.exit(main())
