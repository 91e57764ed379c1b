"""Walkers with named contacts: a simulated step, solve, verify, and a verification in a new process."""

import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from cold import best
from timing import Row, compared

from gaitopt import load_problem, solve, verify
from gaitopt.gait.gait import Gait
from gaitopt.simulation.simulator import Simulator

NAMES = {
    "heel-toe": "four contacts, two of them at a time",
    "crawler": "two contacts that slip and stick",
    "flat-foot": "four contacts, up to three at a time",
}


def rows() -> list[Row]:
    """The smallest processor time of a step, a solution and a verification of every gait."""
    gaits = {name: solve(load_problem(name)) for name in NAMES}
    steps = {name: (stepping(gait), f"{len(gait.steps[0].phases)} phases") for name, gait in gaits.items()}
    solved = {name: (partial(solve, load_problem(name)), NAMES[name]) for name in gaits}
    verified = {name: (partial(verify, gait), "") for name, gait in gaits.items()}
    return [
        *compared("several contacts: simulate a step", steps),
        *compared("several contacts: solve", solved, rounds=2),
        *compared("several contacts: verify", verified, rounds=2),
        *(cold(gait) for gait in gaits.values()),
    ]


def stepping(gait: Gait) -> partial[object]:
    """A simulated step from the state of a gait."""
    return partial(Simulator(gait.dynamics).step, gait.state)


def cold(gait: Gait) -> Row:
    """``gaitopt verify RUN`` in a new process, of a stored gait."""
    with tempfile.TemporaryDirectory() as folder:
        run = str(Path(folder) / "run")
        subprocess.run(
            [sys.executable, "-m", "gaitopt", "solve", gait.problem.name, "-o", run], check=True, capture_output=True
        )
        seconds, _ = best(["verify", run, "--json"])
    what = f"several contacts: gaitopt verify {gait.problem.name}"
    return Row(what=what, way="cold, imports included", seconds=seconds)
