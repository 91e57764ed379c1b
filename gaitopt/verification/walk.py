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
from gaitopt.gait.impacts import impact_records
from gaitopt.gait.measures import contact_record, control_record, measure
from gaitopt.gait.records import phase_records
from gaitopt.gait.trajectory import Step, Trajectory
from gaitopt.gait.zero_dynamics import constraint_measures
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.transitions import Ending
from gaitopt.problem.faults import shown
from gaitopt.problem.floor import Floor
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import MEASURES
from gaitopt.problem.statement import Until
from gaitopt.requests import Engine
from gaitopt.simulation.simulator import Simulator, stepper_class
from gaitopt.systems import problem_dynamics
from gaitopt.threads import cached_property

ON_GROUND = 1e-9
"""A height or a rate below this counts as zero, in natural units."""


@dataclass(frozen=True, kw_only=True)
class Walk(WalkerMotion):
    """A simulated walk.

    Attributes
    ----------
    problem : the problem whose walker, control and friction were used.
    dynamics : the hybrid system at its parameters.
    trajectory : steps, ending and message.
    gait_states : ndarray, shape (n_steps, n_z) - states after each impact of the gait from which the walk started;
        no rows if it started from a problem.
    longest_step : the time limit of a step [s], if one was given.
    floor : the tiles on which it walked; None for the nominal floor.
    """

    trajectory: Trajectory
    gait_states: Array
    longest_step: float | None = None
    floor: Floor | None = None

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
        """One JSON object with the keys of a gait that also apply to a walk; scalars are those of the last step."""
        last = self.complete_steps[-1] if self.complete_steps else None
        shown = self.trajectory.steps[-1] if last is None and self.trajectory.steps else last
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
            "phases": [] if shown is None else phase_records(shown),
            "impact": None if last is None or last.impact is None else last.impact.mode.words,
            "state": self._state_record(state),
            **(dict.fromkeys(MEASURES) if last is None else measure([last])),
            **({} if last is None else {**contact_record([last]), **control_record([last])}),
            **({} if constraints is None else constraints.to_record()),
            "section": [
                {"time": float(t), "impact": mode, "state": self._state_record(z)}
                for t, mode, z in zip(self.section_times, impacts, self.trajectory.section_states, strict=True)
            ],
            "time": self.trajectory.duration,
            "final_state": self._state_record(self.trajectory.final_state),
            "impacts": list(impact_records(self.trajectory)),
            "gait_states": [self._state_record(state) for state in self.gait_states],
            # parameters of the gait that differ from those of its problem
            "parameters": {key: value for (key, value), other in moving if value != other},
            **({} if self.longest_step is None else {"longest_step": self.longest_step}),
            **({} if self.floor is None else {"floor": self.floor.to_record()}),
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
    steps: int | None = None,
    *,
    until: Until | None = None,
    dense: bool = True,
    engine: str = Engine.AUTO,
    longest_step: float | None = None,
    floor: Floor | None = None,
    should_stop: Stop = None,
) -> Walk:
    """Simulate a motion from a state; see ``gaitopt.simulate``."""
    problem = start.problem if isinstance(start, Gait) else start
    dynamics = start.dynamics if isinstance(start, Gait) else problem_dynamics(start)
    until = until or (problem.until if steps is None else None)
    if until is not None and steps is not None:
        raise ProblemError(f"steps = {steps} and until = {until.data}: give one of them; until may have steps, too")
    walker = dynamics.system.walker
    if (until is None or (until.time is None and until.events is None)) and is_endless(dynamics):
        raise ProblemError(
            f"{problem.name}: a step of the {walker.model} never ends, since it has no landing contacts; "
            "end the simulation at a time or after events: until=Until(time=2.0)"
        )
    z, anywhere = _initial_state(start, dynamics, state or {})
    if not isinstance(floor, Floor | None):
        raise ProblemError(f"floor is {shown(floor)}, but must be Floor(friction=[...]), Floor.parse(TEXT) or similar")
    stepper = stepper_class(engine, steps=steps or 1)
    simulator = Simulator(dynamics, stepper, longest_step=longest_step, floor=floor)
    simulator.check_start(z)
    trajectory = simulator.run(
        z, steps=steps or 1, until=until, anywhere=anywhere, dense=dense, should_stop=should_stop
    )
    width = len(dynamics.system.state_names)
    states = states_after_impacts(start) if isinstance(start, Gait) else np.empty(0)
    return Walk(
        problem=problem, dynamics=dynamics, trajectory=trajectory, gait_states=states.reshape(-1, width),
        longest_step=longest_step, floor=floor,
    )  # fmt: skip


def is_endless(dynamics: Dynamics) -> bool:
    """Whether steps have no end: no landing swaps the feet, and the system has no other section."""
    return dynamics.system.cycle_end == TOUCHDOWN and not dynamics.system.walker.step_ends()


def states_after_impacts(gait: Gait) -> Array:
    """States of a gait after each impact; shape (n_steps, n_z)."""
    return np.array([step.arcs[0].states[0] for step in gait.steps])


