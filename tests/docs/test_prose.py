"""Plain technical English: the component is the subject, and the field's terms are used.

``docs/glossary.md`` has the terms. Pages, settings, messages, help texts and docstrings are checked
for the words and the clauses that stood in for them.
"""

import ast
import re
import tokenize
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest

from service.settings import described
from tests.docs.blocks import ROOT

BANNED = re.compile(
    r"\b(somebody|nobody|whoever|everybody|may ask|what is asked|who asks|siblings|patience|crew"
    r"|doubts?|eyes?|stays put|half radi(us|i)|rig-\w+|(un)?familiar\w*|sighted|films?"
    r"|practi[cs]ed?)\b",
    re.IGNORECASE,
)
"""Words of a private language, and people in place of components."""
CLAUSES = re.compile(
    r"\b(what (is|was|are|were|has|the|it|they|comes?|goes|came|a|an|every|each|no|there|may)"
    r"|those (that|of which|who)|that which|whatever (is|was|comes|came|the)|(asks?|tells?) nobody"
    r"|has not the|so many as|as many as there are|is told of)\b",
    re.IGNORECASE,
)
"""Clauses in place of nouns."""
FORMER_WORDS = re.compile(
    r"(eyes?|(un)?familiar\w*|sighted|films?|perplexity|practi[cs]ed?|doubt(s|ed|ful)?|colours?"
    r"|rigs?|campaign|siblings?|crew|scenery|wish|keyring|mistakes?|dissect\w*|survey|taught|bend"
    r"|rehearsed?|arrivals|strangers?|stray|judged|proves|unhelped)"
)
"""Words in identifiers that have a term of the field instead."""
FORMER_NAMES = re.compile(
    r"([Ll]ooks?|[Rr]eadings?|Sight|Course|Encounters|Pace|Effort|Patience|Board|Held|Places|Rates"
    r"|Piece|Moment|Change|Among|Subject|Cell|Asked|Fault|lean|felt|measures|stays_put|line_px"
    r"|half_radi(us|i)|off_the_loop|side_by_side|may_pass|one_rests|guarded|identified|leads"
    r"|leader_first|helped)"
)
"""Whole identifiers that have a term of the field instead; as parts of others they are usual."""
FORMER_OPTIONS = re.compile(r"--(no-)?(every|slower|film|right|objects)")
"""Options of the command lines with a former name."""
SUBJECTLESS = re.compile(r"^(What|Who|That|Those|Whether|Of|Where)\b")
"""Beginnings of descriptions that lack a noun."""
NO_NOUN = re.compile(
    r"^(What|Who|Why|How|That|Those|Which|Whether|Where|When|If|Of|In|By|From|To|As|Between|After"
    r"|Beside|Before|Until|Over|With|Without|On|At|For|Beyond|See|It|Its|False|None|Added"
    r"|Returned|Makes|Reads|Raises|Runs|Turns|Keeps|Narrows|Ends|Called|The same)\b|^[^A-Z]",
)
"""Beginnings of attribute descriptions that are no noun: clauses, phrases, verbs, values."""
PAGES = [
    *(
        ROOT / f"{name}.md"
        for name in ("README", "ARCHITECTURE", "CHANGELOG", "CONTRIBUTING", "SECURITY")
    ),
    *(ROOT / "docs" / f"{name}.md" for name in ("index", "glossary", "benchmarks", "scaling")),
    ROOT / "docs" / "comparison.md",
    ROOT / "docs" / "reliability.md",
    ROOT / "docs" / "results.md",
    ROOT / "docs" / "reproduced.md",
    *sorted((ROOT / "docs" / "results").glob("*.md")),
    *sorted((ROOT / "docs" / "guide").glob("*.md")),
    *sorted((ROOT / "models").glob("*/*/MODEL_CARD.md")),
]
WIDTH = 120
"""Characters of a line of prose. Tables, links and generated text may be longer."""
NARROW = [
    *(ROOT / f"{name}.md" for name in ("README", "ARCHITECTURE", "CHANGELOG", "CONTRIBUTING")),
    ROOT / "SECURITY.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "guide").glob("*.md")),
]
SOURCES = ("rollcast", "service", "training")
CALLS = {"Option", "Argument", "Field", "add_argument", "Counter", "Gauge", "Histogram", "FastAPI"}
"""Functions whose string arguments users read."""
LOGGED = {"debug", "info", "warning", "error", "exception", "critical"}


class Text(NamedTuple):
    """A text in a source file."""

    file: str
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {' '.join(self.text.split())}"


def prose(page: Path) -> str:
    """Return a page without code, file names and targets of links."""
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"\]\([^)]*\)|`[^`]*`", "", text)


def sources() -> Iterator[tuple[str, ast.Module]]:
    for package in SOURCES:
        for path in sorted((ROOT / package).rglob("*.py")):
            yield path.relative_to(ROOT).as_posix(), ast.parse(path.read_text("utf-8"))


