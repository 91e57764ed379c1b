"""Where a design starts: from the motion rolled out from its guess, or from a gait that is known."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import Gait, Step, curves
from gaitopt.mechanics import Dynamics, HybridSystem
from gaitopt.nlp.rollout import Rollout, roll_out
from gaitopt.nlp.solve import free_parameters
from gaitopt.problem import Problem


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Where a design starts.

    Attributes
    ----------
    durations : ndarray, shape (n_phases,) - [s].
    states : from times since impact (n,) to states (n_z, n).
    freed : ndarray, shape (n_free,) - values of the freed parameters.
    """

    durations: Array
    states: Callable[[Array], Array]
    freed: Array


def guessed(problem: Problem, system: HybridSystem) -> Start:
    """The motion rolled out from the guess, which does not close."""
    dynamics = Dynamics(system, system.values(problem.parameters))
    state = np.array([problem.guess.state[name] for name in system.state_names])
    rolled = roll_out(dynamics, problem.cycle, state, problem.guess.durations)
    free = free_parameters(problem, system)
    freed = np.array([dynamics.parameter(name) for name in free])
    return Start(durations=np.array(rolled.durations), states=rolled_states(rolled), freed=freed)


def rolled_states(rollout: Rollout) -> Callable[[Array], Array]:
    """States of a motion that is rolled out, as a function of times since impact."""
    ends = np.cumsum(rollout.durations)[:-1]

    def states(times: Array) -> Array:
        phases = np.searchsorted(ends, times, side="right")
        return np.hstack([rollout(phase, np.array([t])) for phase, t in zip(phases, times, strict=True)])

    return states


def known(gait: Gait, free: tuple[str, ...]) -> Start:
    """A gait that is known."""
    (step,) = gait.steps
    freed = np.array([gait.dynamics.parameter(name) for name in free])
    return Start(durations=np.array([d for _, d in step.phases]), states=lambda t: step_states(step, t), freed=freed)


def step_states(step: Step, times: Array) -> Array:
    """States (n_z, n) of a step at times since impact (n,)."""
    ends = np.array([arc.end for arc in step.arcs[:-1]])
    columns = []
    for t in times:
        arc = step.arcs[int(np.searchsorted(ends, t, side="right"))]
        s = np.clip(2 * (t - arc.start) / arc.duration - 1, -1, 1)
        columns.append(np.polynomial.chebyshev.chebval(s, curves.coefficients(arc.states)))
    return np.array(columns).T