def _initial_state(start: Gait | Problem, dynamics: Dynamics, state: Mapping[str, float]) -> tuple[Array, bool]:
    """The state from which a simulation starts, and whether it is a whole state, which need not be on the section."""
    problem, walker = start.problem if isinstance(start, Gait) else start, dynamics.system.walker
    names = dynamics.system.state_names
    section = () if problem.section is None else problem.map_section.names
    if not isinstance(state, Mapping):
        known = section or names
        raise ProblemError(
            f"state: {shown(state)} has no names; write {{{known[0]!r}: 0.1, ...}}, of {', '.join(known)}"
            + f", or steps={state} for the number of steps" * isinstance(state, int)
        )
    unknown = [name for name in state if name not in (*names, "y", "dy")]
    if unknown:
        known = f"the section is {', '.join(section)}; " if section else ""
        raise UnknownNameError(
            f"state {', '.join(unknown)}: no coordinate of this walker; {known}the whole state is {', '.join(names)}"
        )
    lifted = [f"{name} = {state[name]}" for name in ("y", "dy") if name not in names and state.get(name, 0.0)]
    if lifted:
        reason = f"the {walker.model} has no flight phase: its foot is on the ground, y = dy = 0"
        raise ProblemError(f"state {', '.join(lifted)}: {reason}")
    values: dict[str, float] = {}
    if isinstance(start, Gait) and start.steps:
        values = dict(zip(names, start.state.tolist(), strict=True))
    elif isinstance(start, Problem) and start.start is not None:
        values = dict(start.start.state)
    defaults = values if problem.start is not None and (problem.start.whole or not section) else {}
    whole = {"x": 0.0, **defaults, **state}
    if {*names} <= {*whole}:
        z = np.array([float(whole[name]) for name in names])
        _check_state(dynamics, z)
        return z, True
    if not section:
        missing = [name for name in names if name not in whole]
        reason = "without the modes of a gait there is no section from which the rest follows"
        raise ProblemError(f"state: {', '.join(missing)} is missing; {reason}: give {', '.join(names)}")
    if not problem.map_section.stated:
        return _nearby_state(start, dynamics, state), False
    foreign = [name for name in state if name not in section]
    if foreign:
        raise UnknownNameError(
            f"state {', '.join(foreign)}: not a coordinate just after an impact; use {', '.join(section)}, "
            f"or the whole state, {', '.join(names)}"
        )
    if isinstance(start, Gait) and not start.steps and len(state) < len(section):
        raise SolveError(
            f"{start.problem.name} is {start.status}: give the whole state to start from: {', '.join(section)}"
        )
    missing = [name for name in section if name not in {**values, **state}]
    if missing:
        remedy = f"give the section, {', '.join(section)}, or the whole state, {', '.join(names)}"
        remedy += "; `gaitopt find` lists the gaits" * problem.has_gait
        raise ProblemError(f"state: {', '.join(missing)} is missing; {remedy}")
    chosen = {name: float({**values, **state}[name]) for name in section}
    z = dynamics.lift(np.array([*chosen.values()]))
    undefined = [f"{name} = {value}" for name, value in zip(names, z, strict=True) if not isfinite(value)]
    if undefined:
        given = ", ".join(f"{name} = {value:g}" for name, value in chosen.items())
        raise ProblemError(f"state {given}: the walker would start with {undefined[0]}, which is not a number")
    return z, False


def _check_state(dynamics: Dynamics, z: Array) -> None:
    """Check that a whole state is finite, and that the foot of a walker that flies is not below the ground."""
    values = dict(zip(dynamics.system.state_names, z.tolist(), strict=True))
    undefined = [f"{name} = {value}" for name, value in values.items() if not isfinite(value)]
    if undefined:
        raise ProblemError(f"state {undefined[0]}: is not a number")
    if not dynamics.system.walker.base_contact() or "y" not in values:  # no foot is at (x, y)
        return
    height, rate = values["y"] / dynamics.scales.length, values["dy"] / dynamics.scales.speed
    if height < -ON_GROUND or (height <= ON_GROUND and rate < -ON_GROUND):
        below = f"y = {values['y']:g}, dy = {values['dy']:g}"
        raise ProblemError(f"state {below}: the foot is below the ground or moves into it; start above it, or at rest")


def _nearby_state(start: Gait | Problem, dynamics: Dynamics, state: Mapping[str, float]) -> Array:
    """The state next to that of ``start``, for sections on which more than one state has the same coordinates."""
    problem = start.problem if isinstance(start, Gait) else start
    names, section = dynamics.system.state_names, dynamics.system.section(problem.cycle)
    if isinstance(start, Gait) and start.steps:
        near = start.state.copy()
    else:
        near = np.array([problem.guess.state[name] for name in names])
    near[[names.index(name) for name in state]] = [float(value) for value in state.values()]
    z = section.lift(near[section.indices], dynamics.p, near)
    fixed = [name for name in state if name not in section.names and not isclose(z[names.index(name)], state[name])]
    if fixed or not np.isfinite(z).all():
        fault = f"{', '.join(fixed)} follows from the others" if fixed else "no state of the walker has these values"
        raise ProblemError(f"state: {fault}; the section is {', '.join(section.names)}, or give the whole state")
    return z
