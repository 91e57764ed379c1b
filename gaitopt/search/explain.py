"""Why a problem has no gait with its mode sequence: violated conditions, existing gaits, nearest parameters.

A mode sequence begins or ends at special points of families. Families are followed from gaits that exist: from the gait
of the problem's file towards the changed values, and from gaits of other mode sequences at these values. The special
point on the way is located to machine precision; its parameter is the answer.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from textwrap import shorten
from typing import Any

import numpy as np

from gaitopt.branches.request import Request
from gaitopt.callbacks import Counted, Stop, TimeLimit
from gaitopt.display import Tabulated, distinguished
from gaitopt.errors import SolveError
from gaitopt.gait.branch import TERMINAL, BranchPoint, SpecialPoint
from gaitopt.gait.gait import Cause, Gait, Status
from gaitopt.model.cycle import Cycle
from gaitopt.model.units import Free
from gaitopt.problem.problem import Problem
from gaitopt.problem.rules import TOO_SLIPPERY, least_friction
from gaitopt.requests import ExplainRequest
from gaitopt.search.candidates import family
from gaitopt.search.find import Gaits, SearchPlan, search, with_open_modes
from gaitopt.search.solve import file_gait, solve
from gaitopt.solver.solve import free_parameters
from gaitopt.verification.verify import verify
from gaitopt.verification.walk import Walk, simulate
from gaitopt.workers.jobs import ResumableJobs, Workers

END_TYPES = ("fold", "mode_change", "impact_change", *TERMINAL)
"""Types of special points beyond which a mode sequence does not continue, or not in the same direction."""
MAX_POINTS = 200
"""Largest number of points of one family; an answer usually takes a few dozen."""
WIDEST_FRICTION, WIDEST_SLOPE = 2.0, 0.35
"""Largest friction and slope [rad] of the search."""
SEARCH_CAUSES = ("search", "motion", "event", "periodicity", "duration")
"""Causes that only say how the solver ended. So do events of the mode sequence that do not happen."""
LONGEST_CAUSE = 120
"""Largest number of characters of a cause in one line."""
WALK_STEPS = 20
"""Number of steps of the walk from the guess."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearest:
    """A value of one parameter at which the mode sequence begins to exist; other parameters are those of the problem.

    Attributes
    ----------
    parameter, value : dotted key, and the value in SI.
    type : type of the special point there.
    reason : a sentence that says what happens there.
    gait : the gait at the special point, or None.
    """

    parameter: str
    value: float
    type: str
    reason: str = ""
    gait: Gait | None = None

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of the command line."""
        record = {"parameter": self.parameter, "value": self.value, "type": self.type, "reason": self.reason}
        return record | {"gait": None if self.gait is None else self.gait.to_record()}


@dataclass(frozen=True, kw_only=True)
class Explanation(Tabulated):
    """Why there is no gait.

    Attributes
    ----------
    problem : the problem without a gait.
    gait : the failed solve, or the gait if it ``exists``; None if the reference of a PD law has no solution.
    exists : whether the gait exists after all.
    causes : violated conditions, the decisive one first.
    instead : gaits of any mode sequence at these parameters.
    walk : the simulated walk from the guess; None if there is no guess.
    nearest : values of single parameters at which the mode sequence begins to exist; for a design, the other free
        numbers are those of the failed solve.
    complete : whether the search is complete; False for intermediate results, and after a time limit.
    """

    problem: Problem
    gait: Gait | None
    exists: bool
    causes: tuple[Cause, ...] = ()
    instead: Gaits | None = None
    walk: Walk | None = None
    nearest: tuple[Nearest, ...] = ()
    complete: bool = True

    def __repr__(self) -> str:
        cause = self.causes[0].description if self.causes else "the cause is unknown"
        answer = "the gait exists" if self.exists else shorten(cause, LONGEST_CAUSE)
        return f"<Explanation of {self.problem.name}: {answer}>"

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of the command line."""
        return {
            "problem": self.problem.name,
            "exists": self.exists,
            "causes": [cause.to_record() for cause in self.causes],
            "instead": [] if self.instead is None else self.instead.to_record()["gaits"],
            "simulated": None if self.walk is None else self.walk.to_record(),
            "nearest": [nearest.to_record() for nearest in self.nearest],
            "complete": self.complete,
        }


