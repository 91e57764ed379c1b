"""Simulated walks from a state just after an impact; the simulator does not know the mode sequence."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose, isfinite
from typing import Any

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.display import counted
from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.gait.gait import Gait, WalkerMotion
from gaitopt.gait.measures import contact_record, control_record, measure
from gaitopt.gait.records import phase_records
from gaitopt.gait.trajectory import Step, Trajectory
from gaitopt.gait.zero_dynamics import constraint_measures
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.transitions import Ending
from gaitopt.problem.faults import shown
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import MEASURES
from gaitopt.simulation.engine import Engine
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.systems import problem_dynamics
from gaitopt.threads import cached_property


@dataclass(frozen=True, kw_only=True)
class Walk(WalkerMotion):
    """A simulated walk.

    Attributes
    ----------
    problem : the problem whose walker, control and friction were used.
    dynamics : the hybrid system at its parameters.
    trajectory : steps, ending and message.
    gait_states : ndarray, shape (n_steps, n_z) - states after each impact of the gait from which it started; no
        rows if it started from a problem.
    """

    trajectory: Trajectory
    gait_states: Array

    def __repr__(self) -> str:
        count, ending = len(self.complete_steps), self.trajectory.ending
        return f"<Walk {self.problem.name}: {counted(count, 'step')}, {ending}>"

    @property
    def completed(self) -> bool:
        """Whether the walk completed all its steps; otherwise ``trajectory.message`` says why it ended."""
        return self.trajectory.ending is Ending.COMPLETED

    @cached_property
    def complete_steps(self) -> tuple[Step, ...]:
        """The steps that ended with an impact."""
        return tuple(step for step in self.trajectory.steps if step.impact is not None)

    def to_record(self) -> dict[str, Any]:
        """One JSON object with those keys of a gait that a simulation knows; scalars are of the last step."""
        last = self.complete_steps[-1] if self.complete_steps else None
        state = self.trajectory.section_states[-1]
        stated = self.system.values(self.problem.parameters)
        moving = zip(self.dynamics.parameters.items(), stated, strict=True)
        constraints = None if last is None else constraint_measures([last])
        impacts = [None, *(step.impact.mode.words for step in self.complete_steps if step.impact is not None)]
        return {
            "problem": self.problem.name,
            "status": str(self.trajectory.ending),
            "message": self.trajectory.message,
            "friction": self.problem.friction_data,
            "steps": len(self.complete_steps),
            "phases": [] if last is None else phase_records(last),
            "impact": None if last is None or last.impact is None else last.impact.mode.words,
            "state": self._state_record(state),
            **(dict.fromkeys(MEASURES) if last is None else measure([last])),
            **({} if last is None else {**contact_record([last]), **control_record([last])}),
            **({} if constraints is None else constraints.to_record()),
            "section": [
                {"time": float(t), "impact": mode, "state": self._state_record(z)}
                for t, mode, z in zip(self.section_times, impacts, self.trajectory.section_states, strict=True)
            ],
            "gait_states": [self._state_record(state) for state in self.gait_states],
            "parameters": {key: value for (key, value), other in moving if value != other},  # those of the gait
        }

    @property
    def section_times(self) -> Array:
        """Times of the start and of each impact [s]; shape (n_impacts + 1,)."""
        return np.cumsum([0.0, *(step.period for step in self.complete_steps)])

    def _tabulated(self) -> tuple[tuple[Step, ...], dict[str, str]]:
        return self.trajectory.steps, {"problem": self.problem.name, "ending": str(self.trajectory.ending)}


def simulate(
    start: Gait | Problem,
    state: Mapping[str, float] | None = None,
    steps: int = 1,
    *,
    dense: bool = True,
    engine: str = Engine.AUTO,
    should_stop: Stop = None,
) -> Walk:
    """Simulate steps from a state just after an impact.

    Parameters
    ----------
    start : a gait, or a problem (then from the state of its guess).
    state : values by name that replace those of ``start``'s state; all other entries follow from the section.
    steps : number of steps.
    dense : False keeps only the ends of every arc, for long walks.
    engine : ``auto``, ``scipy`` or ``heyoka``.

    Raises
    ------
    SolveError
        If ``start`` is a failed solve, and ``state`` is not complete.
    ProblemError
        If a coordinate or rate of the state is not a finite number, or a contact is below the ground.
    UnknownNameError
        If ``state`` names something that is not a section coordinate of the walker, or the
        engine is unknown or not installed.
    """
    problem = start.problem if isinstance(start, Gait) else start
    dynamics = start.dynamics if isinstance(start, Gait) else problem_dynamics(start)
    z = _initial_state(start, dynamics, state or {})
    simulator = Simulator(dynamics, stepper_class(engine, steps=steps))
    simulator.check_start(z)
    trajectory = simulator.run(z, steps=steps, dense=dense, should_stop=should_stop)
    width = len(dynamics.system.state_names)
    states = states_after_impacts(start) if isinstance(start, Gait) else np.empty(0)
    return Walk(problem=problem, dynamics=dynamics, trajectory=trajectory, gait_states=states.reshape(-1, width))


def states_after_impacts(gait: Gait) -> Array:
    """States of a gait after each impact; shape (n_steps, n_z)."""
    return np.array([step.arcs[0].states[0] for step in gait.steps])


def _initial_state(start: Gait | Problem, dynamics: Dynamics, state: Mapping[str, float]) -> Array:
    walker, cycle = dynamics.system.walker, (start.problem if isinstance(start, Gait) else start).cycle
    names = dynamics.system.section(cycle).names if walker.contacts else walker.section_names(slipping=True)
    if not isinstance(state, Mapping):
        raise ProblemError(
            f"state: {shown(state)} has no names; write {{{names[0]!r}: 0.1, ...}}, of {', '.join(names)}"
            + f", or steps={state} for the number of steps" * isinstance(state, int)
        )
    if walker.contacts:
        return _contact_state(start, dynamics, state)
    unknown = [name for name in state if name not in names]
    if unknown:
        raise UnknownNameError(
            f"state {', '.join(unknown)}: not a coordinate just after an impact; use {', '.join(names)}"
        )
    if isinstance(start, Gait) and not start.steps and len(state) < len(names):
        raise SolveError(
            f"{start.problem.name} is {start.status}: give the whole state to start from: {', '.join(names)}"
        )
    values: Mapping[str, float] = start.guess.state if isinstance(start, Problem) else {}
    if isinstance(start, Gait) and start.steps:
        values = dict(zip(dynamics.system.state_names, start.state, strict=True))
    section = {name: float({**values, **state}[name]) for name in names}
    z = dynamics.lift(np.array([*section.values()]))
    undefined = [
        f"{name} = {value}" for name, value in zip(dynamics.system.state_names, z, strict=True) if not isfinite(value)
    ]
    if undefined:
        words = ", ".join(f"{name} = {value:g}" for name, value in section.items())
        raise ProblemError(f"state {words}: the walker would start with {undefined[0]}, which is not a number")
    return z


def _contact_state(start: Gait | Problem, dynamics: Dynamics, state: Mapping[str, float]) -> Array:
    """As ``_initial_state``, for a walker with several contacts: the state of the section next to that of ``start``."""
    problem = start.problem if isinstance(start, Gait) else start
    names, section = dynamics.system.state_names, dynamics.system.section(problem.cycle)
    unknown = [name for name in state if name not in names]
    if unknown:
        raise UnknownNameError(
            f"state {', '.join(unknown)}: no coordinate of this walker; the section is {', '.join(section.names)}"
        )
    if isinstance(start, Gait) and start.steps:
        near = start.state.copy()
    else:
        near = np.array([problem.guess.state[name] for name in names])
    if {*state} == {*names}:  # the whole state, which may be off the section
        return np.array([float(state[name]) for name in names])
    near[[names.index(name) for name in state]] = [float(value) for value in state.values()]
    z = section.lift(near[section.indices], dynamics.p, near)
    fixed = [name for name in state if name not in section.names and not isclose(z[names.index(name)], state[name])]
    if fixed or not np.isfinite(z).all():
        words = f"{', '.join(fixed)} follows from the others" if fixed else "no state of the walker has these values"
        raise ProblemError(f"state: {words}; the section is {', '.join(section.names)}, or give the whole state")
    return z
