"""Basins of attraction: where does every state go, step after step?

xi -> Pi(xi) -> Pi(Pi(xi)) -> ... until xi comes back to where it was k steps before, or the walker cannot continue.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait.attractor import Attractor
from gaitopt.mechanics import CONTACTS
from gaitopt.problem import Problem
from gaitopt.simulation.batch.steps import ENDINGS, phase_names
from gaitopt.study.return_map import StepMap

Codes = NDArray[np.int64]

UNDECIDED = -1
"""Ending of a walk that went on for all the steps allowed without settling."""
MAX_PERIOD = 4
"""Longest cycle of steps that is recognised as a gait."""
SETTLED = 1e-6
"""A state that returns this close to itself [rad, rad/s, m/s] has settled: what is left to go is of the same size."""
SAME_GAIT = 1e-3
"""Settled states this close together are on the same gait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcomes:
    """What became of n states.

    Attributes
    ----------
    periods : ndarray, shape (n,) - steps per cycle of the gait that a state settled on; 0 if on none.
    endings : ndarray, shape (n,) - index in ``Ending`` of how the walk failed, ``UNDECIDED``, or 0 where it settled.
    steps : ndarray, shape (n,) - completed steps until then.
    states : ndarray, shape (n, k) - section coordinates there; of a cycle the smallest in lexical order.
    phases, impacts : ndarray, shape (n,) - codes of the step that led there, see ``Returns``.
    """

    periods: Codes
    endings: Codes
    steps: Codes
    states: Array
    phases: Codes
    impacts: Codes


def follow(step_map: StepMap, xi: Array, max_steps: int, *, should_stop: Stop = None) -> Outcomes:
    """Walk from every state until it settles, fails, or has made ``max_steps`` steps.

    Parameters
    ----------
    step_map : the return map.
    xi : ndarray, shape (n, k) - section coordinates just after an impact, ``dx`` included.
    should_stop : polled before every step.
    """
    n = len(xi)
    past = np.full((MAX_PERIOD, *xi.shape), np.nan)  # the last states, the latest first, and the steps that led there
    past_steps = np.zeros((MAX_PERIOD, n, 2), dtype=np.int64)
    past[0] = xi
    periods, steps, endings = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.full(n, UNDECIDED)
    going = np.arange(n)
    for _ in range(max_steps):
        if not going.size:
            break
        if should_stop is not None and should_stop():
            raise KeyboardInterrupt
        walked = step_map(past[0, going])
        completed = walked.completed
        back = _returns(np.abs(walked.states - past[:, going]).max(axis=2)) & completed
        for row in (past, past_steps):
            row[1:, going] = row[:-1, going]
        past[0, going] = walked.states
        past_steps[0, going] = np.column_stack([walked.phases, walked.impacts])
        steps[going] += completed
        settled = back.any(axis=0)
        periods[going] = np.where(settled, np.argmax(back, axis=0) + 1, 0)
        endings[going] = np.where(settled, 0, np.where(completed, UNDECIDED, walked.endings))
        going = going[completed & ~settled]
    first = _first_of_cycle(past, periods)
    rows = np.arange(n)
    phases, impacts = past_steps[first, rows].T
    return Outcomes(
        periods=periods, endings=endings, steps=steps, states=past[first, rows], phases=phases, impacts=impacts
    )


def _returns(distances: Array) -> NDArray[np.bool_]:
    """Whether a state is back where it was 1, 2, ... steps before, from its distances to these; shape (periods, n).

    On its way into a fixed point a walk may come close to earlier states by chance: of a cycle all states differ.
    """
    apart = np.vstack([np.full((1, distances.shape[1]), True), distances[:-1] > SAME_GAIT])
    return (distances < SETTLED) & np.logical_and.accumulate(apart, axis=0)


def _first_of_cycle(past: Array, periods: Codes) -> Codes:
    """How many steps ago the walk was at the state of its cycle that comes first in lexical order; shape (n,)."""
    first = np.zeros(len(periods), dtype=np.int64)
    for row in np.flatnonzero(periods > 1):
        cycle = np.round(past[: periods[row], row], -int(np.log10(SAME_GAIT)))
        first[row] = min(range(periods[row]), key=lambda k: tuple(cycle[k]))
    return first


def claim(outcomes: Outcomes, gaits: list[Attractor], problem: Problem) -> Codes:
    """For each outcome the index of its gait, -1 where there is none, shape (n,); ``gaits`` grow by new ones.

    From one part of a grid after the other, in the same order, they are the same list.
    """
    labels, waiting, index = np.full(len(outcomes.periods), -1), np.flatnonzero(outcomes.periods > 0), 0
    while waiting.size:
        if index == len(gaits):
            gaits.append(_attractor(outcomes, waiting[0], problem))
        gait = gaits[index]
        near = np.abs(outcomes.states[waiting] - gait.state).max(axis=1) < SAME_GAIT
        on_it = near & (outcomes.periods[waiting] == gait.period)
        labels[waiting[on_it]] = index
        gaits[index] = replace(gait, count=gait.count + int(on_it.sum()))
        waiting, index = waiting[~on_it], index + 1
    return labels


def _attractor(outcomes: Outcomes, row: np.intp, problem: Problem) -> Attractor:
    """The gait on which one outcome lies."""
    phases = phase_names(int(outcomes.phases[row]), problem.walker.modes())
    state, period, impact = outcomes.states[row], int(outcomes.periods[row]), CONTACTS[outcomes.impacts[row]]
    return Attractor(problem=problem, state=state, period=period, phases=phases, impact=impact, count=0)


def outcome_counts(endings: NDArray[Any]) -> dict[str, int]:
    """How many walks failed in which way, by name; ``undecided`` is one of them."""
    values, counts = np.unique(endings[endings != 0], return_counts=True)
    return {ending_name(int(v)): int(c) for v, c in zip(values, counts, strict=True)}


def ending_name(code: int) -> str:
    """How a walk failed; ``undecided`` where it neither settled nor failed."""
    return "undecided" if code == UNDECIDED else str(ENDINGS[code])
