"""Markdown tables: the only place that writes them.

Columns are not padded, so that a changed figure changes one line of a page.
"""

from collections.abc import Iterable, Sequence


def table(head: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """Return a table of a head and rows of as many cells each.

    Raises
    ------
    ValueError
        When a row has another number of cells than the head.
    """
    lines = [header(head)]
    for cells in rows:
        if len(cells) != len(head):
            raise ValueError(f"a row of {len(cells)} cells under {len(head)} columns: {cells}")
        lines.append(row(cells))
    return "\n".join(lines)


def header(head: Sequence[object]) -> str:
    """Return the two lines that a table begins with."""
    return f"{row(head)}\n|{'---|' * len(head)}"


def row(cells: Iterable[object]) -> str:
    """Return one line; a bar inside a cell is escaped."""
    return f"| {' | '.join(str(cell).replace('|', chr(92) + '|') for cell in cells)} |"
