"""The kinds of results in a run folder, with their writers and readers: the table behind load_run, plot and report.

A gait or a walk consists of a record and a table of its motion. Numbers of the record that follow from the table must
agree with it, so that a folder that was changed by hand is refused; the error names file and key.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from gaitopt.errors import SolveError, StorageError
from gaitopt.gait import curves
from gaitopt.gait.branch import Branch
from gaitopt.gait.gait import Gait, Status, trajectory_header, trajectory_rows
from gaitopt.gait.measures import measure
from gaitopt.gait.records import CheckedGait, ImpactEntry, WalkRecord
from gaitopt.gait.trace import Trace
from gaitopt.gait.trajectory import SAME_TIME, Arc, Step, Trajectory
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import Ending
from gaitopt.problem.floor import Floor
from gaitopt.runs.atlas import ATLAS_FILE, Atlas, read_atlas
from gaitopt.runs.attractors import ATTRACTORS_FILE, Attractors, read_attractors
from gaitopt.runs.basin import BASIN_FILE, Basin, read_basin
from gaitopt.runs.branch import BRANCH_FILE, restore_branch
from gaitopt.runs.front import Front, front_file, read_fronts
from gaitopt.runs.robustness import ROBUSTNESS_FILE, Robustness, read_robustness
from gaitopt.runs.sweep import SWEEP_FILE, Sweep, read_sweep
from gaitopt.runs.trace import TRACE_FILE, restore_trace
from gaitopt.store.formats import MODE_COLUMN, Table, check_agrees, damaged, validated
from gaitopt.store.gaits import freed_values, gait_from_record, problem_of_record, tabulated_steps
from gaitopt.store.lock import wait_for_writer
from gaitopt.store.run import GAIT_FILE, GAIT_FILES, MANIFEST_FILE, WALK_FILE, WALK_FILES, Run
from gaitopt.systems import problem_dynamics
from gaitopt.verification.walk import Walk

RECOMPUTED = 1e-7
"""Largest relative difference between a stored force or torque and its value at the stored state."""

Result = Gait | Branch | Trace | Walk | Sweep | Basin | Attractors | Atlas | Robustness | Front


def restore_gait(folder: Path) -> Gait:
    """The gait in a run folder.

    Raises
    ------
    SolveError
        If the run contains a failed attempt.
    """
    run = Run(folder)
    (stored, table), problem = run.read_result(), run.problem()
    if stored.get("status") in [status for status in Status if status is not Status.CONVERGED]:
        raise SolveError(f"{folder} contains no gait: {stored.get('status')}, {stored.get('message')}")
    path = folder / GAIT_FILE
    record = validated(CheckedGait, stored, path, states=problem.walker.state_names())
    if problem.is_open:
        problem = replace(problem.with_gait(record), origin=problem)
    problem = problem_of_record(problem, record)
    try:
        dynamics = problem_dynamics(problem).at(freed_values(record))
        periods = [float(step["period"]) for step in record.get("steps", [record])]
        starts = list(accumulate(periods[:-1], initial=0.0))
        steps = tabulated_steps(dynamics, table, starts, problem.cycle.impacts)
        gait = gait_from_record(problem, dynamics, record, steps, measure(steps))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise StorageError(f"{folder}: gait.json or trajectory.csv does not contain a gait ({error!r})") from error
    _check_table(folder / GAIT_FILES[1], table, dynamics, steps)
    check_agrees(path, record, gait.to_record(), "the table beside it")
    return gait


def restore_walk(folder: Path) -> Walk:
    """The walk in a run folder."""
    run = Run(folder)
    (stored, table), problem = run.read_result(WALK_FILES), run.problem()
    try:
        record = validated(WalkRecord, stored, folder / WALK_FILE, states=problem.walker.state_names())
        dynamics = problem_dynamics(problem).at(record["parameters"])
        system = dynamics.system
        began = [point["time"] for point in record["section"]]
        impacts = [Mode.from_record(point["impact"] or "") for point in record["section"][1:]]
        start = np.array([record["section"][0]["state"][name] for name in system.state_names], dtype=float)
        gait = [[state[name] for name in system.state_names] for state in record["gait_states"]]
        floor = Floor.from_record(record["floor"]) if "floor" in record else None
        moved = tabulated_steps(dynamics, table, began, impacts, floor) if table.rows else ()
        trajectory = Trajectory(
            names=system.state_names,
            start=start,
            steps=_with_strikes(moved, record.get("impacts", ())),
            ending=Ending(record["status"]),
            message=record["message"],
        )
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise StorageError(f"{folder}: walk.json or walk.csv does not contain a walk ({error!r})") from error
    states = np.array(gait, dtype=float).reshape(-1, len(system.state_names))
    walk = Walk(problem=problem, dynamics=dynamics, trajectory=trajectory, gait_states=states, floor=floor)
    _check_table(folder / WALK_FILES[1], table, dynamics, trajectory.steps)
    check_agrees(folder / WALK_FILE, record, walk.to_record(), "the table beside it")
    return walk


def _with_strikes(steps: tuple[Step, ...], impacts: Sequence[ImpactEntry]) -> tuple[Step, ...]:
    """The steps, in which arcs that begin with an impact state it."""
    struck = {(entry["step"], entry["time"]): (entry["of"], Mode.from_record(entry["impact"])) for entry in impacts}
    begins = np.cumsum([0.0, *(step.period for step in steps)])

    def arc(number: int, began: float, arc: Arc) -> Arc:
        keys = [key for key in struck if key[0] == number and abs(key[1] - began - arc.start) <= SAME_TIME * key[1]]
        if not keys:
            return arc
        of, after = struck[keys[0]]
        return replace(arc, struck=arc.dynamics.system.transitions.stated_impact(of[0], after))

    return tuple(
        replace(step, arcs=tuple(arc(number, float(began), each) for each in step.arcs))
        for number, (began, step) in enumerate(zip(begins, steps, strict=False), start=1)
    )


def _check_table(path: Path, table: Table, dynamics: Dynamics, steps: Sequence[Step]) -> None:
    """Refuse a table whose header, times, modes, forces or torques do not fit the motion of its states.

    Times must be the Chebyshev points of the arcs. A column is compared relative to its largest value. Forces that the
    equations of motion do not determine are not compared.
    """
    header = trajectory_header(dynamics.system)
    if table.header != header:
        raise damaged(path, f"has columns {', '.join(table.header)}, not {', '.join(header)}", 1)
    stated, true = list[Sequence[Any]](table.rows), list[Sequence[Any]](trajectory_rows(steps))
    numbers = [k for k, name in enumerate(header) if name != MODE_COLUMN]
    values, expected = (np.array([[row[k] for k in numbers] for row in rows], dtype=float) for rows in (stated, true))
    begins = np.cumsum([0.0, *(step.period for step in steps)])
    expected[:, 0] = np.concatenate(
        [
            began + arc.start + arc.duration * (curves.points(arc.times.size) + 1) / 2
            for began, step in zip(begins, steps, strict=False)
            for arc in step.arcs
        ]
    )
    sizes = np.nanmax(np.abs(np.nan_to_num(expected)), axis=0, initial=0.0)
    wrong = ~(np.abs(values - expected) <= RECOMPUTED * sizes) & ~np.isnan(expected)
    for number, (row, other) in enumerate(zip(stated, true, strict=True)):
        name = next((header[k] for k, differs in zip(numbers, wrong[number], strict=True) if differs), "")
        name = name if row[1] == other[1] else MODE_COLUMN
        if name:
            column = header.index(name)
            source = "the equations of motion give" if column else "the points of its arc give"
            value = other[column] if column else expected[number, 0]
            raise damaged(path, f"{name} is {row[column]}, but {source} {value}", number + 2)


def _only_front(folder: Path) -> Front:
    front, *others = read_fronts(folder)
    if others:
        raise StorageError(f"{folder} holds {len(others) + 1} fronts, but no gait; `gaitopt plot` draws them")
    return front


KINDS: Mapping[str, tuple[str, Callable[[Path], Result]]] = {
    "branch": (BRANCH_FILE, restore_branch),
    "trace": (TRACE_FILE, restore_trace),
    "gait": (GAIT_FILE, restore_gait),
    "walk": (WALK_FILE, restore_walk),
    "front": (front_file("*"), _only_front),
    "sweep": (SWEEP_FILE, read_sweep),
    "basin": (BASIN_FILE, read_basin),
    "attractors": (ATTRACTORS_FILE, read_attractors),
    "robustness": (ROBUSTNESS_FILE, read_robustness),
    "atlas": (ATLAS_FILE, read_atlas),
}
"""For each kind of result: the file that identifies it, and its reader. If a folder has several kinds, the first one
counts."""


SUBFOLDER_KINDS = ("sweep", "basin", "attractors", "robustness", "atlas")
"""Kinds of results that lie in a subfolder KIND-KEY of a run folder."""


def kind_of(folder: Path) -> str:
    """The kind of result in a folder, a key of ``KINDS``; empty if there is no such folder, or no result in it.

    A subfolder of a run is identified by its name, so that reading an unfinished one raises an error.
    """
    try:
        name = folder.name.partition("-")[0]
        if name in SUBFOLDER_KINDS and folder.is_dir() and not (folder / MANIFEST_FILE).exists():
            return name
        return next((kind for kind, (file, _) in KINDS.items() if any(folder.glob(file))), "")
    except OSError:  # the text cannot be the name of a folder
        return ""


def read_result(folder: Path) -> Result:
    """The result in a run folder, or in the folder of a sweep or basin.

    Raises
    ------
    StorageError
        If the folder is not a run, or is damaged, unfinished or newer.
    """
    wait_for_writer(folder, lambda: bool(kind_of(folder)))
    kind = kind_of(folder)
    if kind:
        return KINDS[kind][1](folder)
    refuse_other_results(folder)
    raise StorageError(f"{folder} contains no gaitopt result (none of {', '.join(name for name, _ in KINDS.values())})")


def write_result(result: Gait | Walk, run: Run) -> None:
    """Write a gait or a walk, and its table, into a run of its problem.

    Raises
    ------
    SolveError
        If the gait is a failed attempt.
    """
    if isinstance(result, Walk):
        steps, files = result.trajectory.steps, WALK_FILES
    else:
        steps, files = result.steps, GAIT_FILES
        if not steps:
            raise SolveError(f"{result.problem.name} is {result.status}: only a gait is stored")
    table = Table(header=trajectory_header(result.system), rows=trajectory_rows(steps))
    run.write_result(result.problem, result.to_record(), table, files)


def refuse_other_results(folder: Path) -> None:
    """Refuse a run folder that contains other results, but no gait.

    Raises
    ------
    StorageError
        If there are other results; if they are in a folder of their own, the message names it.
    """
    if not (folder / MANIFEST_FILE).is_file() or GAIT_FILE in Run(folder).manifest().files:
        return
    others = [f"a {kind}" for kind in ("branch", "trace", "walk", "front") if any(folder.glob(KINDS[kind][0]))]
    if others:
        raise StorageError(f"{folder} holds {' and '.join(others)}, but no gait")
    subfolders = sorted(str(file.parent) for kind in SUBFOLDER_KINDS for file in folder.glob(f"*/{KINDS[kind][0]}"))
    if subfolders:
        raise StorageError(f"{folder} contains no gait; give the folder of its result: {' or '.join(subfolders)}")
