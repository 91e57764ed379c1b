"""The gait of a problem, with the same meaning for all callers of ``solve``.

If continuous parameters of a file's problem were changed, its gait is followed from the values of the file,

    F(w, p(s)) = 0,        p(0) = p_file,        p(1) = p

All other problems are solved from their guess.
"""

from functools import lru_cache

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop, Valued
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.gait import Attractor, Gait, Status
from gaitopt.model.dynamics import Dynamics
from gaitopt.problem.problem import Problem
from gaitopt.problem.rules import lacks_energy
from gaitopt.requests import DEFAULT_LIMITS, Method, SearchLimits
from gaitopt.search.candidate import cycle_record
from gaitopt.search.find import find_best
from gaitopt.simulation.simulator import Simulator
from gaitopt.solver.following import follow
from gaitopt.systems import problem_dynamics, solve_sequence
from gaitopt.threads import Uncompared

CACHED_GAITS = 16
"""Number of gaits of files in the cache of a process; all points of a sweep follow the same one."""


def solve(
    problem: Problem | Attractor,
    *,
    start: Gait | None = None,
    method: Method = Method.AUTO,
    limits: SearchLimits = DEFAULT_LIMITS,
    progress: Valued = None,
    should_stop: Stop = None,
) -> Gait:
    """See ``gaitopt.solve``; ``progress`` is called with the iteration and the largest violation of a constraint."""
    if isinstance(problem, Attractor):
        return solve_attractor(problem, method=method, progress=progress, should_stop=should_stop)
    if problem.over is not None:
        from gaitopt.search.over import design_over  # only few problems hold over a range

        return design_over(
            problem, start=start, method=method, limits=limits, progress=progress, should_stop=should_stop
        )
    if problem.is_open:
        return find_best(problem, method=method, progress=progress, should_stop=should_stop)
    try:
        from_guess = method is Method.IPOPT or lacks_energy(problem)
        begin = None if from_guess else file_gait(problem, method=method, limits=limits, should_stop=should_stop)
    except KeyboardInterrupt:
        dynamics = problem_dynamics(problem)
        return Gait(problem=problem, dynamics=dynamics, status=Status.INTERRUPTED, message="interrupted")
    if begin is None:
        return solve_sequence(
            problem, start=start, method=method, limits=limits, progress=progress, should_stop=should_stop
        )
    return follow(begin, problem, progress=progress, should_stop=should_stop)


def file_gait(
    problem: Problem, *, method: Method = Method.AUTO, limits: SearchLimits = DEFAULT_LIMITS, should_stop: Stop = None
) -> Gait | None:
    """The gait of the problem's file, from which the problem's gait is followed; None if there is none.

    Raises
    ------
    KeyboardInterrupt
        If ``should_stop`` returned True during the solution.
    """
    file = problem.followed_from
    gait = None if file is None else _solved(file, method, limits, Uncompared(should_stop))
    return gait if gait is not None and gait.converged else None


@lru_cache(maxsize=CACHED_GAITS)
def _solved(file: Problem, method: Method, limits: SearchLimits, should_stop: Uncompared[Stop]) -> Gait:
    gait = solve_sequence(file, method=method, limits=limits, should_stop=should_stop.value)
    if gait.status is Status.INTERRUPTED:
        raise KeyboardInterrupt  # an interrupted solve must not enter the cache
    return gait


def solve_attractor(
    attractor: Attractor, *, method: Method = Method.AUTO, progress: Valued = None, should_stop: Stop = None
) -> Gait:
    """The gait of an attractor, as the shortest cycle that repeats itself.

    Raises
    ------
    ProblemError
        If the problem has free parameters, because an attractor does not contain their values.
    SolveError
        If the simulator does not walk the cycle.
    """
    problem = attractor.problem
    if problem.free:
        raise ProblemError(f"{problem.name} has free parameters: compute the basin of its gait, which has their values")
    dynamics = problem_dynamics(problem, should_stop=should_stop)
    section = problem.map_section
    start = section.lift(attractor.state, dynamics.p) if section.stated else attractor.state
    n_steps = attractor.period * dynamics.steps_per_cycle
    gait = solve_walk(dynamics, problem, start, n_steps, method=method, progress=progress, should_stop=should_stop)
    if gait is None:
        raise SolveError(f"{problem.name}: the simulator does not walk the attractor's {attractor.period} steps")
    return gait


def solve_walk(
    dynamics: Dynamics,
    problem: Problem,
    start: Array,
    n_steps: int,
    *,
    method: Method = Method.AUTO,
    progress: Valued = None,
    should_stop: Stop = None,
) -> Gait | None:
    """The gait with the modes that the simulator walks from a state just after an impact; None if it does not walk on.

    Parameters
    ----------
    start : ndarray, shape (n_z,) - the state.
    n_steps : number of steps of the cycle.
    """
    walked = Simulator(dynamics).run(start, n_steps).steps
    if len(walked) < n_steps or walked[-1].impact is None:
        return None
    guessed = problem.with_gait(cycle_record(dynamics.system, walked, "walk"))
    return solve_sequence(guessed, method=method, progress=progress, should_stop=should_stop)
