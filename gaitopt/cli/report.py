"""``gaitopt report``: a gait, a branch, or gaits side by side as one offline HTML page."""

from pathlib import Path
from typing import Annotated

import typer

from gaitopt.cli.branches import stored_branch
from gaitopt.cli.endings import NOT_A_GAIT
from gaitopt.cli.options import RunArguments, SetOption
from gaitopt.cli.runs import gaits_of
from gaitopt.cli.terminal import Terminal

REPORT = "report.html"
COMPARISON = "comparison.html"

FileOption = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="FILE", help="The page; by default RUN/report.html.", show_default=False),
]


def report(terminal: Terminal, runs: RunArguments, changes: SetOption = None, output: FileOption = None) -> int:
    """Write a page about a gait, a walk or a branch, or about several gaits side by side.

    The page is one file that needs no network. Several gaits go to comparison.html in this folder unless -o says
    otherwise.
    """
    from gaitopt.pages import branch_report, comparison_report, walk_report
    from gaitopt.runs.restore import restore_walk
    from gaitopt.runs.within import kind_of
    from gaitopt.store import adding, check_writable, write_whole

    if output is not None and (not output.name or output.is_dir()):
        raise typer.BadParameter(f"-o {output}: is a folder; give the name of the page, for instance page.html")
    if output is not None:
        check_writable(output)
    kind = kind_of(Path(runs[0])) if len(runs) == 1 else ""
    if kind == "branch":
        page, folder = branch_report(*stored_branch(runs[0])), Path(runs[0])
    elif kind == "walk":
        page, folder = walk_report(restore_walk(Path(runs[0]))), Path(runs[0])
    else:
        gaits, folders = gaits_of(runs, changes, terminal)
        if not all(gait.converged for gait in gaits):
            return NOT_A_GAIT
        page, folder = comparison_report(gaits), folders[0]
    path = output or (folder / REPORT if len(runs) == 1 else Path(COMPARISON))
    with adding(folder, path.parent) as written:
        write_whole(path, page)
        written.append(path)
    terminal.print_paths([path])
    return 0
