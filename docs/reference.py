"""Pages of the reference that are made from the code when the site is built.

The contract of the API, the settings, the errors and the model cards each have one home; here they
become Markdown. Nothing that this writes is committed (``docs/generated``).
"""

import json
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from sphinx.pycode import ModuleAnalyzer
from typer.testing import CliRunner

import rollcast.scene
import rollcast.schemas
import service.http.oip.schemas
from rollcast.__main__ import app as commands_app
from rollcast.markdown import table
from rollcast.schemas import SessionRequest, StreamDone, StreamStep, TickResponse
from service.errors import ServiceError
from service.settings import PREFIX, Settings

CONTRACT = "tests/contract/openapi.json"
BODIES = (rollcast.schemas, rollcast.scene, service.http.oip.schemas)
"""Modules whose classes are the schemas of the contract: they describe every field."""
FOLDER = "generated"
PARTS = "parts"
"""Of pages, which pages of the guide include."""
_PROTOCOL = "open inference protocol"
_HIDDEN = {"HTTPValidationError", "ValidationError", "JsonValue"}
"""Schemas that FastAPI adds; no answer of the service has them."""

Json = Mapping[str, Any]
Docs = Mapping[tuple[str, str], str]
"""What the code says of a field, by class and name."""


def package_version(pyproject: Path) -> str:
    """Return the version of the package."""
    return tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]["version"]


def write(root: Path, source: Path) -> None:
    """Write every page that is made from the code.

    Parameters
    ----------
    root
        The checkout.
    source
        Folder of the site's sources.
    """
    contract = json.loads((root / CONTRACT).read_text(encoding="utf-8"))
    docs = field_docs()
    streamed = described(StreamStep, StreamDone)
    pages = {
        f"{PARTS}/settings.md": settings(),
        f"{PARTS}/problems.md": problems(),
        f"{PARTS}/commands.md": commands(),
        f"{PARTS}/operations.md": operations(contract, protocol=False),
        f"{PARTS}/protocol.md": operations(contract, protocol=True),
        f"{PARTS}/schemas.md": schemas(contract, docs, protocol=False),
        f"{PARTS}/protocol-schemas.md": schemas(contract, docs, protocol=True),
        f"{PARTS}/events.md": "\n".join(
            _schema(name, schema, docs)
            for name, schema in streamed.items()
            if name not in contract["components"]["schemas"]
        ),
        f"{PARTS}/session.md": "\n".join(
            _schema(name, schema, docs)
            for name, schema in described(SessionRequest, TickResponse).items()
            if name not in contract["components"]["schemas"]
        ),
        **cards(root / "models"),
    }
    folder = source / FOLDER
    for name, text in pages.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        # A file that is written anew would be read anew.
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    for path in folder.rglob("*.md"):
        if str(path.relative_to(folder)) not in pages:
            path.unlink()


def settings() -> str:
    """Describe every setting of the service: its variable, its default, what it means."""
    rows = [
        (f"`{PREFIX}{name.upper()}`", _default(field), _one_line(field.description or ""))
        for name, field in Settings.model_fields.items()
    ]
    return table(("variable", "default", "meaning"), rows)


def _default(field: Any) -> str:  # noqa: ANN401
    if field.default_factory is not None:
        return "the cores"
    value = field.default
    return f"`{value.name}/`" if isinstance(value, Path) else f"`{json.dumps(value)}`"


def problems() -> str:
    """Describe every kind of problem document."""
    kinds = sorted(_heirs(ServiceError), key=lambda kind: (kind.status, kind.slug))
    rows = [
        (f"`/problems/{kind.slug}`", kind.status, kind.title, _one_line(kind.__doc__ or ""))
        for kind in kinds
    ]
    return table(("type", "status", "title", "when"), rows)


def _heirs(kind: type[ServiceError]) -> Iterator[type[ServiceError]]:
    for heir in kind.__subclasses__():
        yield heir
        yield from _heirs(heir)


def commands() -> str:
    """Return the help of every command of ``rollcast``."""
    names = [command.name for command in commands_app.registered_commands]
    parts: list[str] = []
    for words in ([], *([name] for name in names if name)):
        shown = CliRunner().invoke(commands_app, [*words, "--help"], terminal_width=92)
        parts += [f"## `{' '.join(['rollcast', *words])}`", "", "```text"]
        parts += [shown.output.strip(), "```", ""]
    return "\n".join(parts)


