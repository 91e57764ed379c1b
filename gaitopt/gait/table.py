"""A motion as a table, for files: time, mode, state, contact force and torques along its steps."""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from gaitopt.gait.frames import columns_of, data_frame, data_set
from gaitopt.gait.measures import observe
from gaitopt.gait.trajectory import Step
from gaitopt.mechanics import Dynamics, HybridSystem
from gaitopt.problem.scalars import state_unit, unit_of

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


def trajectory_header(system: HybridSystem) -> tuple[str, ...]:
    """Names of the columns: t [s], mode, the state in SI, f_t and f_n [N], and the torque of every actuator [N m]."""
    return ("t", "mode", *system.state_names, "f_t", "f_n", *system.walker.actuators)


def trajectory_rows(dynamics: Dynamics, steps: Iterable[Step]) -> Iterator[tuple[float | str, ...]]:
    """Rows under ``trajectory_header``; time runs on over the steps, x counts from each step's own stance foot.

    Both ends of an arc have a row, so that a time that occurs twice separates two arcs.
    """
    began = 0.0
    for step in steps:
        for arc in step.arcs:
            observed = observe(dynamics, arc)
            numbers = np.hstack([arc.states, observed.force, observed.torque])
            for t, row in zip(arc.times, numbers, strict=True):
                yield (began + float(t), str(arc.mode), *map(float, row))
        began += step.period


def motion_frame(dynamics: Dynamics, steps: Iterable[Step], **attributes: str) -> "DataFrame":
    """That table as a pandas data frame."""
    header = trajectory_header(dynamics.system)
    return data_frame(header, trajectory_rows(dynamics, steps), _units(dynamics.system), **attributes)


def motion_set(dynamics: Dynamics, steps: Iterable[Step], **attributes: str) -> "Dataset":
    """That table as an xarray dataset over ``sample``, with the time as a coordinate."""
    columns = columns_of(trajectory_header(dynamics.system), trajectory_rows(dynamics, steps))
    variables = {name: (("sample",), values) for name, values in columns.items()}
    return data_set(variables, {"t": variables.pop("t")}, _units(dynamics.system), **attributes)


def _units(system: HybridSystem) -> dict[str, str]:
    states = {name: state_unit(name) for name in system.state_names}
    return {name: unit_of(name, system.walker.actuators) for name in trajectory_header(system)} | states
