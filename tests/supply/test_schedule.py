"""Commands outside ``make test`` are on the schedule, and it records how they end."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.blocks import ROOT

SCHEDULE = ROOT / "docs/schedule.json"
PAGE = ROOT / "docs/reliability.md"
RECORD = ROOT / "tools/record.py"


def recorded_targets() -> list[str]:
    return re.findall(r"\$\(call recorded,([a-z-]+),", (ROOT / "Makefile").read_text("utf-8"))


def test_every_command_is_on_the_schedule_with_a_quick_part():
    schedule = json.loads(SCHEDULE.read_text("utf-8"))
    assert sorted(schedule) == sorted(recorded_targets())
    outside = ("tests/image", "tests/cluster", "tests/browser")
    for about in schedule.values():
        assert about["runs"]
        assert about["quick"]
        for path in about["quick"]:
            assert (ROOT / path).exists(), path
            assert not path.startswith(outside), f"make test does not run {path}"


def test_what_is_said_to_run_in_ci_runs_there():
    script = (ROOT / ".ci/run").read_text("utf-8")
    for target, about in json.loads(SCHEDULE.read_text("utf-8")).items():
        if "CI" in about["runs"]:
            assert f"make {target}" in script, target


def test_the_tests_that_the_page_names_exist():
    named = set(re.findall(r"\btest_\w+\.py", PAGE.read_text("utf-8")))
    assert len(named) > 30
    assert sorted(named - {path.name for path in (ROOT / "tests").rglob("test_*.py")}) == []


@pytest.fixture
def checkout(tmp_path) -> Path:
    for path in (SCHEDULE, PAGE, RECORD):
        place = tmp_path / path.relative_to(ROOT)
        place.parent.mkdir(exist_ok=True)
        shutil.copy(path, place)
    return tmp_path


def record(checkout: Path, *words: str) -> int:
    return subprocess.run(
        [sys.executable, checkout / "tools/record.py", *words], check=False
    ).returncode


def test_the_page_has_the_table_of_the_schedule(checkout):
    assert record(checkout) == 0
    assert (checkout / "docs/reliability.md").read_text("utf-8") == PAGE.read_text("utf-8")


@pytest.mark.parametrize(("code", "result"), [(0, "passed"), (3, "failed")])
def test_the_end_of_a_command_is_recorded(checkout, code, result):
    assert record(checkout, "soak", sys.executable, "-c", f"raise SystemExit({code})") == code
    last = json.loads((checkout / "docs/schedule.json").read_text("utf-8"))["soak"]["last"]
    assert last["result"] == result
    page = (checkout / "docs/reliability.md").read_text("utf-8")
    (row,) = re.findall(r"^\| `make soak` .*", page, re.MULTILINE)
    assert f"| {result} | {last['on']} |" in row
