"""Commands about problems, none of which solves anything: ``list``, ``show``, ``validate``, ``schema``."""

from typing import TYPE_CHECKING, Any

from gaitopt.cli.options import ProblemArgument, SetOption
from gaitopt.cli.runs import load
from gaitopt.cli.terminal import Terminal

if TYPE_CHECKING:
    from collections.abc import Mapping

    from gaitopt.problem.problem import Problem


def list_problems(terminal: Terminal) -> int:
    """List the named problems by walker, with period, radius and stability if their run is in results/."""
    from gaitopt.problem.problem import load_problem
    from gaitopt.problem.source import problem_names

    problems = [load_problem(name) for name in problem_names()]
    if terminal.json:
        listed = [{"name": p.name, "walker": p.walker.model, "about": p.about} for p in problems]
        terminal.print_json({"problems": listed})
        return 0
    from gaitopt.show.tables import print_problems

    print_problems(terminal.results, [(problem, _stored_record(problem)) for problem in problems])
    return 0


def _stored_record(problem: "Problem") -> "Mapping[str, Any]":
    """The gait in the problem's default run folder; empty where there is none."""
    from gaitopt.errors import StorageError
    from gaitopt.store.run import GAIT_FILE, Run

    try:
        run = Run.of(problem)
        run.check(problem)
        return run.read_object(GAIT_FILE) if run.path(GAIT_FILE).is_file() else {}
    except StorageError:  # a broken run is reported by the commands that need it
        return {}


def show(terminal: Terminal, problem: ProblemArgument, changes: SetOption = None) -> int:
    """Print a problem in SI units, with all defaults."""
    from gaitopt.show.tables import print_problem

    loaded = load(problem, changes)
    if terminal.json:
        terminal.print_json({**loaded.resolved(), "hash": loaded.digest})
    else:
        print_problem(terminal.results, loaded)
    return 0


def validate(terminal: Terminal, problem: ProblemArgument, changes: SetOption = None) -> int:
    """Check a problem and list all its errors."""
    loaded = load(problem, changes, terminal)
    record = {"problem": loaded.name, "valid": True, "hash": loaded.digest}
    terminal.show(record, lambda console, _: console.print(f"{problem}: valid ({loaded.name}, hash {loaded.hash8})"))
    return 0


def schema(terminal: Terminal) -> int:
    """Print the JSON schema of problem files, for editors."""
    from gaitopt.problem.schema import problem_schema

    terminal.print_json(problem_schema())
    return 0
