"""The README's table is made from the committed models, not typed."""

from pathlib import Path

import pytest

from rollcast.manifest import MANIFEST_FILE, Manifest
from training.reporting.markdown import overview, with_results
from training.reporting.results import committed

ROOT = Path(__file__).parents[3]


def test_the_readme_holds_the_committed_models_figures():
    folders = committed(ROOT / "models")
    manifests = [Manifest.read(folder / MANIFEST_FILE) for folder in folders]
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert with_results(text, manifests) == text
    posnet = next(manifest for manifest in manifests if manifest.name == "posnet")
    row = next(row for row in posnet.metrics if row.split == "test" and row.horizon == 20)
    line = next(
        line
        for line in overview(manifests).splitlines()
        if line.startswith(f"| {row.scenario} ({row.sequences}) |")
    )
    assert f"| {row.position_error_px:.1f} |" in line


def test_a_text_without_marks_is_refused():
    with pytest.raises(ValueError, match="lacks"):
        with_results("# Rollcast", [])
