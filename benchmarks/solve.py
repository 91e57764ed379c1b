"""From a problem to a verified gait: times against their targets and against the plain way, all in one run.

``python benchmarks/solve.py [--json FILE]``. The plain way (``plain.py``) is what a careful script does: a NumPy
right-hand side written from the paper, ``solve_ivp`` with terminal events, ``fsolve`` and finite differences.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from plain import PlainCompass
from rich.console import Console
from rich.table import Table
from timing import Row, compared

import gaitopt as go
from gaitopt.gait import floquet_multipliers, multiplier_distance
from gaitopt.nlp import find_gait
from gaitopt.orbit import ReturnMap
from gaitopt.simulation import Simulator
from gaitopt.study import build_system

PROBLEM = "compass-passive-a"
COLD_RUNS = 5
TARGETS = {
    "gaitopt --help, cold": 0.3,
    f"gaitopt solve {PROBLEM}, cold, verified": 4.0,
    "NLP of a gait": 1.0,
    "simulated stick-slip step with events": 4e-3,
}
"""Seconds."""
PACKAGES = ("gaitopt", "casadi", "scipy", "numpy")


def main() -> None:
    """Measure, print the table, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="where to write the rows")
    asked = parser.parse_args()
    rows = [*cold_rows(), *gait_rows(), *step_rows()]
    show(rows)
    if asked.json is not None:
        machine = {"cores": os.cpu_count(), "machine": platform.machine(), "python": platform.python_version()}
        versions = {name: version(name) for name in PACKAGES}
        lines = [row.to_record() | {"target": TARGETS.get(row.what)} for row in rows]
        record = {"rows": lines, "machine": machine, "versions": versions}
        asked.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def cold_rows() -> list[Row]:
    """Whole processes, imports and all; the solved gait goes to a fresh folder every time."""

    def command(*words: str) -> None:
        with tempfile.TemporaryDirectory() as folder:
            options = () if "--help" in words else ("-o", str(Path(folder) / "run"), "--json", "--quiet")
            subprocess.run([sys.executable, "-m", "gaitopt", *words, *options], check=True, capture_output=True)

    return [
        Row(what=what, way="gaitopt", seconds=shortest(lambda words=words: command(*words), COLD_RUNS)[0])
        for what, words in zip(TARGETS, (("--help",), ("solve", PROBLEM)), strict=False)
    ]


def gait_rows() -> list[Row]:
    """The gait and its multipliers, from the guess of its file."""
    problem = go.load_problem(PROBLEM)
    walker, guess = problem.walker.model_dump(), problem.guess.state
    seconds, gait = shortest(lambda: find_gait(problem, build_system(problem)), 3)
    check_seconds, check = shortest(lambda: go.verify(gait), 3)
    assert check.passed, "the gait does not verify"

    plain = PlainCompass(**walker, friction=problem.friction)
    start = np.array([guess[name] for name in ("theta1", "dtheta1", "dtheta2")])
    plain_seconds, found = shortest(lambda: plain.gait(start), 1)
    multipliers_seconds, multipliers = shortest(lambda: plain.multipliers(found), 1)
    apart = np.abs(found - gait.state[gait.system.section(problem.cycle.impact)]).max()
    wrong = multiplier_distance(multipliers.astype(complex), gait.multipliers)
    both = plain_seconds + multipliers_seconds
    what = "NLP of a gait"
    return [
        Row(what=what, way="plain: fsolve, differences", seconds=both, ratio=1.0,
            note=f"state off by {apart:.0e}, multipliers by {wrong:.0e}"),
        Row(what=what, way="gaitopt: built and solved, multipliers", seconds=seconds, ratio=both / seconds,
            note=f"{gait.solver['iterations']:.0f} iterations, right to {gait.shooting.errors.max():.0e}"),
        Row(what="verification of a gait", way="gaitopt", seconds=check_seconds, note=f"{len(check.claims)} claims"),
    ]  # fmt: skip


def step_rows() -> list[Row]:
    """One walking step along the gait, and the derivative of the return map there."""
    gait = go.solve(go.load_problem(PROBLEM))
    xi = gait.state[gait.system.section(gait.problem.cycle.impact)]
    plain = PlainCompass(**gait.problem.walker.model_dump(), friction=gait.problem.friction)
    state = plain.section(xi)
    simulator = Simulator(gait.system, gait.p)
    return_map = ReturnMap(simulator, gait.problem.cycle.impact)
    steps = return_map(xi).steps
    what = "simulated stick-slip step with events"
    off = np.abs(plain.return_map(xi) - xi).max(), np.abs(return_map(xi).xi - xi).max()
    derivative = floquet_multipliers(return_map.jacobian(steps))
    wrong = multiplier_distance(plain.multipliers(xi).astype(complex), derivative)
    return [
        *compared(what, {
            "plain: solve_ivp, NumPy": (lambda: plain.step(state), f"closes to {off[0]:.0e}"),
            "gaitopt: DOP853, compiled": (lambda: simulator.step(gait.state), f"closes to {off[1]:.0e}"),
        }),
        *compared("Floquet multipliers of a simulated step", {
            "plain: central differences": (lambda: plain.multipliers(xi), f"off by {wrong:.0e}"),
            "gaitopt: variational equations, saltation": (lambda: return_map.jacobian(steps), ""),
        }, rounds=3),
    ]  # fmt: skip


def shortest(call: Callable[[], Any], runs: int) -> tuple[float, Any]:
    """The shortest of some runs [s], and what the last one returned."""
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - began)
    return min(times), result


def show(rows: list[Row]) -> None:
    """The table, with targets and ratios to the plain way."""
    table = Table(box=None)
    for name in ("what", "way", "time", "target", "ratio", "note"):
        table.add_column(name, justify="right" if name in ("time", "target", "ratio") else "left")
    for row in rows:
        target = TARGETS.get(row.what) if row.way.startswith("gaitopt") else None
        verdict = "" if target is None else f"{milliseconds(target)} {'met' if row.seconds <= target else 'MISSED'}"
        ratio = "" if row.ratio is None else f"{row.ratio:.3g}"
        table.add_row(row.what, row.way, milliseconds(row.seconds), verdict, ratio, row.note)
    Console(width=170).print(table)


def milliseconds(seconds: float) -> str:
    """A time in milliseconds."""
    return f"{1e3 * seconds:.4g} ms"


if __name__ == "__main__":
    main()
