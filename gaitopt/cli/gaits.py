"""Commands about the gaits of one problem: ``solve``, ``simulate``, ``verify``, ``stabilise``, ``find``, ..."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import gaitopt as go
from gaitopt.cli import options
from gaitopt.cli.runs import gait_of, is_folder, load, report, shown_result, solve_verified, stored_gait
from gaitopt.cli.terminal import NOT_A_GAIT, NOT_VERIFIED, Terminal, interruptible
from gaitopt.errors import ProblemError, SolveError
from gaitopt.requests import (
    AGREEMENT,
    INTERVALS,
    IPOPT_ITERATIONS,
    NEWTON_STEPS,
    Engine,
    FindRequest,
    FloorRequest,
    Method,
    ProveRequest,
    ReplayRequest,
    RobustnessRequest,
    SearchLimits,
    SimulateRequest,
    SolveRequest,
    StabiliseRequest,
    StartsRequest,
    UntilRequest,
    VerifyRequest,
)

if TYPE_CHECKING:
    from gaitopt.problem.problem import Problem
    from gaitopt.proof.check import Proof
    from gaitopt.search.explain import Explanation
    from gaitopt.search.find import Gaits
    from gaitopt.verification.walk import Walk


def solve(
    terminal: Terminal,
    problem: Annotated[
        str,
        typer.Argument(
            metavar="PROBLEM",
            help="A name from `gaitopt list`, a .yaml file, or RUN@attractor.K, the K-th gait in the table of a basin.",
        ),
    ],
    start: Annotated[
        str | None,
        typer.Option(
            "--start",
            metavar="RUN[@BRANCH.INDEX]",
            help="Use the gait of a run, the point where its design failed, or a point of its branch (see branch.csv), "
            "as the guess.",
            show_default=False,
        ),
    ] = None,
    starts: Annotated[int, options.option(StartsRequest, "starts")] = 1,
    seed: options.SeedOption = 0,
    spread: Annotated[float, options.option(StartsRequest, "spread")] = 0.3,
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
    changes: options.SetOption = None,
    from_guess: options.GuessOption = False,
    method: options.MethodOption = "auto",
    newton_steps: Annotated[int, options.option(SolveRequest, "newton_steps")] = NEWTON_STEPS,
    ipopt_iterations: Annotated[int, options.option(SolveRequest, "ipopt_iterations")] = IPOPT_ITERATIONS,
    intervals: Annotated[int, options.option(SolveRequest, "intervals")] = INTERVALS,
    output: options.OutOption = None,
) -> int:
    """Solve for a gait, verify it and store it.

    With --set KEY=VALUE the gait of the file is followed to the new values. If its family ends on the way, the message
    says where and why. --from-guess starts from the guess of the file instead.

    With --starts the distinct solutions are listed and the best one is stored. The result of each start is stored in
    the run folder. Repeat the command to resume.
    """
    from gaitopt.api import stored
    from gaitopt.show.tables import print_optima
    from gaitopt.store.run import Run

    limits = SearchLimits(newton_steps=newton_steps, ipopt_iterations=ipopt_iterations, intervals=intervals)
    given = [f"--{name.replace('_', '-')}" for name in limits.stated]
    given += [] if method == Method.AUTO else ["--method"]
    if starts > 1 and given:
        raise typer.BadParameter(f"{given[0]} and --starts exclude each other; leave out one of them")
    if stored.ATTRACTOR in problem:
        if changes or start or starts > 1 or from_guess:
            raise typer.BadParameter(
                f"{problem} is a finished gait; leave out --set, --start, --starts and --from-guess"
            )
        attractor = stored.load_attractor(problem)
        folder = Run.of(attractor.problem, output).folder
        with shown_result(lambda gait: report(gait, folder, terminal)):
            gait = solve_verified(attractor, terminal, output or True, method, limits=limits)
        return report(gait, Run.of(gait.problem, output).folder, terminal)
    loaded = load(problem, changes, terminal)
    loaded = loaded.from_guess() if from_guess else loaded
    loaded = _started(loaded, start, terminal) if start else loaded
    folder = Run.of(loaded, output).folder
    if starts == 1:
        with shown_result(lambda gait: report(gait, folder, terminal)):
            gait = solve_verified(loaded, terminal, folder, method, limits=limits)
        return report(gait, folder, terminal)
    with Run(folder).writing(loaded):
        with terminal.working("starts") as (progress, interrupted):
            optima = go.multistart(
                loaded, starts, seed=seed, spread=spread, workers=workers, scheduler=scheduler, output=folder,
                progress=progress, should_stop=interrupted,
            )  # fmt: skip
        if not terminal.json:
            print_optima(terminal.results, optima, starts)
        more = {"starts": starts, "optima": [optimum.to_record() for optimum in optima]}
        with shown_result(lambda gait: report(gait, folder, terminal, more)):
            gait = solve_verified(loaded, terminal, folder, method, optima[0] if optima else None)
        return report(gait, folder, terminal, more)


def _started(problem: "Problem", start: str, terminal: Terminal) -> "Problem":
    """The problem with the gait of ``--start`` as its guess."""
    from gaitopt.api.stored import best_point_in, load_branch_point
    from gaitopt.store.run import Run

    if "@" in start:
        gait = load_branch_point(start, "--start ").gait
    else:
        folder = Path(start) if is_folder(start) else Run.of(load(start, None, terminal)).folder
        best = best_point_in(folder)
        if best is not None:
            terminal.say(f"goes on from {folder}, where the design ended")
            return problem.with_guess(best)
        gait, *_ = gait_of(start, None, None, terminal, keep=False)
    if not gait.converged:
        raise SolveError(f"--start {start}: {gait.status}: {gait.message}")
    model, needed = gait.problem.walker.model, problem.walker.model
    if model != needed:
        raise ProblemError(f"--start {start}: a gait of {model}, but {problem.name} has {needed}")
    return problem.with_guess(gait)


def simulate(
    terminal: Terminal,
    run: options.RunArgument,
    state: Annotated[
        list[str] | None,
        typer.Option(
            "--state",
            metavar="NAME=VALUE,...",
            help="Start state: section coordinates just after an impact, or a whole state. Default: the state or guess "
            "of the problem, or the gait of the run.",
        ),
    ] = None,
    steps: Annotated[int | None, options.option(SimulateRequest, "steps")] = None,
    time: Annotated[float | None, options.option(UntilRequest, "time")] = None,
    events: Annotated[int | None, options.option(UntilRequest, "events")] = None,
    engine: options.EngineOption = "auto",
    longest_step: Annotated[float | None, options.option(SimulateRequest, "longest_step")] = None,
    floor: Annotated[str | None, options.option(FloorRequest, "floor", metavar="TILES")] = None,
    random: Annotated[str | None, options.option(FloorRequest, "random", metavar="DISTRIBUTION")] = None,
    seed: options.SeedOption = 0,
    changes: options.SetOption = None,
    output: options.OutOption = None,
) -> int:
    """Simulate steps from a state, or a motion until a time.

    The problem needs no gait: a walker, friction and a state suffice. The simulation selects contact modes and impacts
    from the forces, and names the way in which the walk ends. With -o the walk is stored; `plot` and `report` then
    compare it with the gait of RUN, or of PROBLEM if it is solved.
    """
    from gaitopt.show.tables import print_walk

    start = stored_gait(run, changes) if is_folder(run) else load(run, changes, terminal)
    begin = options.state(state)

    def show(walk: "Walk") -> None:
        record = {**walk.to_record(), "run": None if output is None else str(output)}
        terminal.show(record, lambda console, shown: print_walk(console, shown, walk.problem))

    until = None
    if time is not None or events is not None:
        until, steps = go.Until(time=time, steps=steps, events=events), None
    with shown_result(show), interruptible() as interrupted:
        walk = go.simulate(
            start, begin, steps, until=until, engine=engine, longest_step=longest_step,
            floor=options.floor(floor, random, seed, steps), compare=True,
            output=output or False, should_stop=interrupted,
        )  # fmt: skip
    show(walk)
    return 0


def verify(
    terminal: Terminal,
    run: options.RunArgument,
    engine: options.EngineOption = "auto",
    tolerance: Annotated[float, options.option(VerifyRequest, "tolerance")] = AGREEMENT,
    optimum: Annotated[
        bool, typer.Option("--optimum", help="Search near a design for a better one that meets the constraints.")
    ] = False,
    changes: options.SetOption = None,
    output: options.OutOption = None,
) -> int:
    """Verify a gait by forward simulation.

    The simulation does not know the mode sequence; it selects the modes from the forces. A finished RUN stays as it is;
    -o stores its gait with the new verification in another folder.
    """
    from gaitopt.design.neighbourhood import check_design
    from gaitopt.simulation.engine import choose_engine

    choose_engine(engine)
    with shown_result(lambda gait: report(gait, None, terminal)):
        gait, folder, fresh = gait_of(
            run, changes, output, terminal, required=True, check=check_design if optimum else None
        )
    if not fresh or engine != "auto" or tolerance != AGREEMENT:
        terminal.say("verifying by forward simulation")
        gait = gait.verified(go.verify(gait, engine=engine, tolerance=tolerance).to_record())
        if fresh or output is not None:
            folder = output or folder
            gait.save(folder)
    if not optimum:
        return report(gait, folder, terminal)
    with terminal.working("directions") as (progress, _):
        searched = go.neighbourhood(gait, progress=progress)
    code = report(gait, folder, terminal, {"neighbourhood": searched.to_record()})
    if not terminal.json:
        terminal.results.print(searched.summary)
    return code if searched.optimal else NOT_VERIFIED


def sensitivity(terminal: Terminal, run: options.RunArgument, changes: options.SetOption = None) -> int:
    """Differentiate a gait by every continuous parameter.

    The derivatives of state, period, step length, speed, costs, required friction, multipliers and spectral radius are
    exact. Where there is none, as at multiple multipliers, the table says why.
    """
    from gaitopt.show.tables import print_derivatives

    gait, _, _ = gait_of(run, changes, None, terminal, required=True)
    terminal.show(go.sensitivity(gait).to_record(), print_derivatives)
    return 0


def robustness(
    terminal: Terminal,
    run: options.RunArgument,
    what: Annotated[str | None, options.option(RobustnessRequest, "what")] = None,
    over: Annotated[str | None, options.option(RobustnessRequest, "over", metavar="KEY")] = None,
    random: Annotated[str | None, options.option(RobustnessRequest, "random", metavar="DISTRIBUTION")] = None,
    walks: Annotated[int, options.option(RobustnessRequest, "walks")] = 400,
    steps: Annotated[int, options.option(RobustnessRequest, "steps")] = 1000,
    seed: options.SeedOption = 0,
    engine: options.EngineOption = "auto",
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
    changes: options.SetOption = None,
    output: options.OutOption = None,
) -> int:
    """Measure how robust a stable gait is on an uncertain floor.

    The table has the stable range of friction, the limits of patches of ice, of steps and slopes of the ground and of
    pushes, the gait sensitivity norm, and the mean number of steps to a fall on random tiles. Finished figures are
    stored; repeat the command to resume.
    """
    from gaitopt.runs.robustness import check_question
    from gaitopt.show.tables import print_robustness

    request = RobustnessRequest(
        what=what, over=over, random=random, walks=walks, steps=steps, seed=seed, engine=Engine(engine)
    )
    check = partial(check_question, request=request)
    gait, _, _ = gait_of(run, changes, None, terminal, required=True, check=check)
    with (
        shown_result(lambda gait: report(gait, None, terminal)),
        terminal.working("figures") as (progress, interrupted),
    ):
        found = go.robustness(
            gait, **request.arguments, workers=workers, scheduler=scheduler, output=output, progress=progress,
            should_stop=interrupted,
        )  # fmt: skip
    record = {**found.to_record(), "run": str(found.folder)}
    terminal.show(record, lambda console, _: print_robustness(console, found), "run")
    return 0


def stabilise(
    terminal: Terminal,
    run: options.RunArgument,
    law: Annotated[str | None, options.option(StabiliseRequest, "law")] = None,
    phase: Annotated[str | None, options.option(StabiliseRequest, "phase")] = None,
    degree: Annotated[int | None, options.option(StabiliseRequest, "degree")] = None,
    radius: Annotated[float, options.option(StabiliseRequest, "radius")] = 1.0,
    changes: options.SetOption = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE.yaml", help="Write the problem with the law.")
    ] = None,
) -> int:
    """Find a feedback law that walks a gait stably.

    Virtual constraints: the joints follow curves over a phase variable, which are invariant under the impact. PD
    control: the joints track curves over the clock or a phase variable. -o writes the problem; `gaitopt solve` and all
    other commands take it.
    """
    from gaitopt.api import stored
    from gaitopt.search.stabilise import check_phase
    from gaitopt.show.tables import print_stabilised

    if output is not None:
        stored.check_problem_file(output)
    check = partial(check_phase, phase=phase)
    gait, _, _ = gait_of(run, changes, None, terminal, required=True, check=check)
    with interruptible() as interrupted:
        made = go.stabilise(
            gait, law=law, phase=phase, degree=degree, radius=radius, output=output, progress=terminal.say,
            should_stop=interrupted,
        )  # fmt: skip
    file = None if output is None else str(output)
    terminal.show(
        {**made.to_record(), "file": file},
        lambda console, record: print_stabilised(console, record, made.problem, every=terminal.every),
        *([] if file is None else ["file"]),
    )
    return NOT_A_GAIT if made.objections else 0


def find(
    terminal: Terminal,
    problem: options.ProblemArgument,
    steps: Annotated[int | None, options.option(FindRequest, "steps")] = None,
    starts: options.SamplesOption = 1000,
    seed: options.SeedOption = 0,
    within: Annotated[list[str] | None, options.option(FindRequest, "within", metavar="KEY=LO:HI")] = None,
    method: options.MethodOption = "auto",
    seconds: options.SecondsOption = None,
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
    changes: options.SetOption = None,
    output: options.OutOption = None,
) -> int:
    """Find all gaits of a walker, with any mode sequence.

    Candidates come from simulations of many start states and from the families of gaits. Each gait is solved, verified
    and listed once, stable ones first. Gaits are named on standard error as soon as they are found. Repeat the command
    to resume.
    """
    from gaitopt.show.tables import print_gaits
    from gaitopt.store.run import Run

    loaded, named = load(problem, changes, terminal), set[str]()

    def name(gaits: "Gaits") -> None:
        for gait in gaits:
            line = f"{gait.problem.cycle}, period {gait.period:.6g} s, radius {gait.spectral_radius:.4g}"
            if line not in named:
                named.add(line)
                terminal.say(f"  found: {line}")

    with terminal.working("parts of the search") as (progress, interrupted):
        gaits = go.find(
            loaded, steps=steps, starts=starts, seed=seed, within=options.ranges(within), method=method,
            seconds=seconds, workers=workers, scheduler=scheduler, output=output or True, found=name, progress=progress,
            should_stop=interrupted,
        )  # fmt: skip
    folder = Run.of(gaits.problem, output).folder
    terminal.show({**gaits.to_record(), "run": str(folder)}, print_gaits, "run")
    return 0 if gaits else NOT_A_GAIT


def explain(
    terminal: Terminal,
    problem: options.ProblemArgument,
    starts: options.SamplesOption = 1000,
    seed: options.SeedOption = 0,
    seconds: options.SecondsOption = None,
    workers: options.WorkersOption = None,
    changes: options.SetOption = None,
) -> int:
    """Explain why a problem has no gait.

    The answer lists violated conditions, existing gaits, and the nearest parameter values with a gait. Each line is
    printed as soon as it is known: conditions and the end of the family at once, the rest after a search.
    """
    from gaitopt.api.progress import stage_progress
    from gaitopt.show.tables import explanation_lines, print_explanation

    loaded, printed = load(problem, changes), list[str]()

    def show(explanation: "Explanation") -> None:
        new = [line for line in explanation_lines(explanation.to_record()) if line not in printed]
        for line in new if not terminal.json else ():
            terminal.results.print(line, style=None if printed else "bold")
            printed.append(line)

    with interruptible() as interrupted, stage_progress(terminal.narration, f"explaining {loaded.name}") as progress:
        explanation = go.explain(
            loaded, starts=starts, seed=seed, seconds=seconds, workers=workers, found=show,
            progress=lambda stage: progress(stage, 0, 0), parts=lambda done, total: progress("", done, total),
            should_stop=interrupted,
        )  # fmt: skip
    terminal.show(explanation.to_record(), lambda console, record: print_explanation(console, record, printed))
    return 0


def prove(
    terminal: Terminal,
    run: Annotated[
        str,
        typer.Argument(
            metavar="RUN[@special.K]",
            help="A run folder, a PROBLEM, or the K-th special point of a branch (from 0); with --check a certificate.",
        ),
    ],
    check: Annotated[bool, typer.Option("--check", help="Verify a certificate again, without any search.")] = False,
    width: Annotated[float | None, options.option(ProveRequest, "width")] = None,
    changes: options.SetOption = None,
    output: options.OutOption = None,
) -> int:
    """Prove existence, mode sequence and stability of a gait.

    Ball arithmetic encloses the orbit, its mode sequence and its multipliers. The certificate is stored in the run
    folder. --set KEY=LO..HI proves the gait for all values of an interval. RUN@special.K proves a special point of a
    branch: the family exists around it, and the function that defines it changes its sign.
    """
    from gaitopt.api import stored, verbs

    if check:
        if changes or output is not None:
            raise typer.BadParameter("--check reads a certificate and nothing else; leave out --set and -o")
        return _report_proof(go.check_proof(run), Path(run), terminal)
    if stored.SPECIAL in run:
        if changes:
            raise typer.BadParameter("--set changes a problem, but this branch is finished; leave it out")
        return _prove_special(run, width, output, terminal)
    if width is not None:
        raise typer.BadParameter("--width applies to special points only, RUN@special.K")
    values, intervals = _intervals(changes)
    gait, folder, _ = gait_of(run, values, output, terminal, required=True)
    terminal.say(f"proving {gait.problem.name}; this takes ten seconds to some minutes")
    file = (output or folder) / verbs.CERTIFICATE_FILE
    return _report_proof(go.prove(gait, intervals, output=file, progress=terminal.say), file, terminal)


def _prove_special(address: str, width: float | None, output: Path | None, terminal: Terminal) -> int:
    from gaitopt.api import stored, verbs

    run, _, number = address.rpartition(stored.SPECIAL)
    special, parameter = stored.load_special_point(address)
    file = (output or Path(run)) / f"special-{number}-{verbs.CERTIFICATE_FILE}"
    name = special.gait.problem.name if special.gait is not None else run
    terminal.say(f"proving {special.type} of {name} near {parameter} = {special.value:.9g}: some minutes")
    with shown_result(lambda gait: report(gait, None, terminal)):
        proof = go.prove(special, parameter=parameter, width=width, output=file, progress=terminal.say)
    return _report_proof(proof, file, terminal)


def _intervals(changes: list[str] | None) -> tuple[list[str] | None, dict[str, str]]:
    """The options ``--set`` with every interval replaced by its middle, and the intervals ``LO..HI`` by key."""
    from gaitopt.proof.arithmetic import INTERVAL, ball, precision

    pairs = [options.key_value(text, "--set") for text in changes or ()]
    intervals = {key: text for key, text in pairs if INTERVAL in text}
    try:
        with precision():
            middles = {key: repr(float(ball(text).mid())) for key, text in intervals.items()}
    except ValueError as error:
        raise ProblemError(f"--set {', '.join(intervals)}: {error}") from error
    return [f"{key}={middles.get(key, text)}" for key, text in pairs] or None, intervals


def _report_proof(proof: "Proof", file: Path, terminal: Terminal) -> int:
    from gaitopt.show.tables import print_proof

    terminal.show({**proof.to_record(), "certificate": str(file)}, print_proof, "certificate")
    return 0 if proof.proved else NOT_A_GAIT


def replay(
    terminal: Terminal,
    run: options.RunArgument,
    engine: Annotated[str, typer.Option("--engine", help="mujoco, drake, pybullet or siconos.")],
    setting: Annotated[
        str | None, typer.Option("--setting", help="default or best. Default: both.", show_default=False)
    ] = None,
    time_steps: Annotated[list[float] | None, options.option(ReplayRequest, "time_steps", "--dt")] = None,
    changes: options.SetOption = None,
    output: options.OutOption = None,
) -> int:
    """Replay a gait in another physics engine.

    The engine starts from the gait's state and simulates one cycle with each time step. A table lists the errors for
    each time step. The result is stored in the run folder; `report` draws the motion of the engine over the gait's.
    """
    from gaitopt.api import stored
    from gaitopt.engines.replay import adapter, named_settings
    from gaitopt.show.tables import print_replay

    named_settings(adapter(engine), setting)
    gait, folder, _ = gait_of(run, changes, output, terminal, required=True)
    folder = output or folder
    with terminal.working(f"runs of {engine}") as (progress, interrupted):
        replays = go.replay(
            gait, engine, settings=setting, time_steps=time_steps, output=folder, progress=progress,
            should_stop=interrupted,
        )  # fmt: skip
    file = stored.replay_file(folder, replays[0].engine)
    for result in replays:
        terminal.show({**result.to_record(), "file": str(file)}, print_replay)
    if not terminal.json:
        terminal.print_paths([file])
    return 0