def field_docs() -> dict[tuple[str, str], str]:
    """Read what the code says of the fields of every body, its own and those that it inherits."""
    said: dict[tuple[str, str], str] = {}
    for module in BODIES:
        analyzer = ModuleAnalyzer.for_module(module.__name__)
        for place, lines in analyzer.find_attr_docs().items():
            said[place] = _one_line(" ".join(lines))
    kinds = {name: kind for module in BODIES for name, kind in vars(module).items()}
    return {
        (name, field): said[base.__name__, field]
        for name, kind in kinds.items()
        if isinstance(kind, type)
        for base in reversed(kind.__mro__)
        for owner, field in said
        if owner == base.__name__
    }


def operations(contract: Json, *, protocol: bool) -> str:
    """Describe the operations, of the Open Inference Protocol or all others."""
    parts: list[str] = []
    for path, methods in contract["paths"].items():
        for method, operation in methods.items():
            if (_PROTOCOL in operation["tags"]) == protocol:
                parts.append(_operation(method.upper(), path, operation))
    return "\n".join(parts)


def _operation(method: str, path: str, operation: Json) -> str:
    lines = [f"### `{method} {path}`", "", operation.get("description", ""), ""]
    rows: list[tuple[object, ...]] = []
    for parameter in operation.get("parameters", []):
        kind = _type(parameter["schema"])
        rows.append((parameter["in"], f"`{parameter['name']}`: {kind}"))
    body = operation.get("requestBody")
    if body is not None:
        rows.append(("body", _contents(body["content"])))
    answers: dict[str, list[str]] = {}
    for status, response in operation["responses"].items():
        # The protocol's own document says "default" for what its tables leave open, and FastAPI
        # names a body of its own for 422 that no answer has.
        if status != "default" and not _HIDDEN & set(_references(response)):
            content = _contents(response.get("content", {})) or response["description"]
            answers.setdefault(content, []).append(status)
    rows += [(", ".join(statuses), content) for content, statuses in answers.items()]
    lines += [table(("", "what"), rows), ""]
    return "\n".join(lines)


def _contents(content: Json) -> str:
    by_schema: dict[str, list[str]] = {}
    for media_type, body in content.items():
        by_schema.setdefault(_type(body.get("schema", {})), []).append(f"`{media_type}`")
    if "text/event-stream" in content:
        return "[events](#events-of-a-stream), `text/event-stream`"
    return "; ".join(
        f"{kind}, {' or '.join(types)}" if kind else " or ".join(types)
        for kind, types in by_schema.items()
    )


def schemas(contract: Json, docs: Docs, *, protocol: bool) -> str:
    """Describe the bodies, of the Open Inference Protocol or all others, field by field."""
    wanted = _used(contract, protocol=protocol)
    if protocol:
        wanted -= _used(contract, protocol=False)
    found: dict[str, Json] = contract["components"]["schemas"]
    return "\n".join(_schema(name, found[name], docs) for name in found if name in wanted)


def described(*bodies: type[BaseModel]) -> dict[str, Json]:
    """Return the schemas of events and messages, which the contract leaves out."""
    found: dict[str, Json] = {}
    for body in bodies:
        is_request = issubclass(body, rollcast.schemas.RequestBody)
        schema = body.model_json_schema(mode="validation" if is_request else "serialization")
        found |= {body.__name__: schema} | schema.pop("$defs", {})
    return found


def _used(contract: Json, *, protocol: bool) -> set[str]:
    """Return the schemas that some operations lead to."""
    waiting = [
        operation
        for methods in contract["paths"].values()
        for operation in methods.values()
        if (_PROTOCOL in operation["tags"]) == protocol
    ]
    used: set[str] = set()
    while waiting:
        for name in set(_references(waiting.pop())) - used - _HIDDEN:
            used.add(name)
            waiting.append(contract["components"]["schemas"][name])
    return used


def _references(node: object) -> Iterator[str]:
    match node:
        case dict():
            if isinstance(reference := node.get("$ref"), str):
                yield reference.rpartition("/")[2]
            for value in node.values():
                yield from _references(value)
        case list():
            for value in node:
                yield from _references(value)
        case _:
            pass


def _schema(name: str, schema: Json, docs: Docs) -> str:
    required = schema.get("required", [])
    rows = [
        (
            f"`{field}`",
            _type(kind) + ("" if field in required else _otherwise(kind)),
            docs.get((name, field)) or _one_line(kind.get("description", "")),
        )
        for field, kind in schema.get("properties", {}).items()
    ]
    lines = [f"({_label(name)})=", f"### {name}", "", _one_line(schema.get("description", "")), ""]
    if rows and not any(meaning for *_, meaning in rows):
        lines += [table(("field", "type"), [row[:2] for row in rows]), ""]
    elif rows:
        lines += [table(("field", "type", "meaning"), rows), ""]
    return "\n".join(lines)


