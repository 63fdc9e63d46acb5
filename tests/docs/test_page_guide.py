"""The guide that the service serves is the guide of the documents."""

import re

import pytest

from docs.page_guide import PAGES, TARGET, page


@pytest.mark.parametrize("name", PAGES)
def test_the_served_page_is_written_from_the_guide(name):
    assert (TARGET / f"{name}.html").read_text("utf-8") == page(name), "run make format"


def test_no_other_file_is_served():
    assert {path.stem for path in TARGET.iterdir()} == set(PAGES)


@pytest.mark.parametrize("name", PAGES)
def test_links_lead_to_pages_and_headings_that_are_there(name):
    targets = re.findall(r'<a href="([^"]+)"', page(name))
    own = [target for target in targets if not target.startswith(("http", "../"))]
    assert own
    for target in own:
        file, _, anchor = target.partition("#")
        text = (TARGET / file).read_text("utf-8") if file else page(name)
        assert not anchor or f'id="{anchor}"' in text, target
    assert ".md" not in "".join(targets)
