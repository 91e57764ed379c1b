"""Why a design is infeasible: which constraint cannot be met, how far one gets, and what stands in the way.

All constraints of the problem are given slack, and the sum of the slacks is minimised (elastic mode). Where slack is
left, the multipliers name the bounds and constraints against which the search was pressed.
"""

from collections.abc import Iterator

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import Cause, Status
from gaitopt.nlp.design.program import Program, Rows
from gaitopt.nlp.ipopt import IpoptResult
from gaitopt.problem import Problem, Range

MISSED = 1e-6
"""Slack, relative to the bound or to one, beyond which a constraint is not met."""
PRESSING = 1e-4
"""Multiplier of a bound that stands in the way; the multipliers of the slack itself are of the order of one."""


def conflicts(problem: Problem, program: Program, result: IpoptResult) -> tuple[Cause, ...]:
    """The constraints that cannot be met; empty where all can be met or the search failed.

    Parameters
    ----------
    program, result : an elastic one, and its solution.
    """
    if result.status is not Status.CONVERGED:
        return ()
    reached = dict(zip(program.names, program.values(result.w), strict=True))
    obstacles = list(_obstacles(problem, program, result, reached))
    causes = []
    for name, span in problem.constraints.items():
        bound = _missed(span, reached[name])
        if bound is None:
            continue
        needed = span.minimum if reached[name] < span.minimum else span.maximum
        against = [words for other, words in obstacles if other != name]
        reason = f"conflicts with {', '.join(against)}" if against else "cannot be met by these phases near the start"
        _, place = problem.place.locate(("constraints", name))
        words = f"{place}: {name} {bound} {reason}: best reached {reached[name]:.4g}"
        causes.append(Cause(what=name, words=words, needed=needed, available=float(reached[name])))
    return tuple(causes)


def _missed(span: Range, value: float) -> str | None:
    """The bound that a value misses, in words."""
    if value < span.minimum - MISSED * max(1.0, abs(span.minimum)):
        return f">= {span.minimum:g}" if span.minimum < span.maximum else f"= {span.minimum:g}"
    if value > span.maximum + MISSED * max(1.0, abs(span.maximum)):
        return f"<= {span.maximum:g}" if span.minimum < span.maximum else f"= {span.maximum:g}"
    return None


def _obstacles(
    problem: Problem, program: Program, result: IpoptResult, reached: dict[str, float]
) -> Iterator[tuple[str, str]]:
    """Name and words of every freed bound, other constraint and kind of margin that presses against the search."""
    for name, (pressure, bound) in program.active_bounds(result).items():
        if abs(pressure) > PRESSING:
            yield name, f"{name} {'<=' if pressure > 0 else '>='} {bound:g}"
    for rows, multipliers in program.by_rows(result):
        worst = float(np.abs(multipliers).max(initial=0.0))
        if worst <= PRESSING or rows.name not in (*problem.constraints, "margins"):
            continue
        if rows.name == "margins":
            yield rows.name, program.margin_words(int(np.argmax(np.abs(multipliers))))
        elif _missed(problem.constraints[rows.name], reached[rows.name]) is None:
            yield rows.name, _held(rows, multipliers)


def _held(rows: Rows, multipliers: Array) -> str:
    return f"{rows.name} <= {rows.upper[0]:g}" if multipliers[0] > 0 else f"{rows.name} >= {rows.lower[0]:g}"
