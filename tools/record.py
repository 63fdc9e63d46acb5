"""Run a command outside `make test` and record how it ended.

    python tools/record.py TARGET COMMAND...    runs the command and records its end
    python tools/record.py                      writes the table alone

`docs/schedule.json` has every target, when it runs, and its last result; the table in
`docs/reliability.md` is made from it. Needs no packages.
"""

import json
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

BEGIN = "<!-- schedule: tools/record.py -->"
END = "<!-- end of schedule -->"
HEAD = ("command", "runs", "its quick part in `make test`", "last result", "on", "commit", "took")
NOT_RECORDED = "not recorded yet"


def main(root: Path, words: list[str]) -> int:
    """Run and record; return the command's exit code."""
    file, page = root / "docs/schedule.json", root / "docs/reliability.md"
    code = 0
    if words:
        target, *command = words
        began = time.monotonic()
        code = subprocess.run(command, check=False).returncode
        schedule = json.loads(file.read_text("utf-8"))  # now: another run may have ended meanwhile
        schedule[target]["last"] = {
            "result": "passed" if code == 0 else "failed",
            "on": datetime.now(UTC).date().isoformat(),
            "commit": _commit(root),
            "minutes": round((time.monotonic() - began) / 60, 1),
        }
        file.write_text(json.dumps(schedule, indent=2) + "\n", "utf-8")
    text = page.read_text("utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    made = table(json.loads(file.read_text("utf-8")))
    page.write_text(f"{before}{BEGIN}\n\n{made}\n\n{END}{after}", "utf-8")
    return code


def table(schedule: dict[str, Any]) -> str:
    """Return the table, Markdown."""
    rows = [HEAD, ("---",) * len(HEAD)]
    for target, about in schedule.items():
        quick = ", ".join(f"`{path}`" for path in about["quick"])
        last = about.get("last")
        ended = (NOT_RECORDED, "", "", "")
        if last is not None:
            ended = (last["result"], last["on"], last["commit"], f"{last['minutes']:g} min")
        rows.append((f"`make {target}`", about["runs"], quick, *ended))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _commit(root: Path) -> str:
    """Return the commit of the checkout; a plus says that files have changed since."""

    def said(*words: str) -> str:
        git = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True)
        return git.stdout.strip()

    return said("rev-parse", "--short=8", "HEAD") + "+" * bool(said("status", "--short", "-uno"))


if __name__ == "__main__":
    sys.exit(main(Path(__file__).resolve().parents[1], sys.argv[1:]))