def literal(node: ast.AST) -> str | None:
    """Return a string literal, with the placeholders of an f-string left out."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(literal(part) or "" for part in node.values)
    return None


def messages() -> Iterator[Text]:
    """Yield texts that users read: of exceptions, help, metrics, descriptions and log lines."""
    for file, tree in sources():
        for node in ast.walk(tree):
            if isinstance(node, ast.Raise) and node.exc is not None:
                parts = ast.walk(node.exc)
            elif isinstance(node, ast.Call) and name_of(node.func) in CALLS | LOGGED:
                parts = ast.walk(node)
            else:
                continue
            for part in parts:
                if (text := literal(part)) and " " in text:
                    yield Text(file, node.lineno, text)


def name_of(function: ast.expr) -> str:
    match function:
        case ast.Attribute(attr=name) | ast.Name(id=name):
            return name
        case _:
            return ""


def docstrings() -> Iterator[Text]:
    """Yield docstrings of modules, classes and functions."""
    for file, tree in sources():
        for node in ast.walk(tree):
            if isinstance(
                node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
            ) and (text := ast.get_docstring(node)):
                yield Text(file, getattr(node, "lineno", 1), text)


def attribute_docs() -> Iterator[Text]:
    """Yield docstrings of attributes, constants and type aliases."""
    for file, tree in sources():
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef):
                for before, one in pairwise(node.body):
                    is_doc = isinstance(one, ast.Expr) and isinstance(
                        before, ast.Assign | ast.AnnAssign
                    )
                    if is_doc and (text := literal(one.value)):
                        yield Text(file, one.lineno, text)


def comments() -> Iterator[Text]:
    for package in SOURCES:
        for path in sorted((ROOT / package).rglob("*.py")):
            with path.open("rb") as file:
                for token in tokenize.tokenize(file.readline):
                    if token.type == tokenize.COMMENT:
                        yield Text(path.relative_to(ROOT).as_posix(), token.start[0], token.string)


def identifiers() -> Iterator[Text]:
    """Yield the names that are defined: classes, functions, parameters, attributes, variables.

    Options of the command lines are made of parameters, or are literals.
    """
    for file, tree in sources():
        for node in ast.walk(tree):
            match node:
                case ast.ClassDef(name=name) | ast.FunctionDef(name=name):
                    yield Text(file, node.lineno, name)
                case ast.AsyncFunctionDef(name=name) | ast.arg(arg=name):
                    yield Text(file, node.lineno, name)
                case ast.Attribute(attr=name, ctx=ast.Store()) | ast.Name(id=name, ctx=ast.Store()):
                    yield Text(file, node.lineno, name)
                case ast.Constant(value=str(value)) if re.fullmatch(r"(--[a-z-]+/?)+", value):
                    for option in value.split("/"):
                        yield Text(file, node.lineno, option)
                case _:
                    pass


def is_former(name: str) -> bool:
    """Return whether a name is one that the field's terms have replaced."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)
    return (
        any(FORMER_WORDS.fullmatch(word.lower()) for word in words)
        or FORMER_NAMES.fullmatch(name.strip("_")) is not None
        or FORMER_OPTIONS.fullmatch(name) is not None
    )


def headings(page: Path) -> str:
    return "\n".join(re.findall(r"^#+ .*$", prose(page), flags=re.MULTILINE))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_pages_use_the_fields_terms(page):
    assert not BANNED.findall(prose(page))
    assert not CLAUSES.findall(prose(page))


@pytest.mark.parametrize("page", NARROW, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_lines_of_prose_are_short(page):
    lines = page.read_text("utf-8").splitlines()
    assert [
        line for line in lines if len(line) > WIDTH and not line.startswith(("|", "<!--"))
    ] == []


CARDS = sorted((ROOT / "models").glob("*/*/MODEL_CARD.md"))


@pytest.mark.parametrize("card", CARDS, ids=lambda card: card.parent.relative_to(ROOT).as_posix())
def test_model_cards_name_architecture_and_supervision(card):
    (line,) = re.findall(r"^- Architecture: .*?(?=^- |^$)", card.read_text("utf-8"), re.M | re.S)
    assert "Supervision: " in line


def test_settings_use_the_fields_terms():
    assert not BANNED.findall(described())
    assert not CLAUSES.findall(described())


def test_attribute_docs_of_settings_do_not_begin_with_a_clause():
    for line in described().splitlines():
        assert not re.match(r"\s+(Whether|What|Who|That|Those)\b", line), line


def test_messages_use_the_fields_terms():
    found = list(messages())
    assert len(found) > 300
    assert [str(one) for one in found if BANNED.search(one.text)] == []
    assert [str(one) for one in found if CLAUSES.search(one.text)] == []


def test_docstrings_use_the_fields_terms():
    found = list(docstrings())
    assert len(found) > 1000
    assert [str(one) for one in found if BANNED.search(one.text)] == []
    assert [str(one) for one in found if CLAUSES.search(one.text)] == []


def test_comments_use_the_fields_terms():
    found = list(comments())
    assert len(found) > 300
    assert [str(one) for one in found if CLAUSES.search(one.text)] == []


def test_attribute_docs_begin_with_a_noun_and_use_the_fields_terms():
    found = list(attribute_docs())
    assert len(found) > 900
    assert [str(one) for one in found if BANNED.search(one.text)] == []
    assert [str(one) for one in found if NO_NOUN.search(one.text)] == []
    assert [str(one) for one in found if CLAUSES.search(one.text)] == []


def test_docstrings_of_the_package_and_the_service_begin_with_a_noun_or_a_verb():
    found = [one for one in docstrings() if not one.file.startswith("training")]
    assert [str(one) for one in found if SUBJECTLESS.match(one.text)] == []


def test_headings_of_the_experiments_use_the_fields_terms():
    assert not BANNED.findall(headings(ROOT / "docs" / "experiments.md"))


def test_identifiers_are_the_fields_terms():
    found = list(identifiers())
    assert len(found) > 10_000
    assert [str(one) for one in found if is_former(one.text)] == []


@pytest.mark.parametrize(
    ("name", "former"),
    [
        ("_SharedEye", True), ("first_doubt", True), ("FILMS", True), ("no_film", True),
        ("stays_put", True), ("_look", True), ("look_ahead", False), ("--slower", True),
        ("PerceptionOutput", False), ("Fault", True), ("colors", False),
    ],
)  # fmt: skip
def test_former_identifiers_are_recognised(name, former):
    assert is_former(name) == former
