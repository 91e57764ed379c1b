"""A cycle of steps that is a shorter one walked twice."""

from gaitopt.gait import Gait
from gaitopt.mechanics import Cycle


def halved_cycle(gait: Gait) -> Cycle | None:
    """The first half of a cycle that consists of the same steps twice; None of any other."""
    half, odd = divmod(len(gait.steps), 2)
    return None if odd or half % gait.repeats_after else Cycle(gait.problem.cycle.steps[:half])
