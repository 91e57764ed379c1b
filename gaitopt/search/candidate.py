"""A candidate of a search: one cycle as its mode sequence and its first state, neither solved nor verified yet."""

from collections.abc import Mapping, Sequence

import numpy as np

from gaitopt.gait.records import CandidateRecord, phase_records
from gaitopt.gait.trajectory import Step
from gaitopt.model.system import HybridSystem
from gaitopt.problem.problem import Problem

SAME = 1e-3
"""Two states are the same if their relative difference is below this."""


def guessed_values(problem: Problem) -> dict[str, float]:
    """Guesses of the free parameters by dotted key."""
    return {key: free.guess for key, free in problem.free.items()}


def cycle_record(
    system: HybridSystem, cycle: Sequence[Step], start: str, freed: Mapping[str, float] | None = None
) -> CandidateRecord:
    """The candidate of a simulated cycle without repetitions, starting at its smallest state in lexical order.

    Parameters
    ----------
    freed : values of the free parameters by dotted key.
    """
    steps = [(phase_records(step), step.final_impact.mode) for step in cycle]
    states = [step.arcs[0].states[0] for step in cycle]
    per_cycle, size = cycle[0].arcs[0].dynamics.steps_per_cycle, np.abs(states[0]).max()

    def repeats(n: int) -> bool:
        return all(np.abs(state - states[k % n]).max() < SAME * size for k, state in enumerate(states))

    n = next(n for n in range(per_cycle, len(steps) + 1, per_cycle) if len(steps) % n == 0 and repeats(n))
    first = min(range(0, n, per_cycle), key=lambda k: tuple(states[k]))
    return {
        "steps": [{"phases": phases, "impact": impact.words} for phases, impact in (*steps[first:n], *steps[:first])],
        "state": dict(zip(system.state_names, map(float, states[first]), strict=True)),
        "parameters": dict(freed or {}),
        "start": start,
    }
