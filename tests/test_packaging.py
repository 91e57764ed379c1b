"""The package is what its pyproject, README and citation say it is."""

import ast
import re
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

import gaitopt
from gaitopt.engines.replay import ENGINES

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_public_name_and_no_other_is_listed_and_can_be_imported():
    for name in gaitopt.__all__:
        assert getattr(gaitopt, name).__module__.startswith("gaitopt.")
        assert find_spec(f"gaitopt.{name}") is None, "a package takes the name of a public function"
    assert dir(gaitopt) == sorted([*gaitopt.__all__, "__version__"])
    with pytest.raises(AttributeError, match=r"no attribute 'slove'.*solve"):
        gaitopt.slove  # noqa: B018 - the access is the test


@pytest.mark.parametrize("package", sorted((ROOT / "gaitopt").rglob("__init__.py")), ids=lambda p: p.parent.name)
def test_every_package_says_what_is_in_each_of_its_modules(package):
    words = set(re.findall(r"\w+", ast.get_docstring(ast.parse(package.read_text())) or ""))
    modules = {path.stem for path in package.parent.glob("[!_]*.py")}
    assert modules <= words or package.parent.name == "walkers"  # whose modules are named like their walkers


def test_nothing_imports_what_it_does_not_need():
    """Neither the package its modules, nor results and tables figures and statistics, nor figures a screen."""
    program = """
import sys
import gaitopt
assert not any(name.startswith("gaitopt.") for name in sys.modules)
gaitopt.Gait, gaitopt.Branch
import gaitopt.show.tables
assert not {"scipy", "matplotlib"} & {*sys.modules}
import gaitopt.show.catalogue
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", program], check=True)


OPTIONAL = {"heyoka", "flint", "pandas", "xarray", "IPython", "ipywidgets", "pydrake", "rockit", "mujoco", "pybullet"}
"""What an install without extras does not bring along."""


def test_an_install_without_extras_solves_and_verifies_and_only_engines_and_proofs_need_one(tmp_path):
    program = f"""
import importlib, sys
for name in {sorted(OPTIONAL)}:
    sys.modules[name] = None
from gaitopt.cli.main import main
code = main(["solve", "compass-passive-a", "--quiet", "-o", {str(tmp_path / "gait")!r}])
for name in sys.argv[1:]:
    importlib.import_module(name)
sys.exit(code)
"""
    modules = sorted(
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in (ROOT / "gaitopt").rglob("*.py")
        if path.parent.name != "proof" and not path.stem.startswith(("heyoka_", "__"))
        if path.parent.name != "engines" or path.stem not in ENGINES
    )
    assert len(modules) > 100
    subprocess.run([sys.executable, "-c", program, *modules], check=True)


def test_the_version_is_stated_alike_everywhere():
    assert f"\nversion: {gaitopt.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    heading = rf"^## \[{re.escape(gaitopt.__version__)}\] - (unreleased|\d{{4}}-\d\d-\d\d)$"
    assert re.search(heading, (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)


def test_the_readme_opens_with_the_two_commands():
    lines = re.findall(r"^    (.*)$", (ROOT / "README.md").read_text(), flags=re.MULTILINE)
    assert lines[:2] == [
        "pip install . && gaitopt solve compass-passive-a",
        "pip install '.[test]' && python -m pytest",
    ]


def test_the_wheel_takes_the_problems_along():
    assert PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"] == {
        "problems": "gaitopt/problem/catalogue"
    }


def test_the_conda_recipe_needs_what_the_package_needs():
    recipe = (ROOT / ".github" / "conda" / "meta.yaml").read_text().partition("\n  run:\n")[2].partition("\ntest:")[0]
    stated = {line.strip("- ").partition(" ")[0] for line in recipe.splitlines()} - {"python"}
    other_names = {"matplotlib": "matplotlib-base", "typing-extensions": "typing_extensions"}
    needed = {re.split("[>=]", each)[0] for each in PROJECT["project"]["dependencies"]}
    assert stated == {other_names.get(name, name) for name in needed}


def test_every_citation_of_the_paper_is_in_its_bibliography():
    folder = ROOT / "docs" / "paper"
    cited = set(re.findall(r"@([a-z]+\d{4})", (folder / "paper.md").read_text()))
    known = set(re.findall(r"^@\w+\{(\w+),", (folder / "paper.bib").read_text(), re.MULTILINE))
    assert cited <= known
    assert len((folder / "paper.md").read_text().split()) < 1300
