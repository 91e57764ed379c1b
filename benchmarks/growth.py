"""How cost grows: with shooting intervals, coordinates and steps per cycle."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from chain import chain
from reuse import solve_anew
from timing import Row, compared

from gaitopt import Mode, load_problem, solve
from gaitopt.model.control import NoControl
from gaitopt.model.system import HybridSystem
from gaitopt.solver.interval import shooting_step, stage_derivatives, step_derivatives
from gaitopt.solver.newton import Solution
from gaitopt.solver.rollout import roll_out
from gaitopt.solver.shooting import MultipleShooting

INTERVALS = (16, 32, 64, 128)
LINKS = (2, 4, 6, 8, 10, 12)
CYCLES = (1, 2, 4)
MODE = Mode.SLIP_FORWARD


def rows() -> list[Row]:
    """All of them."""
    return [*interval_rows(), *link_rows(), *cycle_rows()]


def interval_rows() -> list[Row]:
    """One step of Newton's method on the stick-slip gait."""
    gait = solve(load_problem("compass-passive-a"))
    durations = np.array([duration for _, duration in gait.phases])
    rolled = roll_out(gait.dynamics, gait.problem.cycle, gait.state, durations)
    ways = {}
    for count in INTERVALS:
        intervals = [max(2, round(count * duration / durations.sum())) for duration in durations]
        start = rolled.on_mesh(intervals=intervals)
        ways[f"{sum(intervals)} intervals"] = (partial(newton_step, start.equations, start.w, start.p), "")
    return compared("a step of Newton's method", ways, rounds=3)


def newton_step(equations: MultipleShooting, w: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Equations, Jacobian and its solution."""
    at = Solution(equations, w, p)
    return at.scaled.solve(at.residual)


def link_rows() -> list[Row]:
    """Equations of a chain in slip: derived and compiled the first time, then the derivative of one shooting step."""
    found, ways = [], {}
    for links in LINKS:
        system = HybridSystem(chain(links), NoControl())
        compiled = first_time(lambda system=system: (shooting_step(system, MODE), stage_derivatives(system, MODE, ())))
        found.append(Row(what="a chain in slip: derived and compiled", way=f"{links} links", seconds=compiled))
        nodes, p = np.full((system.n_z, 1), 0.1), np.array([9.8, 0.02, 0.3])
        step = partial(step_derivatives, system, MODE, (), nodes, np.zeros(1), np.full(1, 0.01), p, np.zeros(0))
        ways[f"{links} links"] = (step, f"{system.n_z} states")
    measured = [*found, *compared("a chain in slip: derivative of a shooting step", ways, rounds=3)]
    return [replace(row, note=f"{row.note} {exponent(measured, row)}".strip()) for row in measured]


def exponent(rows: list[Row], row: Row) -> str:
    """The power of the number of links with which a cost grows from the first row of its kind to this one."""
    links, first = int(row.way.split()[0]), next(each for each in rows if each.what == row.what)
    if row is first:
        return ""
    return f"links^{np.log(row.seconds / first.seconds) / np.log(links / LINKS[0]):.2g}"


def first_time(call: Callable[[], object]) -> float:
    """Processor time of a call that can only be made once [s]."""
    began = time.process_time()
    call()
    return time.process_time() - began


def cycle_rows() -> list[Row]:
    """The same gait as a cycle of more and more steps, solved with nothing kept of its mesh."""
    ways = {}
    for count in CYCLES:
        problem = load_problem("compass-passive-stick")
        steps = [{"phases": ["stick"], "impact": "stick"}] * count
        problem = problem.replace({"gait": {"steps": steps, "guess": {"state": dict(problem.guess.state)}}})
        ways[f"{count} steps in a cycle"] = (partial(solve_anew, problem), "")
    return compared("the sticking gait", ways, rounds=2)
