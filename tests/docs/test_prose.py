"""Plain technical English: the component is the subject, and the field's terms are used.

``docs/glossary.md`` has the terms. The words below stood in messages and documents instead of them.
"""

import re

import pytest

from service.settings import described
from tests.docs.blocks import ROOT

BANNED = re.compile(
    r"\b(somebody|nobody|whoever|everybody|may ask|what is asked|who asks|siblings|patience|crew"
    r"|doubts?|the eye|stays put|half radi(us|i)|rig-\w+)\b",
    re.IGNORECASE,
)
PAGES = [
    ROOT / "README.md",
    ROOT / "ARCHITECTURE.md",
    ROOT / "docs" / "index.md",
    ROOT / "docs" / "glossary.md",
    *(
        ROOT / "docs" / "guide" / f"{name}.md"
        for name in ("networks", "physics", "reading", "start")
    ),
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_use_the_fields_terms(page):
    # File names and links to decision records keep their words.
    text = re.sub(r"\]\([^)]*\)|`[^`]*`", "", page.read_text("utf-8"))
    assert not BANNED.findall(text)


def test_settings_use_the_fields_terms():
    assert not BANNED.findall(described())


def test_attribute_docs_of_settings_do_not_begin_with_a_clause():
    for line in described().splitlines():
        assert not re.match(r"\s+(Whether|What|Who|That|Those)\b", line), line
