"""``gaitopt verify``: claim by claim, does an independent simulation confirm a gait?"""

from typing import TYPE_CHECKING, Annotated

import typer

from gaitopt.cli.options import DebugOption, EngineOption, JsonOption, OutOption, QuietOption, RunArgument, SetOption

if TYPE_CHECKING:
    from rich.console import Console

    from gaitopt.gait import Gait
    from gaitopt.nlp import Neighbourhood

OptimumOption = Annotated[
    bool, typer.Option("--optimum", help="Of a design: search its feasible neighbourhood for a better one.")
]


def verify(
    run: RunArgument,
    engine: EngineOption = "auto",
    optimum: OptimumOption = False,
    changes: SetOption = None,
    output: OutOption = None,
    json: JsonOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Verify a gait by forward simulation.

    The simulation never sees the mode sequence; it has to find it.
    """
    from gaitopt import study
    from gaitopt.cli.console import narration, results
    from gaitopt.cli.runs import gait_of
    from gaitopt.cli.solve import NOT_VERIFIED, report
    from gaitopt.simulation import choose_engine

    choose_engine(engine)
    console = narration(quiet=quiet)
    gait, folder, fresh = gait_of(run, changes, output, console)
    if not gait.converged:
        return report(gait, None, json=json)
    if not fresh or engine != "auto":
        console.print("verifying by forward simulation")
        gait = gait.verified(study.verify(gait, engine=engine).to_record())
    if not optimum:
        return report(gait, folder, json=json, store=fresh)
    searched = _searched(gait, console)
    code = report(gait, folder, json=json, store=fresh, about={"neighbourhood": searched.to_record()})
    if not json:
        results().print(searched.words)
    return code if searched.optimal else NOT_VERIFIED


def _searched(gait: "Gait", console: "Console") -> "Neighbourhood":
    """The feasible neighbourhood of a design."""
    from gaitopt.library.progress import job_progress
    from gaitopt.nlp import neighbourhood

    with job_progress(console, "directions") as progress:
        return neighbourhood(gait, progress=progress)
