"""The gaits of several RUNs: taken from the store, or solved and stored now."""

from pathlib import Path
from typing import TYPE_CHECKING

from gaitopt.cli.runs import gait_of
from gaitopt.cli.solve import report

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from gaitopt.gait import Gait


def stored_gaits(
    runs: "Sequence[str]", changes: list[str] | None, console: "Console"
) -> "tuple[list[Gait], list[Path]]":
    """Gaits and their run folders; what was solved just now is stored, and a failed attempt is reported."""
    from gaitopt.library.stored import save

    gaits: list[Gait] = []
    folders: list[Path] = []
    for run in runs:
        gait, folder, fresh = gait_of(run, changes, None, console)
        if not gait.converged:
            report(gait, None, json=False)
        elif fresh:
            save(gait, folder)
        gaits.append(gait)
        folders.append(folder)
    return gaits, folders
