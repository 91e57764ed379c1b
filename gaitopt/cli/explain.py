"""``gaitopt explain``: why there is no such gait, what there is instead, and where it begins to exist."""

from typing import TYPE_CHECKING, Any

from gaitopt.cli.find import StartsOption
from gaitopt.cli.grids import WorkersOption
from gaitopt.cli.options import DebugOption, JsonOption, ProblemArgument, QuietOption, SetOption
from gaitopt.cli.starts import SeedOption

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console


def explain(
    problem: ProblemArgument,
    starts: StartsOption = 1000,
    seed: SeedOption = 0,
    workers: WorkersOption = None,
    changes: SetOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Say why a problem has no gait: the conditions that it violates, the gaits that there are, the nearest values."""
    from gaitopt.cli.console import narration, print_json, results
    from gaitopt.cli.runs import load
    from gaitopt.cli.signals import interruptible
    from gaitopt.search.explain import explain as explained
    from gaitopt.workers.jobs import make_workers

    console, loaded = narration(quiet=quiet), load(problem, changes)
    with interruptible() as interrupted:
        explanation = explained(
            loaded,
            starts=starts,
            seed=seed,
            workers=make_workers(workers, None).count,
            progress=console.print,
            should_stop=interrupted,
        )
    record = explanation.to_record()
    if json:
        print_json(record)
    else:
        _print(results(), record)
    return 0


def _print(console: "Console", record: "Mapping[str, Any]") -> None:
    from gaitopt.cli.find import print_list

    if record["exists"]:
        console.print(f"{record['problem']}: this gait exists; `gaitopt solve` shows it", style="bold")
        return
    console.print(f"{record['problem']}: there is no such gait", style="bold")
    for cause in record["causes"]:
        console.print(f"  {cause['words']}")
    if record["simulated"]:
        walk = record["simulated"]
        console.print(f"from the guess: {walk['steps']} steps, {walk['status']}: {walk['message']}")
    for nearest in record["nearest"]:
        where = f"{nearest['parameter']} = {nearest['value']:.10g}"
        console.print(
            f"the phases begin to exist at {where} ({nearest['type'].replace('_', ' ')}): {nearest['reason']}"
        )
    if record["instead"]:
        print_list(console, "gaits that there are", record["instead"])
    else:
        console.print("no gait of any other mode sequence was found here")
