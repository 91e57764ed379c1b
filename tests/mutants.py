"""Spoil the package at one point after the other, chosen by a seed, and list what the quick tests do not notice.

    python tests/mutants.py --seed 1 --count 50

A point is a sign in a formula, a comparison, or a tolerance. Of each mutant the test files that import its module run,
until one test fails; with ``--against FILE`` the tests named there follow, so that two sets of tests are compared.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("model", "simulation", "verification", "proof", "branches")
SIGNS = {ast.Add: ("+", "-"), ast.Sub: ("-", "+")}
COMPARISONS = {ast.Lt: ("<", ">="), ast.LtE: ("<=", ">"), ast.Gt: (">", "<="), ast.GtE: (">=", "<")}
SMALL, FACTOR = 1e-2, 1e4
"""Named constants below the first are tolerances; a spoiled one is larger by the second."""
TIME_LIMIT = 1800


@dataclass(frozen=True)
class Mutant:
    """One change of one line of a file."""

    file: str
    line: int
    column: int
    old: str
    new: str

    @property
    def package(self) -> str:
        return self.file.split("/")[1]

    def apply(self, folder: Path) -> None:
        path = folder / self.file
        lines = path.read_text().splitlines(keepends=True)
        text = lines[self.line - 1]
        lines[self.line - 1] = text[: self.column] + self.new + text[self.column + len(self.old) :]
        path.write_text("".join(lines))

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column} {self.old} -> {self.new}"


def between(
    text: list[str], left: ast.expr, right: ast.expr, pair: tuple[str, str]
) -> Iterator[tuple[int, int, str, str]]:
    """Line and column of an operator between two operands on one line of ASCII."""
    line = text[left.end_lineno - 1]
    if left.end_lineno == right.lineno and line.isascii():
        column = line.find(pair[0], left.end_col_offset, right.col_offset)
        if column >= 0:
            yield left.end_lineno, column, *pair


def is_tolerance(constant: ast.Constant) -> bool:
    return isinstance(constant.value, float) and 0 < constant.value < SMALL


def mutants(file: Path) -> Iterator[Mutant]:
    """All mutants of a file."""
    text = file.read_text()
    lines, name = text.splitlines(), file.relative_to(ROOT).as_posix()
    for node in ast.walk(ast.parse(text)):
        found: Iterator[tuple[int, int, str, str]] = iter(())
        if isinstance(node, ast.BinOp) and type(node.op) in SIGNS:
            found = between(lines, node.left, node.right, SIGNS[type(node.op)])
        elif isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARISONS:
            found = between(lines, node.left, node.comparators[0], COMPARISONS[type(node.ops[0])])
        elif isinstance(node, ast.Assign) and isinstance(value := node.value, ast.Constant) and is_tolerance(value):
            old = lines[value.lineno - 1][value.col_offset : value.end_col_offset]
            found = iter([(value.lineno, value.col_offset, old, repr(value.value * FACTOR))])
        yield from (Mutant(name, *change) for change in found)


def chosen(seed: int, count: int) -> list[Mutant]:
    """Mutants of all packages, the same number of each."""
    rng, packages = random.Random(seed), []
    for package in PACKAGES:
        own = [mutant for file in sorted((ROOT / "gaitopt" / package).rglob("*.py")) for mutant in mutants(file)]
        packages.append(rng.sample(own, min(count, len(own))))
    return [mutant for turn in zip(*packages, strict=False) for mutant in turn][:count]


def test_files(mutant: Mutant) -> list[str]:
    """Test files that import the module, those in the folder of its package first."""
    module, package = mutant.file.removesuffix(".py").replace("/", "."), mutant.package
    importing = [p for p in sorted((ROOT / "tests").rglob("test_*.py")) if f"from {module} import" in p.read_text()]
    files = importing or sorted((ROOT / "tests" / package).glob("test_*.py"))
    return [str(p.relative_to(ROOT)) for p in sorted(files, key=lambda p: (p.parent.name != package, p.stat().st_size))]


def killed(folder: Path, tests: list[str], *options: str) -> str:
    """The first test that fails with the package in a folder, or nothing."""
    if not tests:
        return ""
    command = [sys.executable, "-P", "-m", "pytest", "-x", "-q", "-n", "0", "--no-header", "--tb=no", *options, *tests]
    environment = os.environ | {"PYTHONPATH": str(folder)}
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=TIME_LIMIT, check=False
        )
    except subprocess.TimeoutExpired:
        return "too slow"
    if done.returncode in (0, 5):  # all pass, or none is quick
        return ""
    return next((line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))), "ended")[:150]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="number of mutants to skip")
    parser.add_argument("--against", type=Path, help="file with tests, one a line, that may be marked slow")
    arguments = parser.parse_args()
    others = arguments.against.read_text().splitlines() if arguments.against else []
    for number, mutant in enumerate(chosen(arguments.seed, arguments.count)):
        if number < arguments.first:
            continue
        with tempfile.TemporaryDirectory() as scratch:
            shutil.copytree(ROOT / "gaitopt", Path(scratch) / "gaitopt")
            (Path(scratch) / "problems").symlink_to(ROOT / "problems")
            mutant.apply(Path(scratch))
            by = killed(Path(scratch), test_files(mutant))
            kept = by or killed(
                Path(scratch), [t for t in others if t.startswith(f"tests/{mutant.package}/")], "-m", ""
            )
        result = by or (f"SURVIVES, but {kept}" if kept else "SURVIVES")
        sys.stdout.write(f"{number} {mutant} | {result}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
