"""``make fuzz``: every target for a number of executions, one after the other.

Each runs in a process of its own at low priority. Exits with 1 when one of them crashed, hung,
passed its memory limit or did not keep its memory. Prints a line a target, as in
``docs/reliability.md``.
"""

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

from rollcast import markdown

ROOT = Path(__file__).resolve().parents[2]
EXECUTIONS = {
    "manifest": 500_000,
    "tensors": 600_000,
    "multipart": 200_000,
    "frames": 300_000,
    "app": 100_000,
    "answer": 100_000,
    "cost": 100_000,
}
ALLOWED_GROWTH_MIB = 64.0
"""After the first quarter: libFuzzer's own corpus grows too, most at first."""


def fuzz(target: str, executions: int, folder: Path) -> bool:
    """Run one target; return whether all went well."""
    home = folder / target
    home.mkdir(parents=True, exist_ok=True)
    options = [f"-runs={executions}", "-seed=1"]
    command = ["nice", "-n", "15", sys.executable, "-m", "tests.fuzz.one", target, str(home)]
    with (home / "log").open("w") as log:
        ended = subprocess.run([*command, *options], cwd=ROOT, stdout=log, stderr=log, check=False)
    said = (home / "log").read_text(errors="replace")
    done = re.search(r"Done (\d+) runs in (\d+) second", said)
    runs, seconds = done.groups() if done else ("?", "?")
    covered = re.findall(r" cov: (\d+) ", said)[-1]
    memory = [mib for _, mib in json.loads((home / "memory.json").read_text())]
    early = memory[len(memory) // 4]
    well = ended.returncode == 0 and done and memory[-1] - early <= ALLOWED_GROWTH_MIB
    growth = f"{early:.0f} -> {memory[-1]:.0f} MiB"
    said = "none" if well else f"FAILED: {home}/log"
    print(markdown.row((target, runs, f"{seconds} s", covered, growth, said)), flush=True)
    if target == "cost" and (home / "cost.json").exists():
        _tell_costs(json.loads((home / "cost.json").read_text()))
    return bool(well)


def _tell_costs(worst: dict[str, dict[str, float]]) -> None:
    head = ("reader", "longest", "most memory", "µs a byte", "bytes a byte")
    rows = [
        (
            name,
            f"{1000 * found['seconds']:.0f} ms",
            f"{found['bytes'] / 2**20:.1f} MiB",
            f"{1e6 * found['seconds a byte']:.1f}",
            f"{found['bytes a byte']:.0f}",
        )
        for name, found in worst.items()
    ]
    print(markdown.table(head, rows), flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--targets", nargs="+", choices=list(EXECUTIONS), default=list(EXECUTIONS))
    parser.add_argument("--share", type=float, default=1.0, help="of the usual executions")
    parser.add_argument("--folder", type=Path, default=ROOT / "build/fuzz")
    given = parser.parse_args()
    counts = {target: int(given.share * EXECUTIONS[target]) for target in given.targets}
    well = [fuzz(target, count, given.folder) for target, count in counts.items()]
    return 0 if all(well) else 1


if __name__ == "__main__":
    sys.exit(main())
