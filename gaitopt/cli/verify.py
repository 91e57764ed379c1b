"""``gaitopt verify``: claim by claim, does an independent simulation confirm a gait?"""

from gaitopt.cli.options import DebugOption, EngineOption, JsonOption, OutOption, QuietOption, RunArgument, SetOption


def verify(
    run: RunArgument,
    engine: EngineOption = "auto",
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
    from gaitopt.cli.console import narration
    from gaitopt.cli.runs import gait_of
    from gaitopt.cli.solve import report
    from gaitopt.simulation import choose_engine

    choose_engine(engine)
    console = narration(quiet=quiet)
    gait, folder, fresh = gait_of(run, changes, output, console)
    if not gait.converged:
        return report(gait, None, json=json)
    if not fresh or engine != "auto":
        console.print("verifying by forward simulation")
        gait = gait.verified(study.verify(gait, engine=engine).to_record())
    return report(gait, folder, json=json, store=fresh)
