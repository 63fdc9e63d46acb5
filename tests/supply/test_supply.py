"""What the project is made of, what it loads, and what SECURITY.md says of it."""

import ast
import json
import re
import subprocess
import tomllib
from pathlib import Path
from pickle import UnpicklingError

import pytest
import torch

from training.baselines.vlstm import AlexNetEncoder

ROOT = Path(__file__).parents[2]
LOCK = tomllib.loads((ROOT / "uv.lock").read_text())
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
INDEX = "https://pypi.org/simple"
FILES = "https://files.pythonhosted.org/packages/"
OURS = {"rollcast", "rollcast-models"}
UV = ROOT / ".venv/uv/bin/uv"
MOST_ENVIRONMENTS = 6
PICKLES = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}
RESTRICTED = ("training/networks/imagenet.py",)
"""Modules whose unpickler finds nothing but the constructors of arrays
(tests/training/networks/test_vgg.py)."""
SHIPPED = ("rollcast", "service", "training")
LICENCES = re.compile(
    r"(Apache|MIT|BSD|ISC|Python|PSF|Mozilla Public License 2.0|MPL-2.0|HPND|Historical Permission"
    r"|zlib|Zlib|Unlicense|CC0|0BSD|Public Domain)"
)


def exported(*extras: str) -> dict[str, str]:
    """Return the locked requirement of every package of the extras, by name."""
    done = subprocess.run(
        [
            *(UV, "export", "--frozen", "--quiet", "--no-hashes", "--no-annotate", "--no-header"),
            *("--no-emit-project", *(part for extra in extras for part in ("--extra", extra))),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return {
        re.split(r"[=\[]", line, maxsplit=1)[0]: line
        for line in done.stdout.splitlines()
        if line and not line.startswith("#")
    }


def test_every_package_is_locked_by_hash():
    others = [package for package in LOCK["package"] if package["name"] not in OURS]
    assert len(others) > 200
    for package in others:
        files = [*package.get("wheels", []), *filter(None, [package.get("sdist")])]
        assert files, package["name"]
        for file in files:
            assert re.fullmatch(r"sha256:[0-9a-f]{64}", file["hash"]), file


def test_the_lock_names_the_public_index_alone():
    sources = {
        json.dumps(package["source"]) for package in LOCK["package"] if package["name"] not in OURS
    }
    assert sources == {json.dumps({"registry": INDEX})}
    addresses = re.findall(r"\w+://[^\"]*", (ROOT / "uv.lock").read_text())
    assert {address for address in addresses if not address.startswith(FILES)} == {INDEX}


def test_uv_is_locked_by_its_hashes():
    text = (ROOT / "tools/uv.txt").read_text()
    version = PROJECT["tool"]["uv"]["required-version"]
    assert re.findall(r"(?m)^([\w-]+==\S+)", text) == [f"uv{version}"]
    assert len(re.findall(r"--hash=sha256:[0-9a-f]{64}\b", text)) > 10
    assert f"UV_VERSION := {version.removeprefix('==')}\n" in (ROOT / "Makefile").read_text()


def test_the_lock_is_the_one_of_the_dependencies():
    """Compares names only, since resolving needs an index; ``make lock`` shows the rest."""
    (ours,) = (package for package in LOCK["package"] if package["name"] == "rollcast")
    assert set(ours["metadata"]["provides-extras"]) == set(
        PROJECT["project"]["optional-dependencies"]
    )
    groups = {
        name: sorted(re.split(r"[>=<;\[ ]", requirement, maxsplit=1)[0] for requirement in needed)
        for name, needed in PROJECT["dependency-groups"].items()
    }
    locked = {
        name: sorted(requirement["name"] for requirement in needed)
        for name, needed in ours["metadata"]["requires-dev"].items()
    }
    assert locked == groups


def test_no_cuda_comes_with_torch():
    """nvidia-ml-py, a requirement of BentoML, is a small reader of device statistics."""
    (torch_itself,) = (package for package in LOCK["package"] if package["name"] == "torch")
    assert f"torch=={torch_itself['version']}" in (ROOT / "pyproject.toml").read_text()
    needed = {dependency["name"] for dependency in torch_itself["dependencies"]}
    assert not {name for name in needed if name.startswith(("nvidia", "triton", "cuda"))}
    assert not [name for name in exported("training") if name.startswith(("nvidia", "cuda"))]


def test_the_service_has_neither_torch_nor_pybullet():
    assert not {"torch", "onnx", "pybullet", "ray"} & set(exported("service"))
    assert set(exported("service", "simulation")) - set(exported("service")) == {"pybullet"}


def test_environments_are_few():
    script = (ROOT / "tools/environment.sh").read_text()
    names = re.findall(r"(?m)^([\w.-]+)\) #", script)
    assert "service" in names
    assert len(names) <= MOST_ENVIRONMENTS
    used = {
        name
        for folder in ("docs", "tests", "tools", "training", "service", "rollcast")
        for path in (ROOT / folder).rglob("*.py")
        for name in re.findall(r"\.venv/([\w.-]*\w)", path.read_text())
    } | set(re.findall(r"\.venv/([\w.-]*\w)", (ROOT / "Makefile").read_text()))
    assert used - {"client", "uv", "uv.txt"} <= set(names)


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
            if str(path.relative_to(ROOT)) in RESTRICTED:
                continue
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
    locked = exported("service", "simulation")
    listed = {name.lower().replace("_", "-") for name, *_ in rows}
    assert listed <= set(locked)
    # Those for other systems or versions of Python are not installed here.
    assert all(" ; " in locked[name] for name in set(locked) - listed)
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
