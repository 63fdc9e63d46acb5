"""Every Python block of the README and the guide is clean under pyright's strict rules."""

import json
import subprocess
import sys

from tests.docs.blocks import ROOT, blocks

UNTYPED = ("matplotlib",)
"""Libraries without complete types: what they return is unknown to pyright, whoever calls them."""
UNKNOWN = ("reportUnknownMemberType", "reportUnknownArgumentType", "reportUnknownVariableType")


def test_python_is_typed_strictly(tmp_path):
    for block in blocks():
        if block.language == "python":
            rules = [f"{rule}=false" for rule in UNKNOWN] if imports_untyped(block.text) else []
            header = f"# pyright: strict{''.join(', ' + rule for rule in rules)}"
            name = f"{block.page.removesuffix('.md').replace('-', '_')}_{block.line}.py"
            (tmp_path / name).write_text(f"{header}\n{block.text}")
    settings = {
        "pythonVersion": "3.11",
        "venvPath": str(ROOT / ".venv"),
        "venv": "test",
        "extraPaths": [str(ROOT)],
        "reportMissingModuleSource": "none",
    }
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--project", tmp_path, "--outputjson"],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert found["summary"]["filesAnalyzed"] > 10
    assert [
        (one["file"], one["range"]["start"]["line"] + 1, one["message"])
        for one in found["generalDiagnostics"]
    ] == []


def imports_untyped(text):
    return any(f"import {name}" in text for name in UNTYPED)
