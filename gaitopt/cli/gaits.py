"""``gaitopt solve``: a problem's gait, verified and stored.

``gaitopt simulate``: walk forward from a state.

``gaitopt verify``: claim by claim, does an independent simulation confirm a gait?

``gaitopt find``: the gaits at a problem's parameters, of any mode sequence.

``gaitopt explain``: why there is no such gait, what there is instead, and where it begins to exist.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gaitopt.cli import values
from gaitopt.cli.runs import gait_of, is_folder, load, report, solve_verified, stored_branch, stored_gait, verified
from gaitopt.cli.terminal import NOT_A_GAIT, NOT_VERIFIED, Terminal, interruptible
from gaitopt.cli.values import (
    EngineOption,
    GuessOption,
    OutOption,
    ProblemArgument,
    RunArgument,
    SamplesOption,
    SchedulerOption,
    SeedOption,
    SetOption,
    WorkersOption,
    ranges,
)
from gaitopt.errors import ProblemError, SolveError, StorageError

if TYPE_CHECKING:
    from gaitopt.gait.gait import Gait
    from gaitopt.problem.problem import Problem
    from gaitopt.runs.multistart import Optimum
    from gaitopt.verification.walk import Walk
    from gaitopt.workers.jobs import Workers


ATTRACTOR = "@attractor."
LARGEST_SPREAD = 0.99
"""Below one, no coordinate of a sample changes its sign."""
StartOption = Annotated[
    str | None,
    typer.Option(
        "--start",
        metavar="RUN[@BRANCH.INDEX]",
        help="Guess the gait of a run, or a point of its branch (columns branch and index of branch.csv).",
        show_default=False,
    ),
]
StartsOption = Annotated[
    int, typer.Option("--starts", min=1, help="Solve from so many guesses, sampled around the first; keep the best.")
]
SpreadOption = Annotated[
    float,
    typer.Option(
        "--spread", min=0.0, max=LARGEST_SPREAD, help="How far samples go from the first guess, relative to it."
    ),
]

SolvedArgument = Annotated[
    str,
    typer.Argument(
        metavar="PROBLEM",
        help="A name from `gaitopt list`, a .yaml file, or RUN@attractor.K, the K-th gait in the table of a basin.",
    ),
]


def solve(
    terminal: Terminal,
    problem: SolvedArgument,
    start: StartOption = None,
    starts: StartsOption = 1,
    seed: SeedOption = 0,
    spread: SpreadOption = 0.3,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    from_guess: GuessOption = False,
    output: OutOption = None,
) -> int:
    """Solve for a gait, verify it and store it.

    With --set KEY=VALUE the file's own gait is followed to the new values; if its family ends on the way, the message
    says where and why. --from-guess looks for a gait near the guess of the file instead.

    With --starts the distinct solutions are listed and the best one is kept; what each start has found stays in the
    run folder, so that the same command resumes where it stopped.
    """
    from gaitopt.store.run import Run
    from gaitopt.workers.jobs import make_workers

    if ATTRACTOR in problem:
        if changes or start or starts > 1 or from_guess:
            raise typer.BadParameter(
                f"{problem} is a gait as it is: --set, --start, --starts and --from-guess change a problem"
            )
        return _solve_attractor(problem, output, terminal)
    loaded = load(problem, changes, terminal)
    loaded = loaded.from_guess() if from_guess else loaded
    loaded = _started(loaded, start, terminal) if start else loaded
    run = Run.of(loaded, output)
    folder = run.folder
    jobs_at = make_workers(workers, scheduler)
    with run.writing(loaded):
        if starts == 1:
            return _report_solved(solve_verified(loaded, terminal), folder, terminal)
        optima = _optima(loaded, starts, seed, spread, folder, jobs_at, terminal)
        about = {"starts": starts, "optima": [optimum.to_record() for optimum in optima]}
        gait = solve_verified(optima[0].problem if optima else loaded, terminal)
        return _report_solved(replace(gait, problem=loaded), folder, terminal, about)


def _report_solved(gait: "Gait", folder: Path, terminal: Terminal, about: dict[str, Any] | None = None) -> int:
    return report(gait, folder if gait.converged else None, terminal, store=True, about=about)


def _optima(
    problem: "Problem", starts: int, seed: int, spread: float, folder: Path, workers: "Workers", terminal: Terminal
) -> "list[Optimum]":
    """The distinct solutions from many starts, printed."""
    from gaitopt.runs.multistart import multistart
    from gaitopt.show.tables import print_optima

    with terminal.working("starts") as (progress, interrupted):
        optima = multistart(
            problem, starts, folder, seed=seed, spread=spread, workers=workers,
            progress=progress, should_stop=interrupted,
        )  # fmt: skip
    if not terminal.json:
        print_optima(terminal.results, optima, starts)
    return optima


def _solve_attractor(place: str, output: Path | None, terminal: Terminal) -> int:
    """Solve the gait of RUN@attractor.K, verify it and store it."""
    from gaitopt.runs.basin import stored_attractor
    from gaitopt.search.solve import solve_attractor
    from gaitopt.store.run import Run

    run, _, index = place.rpartition(ATTRACTOR)
    attractor = stored_attractor(Path(run), index)
    with terminal.solving(place) as (progress, interrupted):
        gait = solve_attractor(attractor, progress=progress, should_stop=interrupted)
    gait = verified(gait, terminal)
    gait_run = Run.of(gait.problem, output)
    with gait_run.writing(gait.problem):
        return _report_solved(gait, gait_run.folder, terminal)


def _started(problem: "Problem", start: str, terminal: Terminal) -> "Problem":
    """The problem with a known gait as its guess."""
    if "@" in start:
        source, record, known = _branch_point(start)
    else:
        gait, _, _ = gait_of(start, None, None, terminal)
        if not gait.converged:
            raise SolveError(f"--start {start}: {gait.status}: {gait.message}")
        source, record, known = gait.problem, gait.to_record(), gait.dynamics.parameters
    if source.walker.model != problem.walker.model:
        raise ProblemError(
            f"--start {start}: a gait of {source.walker.model}, but {problem.name} has {problem.walker.model}"
        )
    return problem.with_guess(record, known)


def _branch_point(start: str) -> "tuple[Problem, dict[str, Any], dict[str, float]]":
    run, _, place = start.rpartition("@")
    problem, parameter, records = stored_branch(run, f"--start {start}: ")
    points = {f"{r['branch']}.{r['index']}": r for r in records if r.get("record") == "point"}
    if place not in points:
        raise StorageError(
            f"--start {start}: the branch has no point {place}; its points are {next(iter(points))} to "
            f"{list(points)[-1]}, in columns branch and index of branch.csv"
        )
    record = points[place]
    return problem, record, problem.parameters | record["parameters"] | {parameter: record["value"]}


STEP_BYTES_MEMORY, STEP_BYTES_DISK = 40_000, 20_000
"""Of the arcs of one step, in memory and as rows of a table."""

StateOption = Annotated[
    list[str] | None,
    typer.Option(
        "--state",
        metavar="NAME=VALUE,...",
        help="State just after an impact, where it differs from the problem's guess or the run's gait.",
    ),
]
StepsOption = Annotated[int, typer.Option("--steps", min=1, help="Steps to walk.")]


def simulate(
    terminal: Terminal,
    run: RunArgument,
    state: StateOption = None,
    steps: StepsOption = 1,
    engine: EngineOption = "auto",
    changes: SetOption = None,
    output: OutOption = None,
) -> int:
    """Simulate steps from a state.

    Contact modes and impacts follow from the forces; every ending has a name. `plot` and `report` of a walk that -o
    has kept compare it with the gait of RUN, or of PROBLEM where that has been solved.
    """
    from gaitopt.api.stored import save
    from gaitopt.gait.gait import Gait
    from gaitopt.problem.problem import Problem
    from gaitopt.runs.grid import check_room
    from gaitopt.show.tables import print_walk
    from gaitopt.store.run import Run
    from gaitopt.verification.walk import simulate as simulate_walk

    start = stored_gait(run, changes)[0] if is_folder(run) else load(run, changes)
    begin = values.state(state)
    if output is not None:
        Run(output).check(start.problem if isinstance(start, Gait) else start)
    disk = 0 if output is None else STEP_BYTES_DISK
    check_room(steps, output or Path(), disk=disk, memory=STEP_BYTES_MEMORY, what="steps")
    terminal.say(f"walking {steps} step{'s' if steps > 1 else ''}")
    with interruptible() as interrupted:
        walk = simulate_walk(start, begin, steps, engine=engine, should_stop=interrupted)
    walk = _compared(walk) if isinstance(start, Problem) else walk
    record = {**walk.to_record(), "run": None if output is None else str(output)}
    try:
        if output is not None:
            save(walk, output)
    finally:  # what was computed is printed even where it cannot be kept
        terminal.show(record, print_walk)
    return 0


def _compared(walk: "Walk") -> "Walk":
    """The walk of a problem beside its gait, where the store has one."""
    from gaitopt.store.run import GAIT_FILES, Run
    from gaitopt.verification.walk import section_states

    run = Run.of(walk.problem)
    if not run.holds(*GAIT_FILES):
        return walk
    return replace(walk, gait_states=section_states(stored_gait(str(run.folder), None)[0]))


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
    from gaitopt.api.progress import job_progress
    from gaitopt.design.neighbourhood import neighbourhood
    from gaitopt.simulation.engine import choose_engine
    from gaitopt.verification import verify as verification

    choose_engine(engine)
    gait, folder, fresh = gait_of(run, changes, output, terminal)
    if not gait.converged:
        return report(gait, None, terminal)
    if not fresh or engine != "auto":
        terminal.say("verifying by forward simulation")
        gait = gait.verified(verification.verify(gait, engine=engine).to_record())
    if not optimum:
        return report(gait, folder, terminal, store=fresh)
    with job_progress(terminal.narration, "directions") as progress:
        searched = neighbourhood(gait, progress=progress)
    code = report(gait, folder, terminal, store=fresh, about={"neighbourhood": searched.to_record()})
    if not terminal.json:
        terminal.results.print(searched.words)
    return code if searched.optimal else NOT_VERIFIED


FindStepsOption = Annotated[
    int | None, typer.Option("--steps", min=1, help="Longest cycle, in steps.", show_default=False)
]
WithinOption = Annotated[
    list[str] | None,
    typer.Option("--within", metavar="KEY=LO:HI", help="Range of a start coordinate, as dtheta1=0:1deg; repeat it."),
]


def find(
    terminal: Terminal,
    problem: ProblemArgument,
    steps: FindStepsOption = None,
    starts: SamplesOption = 1000,
    seed: SeedOption = 0,
    within: WithinOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    changes: SetOption = None,
    output: OutOption = None,
) -> int:
    """Search for all gaits at a problem's parameters, of any mode sequence.

    Walks from many start states and a program with open modes propose gaits; each is solved, verified and listed once,
    stable ones first. What is done is kept; the same command resumes where it stopped.
    """
    from gaitopt.runs.jobs import find_durably
    from gaitopt.search.find import SearchPlan, opened
    from gaitopt.show.tables import print_gaits
    from gaitopt.store.run import Run
    from gaitopt.workers.jobs import make_workers

    loaded = opened(load(problem, changes))
    loaded = loaded if steps is None else loaded.replace({"gait.steps": steps})
    run = Run.of(loaded, output)
    plan = SearchPlan(problem=loaded, starts=starts, seed=seed, within=ranges(within))
    parts_at = make_workers(workers, scheduler)
    with terminal.working("parts of the search") as (progress, interrupted):
        gaits = find_durably(plan, run, parts_at, progress=progress, should_stop=interrupted)
    terminal.show({**gaits.to_record(), "run": str(run.folder)}, print_gaits, "run")
    return 0 if gaits else NOT_A_GAIT


def explain(
    terminal: Terminal,
    problem: ProblemArgument,
    starts: SamplesOption = 1000,
    seed: SeedOption = 0,
    workers: WorkersOption = None,
    changes: SetOption = None,
) -> int:
    """Say why a problem has no gait: the conditions that it violates, the gaits that there are, the nearest values."""
    from gaitopt.search.explain import explain as explained
    from gaitopt.show.tables import print_explanation
    from gaitopt.workers.jobs import make_workers

    loaded, count = load(problem, changes), make_workers(workers, None).count
    with interruptible() as interrupted:
        explanation = explained(
            loaded, starts=starts, seed=seed, workers=count, progress=terminal.say, should_stop=interrupted
        )
    terminal.show(explanation.to_record(), print_explanation)
    return 0
