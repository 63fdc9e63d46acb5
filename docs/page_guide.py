"""Pages of the guide as the demo page's service serves them: HTML files below service/static/guide.

python -m docs.page_guide

The service needs neither Sphinx nor a Markdown parser for them; a test compares them with their
sources.
"""

import re
from html import escape
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "docs/guide"
TARGET = ROOT / "service/static/guide"
PAGES = {
    "video": "Your own video",
    "reading": "Reading a forecast",
    "troubleshooting": "Troubleshooting",
}
"""Names of the pages and their titles in the navigation."""
PAGE = """\
<!doctype html>
<!-- Written by `python -m docs.page_guide` (`make format`) from docs/guide/{name}.md. -->
<html lang="en" data-theme="auto">
<head>
  <meta charset="utf-8">
  <meta name="viewport" content="width=device-width, initial-scale=1">
  <meta name="color-scheme" content="light dark">
  <title>{title} · Rollcast</title>
  <link rel="icon" href="../icon.svg" type="image/svg+xml">
  <link rel="stylesheet" href="../style/base.css">
  <link rel="stylesheet" href="../style/guide.css">
</head>
<body>
<nav aria-label="Guide">
  <a href="../../">Rollcast</a>
{links}
</nav>
<main>
{body}</main>
</body>
</html>
"""


def page(name: str) -> str:
    """Return a page as HTML."""
    text = _definitions_as_lists((SOURCE / f"{name}.md").read_text(encoding="utf-8"))
    markdown = MarkdownIt("commonmark", {"html": False}).enable("table")
    body = _with_anchors(_with_links(_without_pictures(markdown.render(text))))
    links = "\n".join(
        f'  <a href="{other}.html"{_current(other, name)}>{escape(title)}</a>'
        for other, title in PAGES.items()
    )
    return PAGE.format(name=name, title=escape(PAGES[name]), links=links, body=body)


def main() -> None:
    """Write all pages."""
    TARGET.mkdir(exist_ok=True)
    for name in PAGES:
        (TARGET / f"{name}.html").write_text(page(name), encoding="utf-8")


def _current(other: str, name: str) -> str:
    return ' aria-current="page"' if other == name else ""


def _definitions_as_lists(text: str) -> str:
    """Turn definition lists, which are none of CommonMark's, into lists: "- term: definition"."""
    return re.sub(r"^(?!- )(\S.*)\n: (?=\S)", r"- \1<br>: ", text, flags=re.MULTILINE).replace(
        "<br>: ", "\\\n  "
    )


def _without_pictures(html: str) -> str:
    """Leave pictures out: they are files of the documents."""
    return re.sub(r"<p><img [^>]*></p>\n", "", html)


def _with_links(html: str) -> str:
    """Lead links to the pages that are there, and make text of those to other documents."""

    def link(match: re.Match[str]) -> str:
        target, text = match.groups()
        name, dot, fragment = target.partition(".md")
        if dot and name in PAGES:
            return f'<a href="{name}.html{fragment}">{text}</a>'
        return match.group() if target.startswith("#") else text

    return re.sub(r'<a href="([^"]*)">(.*?)</a>', link, html, flags=re.DOTALL)


def _with_anchors(html: str) -> str:
    """Give headings the anchors that links name, and tables a box that scrolls."""

    def heading(match: re.Match[str]) -> str:
        level, text = match.groups()
        anchor = re.sub(r"[^\w -]", "", re.sub(r"<[^>]*>", "", text)).strip().lower()
        return f'<h{level} id="{anchor.replace(" ", "-")}">{text}</h{level}>'

    html = re.sub(r"<h([2-6])>(.*?)</h\1>", heading, html)
    box = '<div class="table-box" tabindex="0" role="region" aria-label="Table">'
    html = html.replace("<table>", f"{box}<table>").replace("</table>", "</table></div>")
    return html.replace("<pre>", '<pre tabindex="0">')


if __name__ == "__main__":
    main()
