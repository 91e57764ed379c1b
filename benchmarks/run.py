"""Every row of the page on speed from one command: ``python benchmarks/run.py [PART ...] [--json FILE]``."""

import argparse
import json
import os
import platform
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import cold
import commands
import contacts
import design
import family
import growth
import kinds
import methods
import peers
import rabbit
import reuse
import scaling
import walking
from rich.console import Console
from rich.table import Table
from timing import Row

PACKAGES = {
    "gaitopt": "gaitopt",
    "casadi": "casadi",
    "heyoka": "heyoka",
    "scipy": "scipy",
    "numpy": "numpy",
    "distributed": "distributed",
    "drake": "pydrake",
    "rockit-meco": "rockit",
}
"""Distributions by what they are imported as; those that are installed are recorded."""


def main() -> None:
    """Measure, print the table, write JSON."""
    options = arguments()
    groups: dict[str, Callable[[], list[Row]]] = {
        "cold": cold.rows,
        "walking": partial(walking.rows, options.states, options.workers),
        "peers": peers.rows,
        "reuse": reuse.rows,
        "family": family.rows,
        "kinds": kinds.rows,
        "contacts": contacts.rows,
        "methods": methods.rows,
        "growth": growth.rows,
        "rabbit": rabbit.rows,
        "scaling": partial(scaling.rows, options.jobs, options.workers),
        "commands": commands.rows,
        "designs": design.rows,
    }
    rows: list[Row] = []
    for group in options.parts or groups:
        measured = groups[group]()
        show(measured)
        rows += measured
        if options.json is not None:  # after every group, so that an interruption loses only this one
            record = {"rows": [row.to_record() for row in rows], "machine": machine()}
            options.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def arguments() -> argparse.Namespace:
    """The choice of measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help="cold, walking, ...; all of them unless given")
    parser.add_argument("--states", type=int, default=100_000, help="states of the basin; 1000000 for the full one")
    parser.add_argument("--jobs", type=int, default=100, help="jobs of the sweep; 1000 for the full one")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--json", type=Path, help="where to write the rows")
    return parser.parse_args()


def machine() -> dict[str, object]:
    """Cores, processor and versions."""
    names = [line.partition(":")[2].strip() for line in processor_lines() if line.startswith("model name")]
    installed = [name for name, module in PACKAGES.items() if find_spec(module)]
    versions = {"python": platform.python_version()} | {name: version(name) for name in installed}
    processor = names[0] if names else platform.processor()
    return {"cores": os.cpu_count(), "machine": platform.machine(), "processor": processor, "versions": versions}


def processor_lines() -> list[str]:
    """The lines in which Linux describes its processors; none elsewhere."""
    file = Path("/proc/cpuinfo")
    return file.read_text(encoding="utf-8").splitlines() if file.exists() else []


def show(rows: list[Row]) -> None:
    """The table, ratios to the first way of each kind."""
    table = Table(box=None)
    for name, justify in (("what", "left"), ("way", "left"), ("time", "right"), ("ratio", "right"), ("note", "left")):
        table.add_column(name, justify=justify)
    before = ""
    for row in rows:
        ratio = "" if row.ratio is None else f"{row.ratio:.3g}"
        table.add_row(row.what if row.what != before else "", row.way, duration(row.seconds), ratio, row.note)
        before = row.what
    Console(width=170).print(table)


def duration(seconds: float) -> str:
    """A time with a unit that fits it."""
    return next(
        f"{seconds / unit:.3g} {name}" for unit, name in ((1, "s"), (1e-3, "ms"), (1e-6, "us")) if seconds >= unit
    )


if __name__ == "__main__":
    main()
