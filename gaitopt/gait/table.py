"""A motion as a table, for files: time, mode, state, contact force and torques along its steps."""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from gaitopt.gait.measures import observe
from gaitopt.gait.trajectory import Step
from gaitopt.mechanics import HybridSystem

Array = NDArray[np.float64]


def trajectory_header(system: HybridSystem) -> tuple[str, ...]:
    """Names of the columns: t [s], mode, the state in SI, f_t and f_n [N], and the torque of every actuator [N m]."""
    return ("t", "mode", *system.state_names, "f_t", "f_n", *system.walker.actuators)


def trajectory_rows(system: HybridSystem, p: Array, steps: Iterable[Step]) -> Iterator[tuple[float | str, ...]]:
    """Rows under ``trajectory_header``; time runs on over the steps, x counts from each step's own stance foot.

    Both ends of an arc have a row, so that a time that occurs twice separates two arcs.
    """
    began = 0.0
    for step in steps:
        for arc in step.arcs:
            observed = observe(system, p, arc)
            numbers = np.hstack([arc.states, observed.force, observed.torque])
            for t, row in zip(arc.times, numbers, strict=True):
                yield (began + float(t), str(arc.mode), *map(float, row))
        began += step.period
