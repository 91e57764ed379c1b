"""A simulated walk from its run folder: its table cut into steps at the impacts of its record."""

from pathlib import Path

import numpy as np

from gaitopt.arrays import Array
from gaitopt.errors import StorageError
from gaitopt.gait import Arc, Ending, Step, Trajectory
from gaitopt.mechanics import HybridSystem, Mode
from gaitopt.nlp.assembly import impact_record
from gaitopt.runs.restore import table_arcs
from gaitopt.store import read_problem, read_walk
from gaitopt.study.simulate import Walk
from gaitopt.study.system import build_system


def restore_walk(folder: Path) -> Walk:
    """The walk that a run folder holds.

    Raises
    ------
    StorageError
        If there is none, or its files do not fit together.
    """
    record, table = read_walk(folder)
    problem = read_problem(folder)
    system = build_system(problem)
    try:
        p = system.values(problem.parameters | record["parameters"])
        section = record["section"]
        began = [float(point["time"]) for point in section]
        arcs = list(table_arcs(system, table, began)) if table.rows else []
        impacts = [Mode(point["impact"]) for point in section[1:]]
        start, *_ = (np.array([point["state"][name] for name in system.state_names]) for point in section)
        gait = [[float(state[name]) for name in system.state_names] for state in record["gait_states"]]
        ending, message = Ending(record["status"]), str(record["message"])
        steps = tuple(_steps(system, p, arcs, impacts))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise StorageError(f"{folder}: walk.json or walk.csv does not hold a walk ({error!r})") from error
    trajectory = Trajectory(start=start, steps=steps, ending=ending, message=message)
    return Walk(problem=problem, system=system, p=p, trajectory=trajectory, gait_states=np.array(gait))


def _steps(system: HybridSystem, p: Array, arcs: list[tuple[int, Arc]], impacts: list[Mode]) -> list[Step]:
    steps = []
    for index in range(1 + max((index for index, _ in arcs), default=-1)):
        own = tuple(arc for k, arc in arcs if k == index)
        ended = index < len(impacts)
        impact = impact_record(system, impacts[index], own[-1].states[-1], p) if ended else None
        steps.append(Step(arcs=own, impact=impact))
    return steps
