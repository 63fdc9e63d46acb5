"""``make mutate``: change the core line by line, and count the changes that the tests notice.

Cosmic Ray makes the changes; every one is tried in a process of its own, which imports the changed
module and runs the tests that belong to it. Prints a row a module, as in ``docs/reliability.md``,
and every change that was not noticed; exits with 1 below LEAST_SHARE.
"""

import argparse
import importlib.util
import io
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

from rollcast import markdown

ROOT = Path(__file__).resolve().parents[2]
LEAST_SHARE = 0.8
LONGEST_S = 20
MODULES = {
    "rollcast.camera": ["tests/rollcast/test_camera.py"],
    "rollcast.manifest": ["tests/rollcast/test_manifest.py"],
    "service.inference.rollout": ["tests/service/inference/test_rollout.py"],
    "service.http.problem_details": ["tests/service/http/test_problem_details.py"],
}
PYTEST_OPTIONS = (
    *("-x", "-q", "--tb=no", "-p", "no:cacheprovider", "--noconftest"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),
)
UNCHANGED = ("core/RemoveDecorator", "core/ReplaceBinaryOperator_BitOr")
"""Of types and their validators: the module cannot be imported any more, or nothing changes."""


@dataclass(frozen=True)
class Change:
    """One change of a module."""

    operator: str
    occurrence: int
    line: int
    source: str


def changes(path: Path) -> list[Change]:
    """Every change that Cosmic Ray knows of a module."""
    source = path.read_text()
    tree = get_ast(source)
    found: list[Change] = []
    for name in sorted(operator_names()):
        if name.startswith(UNCHANGED):
            continue
        operator = get_operator(name)
        if operator.arguments():
            continue  # names of variables
        instance = operator()
        places = [place for node in ast_nodes(tree) for place in instance.mutation_positions(node)]
        for occurrence, (start, _) in enumerate(places):
            changed = mutate_code(source, instance, occurrence)
            if changed is not None:
                found.append(Change(name, occurrence, start[0], changed))
    return found


class Changed(MetaPathFinder, Loader):
    """Gives one module another source."""

    def __init__(self, name: str, path: Path, source: str) -> None:
        self._name, self._path, self._source = name, path, source

    def find_spec(self, name: str, path: object, target: object = None) -> ModuleSpec | None:
        if name != self._name:
            return None
        return importlib.util.spec_from_file_location(name, self._path, loader=self)

    def exec_module(self, module: ModuleType) -> None:
        exec(compile(self._source, self._path, "exec"), module.__dict__)


def is_noticed(name: str, path: Path, source: str, tests: Sequence[str]) -> bool:
    """Run tests on a changed module in a process of its own."""
    child = os.fork()
    if child == 0:
        signal.alarm(LONGEST_S)
        sys.meta_path.insert(0, Changed(name, path, source))
        with redirect_stdout(io.StringIO()):
            silent = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            code = pytest.main([*PYTEST_OPTIONS, *tests])
        os._exit(int(code))
    return os.waitpid(child, 0)[1] != 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--modules", nargs="+", choices=list(MODULES), default=list(MODULES))
    given = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    _load_what_is_not_ours()
    tried = noticed = 0
    for name in given.modules:
        path = ROOT / f"{name.replace('.', '/')}.py"
        assert not is_noticed(name, path, path.read_text(), MODULES[name]), "its tests fail anyway"
        lines = path.read_text().splitlines()
        found = changes(path)
        missed = [c for c in found if not is_noticed(name, path, c.source, MODULES[name])]
        tried, noticed = tried + len(found), noticed + len(found) - len(missed)
        share = 1 - len(missed) / len(found)
        cells = (f"`{name}`", len(found), len(found) - len(missed), f"{100 * share:.1f} %")
        print(markdown.row(cells))
        for change in missed:
            print(f"    {change.line}: {change.operator}: {lines[change.line - 1].strip()}")
        sys.stdout.flush()
    print(markdown.row(("all", tried, noticed, f"{100 * noticed / tried:.1f} %")))
    return 0 if noticed / tried >= LEAST_SHARE else 1


def _load_what_is_not_ours() -> None:
    """Import, once for all, what takes most of the time."""
    import fastapi.testclient  # noqa: F401
    import hypothesis.extra.numpy
    import jaxtyping  # noqa: F401
    import numpy as np  # noqa: F401
    import pydantic  # noqa: F401

    with redirect_stdout(io.StringIO()):
        pytest.main([*PYTEST_OPTIONS, "--collect-only", "tests/mutation"])  # its plugins
    generated = (hypothesis.Phase.explicit, hypothesis.Phase.generate)  # none is made smaller
    hypothesis.settings.register_profile(
        "few", deadline=None, derandomize=True, max_examples=10, phases=generated
    )
    hypothesis.settings.load_profile("few")


if __name__ == "__main__":
    sys.exit(main())
