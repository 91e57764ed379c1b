"""The gait of a problem: solved, or designed where parameters are unknowns."""

import time
from dataclasses import replace

from gaitopt.callbacks import Stop
from gaitopt.gait import Gait, Status
from gaitopt.mechanics import HybridSystem
from gaitopt.nlp.ipopt import Progress
from gaitopt.nlp.solve import solve_gait
from gaitopt.nlp.start import free_parameters
from gaitopt.problem import Problem


def find_gait(
    problem: Problem,
    system: HybridSystem,
    *,
    start: Gait | None = None,
    progress: Progress | None = None,
    should_stop: Stop = None,
) -> Gait:
    """The gait of ``problem``: designed where parameters are unknowns, solved otherwise.

    Parameters
    ----------
    start : a gait of the same system with the same mode sequence from which a design starts instead of the guess.
    progress : called at every iteration with its number and the largest violation.
    should_stop : polled at every iteration; True ends the search with the status ``interrupted``.
    """
    began = time.perf_counter()
    designed = free_parameters(problem, system)
    first = start if designed and start else solve_gait(problem, system, progress=progress, should_stop=should_stop)
    if not designed or first.status is Status.INTERRUPTED:
        return first
    from gaitopt.nlp.design import design_gait  # most problems have no unknowns, and need not wait for its modules

    gait = design_gait(problem, system, first, progress=progress, should_stop=should_stop)
    return replace(gait, solver={**gait.solver, "seconds": time.perf_counter() - began})
