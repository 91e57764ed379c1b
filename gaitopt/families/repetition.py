"""A cycle of steps that is a shorter one walked twice."""

import numpy as np

from gaitopt.gait import Gait
from gaitopt.mechanics import Cycle

SAME_HALVES = 1e-6
"""Largest difference of the states of two equal halves, relative to the largest coordinate in natural units."""


def halved_cycle(gait: Gait) -> Cycle | None:
    """The first half of a cycle that consists of the same steps twice; None of any other."""
    steps, half = gait.problem.cycle.steps, len(gait.steps) // 2
    if half % gait.system.walker.n_sides() or len(steps) % 2 or steps[:half] != steps[half:]:
        return None
    unit = gait.system.state_scales(gait.system.scales(gait.p))
    states = np.array([step.arcs[0].states[0] for step in gait.steps]) / unit
    size = np.abs(states).max()
    return Cycle(steps[:half]) if np.abs(states[:half] - states[half:]).max() < SAME_HALVES * size else None
