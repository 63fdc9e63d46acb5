"""Links between the committed documents, as they are read without the site."""

import pytest
from markdown_it import MarkdownIt

from tests.docs.blocks import ROOT

PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
MADE = ROOT / "docs/generated"


def targets(page):
    for token in MarkdownIt().enable("table").parse(page.read_text(encoding="utf-8")):
        for child in token.children or ():
            target = child.attrGet("href") or child.attrGet("src")
            if target and "://" not in target and not target.startswith(("#", "mailto:")):
                yield target.partition("#")[0]


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if MADE not in page.parents],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_links_lead_somewhere(page):
    for target in targets(page):
        path = (page.parent / target).resolve()
        assert path.exists() or MADE in path.parents, target
