"""From an attractor of the simulator to a gait: its cycle, with the modes that the simulator sees, is solved."""

from collections.abc import Callable

from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait import Gait
from gaitopt.gait.attractor import Attractor
from gaitopt.nlp.ipopt import Progress
from gaitopt.orbit import ReturnMap
from gaitopt.search.candidates import cycle_record
from gaitopt.search.distinct import closed
from gaitopt.simulation import Simulator
from gaitopt.study.solve import solve_sequence
from gaitopt.study.system import problem_dynamics


def solve_attractor(
    attractor: Attractor, *, progress: Progress | None = None, should_stop: Callable[[], bool] | None = None
) -> Gait:
    """The gait of an attractor; of a cycle that repeats itself, the shortest one.

    Raises
    ------
    ProblemError
        If the problem has free parameters, whose values an attractor does not know.
    SolveError
        If the simulator does not walk the cycle.
    """
    problem = attractor.problem
    if problem.free:
        raise ProblemError(
            f"{problem.name} has free parameters: fix them at the values of the design, then walk its basin"
        )
    dynamics = problem_dynamics(problem, should_stop=should_stop)
    mode = attractor.impact
    xi = attractor.state if mode.slips else attractor.state[:-1]
    walked = ReturnMap(Simulator(dynamics), mode, attractor.period * dynamics.system.walker.n_sides())(xi)
    if walked.xi is None:
        raise SolveError(f"{problem.name}: the simulator does not walk the attractor's {attractor.period} steps")
    guessed = closed(problem, cycle_record(dynamics.system, walked.steps, "attractor"))
    return solve_sequence(guessed, progress=progress, should_stop=should_stop)
