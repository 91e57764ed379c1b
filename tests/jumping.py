"""A compass with torques that jump at breakpoints, of which one pulls its foot over the ground in every step.

The ankle brakes with 1 N m, but pushes with 12 N m from 0.6 s to 0.62 s. During this push the ratio of the forces that
would hold the foot rises from 0.1678 to 0.1783. With less friction than the larger one the foot slips until the push
ends; with less than the smaller one it slips at once.
"""

from functools import cache

import numpy as np
from casadi import SX

from gaitopt.arrays import Array
from gaitopt.gait.gait import Gait
from gaitopt.model.control import Control
from gaitopt.model.instant import Instant
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.problem.problem import Problem, load_problem
from gaitopt.solver.solve import solve_gait

PUSH = (0.6, 0.62)
SLIPPING = ("stick", "slip_backward", "stick")
AT_ONCE, AT_ALL = 0.167825357, 0.178328165
"""Frictions below which the foot slips at the breakpoint, and at all; from continuation, which locates them in both
directions."""
STATE = {"theta1": -0.12824, "dtheta1": 0.64306, "dtheta2": -0.42062}
"""State after the impact; it depends little on the friction."""


class Staircase(Control):
    """Torques of the ankle that are constant between breakpoints."""

    type = "steps_of_the_ankle"
    jumps = True

    times: tuple[float, ...]
    levels: tuple[float, ...]

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return self.times

    def torques(self, now: Instant) -> dict[str, SX]:
        return {"ankle": now.r[0]}

    def data(self, segment: int) -> Array:
        return np.array([self.levels[segment]])


@cache
def staircase(times: tuple[float, ...], *levels: float) -> HybridSystem:
    """The compass with an ankle torque of these ``levels`` between these times."""
    return HybridSystem(CompassBiped, Staircase(times=times, levels=levels))


@cache
def pushed() -> HybridSystem:
    """The compass that is pushed for 0.02 s."""
    return staircase(PUSH, -1, 12, -1)


def problem(friction: float, *phases: str, **guess: float) -> Problem:
    """A problem of the compass, which is solved with one of these systems."""
    state = {f"gait.guess.state.{name}": value for name, value in (STATE | guess).items()}
    changes = {"friction": friction, "gait.phases": list(phases), "gait.impact": "stick", **state}
    return load_problem("compass-passive-stick").replace(changes)


@cache
def gait(friction: float, *phases: str) -> Gait:
    """A gait of the compass that is pushed; it is shared, so do not alter its arrays."""
    solved = solve_gait(problem(friction, *phases), pushed())
    assert solved.converged, solved.message
    return solved
