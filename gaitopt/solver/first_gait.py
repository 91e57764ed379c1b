"""A first gait of a problem whose guess is not a motion: collocation from the straight motion between postures.

If the guess has no postures, the straight motion leads from the guessed posture just after the impact to the one just
before the next impact. It fulfils no equation of motion; a direct collocation without an objective leads from it to a
gait.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop, Valued
from gaitopt.gait.gait import Cause, Status
from gaitopt.model.dynamics import Dynamics
from gaitopt.problem.problem import Problem
from gaitopt.solver.collocation import Collocation, Motion
from gaitopt.solver.ipopt import IpoptResult
from gaitopt.solver.newton import Solution
from gaitopt.solver.rollout import step_of_shape, transit_time


def straight_motion(problem: Problem, dynamics: Dynamics) -> tuple[Motion, Array]:
    """The straight motion between the postures of a guess, the same in each step, and the durations of its phases."""
    guess, system, cycle = problem.guess, dynamics.system, problem.cycle
    state = np.array([guess.state[name] for name in system.state_names])
    n, first, steps = len(system.walker.shape), guess.first, cycle.steps
    period = sum(guess.durations) / len(steps) if guess.durations else transit_time(dynamics, cycle, state)
    equal = [period / len(step.phases) for step in steps for _ in step.phases]
    durations = np.array(guess.durations or equal, dtype=float)
    if first is not None and first.postures:
        shapes = np.array([[posture[name] for name in system.walker.shape] for posture in first.postures])
    else:
        shapes = np.array([state[:n], state[:n] + step_of_shape(dynamics, cycle, state)])
    grid = np.linspace(0.0, period, len(shapes))

    def motion(phase: int, times: Array) -> Array:
        states = np.tile(state, (times.size, 1))
        pieces = np.clip(np.searchsorted(grid, times, side="right") - 1, 0, len(shapes) - 2)
        rates = np.diff(shapes, axis=0) / np.diff(grid)[:, None]
        states[:, :n] = shapes[pieces] + (times - grid[pieces])[:, None] * rates[pieces]
        states[:, system.n_shape + 1 : system.n_shape + 1 + n] = rates[pieces]
        states[:, -1] = cycle.phases[phase].direction * np.abs(states[:, -1])
        return states

    return motion, durations


def first_gait(
    problem: Problem, dynamics: Dynamics, *, progress: Valued = None, should_stop: Stop = None
) -> tuple[Solution | None, IpoptResult, Sequence[Cause]]:
    """A motion of a problem under its control law, found without a known motion.

    Returns
    -------
    solution : None if there is none.
    result : end of the search by IPOPT.
    causes : why there is no solution.
    """
    motion, durations = straight_motion(problem, dynamics)
    plain = replace(problem, objective={}, constraints={}, free={}, over=None)
    collocation = Collocation(plain, dynamics.system, durations, free={})
    result = collocation.solve(motion, np.zeros(0), durations, [], progress=progress, should_stop=should_stop)
    if result.status is Status.CONVERGED:
        return collocation.on_mesh(result.w, dynamics), result, ()
    return None, result, collocation.worst(result.w)
