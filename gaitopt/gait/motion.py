"""A motion of a problem's walker, and its table: time, mode, state, contact force and torques along its steps."""

from abc import abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.display import Moving
from gaitopt.gait.frames import data_frame, sample_set
from gaitopt.gait.measures import observe
from gaitopt.gait.trajectory import Step
from gaitopt.mechanics import Dynamics, HybridSystem
from gaitopt.problem import Problem
from gaitopt.problem.scalars import state_unit, unit_of

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkerMotion(Moving, ReadOnlyArrays):
    """What a gait and a simulated walk have in common.

    Attributes
    ----------
    problem : whose walker, control and friction were used.
    dynamics : the hybrid system at its parameters.
    """

    problem: Problem
    dynamics: Dynamics

    @property
    def system(self) -> HybridSystem:
        """The hybrid system that moves."""
        return self.dynamics.system

    @property
    def p(self) -> Array:
        """Parameter vector, shape (n_p,); see ``Dynamics``."""
        return self.dynamics.p

    def to_frame(self) -> "DataFrame":
        """All steps as a pandas data frame: the columns of the table in a run folder, units in ``attrs["units"]``."""
        steps, attributes = self._tabulated()
        rows = trajectory_rows(self.dynamics, steps)
        return data_frame(trajectory_header(self.system), rows, _units(self.system), **attributes)

    def to_xarray(self) -> "Dataset":
        """The same as an xarray dataset over ``sample``, with the time as a coordinate and units as attributes."""
        steps, attributes = self._tabulated()
        rows = trajectory_rows(self.dynamics, steps)
        return sample_set(trajectory_header(self.system), rows, _units(self.system), **attributes)

    @abstractmethod
    def _tabulated(self) -> tuple[tuple[Step, ...], dict[str, str]]:
        """The steps of the table, and its attributes."""

    def _state_record(self, state: Array) -> dict[str, float]:
        return dict(zip(self.system.state_names, map(float, state), strict=True))


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


def _units(system: HybridSystem) -> dict[str, str]:
    states = {name: state_unit(name) for name in system.state_names}
    return {name: unit_of(name, system.walker.actuators) for name in trajectory_header(system)} | states
