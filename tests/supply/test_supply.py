"""What the project is made of, what it loads, and what SECURITY.md says of it."""

import ast
import re
from pathlib import Path
from pickle import UnpicklingError

import pytest
import torch

from training.baselines.vlstm import AlexNetEncoder

ROOT = Path(__file__).parents[2]
LOCKS = sorted((ROOT / "requirements").glob("*.txt"))
UNHASHED = {"constraints-torch.txt"}
"""torch, of which every platform has a build of its own."""
PICKLES = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}
SHIPPED = ("rollcast", "service", "training")
LICENCES = re.compile(
    r"(Apache|MIT|BSD|ISC|Python|PSF|Mozilla Public License 2.0|MPL-2.0|HPND|Historical Permission"
    r"|zlib|Zlib|Unlicense|CC0|0BSD|Public Domain)"
)


@pytest.mark.parametrize("lock", LOCKS, ids=lambda path: path.name)
def test_every_package_is_locked_by_hash(lock: Path):
    if lock.name in UNHASHED:
        return
    packages = re.split(r"\n(?=\S)", re.sub(r"(?m)^\s*#.*\n", "", lock.read_text()).strip())
    assert packages
    for package in packages:
        assert re.match(r"\S+==\S+", package), package
        assert "--hash=sha256:" in package, package


def _calls() -> list[tuple[Path, ast.Call]]:
    return [
        (path, node)
        for folder in SHIPPED
        for path in (ROOT / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call)
    ]


def test_no_pickle_is_loaded():
    loads = 0
    for path, call in _calls():
        name = ast.unparse(call.func)
        given = {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords}
        if name == "torch.load":
            loads += 1
            assert given.get("weights_only") == "True", f"{path}:{call.lineno}"
        assert given.get("allow_pickle") in (None, "False"), f"{path}:{call.lineno}"
    assert loads
    for folder in SHIPPED:
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    names = {alias.name for alias in node.names}
                elif isinstance(node, ast.ImportFrom):
                    names = {node.module or ""}
                else:
                    continue
                assert not PICKLES & {name.partition(".")[0] for name in names}, path


class Harm:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self):
        return Path.touch, (self._path,)


def test_a_pickle_for_weights_is_refused_and_not_run(tmp_path):
    weights, left = tmp_path / "weights.pt", tmp_path / "left"
    torch.save({"features.3.weight": Harm(left)}, weights)
    with pytest.raises(UnpicklingError, match="weights_only"):
        AlexNetEncoder().load_imagenet(weights)
    assert not left.exists()


def test_every_licence_is_one_that_may_be_shipped():
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in (ROOT / "docs" / "licences.md").read_text().splitlines()
        if line.startswith("|")
    ][2:]
    lock = (ROOT / "requirements" / "service.txt").read_text()
    locked = {name.lower().replace("_", "-") for name in re.findall(r"(?m)^([\w.-]+)==", lock)}
    listed = {name.lower().replace("_", "-") for name, *_ in rows}
    assert listed <= locked
    # Those for other systems or versions of Python are not installed here.
    missing = locked - listed
    marked = {
        name.lower().replace("_", "-") for name in re.findall(r"(?m)^([\w.-]+)==\S+ ; ", lock)
    }
    assert missing <= marked
    for name, _, licence, *_ in rows:
        assert LICENCES.search(licence), f"{name}: {licence}"


def test_what_security_md_names_is_there():
    text = (ROOT / "SECURITY.md").read_text()
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", text)
    assert len(named) > 20
    for file, test in named:
        functions = {
            node.name
            for node in ast.walk(ast.parse((ROOT / file).read_text()))
            if isinstance(node, ast.FunctionDef)
        }
        assert test in functions, f"{file}::{test}"
