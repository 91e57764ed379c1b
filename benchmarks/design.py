"""Seconds for designs: constant torques cold, PD with a stability constraint, multi-start over cores.

Run from anywhere: python benchmarks/design.py
"""

import time

from gaitopt.problem import load_problem
from gaitopt.study import solve
from gaitopt.study.jobs import Workers
from gaitopt.study.multistart import multistart

BUDGETS = {
    "compass-torque-efficient": 5.0,
    "compass-minimum-friction": 5.0,
    "compass-torque-stable-slip": 60.0,
    "compass-pd-designed": 60.0,
}
"""Seconds allowed, cold, on one core."""
STARTS = 8


def main() -> None:
    """Print one line per design, and one per number of workers."""
    for name, budget in BUDGETS.items():
        began = time.perf_counter()
        gait = solve(load_problem(name))
        seconds = time.perf_counter() - began
        verdict = "within" if seconds <= budget else "OVER"
        print(f"{name}: {gait.status}, {seconds:.1f} s, {verdict} {budget:g} s")
    for count in (1, 2, 4):
        began = time.perf_counter()
        found = multistart(load_problem("compass-torque-efficient"), STARTS, workers=Workers(count=count))
        print(f"{STARTS} starts, {count} workers: {time.perf_counter() - began:.1f} s, {len(found)} optima")


if __name__ == "__main__":
    main()
