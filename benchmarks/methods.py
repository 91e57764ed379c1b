"""Every named problem by Newton's method and by IPOPT; and the program in the hands of a user."""

from functools import partial
from typing import Any

import casadi as ca
from timing import Row, Way, compared

from gaitopt import load_problem, nlp, problem_names, solve

OURS = "compass-passive-a"
QUIET = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}


def by_hand(program: Any, solver: Any) -> Any:
    """The gait at the solution of a solver of CasADi."""
    return program.gait(solver(**program.arguments())["x"])


def rows() -> list[Row]:
    """Seconds to solve every named problem by IPOPT, and by Newton's method where it finds the gait."""
    measured: list[Row] = []
    for name in problem_names():
        ways: dict[str, Way] = {}
        for method in ("newton", "ipopt"):
            call = partial(solve, load_problem(name), method=method, progress=False)
            gait = call()
            if gait.converged:
                ways[method] = call, f"{gait.solver['iterations']:.0f} iterations"
        measured += compared(f"{name} by method", ways, rounds=3 if "newton" in ways else 1)
    program = nlp(OURS)
    exact, secants = (
        ca.nlpsol("solver", "ipopt", program.casadi(), QUIET | {"ipopt.hessian_approximation": hessian})
        for hessian in ("exact", "limited-memory")
    )
    measured += compared(
        f"{OURS} by nlpsol",
        {
            "nlpsol and gait, exact Hessian": (partial(by_hand, program, exact), ""),
            "the same, secants": (partial(by_hand, program, secants), ""),
            "nlp(problem)": (partial(nlp, load_problem(OURS)), "statement alone"),
            "nlpsol": (partial(ca.nlpsol, "solver", "ipopt", program.casadi(), QUIET), "construction of the solver"),
        },
        rounds=3,
    )
    return measured
