"""The sticking compass gait by other toolkits, when they are installed: ``pip install '.[peers]'``."""

from importlib.util import find_spec

from reuse import solve_anew
from timing import Row, compared

from gaitopt import load_problem, solve

NAMED = {"rockit": "rockit", "pydrake": "drake"}


def rows() -> list[Row]:
    """The periodic sticking gait of the passive compass, from the same guess, built and solved."""
    problem = load_problem("compass-passive-stick")
    gait = solve(problem)
    note = f"period {gait.period:.9f} s; multipliers, error estimate"
    ways = {
        "gaitopt.solve, mesh new": (lambda: solve_anew(problem), note),
        "gaitopt.solve, mesh known": (lambda: solve(problem), ""),
    }
    if find_spec("rockit"):
        import rockit_gait

        period = rockit_gait.period(gait.problem, gait.system)
        ways["rockit, multiple shooting"] = (lambda: rockit_gait.period(problem, gait.system), f"period {period:.9f} s")
    if find_spec("pydrake"):
        import drake_gait

        period = drake_gait.period(problem)
        ways["pydrake, DirectCollocation"] = (lambda: drake_gait.period(problem), f"period {period:.9f} s")
    return compared("the sticking compass gait", ways, rounds=2) if len(ways) > 2 else []
