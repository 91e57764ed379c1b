"""The tables that the command line prints, as HTML for a notebook."""

from functools import singledispatch
from io import StringIO
from typing import Any

from rich.console import Console

from gaitopt.gait import TERMINAL, Branch, Gait, Trajectory
from gaitopt.library.quantities import number
from gaitopt.library.tables import (
    print_gait,
    print_problem,
    print_verification,
    print_walk,
    section,
)
from gaitopt.mechanics.cycle import mode_words
from gaitopt.problem import Problem
from gaitopt.runs.basin_tiles import Basin
from gaitopt.runs.front import Front
from gaitopt.runs.sweep_table import Sweep
from gaitopt.search.distinct import Gaits
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
def _(result: Walk, console: Console) -> None:
    print_walk(console, result.to_record())


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


@print_result.register
def _(result: Problem, console: Console) -> None:
    print_problem(console, result)


@print_result.register
def _(result: Verification, console: Console) -> None:
    print_verification(console, result.to_record())


@print_result.register
def _(result: Branch, console: Console) -> None:
    rows = [_branch_row(result.branch(number)) for number in sorted({point.branch for point in result})]
    section(console, "branches", ("branch", "mode sequence", "from", "to", "points", "radius", "ends with"), rows)
    specials = [(str(s.branch), number(s.value), s.type.replace("_", " "), s.reason) for s in result.specials]
    section(console, "special points", ("branch", result.parameter, "type", ""), specials, numbers=(1,))


def _branch_row(own: Branch) -> tuple[str, ...]:
    radii = own.column("spectral_radius")
    ends = [special for special in own.specials if special.next or special.type in TERMINAL]
    end = ends[-1].type.replace("_", " ") if ends else ""
    spread = f"{radii.min():.4f} to {radii.max():.4f}"
    cycle = str(own[0].gait.problem.cycle)
    return str(own[0].branch), cycle, number(own[0].value), number(own[-1].value), str(len(own)), spread, end


@print_result.register
def _(result: Gaits, console: Console) -> None:
    rows = [
        (str(k), str(gait.problem.cycle), number(gait.period), number(gait.spectral_radius))
        for k, gait in enumerate(result)
    ]
    section(console, "gaits", ("", "mode sequence", "period [s]", "radius"), rows, numbers=(2, 3))


@print_result.register
def _(result: Basin, console: Console) -> None:
    record = result.to_record()
    gaits = [(g["kind"], f"{g['states']:,}", f"{g['share']:.2%}", _modes(g)) for g in record["gaits"]]
    failures = sorted(record["failures"].items(), key=lambda item: -item[1])
    failed = [(name.replace("_", " "), f"{n:,}", f"{n / result.grid.size:.2%}", "") for name, n in failures]
    section(console, "ends on", ("", "states", "share", "modes; impact"), [*gaits, *failed], numbers=(1, 2))


def _modes(gait: Any) -> str:
    return f"{', '.join(gait['phases'])}; {gait['impact']}"


@print_result.register
def _(result: Sweep, console: Console) -> None:
    _count(console, [record["status"] for record in result.records])


@print_result.register
def _(result: Front, console: Console) -> None:
    rows = [
        (
            number(point.value),
            point.gait["status"].replace("_", " "),
            number(point.gait["solver"].get("objective")) if point.converged else "-",
            "front" if point.pareto else "",
        )
        for point in result
    ]
    section(console, "designs", (result.key, "status", "objective", ""), rows, numbers=(0, 2))


def _count(console: Console, words: list[str]) -> None:
    rows = [(word.replace("_", " "), str(words.count(word))) for word in sorted(set(words))]
    section(console, "points", ("status", "number"), rows, numbers=(1,))
