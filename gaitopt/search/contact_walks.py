"""Candidates of a walker with several contacts: fixed points of the return map next to walks from around a guess.

Its sections differ with what the contacts do, so that starts are sampled around one state: that of the guess. The
simulator walks on from each. Newton's method seeks a fixed point of the return map, which may be unstable, from where
the walk is last in each mode sequence that it meets, and from its start. Where several gaits have one mode sequence,
walks lead away from the unstable ones, and Newton's method from their ends to the same gait again and again.
"""

from collections.abc import Callable, Iterator

import numpy as np

from gaitopt.arrays import Array
from gaitopt.errors import ProblemError
from gaitopt.gait.records import CandidateRecord
from gaitopt.gait.trajectory import Step
from gaitopt.model.cycle import Cycle
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import OFF, Mode
from gaitopt.problem.problem import Problem
from gaitopt.search.candidate import cycle_record, guessed_values
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import problem_dynamics
from gaitopt.verification.return_map import ReturnMap

STARTS = 12
"""Start states of a job; each costs some walks of a cycle, a tenth of a second."""
CYCLES = 6
"""Cycles of a walk: a stable gait is met after a few, an unstable one in the first."""
PLACE, RATE = 0.1, 0.3
"""Range of the starts around the guess, in natural units of coordinates and rates."""
SMALLEST_SCALE = 0.3
"""Smallest size of the sampled boxes relative to the default box: walkers make small steps too."""
TOUCHING = 1e-3
"""A contact of the guess touches the ground if its height and velocity are below this, in natural units."""


def contact_candidates(
    problem: Problem, number: int, seed: int, n_steps: int, should_stop: Callable[[], bool]
) -> tuple[list[CandidateRecord], int]:
    """Candidates of one job, and the number of its starts; the first start of job 0 is the guess itself.

    Raises
    ------
    KeyboardInterrupt
        If ``should_stop`` ends the job.
    """
    dynamics, rng = problem_dynamics(problem), np.random.default_rng([seed, number])
    simulator, candidates = Simulator(dynamics), list[CandidateRecord]()
    units, names = dynamics.state_units, dynamics.system.state_names
    n, guess = len(names) // 2, np.array([problem.guess.state[name] for name in names])
    spread = units * np.repeat([PLACE, RATE], n)
    for start in range(STARTS):
        if should_stop():
            raise KeyboardInterrupt
        exact = number == 0 and start == 0
        size = 0.0 if exact else rng.uniform(SMALLEST_SCALE, 1.0)
        z = on_ground(dynamics, guess, size * spread * rng.uniform(-1, 1, 2 * n))
        if not np.isfinite(z).all():
            continue
        steps = [step for step in simulator.run(z, CYCLES * n_steps).steps if step.impact is not None]
        for length in range(1, n_steps + 1):
            for sequence, state in _places(steps, length, z):
                section = dynamics.system.section(sequence)
                found = ReturnMap(simulator, section, length, state).damped_fixed_point(
                    state[section.indices], units[section.indices]
                )
                if found is not None:
                    candidates.append(
                        cycle_record(dynamics.system, found, f"walk {number}.{start}", guessed_values(problem))
                    )
    return candidates, STARTS


def _places(steps: list[Step], length: int, start: Array) -> Iterator[tuple[Cycle, Array]]:
    """The cycles of a length in a walk, each with the state after its last occurrence; the first also with the start.

    Parameters
    ----------
    start : ndarray, shape (n_z,) - state from which the walk began.
    """
    tried = set[Cycle]()
    for last in range(len(steps), length - 1, -1):
        sequence = _cycle(steps[last - length : last])
        if sequence is not None and sequence not in tried:
            tried.add(sequence)
            yield sequence, steps[last - 1].final_impact.state
    first = _cycle(steps[:length])
    if first is not None:
        yield first, start


def on_ground(dynamics: Dynamics, state: Array, change: Array) -> Array:
    """A state with its coordinates changed, in which the contacts that touch the ground still do; NaN if there is none.

    They touch it with what they do in ``state``: they stick, or slip.
    """
    system, scales, p = dynamics.system, dynamics.scales, dynamics.p
    heights, velocities, _ = (np.asarray(value).ravel() for value in system.contact_points(state, p))
    words = dict[str, str]()
    for name, height, (v_t, v_n) in zip(system.walker.contacts, heights, velocities.reshape(-1, 2), strict=True):
        touches = abs(height) < TOUCHING * scales.length and abs(v_n) < TOUCHING * scales.speed
        slip = "stick" if abs(v_t) < TOUCHING * scales.speed else str(Mode.slip(v_t))
        words[name] = ("stick" if name in system.walker.massless_contacts else slip) if touches else OFF
    mode = Mode.of_contacts(words)
    try:
        section = system.section(mode)
    except ProblemError:  # its contacts do not reach the ground together
        return np.full(state.size, np.nan)
    near = state.copy()
    near[section.indices] += change[section.indices]
    return section.lift(near[section.indices], p, near)


def _cycle(steps: list[Step]) -> Cycle | None:
    """The modes of some steps as a cycle; None if it does not close."""
    try:
        return Cycle(tuple(step.sequence for step in steps))
    except ValueError:
        return None
