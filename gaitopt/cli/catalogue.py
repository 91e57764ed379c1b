"""``gaitopt list``, ``show``, ``validate``, ``schema``: problems, before anything is solved."""

from typing import TYPE_CHECKING, Any

from gaitopt.cli.options import DebugOption, JsonOption, ProblemArgument, SetOption

if TYPE_CHECKING:
    from collections.abc import Mapping

    from gaitopt.problem import Problem


def list_problems(json: JsonOption = False, debug: DebugOption = False) -> int:
    """List the named problems by walker; of those whose run is in results/ also period, radius and stability."""
    from gaitopt.cli.console import print_json, results
    from gaitopt.problem import load_problem, problem_names

    problems = [load_problem(name) for name in problem_names()]
    if json:
        print_json({"problems": [{"name": p.name, "walker": p.walker.model, "about": p.about} for p in problems]})
        return 0
    from gaitopt.library.tables import listed, section

    columns = ("problem", "control", "friction", "phases; impact", "period", "radius", "", "about")
    for model in sorted({problem.walker.model for problem in problems}):
        rows = [listed(problem, _stored_record(problem)) for problem in problems if problem.walker.model == model]
        kept = [k for k in range(len(columns)) if k == len(columns) - 1 or any(row[k] for row in rows)]
        section(results(), model, [columns[k] for k in kept], [[row[k] for k in kept] for row in rows])
    return 0


def _stored_record(problem: "Problem") -> "Mapping[str, Any]":
    """The gait in the problem's default run folder; empty where there is none."""
    from gaitopt.errors import StorageError
    from gaitopt.store import find_run, read_object
    from gaitopt.store.run import GAIT_FILE

    try:
        folder = find_run(problem)
        return {} if folder is None else read_object(folder, GAIT_FILE)
    except StorageError:  # not ours to report while listing problems
        return {}


def show(
    problem: ProblemArgument, changes: SetOption = None, json: JsonOption = False, debug: DebugOption = False
) -> int:
    """Show a problem, complete and in SI."""
    from gaitopt.cli.console import print_json, results
    from gaitopt.cli.runs import load

    loaded = load(problem, changes)
    if json:
        print_json({**loaded.resolved(), "hash": loaded.digest})
        return 0
    from gaitopt.library.tables import print_problem

    print_problem(results(), loaded)
    return 0


def validate(
    problem: ProblemArgument, changes: SetOption = None, json: JsonOption = False, debug: DebugOption = False
) -> int:
    """Check a problem and name all of its faults."""
    from gaitopt.cli.console import narration, print_json, results
    from gaitopt.cli.runs import load

    loaded = load(problem, changes, narration(quiet=False))
    if json:
        print_json({"problem": loaded.name, "valid": True, "hash": loaded.digest})
    else:
        results().print(f"{problem}: valid ({loaded.name}, hash {loaded.hash8})")
    return 0


def schema(debug: DebugOption = False) -> int:
    """Print the JSON schema of problem files, for editors."""
    from gaitopt.cli.console import print_json
    from gaitopt.problem import problem_schema

    print_json(problem_schema())
    return 0
