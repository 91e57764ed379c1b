"""Whole processes, imports and all, and what they and the installation weigh."""

import os
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from timing import Row

PROBLEM = "compass-passive-a"
RUNS = 5
LAUNCHER = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, capture_output=True)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss)
"""
"""A process inherits the largest memory of whoever starts it, so that this must be a small one."""


def rows() -> list[Row]:
    """Cold commands from an empty run folder, and the memory and disk that ``solve`` takes."""
    commands = {"gaitopt --help": ["--help"], f"gaitopt solve {PROBLEM}, verified": ["solve", PROBLEM, "--json"]}
    measured = []
    for what, arguments in commands.items():
        seconds, peak = best(arguments)
        note = weight(peak) if "solve" in arguments else ""
        measured.append(Row(what=what, way="cold, imports included", seconds=seconds, note=note))
    return measured


def best(arguments: list[str]) -> tuple[float, int]:
    """Smallest processor time [s] and memory [bytes] of some processes; a first one compiles the bytecode."""
    measured = []
    with tempfile.TemporaryDirectory() as folder:
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
        environment["PYTHONPYCACHEPREFIX"] = folder
        for run in range(RUNS + 1):
            output = ["-o", str(Path(folder) / f"run-{run}")] if "solve" in arguments else []
            command = [sys.executable, "-c", LAUNCHER, sys.executable, "-m", "gaitopt", *arguments, *output]
            measured.append(subprocess.run(command, env=environment, check=True, capture_output=True).stdout.split())
    seconds, memory = zip(*measured[1:], strict=True)
    return min(map(float, seconds)), min(map(int, memory)) * 1024


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
