"""Commands that show something: ``list``, ``show``, ``validate``, ``schema``, ``plot``, ``report``, ``reproduce``."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

import gaitopt as go
from gaitopt.cli import options
from gaitopt.cli.runs import gaits_of, load
from gaitopt.cli.terminal import NOT_A_GAIT, Terminal

FIGURES = "figures"
"""Folder of the figures within a run folder."""
COMPARISON = "comparison"
"""Folder of the figures of several runs, in the working folder."""
REPORT, COMPARISON_REPORT = "report.html", "comparison.html"


def list_problems(terminal: Terminal) -> int:
    """List the included problems.

    Period, radius and stability are shown for problems whose run is in results/, if the terminal is wide enough.
    """
    problems = [go.load_problem(name) for name in go.problem_names()]
    if terminal.json:
        listed = [{"name": p.name, "walker": p.walker.model, "about": p.about} for p in problems]
        terminal.print_json({"problems": listed})
        return 0
    from gaitopt.api.stored import stored_gait_record
    from gaitopt.show.tables import print_problems

    print_problems(terminal.results, [(problem, stored_gait_record(problem)) for problem in problems])
    return 0


class TextFormat(StrEnum):
    """Formats of ``show``: the problem file itself, and the walker for other programs."""

    YAML = "yaml"
    URDF = "urdf"
    MJCF = "mjcf"


def show(
    terminal: Terminal,
    problem: options.ProblemArgument,
    changes: options.SetOption = None,
    form: Annotated[
        TextFormat | None,
        typer.Option("--format", help="Print the problem file as it is, or the walker's links for other programs."),
    ] = None,
) -> int:
    """Print a problem, in SI units with all defaults.

    --format prints its YAML file as it is, or its walker as URDF or MJCF (MuJoCo).
    """
    from gaitopt.show.tables import print_problem

    loaded = load(problem, changes)
    if form is not None:
        if form is not TextFormat.YAML:
            text = go.robot_description(loaded.walker, "urdf" if form is TextFormat.URDF else "mjcf")
        elif changes:
            raise typer.BadParameter("--format yaml prints the file as it is; leave out --set")
        else:
            text = loaded.text
        terminal.show(
            {"format": form.value, "text": text},
            lambda console, _: console.print(text, markup=False, highlight=False, soft_wrap=True, end=""),
        )
        return 0
    if terminal.json:
        terminal.print_json({**loaded.resolved(), "hash": loaded.digest})
    else:
        print_problem(terminal.results, loaded, every=terminal.every)
    return 0


def validate(terminal: Terminal, problem: options.ProblemArgument, changes: options.SetOption = None) -> int:
    """Check a problem and list all its errors."""
    loaded = load(problem, changes, terminal)
    record = {"problem": loaded.name, "valid": True, "hash": loaded.digest}
    terminal.show(record, lambda console, _: console.print(f"{problem}: valid ({loaded.name}, hash {loaded.hash8})"))
    return 0


def schema(terminal: Terminal) -> int:
    """Print the JSON schema of problem files, for editors."""
    terminal.print_json(go.problem_schema())
    return 0


class Format(StrEnum):
    """Formats of figures, and of the animation."""

    SVG = "svg"
    PNG = "png"
    PDF = "pdf"
    HTML = "html"
    GIF = "gif"
    MP4 = "mp4"


def plot(
    terminal: Terminal,
    runs: options.RunArguments,
    what: Annotated[
        list[str] | None,
        typer.Option(
            "--what",
            metavar="NAME",
            help="Name of a figure; may be repeated. Default: all figures that apply.",
        ),
    ] = None,
    formats: Annotated[
        list[Format] | None,
        typer.Option(
            "--format",
            help="Default: svg and png for figures, html for the animation. gif and mp4 apply to the animation only.",
        ),
    ] = None,
    over: Annotated[
        list[str] | None,
        typer.Option("--over", metavar="RUN", help="Draw attractors over the branches in this run; may be repeated."),
    ] = None,
    changes: options.SetOption = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="Folder of the figures. Default: RUN/figures; ./comparison for several runs; the folder of a basin "
            "or a sweep itself.",
            show_default=False,
        ),
    ] = None,
) -> int:
    """Draw figures and animations of results.

    Results are gaits, walks, branches, basins, sweeps, fronts and attractors; several gaits or branches are compared.

    Gait: portrait, force, slip, torques, contacts, postures, force_over_COORDINATE, multipliers, methods (NLP and
    simulation), animation (an HTML page). Walk stored by `simulate -o`: section (states step by step), portrait, force,
    slip, torques, contacts, postures, animation.
    Branch: multipliers, or any scalar of the result, such as spectral_radius. Sweep: any scalar of the result; give
    the folder of the sweep. Front: front.
    """
    from gaitopt.runs.results import SUBFOLDER_KINDS, kind_of
    from gaitopt.show.catalogue import ANIMATION, check_gait_figures, figures_of, folder_figures
    from gaitopt.store.files import check_writable

    if output is not None:
        check_writable(output / FIGURES)
    folder, alone = Path(runs[0]), len(runs) == 1
    figures = folder_figures(*map(Path, runs), over=[Path(run) for run in over or ()])
    if figures:
        target = output or (
            Path(COMPARISON) if not alone else folder if kind_of(folder) in SUBFOLDER_KINDS else folder / FIGURES
        )
    else:
        if not alone and {"methods", ANIMATION} & {*(what or ())}:
            raise typer.BadParameter(f"--what methods and animation show one gait, not {len(runs)}")
        gaits, folders = gaits_of(
            runs, changes, terminal, lambda problem: check_gait_figures(problem, what or (), alone=alone)
        )
        if not all(gait.converged for gait in gaits):
            return NOT_A_GAIT
        target = output or (folders[0] / FIGURES if alone else Path(COMPARISON))
        figures = [figures_of(gaits)]
    for drawn in figures:
        terminal.print_paths(go.save_figures(drawn, target, what or (), formats or (Format.SVG, Format.PNG)))
    return 0


def report(
    terminal: Terminal,
    runs: options.RunArguments,
    changes: options.SetOption = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="The page. Default: RUN/report.html.", show_default=False),
    ] = None,
) -> int:
    """Write one offline page about a result.

    The result is a gait, a walk, a branch, an atlas or robustness, or several gaits side by side. Several gaits are
    written to comparison.html in the working folder, or to the file given by -o.
    """
    from gaitopt.api.pictures import page_in
    from gaitopt.api.stored import stored_replays
    from gaitopt.store.files import check_writable

    if output is not None and (not output.name or output.is_dir()):
        raise typer.BadParameter(f"-o {output}: is a folder; give the name of the page, for instance page.html")
    if output is not None:
        check_writable(output)
    folder, alone = Path(runs[0]), len(runs) == 1
    page = page_in(folder) if alone else None
    if page is None:
        gaits, folders = gaits_of(runs, changes, terminal)
        if not all(gait.converged for gait in gaits):
            return NOT_A_GAIT
        replays = stored_replays(folders[0]) if alone else []
        page, folder = go.report(*gaits, replays=replays), folders[0]
    file = output or (folder / REPORT if alone else Path(COMPARISON_REPORT))
    check_writable(file)
    terminal.print_paths([page.save(file)])
    return 0


def reproduce(
    terminal: Terminal,
    paper: Annotated[str, typer.Argument(metavar="PAPER", help="gamus-or-2013.")],
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="NAME", help="A figure, such as fig9, or table; may be repeated."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="DIR", help="Output folder. Default: results/PAPER.", show_default=False
        ),
    ] = None,
) -> int:
    """Reproduce the figures and numbers of a paper.

    A table compares printed numbers with computed ones.

    Gaits and families are read from the run folders in results/, or computed on all cores and stored there.
    """
    with terminal.working("percent") as (progress, interrupted):
        written = go.reproduce(
            paper, only or (), output=output, narrate=terminal.say, progress=progress, should_stop=interrupted
        )
    terminal.print_paths(written)
    return 0
