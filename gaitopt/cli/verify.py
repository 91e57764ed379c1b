"""``gaitopt verify``: claim by claim, does an independent simulation confirm a gait?"""

from typing import Annotated

import typer

from gaitopt.cli.endings import NOT_VERIFIED
from gaitopt.cli.options import EngineOption, OutOption, RunArgument, SetOption
from gaitopt.cli.runs import gait_of, report
from gaitopt.cli.terminal import Terminal

OptimumOption = Annotated[
    bool, typer.Option("--optimum", help="Of a design: search its feasible neighbourhood for a better one.")
]


def verify(
    terminal: Terminal,
    run: RunArgument,
    engine: EngineOption = "auto",
    optimum: OptimumOption = False,
    changes: SetOption = None,
    output: OutOption = None,
) -> int:
    """Verify a gait by forward simulation.

    The simulation never sees the mode sequence; it has to find it.
    """
    from gaitopt import study
    from gaitopt.library.progress import job_progress
    from gaitopt.nlp.design import neighbourhood
    from gaitopt.simulation import choose_engine

    choose_engine(engine)
    gait, folder, fresh = gait_of(run, changes, output, terminal)
    if not gait.converged:
        return report(gait, None, terminal)
    if not fresh or engine != "auto":
        terminal.say("verifying by forward simulation")
        gait = gait.verified(study.verify(gait, engine=engine).to_record())
    if not optimum:
        return report(gait, folder, terminal, store=fresh)
    with job_progress(terminal.narration, "directions") as progress:
        searched = neighbourhood(gait, progress=progress)
    code = report(gait, folder, terminal, store=fresh, about={"neighbourhood": searched.to_record()})
    if not terminal.json:
        terminal.results.print(searched.words)
    return code if searched.optimal else NOT_VERIFIED
