"""Walking forward from a state, without any knowledge of the mode sequence."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.errors import SolveError, UnknownNameError
from gaitopt.gait import MEASURES, Gait, Step, Trajectory, measure
from gaitopt.mechanics import HybridSystem
from gaitopt.problem import Problem
from gaitopt.simulation import Engine, Simulator, make_stepper
from gaitopt.study.system import build_system

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Walk:
    """A simulated walk.

    Attributes
    ----------
    problem : whose walker, control and friction were used.
    system, p : the hybrid system and its parameter vector.
    trajectory : steps, ending and message.
    """

    problem: Problem
    system: HybridSystem
    p: Array
    trajectory: Trajectory

    @cached_property
    def complete_steps(self) -> tuple[Step, ...]:
        """The steps that ended with an impact."""
        return tuple(step for step in self.trajectory.steps if step.impact is not None)

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of a gait as far as a simulation knows them; scalars are of the last step."""
        last = self.complete_steps[-1] if self.complete_steps else None
        state = self.trajectory.section_states[-1]
        return {
            "problem": self.problem.name,
            "status": str(self.trajectory.ending),
            "message": self.trajectory.message,
            "friction": self.problem.friction_data,
            "steps": len(self.complete_steps),
            "phases": [] if last is None else [{**m.record, "duration": d} for m, d in last.phases],
            "impact": None if last is None or last.impact is None else str(last.impact.mode),
            "state": dict(zip(self.system.state_names, map(float, state), strict=True)),
            **(dict.fromkeys(MEASURES) if last is None else measure(self.system, self.p, [last])),
        }


def simulate(
    start: Gait | Problem,
    state: Mapping[str, float] | None = None,
    steps: int = 1,
    *,
    dense: bool = True,
    engine: str = Engine.AUTO,
    should_stop: Callable[[], bool] | None = None,
) -> Walk:
    """Simulate steps from a state just after an impact.

    Parameters
    ----------
    start : a gait, or a problem (then from the state of its guess).
    state : values by name that replace those of ``start``'s state; what follows from the section is completed.
    steps : how many.
    dense : False keeps only the ends of every arc, for long walks.
    engine : ``auto``, ``scipy`` or ``heyoka``.

    Raises
    ------
    SolveError
        If ``start`` is an attempt that failed, and ``state`` does not say where to start.
    UnknownNameError
        If ``state`` names something that is not a section coordinate of the walker, or the
        engine is unknown or not installed.
    """
    problem, system, p = _prepare(start)
    z = _initial_state(start, system, p, state or {})
    stepper = make_stepper(system, p, engine, steps=steps)
    trajectory = Simulator(system, p, stepper=stepper).run(z, steps=steps, dense=dense, should_stop=should_stop)
    return Walk(problem=problem, system=system, p=p, trajectory=trajectory)


def _prepare(start: Gait | Problem) -> tuple[Problem, HybridSystem, Array]:
    if isinstance(start, Gait):
        return start.problem, start.system, start.p
    system = build_system(start)
    return start, system, system.values(start.parameters)


def _initial_state(start: Gait | Problem, system: HybridSystem, p: Array, state: Mapping[str, float]) -> Array:
    names = system.walker.section_names(slipping=True)
    unknown = [name for name in state if name not in names]
    if unknown:
        raise UnknownNameError(
            f"state {', '.join(unknown)}: not a coordinate just after an impact; use {', '.join(names)}"
        )
    if isinstance(start, Gait) and not start.steps and len(state) < len(names):
        raise SolveError(
            f"{start.problem.name} is {start.status}: give the whole state to start from: {', '.join(names)}"
        )
    if isinstance(start, Problem):
        known = dict(start.guess.state)
    elif not start.steps:
        known = {}
    else:
        known = dict(zip(system.state_names, start.state, strict=True))
    return system.lift_state(np.array([float({**known, **state}[name]) for name in names]), p)
