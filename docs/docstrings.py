"""Docstrings as the code has them become what docutils reads: small differences, mended here."""

import re
from collections.abc import Iterator
from itertools import pairwise

ATTRIBUTES = {"attribute", "data", "property"}


def mend(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:  # noqa: ARG001
    """Change a docstring in place; autodoc asks before napoleon does."""
    # Docutils takes NAME@VERSION for an address.
    lines[:] = [re.sub(r"(?<![`\w])\w+@\w+\b", r"``\g<0>``", line) for line in lines]
    if what in ATTRIBUTES:
        # Napoleon takes what stands before a colon in the first line for a type: an empty comment.
        lines[:0] = ["..", ""]
    elif what == "module":
        lines[:] = _literal_blocks(lines)


def _literal_blocks(lines: list[str]) -> Iterator[str]:
    """Mark trees of names, and code behind a colon, as blocks that are shown as they are."""
    in_tree = False
    following = [after for _, after in pairwise([*lines, ""])]
    for line, after in zip(lines, following, strict=True):
        if re.match(r"\* \w+$", line) and re.match(r" +[x+-] ", after):
            in_tree = True
            yield from ("::", "")
        in_tree = in_tree and bool(line)
        if in_tree:
            yield f"    {line}"
        elif line.endswith(":") and not line.startswith(" ") and not after:
            yield f"{line}:"
        else:
            yield line
