"""``gaitopt reproduce``: the figures and the printed numbers of a paper, computed again."""

from pathlib import Path
from typing import Annotated

import typer

from gaitopt.cli.terminal import Terminal

PaperArgument = Annotated[str, typer.Argument(metavar="PAPER", help="gamus-or-2013.")]
OnlyOption = Annotated[
    list[str] | None,
    typer.Option("--only", metavar="NAME", help="One figure, fig9 for instance, or table; repeat it for several."),
]
FolderOption = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="DIR", help="By default results/PAPER.", show_default=False)
]


def reproduce(terminal: Terminal, paper: PaperArgument, only: OnlyOption = None, output: FolderOption = None) -> int:
    """Write the figures of a paper, and a table of its printed numbers beside the computed ones.

    Gaits and families are taken from the run folders in results/, or computed, on all cores, and kept there.
    """
    from gaitopt.paper import reproduce as write
    from gaitopt.paper.archive import Archive
    from gaitopt.paper.reproduction import check_names
    from gaitopt.store.run import RESULTS
    from gaitopt.workers.jobs import Workers

    check_names(paper, only or ())
    with terminal.working("percent") as (progress, interrupted):
        archive = Archive(narrate=terminal.say, should_stop=interrupted)
        written = write(archive, output or RESULTS / paper, only or (), progress, Workers())
    terminal.print_paths(written)
    return 0
