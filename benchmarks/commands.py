"""Long commands from an empty folder: a basin where heyoka is not used, and the reproduction of the paper."""

import os
import resource
import subprocess
import sys
import tempfile
import time

from timing import Row

COMMANDS = {
    "a basin of 30 x 30 states on scipy": (
        "basin compass-passive-a --over dtheta1=0.4:1:30 --over dtheta2=-0.9:0.1:30 --engine scipy -o run"
    ),
    "the paper from nothing": "reproduce gamus-or-2013 -o paper",
}


def rows() -> list[Row]:
    """Time on the clock, and processor time of all processes."""
    return [row(what, command.split()) for what, command in COMMANDS.items()]


def row(what: str, arguments: list[str]) -> Row:
    """One command, once."""
    with tempfile.TemporaryDirectory() as folder:
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run([sys.executable, "-m", "gaitopt", *arguments], check=True, capture_output=True, cwd=folder)
        seconds, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Row(what=what, way=f"{os.cpu_count()} cores", seconds=seconds, note=f"{busy:.3g} s of processors")