def _label(schema: str) -> str:
    return f"schema-{schema.lower()}"


def _otherwise(kind: Json) -> str:
    return f"; default `{json.dumps(kind['default'])}`" if "default" in kind else "; optional"


def _type(schema: Json) -> str:
    """Say what a value may be, in words."""
    match schema:
        case {"$ref": str(reference)}:
            name = reference.rpartition("/")[2]
            return "any JSON value" if name in _HIDDEN else f"[{name}](#{_label(name)})"
        case {"anyOf": list(kinds)} | {"oneOf": list(kinds)}:
            return " or ".join(dict.fromkeys(_type(kind) for kind in kinds))
        case {"enum": list(values)}:
            return " or ".join(f"`{json.dumps(value)}`" for value in values)
        case {"const": value}:
            return f"`{json.dumps(value)}`"
        case {"type": "array", "prefixItems": list(kinds)}:
            parts = [_type(kind) for kind in kinds]
            if len(set(parts)) == 1:
                return f"{len(parts)} x {parts[0]}"
            return f"[{', '.join(parts)}]"
        case {"type": "array"}:
            return f"list of {_type(schema.get('items', {}))}{_limits(schema, 'Items')}"
        case {"type": "string", "contentEncoding": "base64"}:
            return "base64"
        case {"type": "null"}:
            return "null"
        case {"type": "object", "additionalProperties": dict(kind)} if kind:
            return f"object of {_type(kind)}"
        case {"type": str(name)}:
            return name + _limits(schema, "imum") + _limits(schema, "Length")
        case _:
            return ""


def _limits(schema: Json, what: str) -> str:
    """Say what bounds a number, a text's length or a list's."""
    lowest, highest = schema.get(f"min{what}"), schema.get(f"max{what}")
    over, under = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
    unit = " items" if what == "Items" else " characters" if what == "Length" else ""
    parts: list[str] = []
    if lowest is not None and lowest == highest:
        return f", {lowest}{unit}"
    if what == "imum" and over is not None:
        parts.append(f"over {over:g}")
    if what == "imum" and under is not None:
        parts.append(f"under {under:g}")
    if lowest is not None:
        parts.append(f"at least {_number(lowest)}")
    if highest is not None:
        parts.append(f"at most {_number(highest)}")
    return f", {' and '.join(parts)}{unit}" if parts else ""


def _number(value: float) -> str:
    """Write a bound; 2^53 - 1 is easier to read so."""
    return "2^53 - 1" if value == 2**53 - 1 else f"{value:g}"


def cards(models: Path) -> dict[str, str]:
    """Return the page of every model card, and the one that lists them."""
    folders = sorted(
        path.parent for path in models.glob("*/*/manifest.json") if path.parent.name.isdecimal()
    )
    pages: dict[str, str] = {}
    rows: list[tuple[object, ...]] = []
    for folder in folders:
        manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
        page = f"{manifest['name']}-{manifest['version']}"
        pages[f"models/{page}.md"] = (folder / "MODEL_CARD.md").read_text(encoding="utf-8")
        label = f"{manifest['name']}@{manifest['version']}"
        rows.append(
            (
                f"[{label}](models/{page}.md)",
                manifest["variant"],
                manifest["objects"],
                "4" if manifest["final_step"] is None else f"4, and step {manifest['final_step']}",
                manifest["trained_horizon"],
                manifest["covariance"]["source"],
                "yes" if manifest["default"] else "no",
                f"{sum(file.stat().st_size for file in folder.iterdir()) / 1e6:.1f}",
            )
        )
    head = (
        "model", "variant", "balls", "frames", "trained horizon", "covariance", "default", "MB",
    )  # fmt: skip
    hidden = "\n".join(["```{toctree}", ":hidden:", "", *(n[:-3] for n in pages), "```", ""])
    return {**pages, "models.md": f"# Model cards\n\n{_LEAD}\n\n{table(head, rows)}\n\n{hidden}"}


_LEAD = (
    "The card of each committed model states its training data, its errors on test scenes and "
    "the source of its uncertainty. A name without a version selects the default version. See "
    "[Networks](../guide/networks.md) for the architectures and [Results](../results.md) for a "
    "comparison."
)


def _one_line(text: str) -> str:
    return " ".join(text.split()).replace("``", "`")
