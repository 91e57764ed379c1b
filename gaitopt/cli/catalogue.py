"""``gaitopt list``, ``show``, ``validate``, ``schema``: problems, before anything is solved."""

from gaitopt.cli.options import DebugOption, JsonOption, ProblemArgument, SetOption


def list_problems(json: JsonOption = False, debug: DebugOption = False) -> int:
    """List the named problems."""
    from gaitopt.cli.console import print_json, results
    from gaitopt.problem import load_problem, problem_names

    problems = [load_problem(name) for name in problem_names()]
    if json:
        print_json({"problems": [{"name": problem.name, "about": problem.about} for problem in problems]})
        return 0
    from gaitopt.library.tables import friction, table

    rows = ((p.name, friction(p), str(p.modes), p.about) for p in problems)
    results().print(table(("problem", "friction", "phases; impact", "about"), rows, numbers=(1,)))
    return 0


def show(
    problem: ProblemArgument, changes: SetOption = None, json: JsonOption = False, debug: DebugOption = False
) -> int:
    """Show a problem, complete and in SI."""
    from gaitopt.cli.console import print_json, results
    from gaitopt.cli.runs import asked

    found = asked(problem, changes)
    if json:
        print_json({**found.resolved(), "hash": found.digest})
        return 0
    from gaitopt.library.tables import print_problem

    print_problem(results(), found)
    return 0


def validate(
    problem: ProblemArgument, changes: SetOption = None, json: JsonOption = False, debug: DebugOption = False
) -> int:
    """Check a problem and name all of its faults."""
    from gaitopt.cli.console import narration, print_json, results
    from gaitopt.cli.runs import asked

    found = asked(problem, changes, narration(quiet=False))
    if json:
        print_json({"problem": found.name, "valid": True, "hash": found.digest})
    else:
        results().print(f"{problem}: valid ({found.name}, hash {found.hash8})")
    return 0


def schema(debug: DebugOption = False) -> int:
    """Print the JSON schema of problem files, for editors."""
    from gaitopt.cli.console import print_json
    from gaitopt.problem import problem_schema

    print_json(problem_schema())
    return 0