def explain(
    problem: Problem,
    request: ExplainRequest,
    *,
    workers: int = 1,
    found: Callable[[Explanation], None] | None = None,
    progress: Callable[[str], None] | None = None,
    parts: Counted = None,
    should_stop: Stop = None,
) -> Explanation:
    """See ``gaitopt.explain``. The quick answers come first; the search takes a hundred times as long."""
    say, limit = progress or (lambda _: None), TimeLimit(seconds=request.seconds, should_stop=should_stop)
    say(f"solving {problem.name}")
    try:
        gait = solve(problem, should_stop=should_stop)
    except SolveError as error:
        cause = Cause(what="reference", description=str(error))
        return Explanation(problem=problem, gait=None, exists=False, causes=(cause,))
    if gait.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    direct = gait.causes
    if gait.converged:
        direct = tuple(
            Cause(
                what=claim.name,
                description=f"the simulator disagrees: {claim.summary}",
                needed=claim.tolerance,
                available=claim.figure,
            )
            for claim in verify(gait).claims
            if not claim.passed
        )
        if not direct:
            return Explanation(problem=problem, gait=gait, exists=True)
    walk = None if problem.start is None else simulate(problem, steps=WALK_STEPS, dense=False)
    given, gait_of_file = _with_fixed_numbers(problem, gait), None
    if given is not None:
        gait_of_file = file_gait(problem, should_stop=should_stop)

    def known(nearest: Sequence[Nearest], instead: Gaits | None = None, complete: bool = False) -> Explanation:
        causes = _causes(problem, gait, direct, nearest, gait_of_file)
        return Explanation(
            problem=problem, gait=gait, exists=False, causes=causes, instead=instead, walk=walk,
            nearest=tuple(nearest), complete=complete,
        )  # fmt: skip

    def tell(nearest: Sequence[Nearest], instead: Gaits | None = None) -> None:
        if found is not None:
            found(known(nearest, instead))

    end = None if given is None or gait_of_file is None else end_on_the_way(given, gait_of_file, should_stop)
    ends = [] if end is None else [end]
    tell(ends)
    say("searching for gaits of any mode sequence")
    jobs = ResumableJobs(workers=Workers(count=workers), progress=parts, should_stop=should_stop, limit=limit)

    def gaits_at(given: Problem) -> Gaits:
        plan = SearchPlan(problem=with_open_modes(given), starts=request.starts, seed=request.seed)
        return search(plan, jobs)

    instead, nearest = gaits_at(problem), ends
    tell(nearest, instead)
    if given is not None:
        say("following families of gaits to where the mode sequence begins")
        others: Sequence[Gait] = instead
        if given is not problem:  # if the mode sequence exists there, only constraints exclude the design
            others = () if solve(given, should_stop=should_stop).converged else gaits_at(given)
        nearest = []
        for answer in nearest_values(given, gait_of_file, end, others, problem.free, parts, limit):
            nearest.append(answer)
            tell(nearest if answer is end or end is None else [end, *(n for n in nearest if n is not end)], instead)
    if limit.is_interrupted:
        raise KeyboardInterrupt
    return known(nearest, instead, complete=not limit.is_over)


def _with_fixed_numbers(problem: Problem, gait: Gait) -> Problem | None:
    """The problem with its free numbers fixed at the values of the failed solve, and without requirements.

    None if the mode sequence is open, or if the control points of a curve are free, because these are no such numbers.
    """
    if problem.is_open or free_parameters(problem, gait.system).keys() != problem.free.keys():
        return None
    return problem.with_fixed(gait.dynamics.parameters) if problem.free else problem


def _causes(
    problem: Problem, gait: Gait, direct: tuple[Cause, ...], nearest: Sequence[Nearest], gait_of_file: Gait | None
) -> tuple[Cause, ...]:
    """The violated conditions. If they only say how the solver ended, the end of a family comes first.

    This is the end of the family of the file's gait along a changed parameter, or the nearest end of any family. It
    also comes first if the gait could not be followed to the problem's values.
    """
    causes = direct or (Cause(what="search", description=gait.message),)
    needed, friction = least_friction(problem), problem.static_friction
    if friction < needed:
        sentence = f"friction {TOO_SLIPPERY.format(*distinguished(friction, needed))}"
        return (Cause(what="friction", description=sentence, needed=needed, available=friction), *causes)
    if not nearest:
        return causes
    table, cycle = gait.system.transitions, problem.cycle
    events = {table.ending(cycle, k).guard for k in range(len(cycle.phases))}
    at_values = gait.solver.get("followed", 1.0) == 1.0
    if at_values and causes[0].what not in {*SEARCH_CAUSES, *events}:
        return causes
    values, changed = problem.parameters, [] if gait_of_file is None else changed_parameters(problem, gait_of_file)
    along = [n for n in nearest if n.parameter in changed] or nearest
    first = min(along, key=lambda n: abs(n.value - values[n.parameter]) / max(abs(n.value), abs(values[n.parameter])))
    there, here = distinguished(first.value, values[first.parameter], digits=6)
    sentence = f"{first.reason} at {first.parameter} = {there}; here it is {here}"
    cause = Cause(what=first.type, description=sentence, needed=first.value, available=values[first.parameter])
    return (cause, *causes)


def changed_parameters(problem: Problem, gait: Gait) -> list[str]:
    """Dotted keys whose values in the problem differ from those of the gait."""
    values = gait.dynamics.parameters
    return [key for key, value in problem.parameters.items() if key in values and values[key] != value]


