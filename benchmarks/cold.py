"""Whole processes, imports and all, and what they and the installation weigh."""

import os
import resource
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from timing import Row

PROBLEM = "compass-passive-a"
RUNS = 5


def rows() -> list[Row]:
    """Cold commands from an empty run folder, and the memory and disk that ``solve`` takes."""
    commands = {"gaitopt --help": ["--help"], f"gaitopt solve {PROBLEM}, verified": ["solve", PROBLEM, "--json"]}
    found = [Row(what=what, way="cold, imports included", seconds=seconds(words)) for what, words in commands.items()]
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    return [*found[:-1], Row(what=found[-1].what, way=found[-1].way, seconds=found[-1].seconds, note=weight(peak))]


def seconds(words: list[str]) -> float:
    """Processor time of the best of some processes [s]; a first one compiles the bytecode, as an installation does."""
    times = []
    with tempfile.TemporaryDirectory() as folder:
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
        environment["PYTHONPYCACHEPREFIX"] = folder
        for run in range(RUNS + 1):
            output = ["-o", str(Path(folder) / f"run-{run}")] if "solve" in words else []
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [sys.executable, "-m", "gaitopt", *words, *output]
            subprocess.run(command, check=True, capture_output=True, env=environment)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times[1:])


def weight(peak: int) -> str:
    """Memory of the process at its fullest, and what lies on disk of the packages that it imports."""
    sizes = {name: disk(name) / 1e6 for name in ("casadi", "scipy", "numpy", "gaitopt")}
    packages = ", ".join(f"{name} {size:.0f}" for name, size in sizes.items())
    return f"at most {peak / 1e6:.0f} MB; on disk {packages} MB"


def disk(name: str) -> int:
    """Bytes of an installed package, its libraries beside it included."""
    spec = find_spec(name)
    assert spec is not None, f"{name} is not installed"
    assert spec.origin is not None, f"{name} has no folder"
    package = Path(spec.origin).parent
    folders = (package, package.with_name(f"{name}.libs"))
    return sum(file.stat().st_size for folder in folders for file in folder.rglob("*") if file.is_file())
