"""Ratios against named peers, all in one run: ``python benchmarks/fast.py [--json FILE] [--states N] [--jobs N]``."""

import argparse
import json
import os
import platform
from importlib.metadata import version
from pathlib import Path

import peers
import reuse
import scaling
import walking
from rich.console import Console
from rich.table import Table
from timing import Row

PACKAGES = ("gaitopt", "casadi", "heyoka", "scipy", "numpy", "distributed")


def main() -> None:
    """Measure, print the table, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=100_000, help="states of the basin; 1000000 for the full one")
    parser.add_argument("--jobs", type=int, default=100, help="jobs of the sweep; 1000 for the full one")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--json", type=Path, help="where to write the rows")
    asked = parser.parse_args()
    rows = [
        *walking.rows(asked.states, asked.workers),
        *reuse.rows(),
        *scaling.rows(asked.jobs, asked.workers),
        *peers.rows(),
    ]
    show(rows)
    if asked.json is not None:
        machine = {"cores": os.cpu_count(), "machine": platform.machine(), "python": platform.python_version()}
        versions = {name: version(name) for name in PACKAGES}
        record = {"rows": [row.to_record() for row in rows], "machine": machine, "versions": versions}
        asked.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


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
