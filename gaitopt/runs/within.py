"""Basins and sweeps within a run folder, each of which has a folder of its own."""

from pathlib import Path

from gaitopt.errors import StorageError
from gaitopt.runs.basin_tiles import BASIN_FILE
from gaitopt.runs.sweep_table import SWEEP_FILE


def refuse_parent(folder: Path) -> None:
    """Name the basins and sweeps of a folder that holds nothing else.

    Raises
    ------
    StorageError
        If there are some; the message says which folder to give.
    """
    places = sorted(str(file.parent) for name in (BASIN_FILE, SWEEP_FILE) for file in folder.glob(f"*/{name}"))
    if places:
        raise StorageError(f"{folder} holds no gait; give the folder of its basin or sweep: {' or '.join(places)}")
