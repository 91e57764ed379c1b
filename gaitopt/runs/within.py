"""What a folder holds, by its files: a branch, a gait, a walk, fronts; or in a folder of its own a sweep or a basin."""

from pathlib import Path

from gaitopt.errors import StorageError
from gaitopt.runs.basin_tiles import BASIN_FILE
from gaitopt.runs.front import front_file
from gaitopt.runs.sweep_table import SWEEP_FILE
from gaitopt.store import BRANCH_FILE, GAIT_FILE, WALK_FILE
from gaitopt.store.manifest import MANIFEST_FILE, read_manifest

FILES = {
    "branch": BRANCH_FILE,
    "gait": GAIT_FILE,
    "walk": WALK_FILE,
    "front": front_file("*"),
    "sweep": SWEEP_FILE,
    "basin": BASIN_FILE,
}
"""By which a result is known; of several in one folder the first one counts."""


def kind_of(folder: Path) -> str:
    """What a folder holds, a key of ``FILES``; empty where there is no such folder, or nothing of these in it."""
    try:
        return next((kind for kind, name in FILES.items() if any(folder.glob(name))), "")
    except OSError:  # no name of a folder
        return ""


def refuse_other_results(folder: Path) -> None:
    """Name what a run folder holds that never had a gait.

    Raises
    ------
    StorageError
        If it holds something; of basins and sweeps the message says which folder to give.
    """
    if not (folder / MANIFEST_FILE).is_file() or GAIT_FILE in read_manifest(folder).files:
        return
    others = [f"a {kind}" for kind in ("branch", "walk", "front") if any(folder.glob(FILES[kind]))]
    if others:
        raise StorageError(f"{folder} holds {' and '.join(others)}, but no gait")
    places = sorted(str(file.parent) for name in (BASIN_FILE, SWEEP_FILE) for file in folder.glob(f"*/{name}"))
    if places:
        raise StorageError(f"{folder} holds no gait; give the folder of its basin or sweep: {' or '.join(places)}")
