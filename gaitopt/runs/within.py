"""What a run folder holds instead of a gait: a branch, a walk, a front, or basins and sweeps in their own folders."""

from pathlib import Path

from gaitopt.errors import StorageError
from gaitopt.runs.basin_tiles import BASIN_FILE
from gaitopt.runs.front import front_file
from gaitopt.runs.sweep_table import SWEEP_FILE
from gaitopt.store import BRANCH_FILE, GAIT_FILE, WALK_FILE
from gaitopt.store.manifest import MANIFEST_FILE, read_manifest

OTHERS = {BRANCH_FILE: "a branch", WALK_FILE: "a walk", front_file("*"): "a front"}


def refuse_other_results(folder: Path) -> None:
    """Name what a run folder holds that never had a gait.

    Raises
    ------
    StorageError
        If it holds something; of basins and sweeps the message says which folder to give.
    """
    if not (folder / MANIFEST_FILE).is_file() or GAIT_FILE in read_manifest(folder).files:
        return
    others = [words for name, words in OTHERS.items() if any(folder.glob(name))]
    if others:
        raise StorageError(f"{folder} holds {' and '.join(others)}, but no gait")
    places = sorted(str(file.parent) for name in (BASIN_FILE, SWEEP_FILE) for file in folder.glob(f"*/{name}"))
    if places:
        raise StorageError(f"{folder} holds no gait; give the folder of its basin or sweep: {' or '.join(places)}")
