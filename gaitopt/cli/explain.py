"""``gaitopt explain``: why there is no such gait, what there is instead, and where it begins to exist."""

from gaitopt.cli.options import ProblemArgument, SamplesOption, SeedOption, SetOption, WorkersOption
from gaitopt.cli.runs import load
from gaitopt.cli.signals import interruptible
from gaitopt.cli.terminal import Terminal


def explain(
    terminal: Terminal,
    problem: ProblemArgument,
    starts: SamplesOption = 1000,
    seed: SeedOption = 0,
    workers: WorkersOption = None,
    changes: SetOption = None,
) -> int:
    """Say why a problem has no gait: the conditions that it violates, the gaits that there are, the nearest values."""
    from gaitopt.library.print_results import print_explanation
    from gaitopt.search.explain import explain as explained
    from gaitopt.workers.jobs import make_workers

    loaded, count = load(problem, changes), make_workers(workers, None).count
    with interruptible() as interrupted:
        explanation = explained(
            loaded, starts=starts, seed=seed, workers=count, progress=terminal.say, should_stop=interrupted
        )
    terminal.show(explanation.to_record(), print_explanation)
    return 0