def end_on_the_way(problem: Problem, gait_of_file: Gait, should_stop: Stop) -> Nearest | None:
    """The end of the family of the file's gait on the way to the changed value, if one parameter was changed."""
    changed = changed_parameters(problem, gait_of_file)
    if len(changed) != 1:
        return None
    return end_of_family(gait_of_file, changed[0], problem.parameters[changed[0]], should_stop)


def nearest_values(
    problem: Problem,
    gait_of_file: Gait | None,
    end: Nearest | None,
    others: Iterable[Gait],
    free: Mapping[str, Free[float]],
    parts: Counted = None,
    should_stop: Stop = None,
) -> Iterator[Nearest]:
    """The nearest values of single parameters at which the mode sequence of a problem exists, as they are found.

    The parameters are those that differ from the file, friction, slope and the numbers that a design leaves free.

    Parameters
    ----------
    problem : the problem without free numbers.
    gait_of_file : the gait of the problem's file.
    end : the end of its family on the way to the problem.
    others : gaits of other mode sequences at the problem's parameters.
    free : the numbers that a design leaves free, with their ranges.
    parts : called with the number of finished parameters and their total.
    """
    changed = [] if gait_of_file is None else changed_parameters(problem, gait_of_file)
    gaits, values = list(others), problem.parameters
    ranges = {key: _widened(problem, key, span) for key, span in free.items()}
    ranges |= {key: (0.0, WIDEST_FRICTION) for key in values if key.partition(".")[0] == "friction"}
    ranges |= {key: (-WIDEST_SLOPE, WIDEST_SLOPE) for key in values if key == "walker.slope"}
    parameters = list(dict.fromkeys([*changed, *ranges]))
    for number, parameter in enumerate(parameters, start=1):
        best = end if end is not None and end.parameter == parameter else None
        within = np.inf if best is None else abs(best.value - values[parameter])
        bounds = ranges.get(parameter, ())
        best = nearest_begin(gaits, parameter, bounds, problem.cycle, within=within, should_stop=should_stop) or best
        if best is not None:
            yield best
        if parts is not None:
            parts(number, len(parameters))


def end_of_family(gait: Gait, parameter: str, value: float, should_stop: Stop) -> Nearest | None:
    """The end of a gait's mode sequence on the way to a value of a parameter; None if the gait gets there."""
    cycle = gait.problem.cycle
    for point in _on_the_way(gait, parameter, value, should_stop):
        if isinstance(point, SpecialPoint) and point.type in END_TYPES:
            if point.before is not None and point.after is not None and point.before.untimed == point.after.untimed:
                continue  # a switch meets a breakpoint, but the modes stay the same
            is_there = np.isclose(point.value, value, rtol=1e-12, atol=1e-14)
            return None if is_there else _nearest(parameter, point)
        if isinstance(point, BranchPoint) and point.gait.problem.cycle != cycle:
            return None
    return None


def nearest_begin(
    gaits: Iterable[Gait],
    parameter: str,
    bounds: Iterable[float],
    cycle: Cycle,
    *,
    within: float = np.inf,
    should_stop: Stop = None,
) -> Nearest | None:
    """The nearest value of a parameter at which the family of one of the gaits changes to a mode sequence, or None.

    All families are followed towards all bounds together: the one whose value is nearest to the start takes the next
    step. When one reaches the mode sequence, no other family can reach it at a nearer value.

    Parameters
    ----------
    gaits : gaits with the same value of the parameter.
    within : largest distance from this value at which an answer is sought.
    """
    starts = [(gait, bound) for gait in gaits for bound in bounds]
    families = [_on_the_way(gait, parameter, bound, should_stop) for gait, bound in starts]
    best, queue = None, [(0.0, number) for number in range(len(starts))]
    while queue:
        distance, number = heappop(queue)
        if distance >= within:
            break
        point = next(families[number], None)
        if point is None:
            continue
        distance = max(distance, abs(point.value - starts[number][0].dynamics.parameter(parameter)))
        if isinstance(point, SpecialPoint) and point.after is not None and point.after.untimed == cycle:
            if distance < within:
                best, within = _nearest(parameter, point), distance
            continue
        heappush(queue, (distance, number))
    return best


def _on_the_way(gait: Gait, parameter: str, value: float, should_stop: Stop) -> Iterator[BranchPoint | SpecialPoint]:
    """The points of the family of a gait on the way to a value of a parameter."""
    request = Request(parameter=parameter, to=(value,), max_points=MAX_POINTS, verify_every=0)
    return family(gait, request, should_stop)


def _nearest(parameter: str, special: SpecialPoint) -> Nearest:
    return Nearest(
        parameter=parameter, value=special.value, type=special.type, reason=special.reason, gait=special.gait
    )


def _widened(problem: Problem, key: str, span: Free[float]) -> tuple[float, ...]:
    """The range of a free number, extended by its width on either side if the walker can have these values."""
    width = span.upper - span.lower
    wide = ((span.lower - width, span.lower), (span.upper + width, span.upper))
    return tuple(bound if problem.objection(key, beyond) else beyond for beyond, bound in wide)
