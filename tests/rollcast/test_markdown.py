"""Markdown tables, read again by a parser of Markdown."""

import pytest
from markdown_it import MarkdownIt

from rollcast.markdown import table


def cells(text: str) -> list[str]:
    """Return the text of every cell, in order."""
    tokens = MarkdownIt("commonmark").enable("table").parse(text)
    inline = [token for token in tokens if token.type == "inline"]
    return ["".join(child.content for child in token.children or []) for token in inline]


def test_a_parser_reads_every_cell_as_it_was_given():
    text = table(("a", "b | c"), [(1, "x|y"), ("", "**no**")])
    assert cells(text) == ["a", "b | c", "1", "x|y", "", "no"]
    assert text.splitlines()[:2] == ["| a | b \\| c |", "|---|---|"]


def test_a_row_of_another_length_is_an_error():
    with pytest.raises(ValueError, match="3 cells under 2 columns"):
        table(("a", "b"), [(1, 2, 3)])
