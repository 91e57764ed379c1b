"""A candidate of a search: one cycle as its mode sequence and its first state, neither solved nor verified yet."""

from collections.abc import Mapping, Sequence

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait.records import CandidateRecord, PhaseRecord, phase_records
from gaitopt.gait.trajectory import Step
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem

SAME = 1e-3
"""Relative difference below which two states are the same."""


def cycle_record(system: HybridSystem, steps: Sequence[Step], start: str) -> CandidateRecord:
    """The candidate of a simulated cycle."""
    sequences = [(phase_records(step), step.final_impact.mode) for step in steps]
    return candidate_record(system, sequences, [step.arcs[0].states[0] for step in steps], {}, start)


def candidate_record(
    system: HybridSystem,
    steps: Sequence[tuple[list[PhaseRecord], Mode]],
    states: Sequence[Array],
    freed: Mapping[str, float],
    start: str,
) -> CandidateRecord:
    """The candidate of a cycle without repetitions, starting at its smallest state in lexical order."""
    least, size = system.walker.steps_per_cycle(), np.abs(states[0]).max()

    def repeats(n: int) -> bool:
        return all(np.abs(state - states[k % n]).max() < SAME * size for k, state in enumerate(states))

    n = next(n for n in range(least, len(steps) + 1, least) if len(steps) % n == 0 and repeats(n))
    first = min(range(0, n, least), key=lambda k: tuple(states[k]))
    return {
        "steps": [{"phases": phases, "impact": impact.words} for phases, impact in (*steps[first:n], *steps[:first])],
        "state": dict(zip(system.state_names, map(float, states[first]), strict=True)),
        "parameters": dict(freed),
        "start": start,
    }
