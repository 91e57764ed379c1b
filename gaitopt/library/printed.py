"""The tables that the command line prints, as HTML for a notebook."""

from functools import singledispatch
from io import StringIO
from typing import Any

from rich.console import Console

from gaitopt.gait import Branch, Gait, Trajectory
from gaitopt.library.print_gait import print_gait, print_problem, print_verification, print_walk
from gaitopt.library.print_results import (
    print_basin,
    print_branch,
    print_explanation,
    print_front,
    print_gaits,
    print_sweep,
)
from gaitopt.library.tables import number, section
from gaitopt.mechanics.cycle import mode_words
from gaitopt.problem import Problem
from gaitopt.runs.basin_tiles import Basin
from gaitopt.runs.front import Front
from gaitopt.runs.sweep_table import Sweep, sweep_record
from gaitopt.search.distinct import Gaits
from gaitopt.search.explain import Explanation
from gaitopt.study import Verification
from gaitopt.study.simulate import Walk

WIDTH = 110
"""Characters of a line."""
BLOCK = '<pre style="line-height: 1.25; overflow-x: auto">{code}</pre>'


def printed(result: Any) -> str:
    """What is printed of a result, in a block of HTML."""
    console = Console(record=True, file=StringIO(), width=WIDTH, markup=False, highlight=False, emoji=False)
    print_result(result, console)
    return console.export_html(inline_styles=True, code_format=BLOCK)


@singledispatch
def print_result(result: Any, console: Console) -> None:
    """Print a result."""
    raise TypeError(f"a {type(result).__name__} has no table")


@print_result.register
def _(result: Gait, console: Console) -> None:
    if result.converged:
        print_gait(console, result.to_record())
    else:
        console.print(f"{result.problem.name}: {result.status}: {result.message}")


@print_result.register
def _(result: Trajectory, console: Console) -> None:
    rows = [
        (
            str(k),
            mode_words(mode for mode, _ in step.phases),
            "-" if step.impact is None else str(step.impact.mode),
            number(step.period),
            "-" if step.impact is None else number(step.impact.step_length),
        )
        for k, step in enumerate(result.steps, start=1)
    ]
    section(console, "steps", ("", "phases", "impact", "time [s]", "length [m]"), rows, numbers=(0, 3, 4))
    console.print(result.message)


print_result.register(Problem, lambda problem, console: print_problem(console, problem))
print_result.register(Walk, lambda walk, console: print_walk(console, walk.to_record()))
print_result.register(Verification, lambda checked, console: print_verification(console, checked.to_record()))
print_result.register(Gaits, lambda gaits, console: print_gaits(console, gaits.to_record()))
print_result.register(Explanation, lambda why, console: print_explanation(console, why.to_record()))
print_result.register(Branch, lambda branch, console: print_branch(console, branch.to_records(), branch.parameter))
print_result.register(Basin, lambda basin, console: print_basin(console, basin.to_record()))
print_result.register(Sweep, lambda sweep, console: print_sweep(console, sweep_record(sweep)))


@print_result.register
def _(result: Front, console: Console) -> None:
    record = {"problem": result.problem.name, "over": result.key, "points": result.to_records()}
    print_front(console, record)
