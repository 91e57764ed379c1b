"""The gait of a problem, whether its mode sequence is given or open, or that of an attractor of the simulator."""

from gaitopt.callbacks import Stop, Valued
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait import Gait
from gaitopt.gait.attractor import Attractor
from gaitopt.orbit import ReturnMap
from gaitopt.problem import Problem
from gaitopt.search.candidates import cycle_record
from gaitopt.search.distinct import closed
from gaitopt.search.find import find_best
from gaitopt.simulation import Simulator
from gaitopt.study.system import problem_dynamics, solve_sequence


def solve(
    problem: Problem | Attractor, *, start: Gait | None = None, progress: Valued = None, should_stop: Stop = None
) -> Gait:
    """As ``gaitopt.solve``; ``progress`` is called with the iteration and the largest violation of a constraint."""
    if isinstance(problem, Attractor):
        return solve_attractor(problem, progress=progress, should_stop=should_stop)
    if problem.is_open:
        return find_best(problem, progress=progress, should_stop=should_stop)
    return solve_sequence(problem, start=start, progress=progress, should_stop=should_stop)


def solve_attractor(attractor: Attractor, *, progress: Valued = None, should_stop: Stop = None) -> Gait:
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
