"""No module imports one that imports it, within packages too; import-linter compares packages only.

Imports within functions and for annotations count: a circle that is hidden from Python is still one for a reader.
"""

import ast
import re
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "gaitopt"


def imported(source: str, known: frozenset[str], package: str = "gaitopt") -> Iterator[str]:
    """The modules of a package that a source imports anywhere, by their names within the package."""
    for node in ast.walk(ast.parse(source)):
        names = list[str]()
        if isinstance(node, ast.ImportFrom) and node.module is not None and node.level == 0:
            names = [f"{node.module}.{alias.name}" for alias in node.names] + [node.module]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        yield from known & {name.removeprefix(f"{package}.") for name in names}


def import_graph(sources: Mapping[str, str]) -> dict[str, set[str]]:
    """The modules that each module imports."""
    known = frozenset(sources)
    return {name: set(imported(source, known)) - {name} for name, source in sources.items()}


def circle(graph: Mapping[str, set[str]]) -> list[str]:
    """The modules of a circle in order; none if there is no circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    sources = {
        ".".join(path.relative_to(PACKAGE).with_suffix("").parts): path.read_text(encoding="utf-8")
        for path in PACKAGE.rglob("*.py")
        if path.name != "__init__.py"
    }
    return import_graph(sources)


def test_no_module_imports_one_that_imports_it(graph: dict[str, set[str]]) -> None:
    assert not circle(graph), "move what both modules need to one of its own"


def test_a_circle_that_python_does_not_notice_is_found() -> None:
    hidden = "def f():\n    from gaitopt.model.first import g\n"
    assert set(circle(import_graph({"model.first": "import gaitopt.model.second", "model.second": hidden}))) == {
        "model.first",
        "model.second",
    }
    typed = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from gaitopt.model import first\n"
    assert circle(import_graph({"model.first": "from gaitopt.model.second import g", "model.second": typed}))
    assert not circle(import_graph({"model.first": "import gaitopt.model.second", "model.second": "import math"}))


@pytest.mark.parametrize("folder", sorted(path.parent for path in PACKAGE.rglob("__init__.py")), ids=lambda p: p.name)
def test_every_package_says_what_is_in_each_of_its_modules(folder):
    words = set(re.findall(r"\w+", ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""))
    modules = {path.stem for path in folder.glob("[!_]*.py")}
    assert modules <= words or folder.name == "walkers"  # whose modules are named like their walkers
