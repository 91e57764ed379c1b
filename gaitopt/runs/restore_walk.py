"""A simulated walk from its run folder: its table cut into steps at the impacts of its record."""

from pathlib import Path

import numpy as np

from gaitopt.errors import StorageError
from gaitopt.gait import Arc, Ending, Step, Trajectory
from gaitopt.mechanics import Dynamics, Mode
from gaitopt.nlp.assembly import impact_record
from gaitopt.runs.restore import table_arcs
from gaitopt.store import read_problem, read_walk
from gaitopt.study.simulate import Walk
from gaitopt.study.system import problem_dynamics


def restore_walk(folder: Path) -> Walk:
    """The walk that a run folder holds."""
    record, table = read_walk(folder)
    problem = read_problem(folder)
    try:
        dynamics = problem_dynamics(problem).at(record["parameters"])
        system = dynamics.system
        section = record["section"]
        began = [float(point["time"]) for point in section]
        arcs = list(table_arcs(system, table, began)) if table.rows else []
        impacts = [Mode(point["impact"]) for point in section[1:]]
        start, *_ = (np.array([point["state"][name] for name in system.state_names]) for point in section)
        gait = [[float(state[name]) for name in system.state_names] for state in record["gait_states"]]
        ending, message = Ending(record["status"]), str(record["message"])
        steps = tuple(_steps(dynamics, arcs, impacts))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise StorageError(f"{folder}: walk.json or walk.csv does not hold a walk ({error!r})") from error
    trajectory = Trajectory(names=system.state_names, start=start, steps=steps, ending=ending, message=message)
    return Walk(problem=problem, dynamics=dynamics, trajectory=trajectory, gait_states=np.array(gait))


def _steps(dynamics: Dynamics, arcs: list[tuple[int, Arc]], impacts: list[Mode]) -> list[Step]:
    steps = []
    for index in range(1 + max((index for index, _ in arcs), default=-1)):
        own = tuple(arc for k, arc in arcs if k == index)
        ended = index < len(impacts)
        impact = impact_record(dynamics, impacts[index], own[-1].states[-1]) if ended else None
        steps.append(Step(arcs=own, impact=impact))
    return steps
