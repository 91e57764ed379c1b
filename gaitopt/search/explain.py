"""Why a problem has no gait with its mode sequence: violated conditions, existing gaits, nearest parameters.

A mode sequence begins or ceases to exist at special points of families. Families are followed from gaits that exist:
from that of the problem's file towards the changed values, and from gaits of other mode sequences at these values. The
special point on the way is located to rounding; its parameter is the answer.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import Any

import numpy as np

from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.callbacks import Stop
from gaitopt.display import Tabulated
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.branch import BranchPoint, SpecialPoint
from gaitopt.gait.gait import Cause, Gait, Status
from gaitopt.model.cycle import Cycle
from gaitopt.nlp.solve import free_parameters
from gaitopt.problem.problem import Problem
from gaitopt.problem.statement import Free
from gaitopt.search.find import STARTS, Gaits, SearchPlan, opened, search
from gaitopt.search.solve import file_gait, solve
from gaitopt.verification.verify import verify
from gaitopt.verification.walk import Walk, simulate
from gaitopt.workers.jobs import ResumableJobs, Workers

ENDS = ("fold", "mode_change", "impact_change", "vanishing", "lift_off", "painleve", "end")
"""Special points beyond which a mode sequence does not continue, or not in the same direction."""
MAX_POINTS = 200
"""Maximum number of points of one family; an answer takes some tens."""
WIDEST_FRICTION, WIDEST_SLOPE = 2.0, 0.35
"""Largest friction and slope [rad] of the search."""
INDIRECT = ("search", "motion", "event", "periodicity", "duration", "touchdown", "slip_velocity", "equations")
"""Causes that only say where the solver ended; the end of a family of gaits is listed before them."""
LONGEST = 120
"""Maximum length of a cause in one line [characters]."""
WALK = 20
"""Number of steps of the walk from the guess."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearest:
    """A value of one parameter at which the mode sequence begins to exist, the others being those of the problem.

    Attributes
    ----------
    parameter, value : dotted key, and the value in SI.
    type : of the special point there.
    reason : what happens there, in words.
    gait : at the special point, or None.
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
    gait : the attempt, where ``exists`` the gait; None where the reference of a PD law already failed.
    exists : whether the gait exists after all.
    causes : violated conditions, the decisive one first.
    instead : gaits of any mode sequence at these parameters.
    walk : what the simulator does from the guess, None where there is no guess.
    nearest : values of single parameters at which the mode sequence begins to exist; of a design, the other free
        numbers are those of the attempt.
    """

    problem: Problem
    gait: Gait | None
    exists: bool
    causes: tuple[Cause, ...] = ()
    instead: Gaits | None = None
    walk: Walk | None = None
    nearest: tuple[Nearest, ...] = ()

    def __repr__(self) -> str:
        why = self.causes[0].words if self.causes else "no cause is known"
        return f"<Explanation of {self.problem.name}: {'the gait exists' if self.exists else shorten(why, LONGEST)}>"

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of the command line."""
        return {
            "problem": self.problem.name,
            "exists": self.exists,
            "causes": [cause.to_record() for cause in self.causes],
            "instead": [] if self.instead is None else self.instead.to_record()["gaits"],
            "simulated": None if self.walk is None else self.walk.to_record(),
            "nearest": [nearest.to_record() for nearest in self.nearest],
        }


def explain(
    problem: Problem,
    *,
    starts: int = STARTS,
    seed: int = 0,
    workers: int = 1,
    progress: Callable[[str], None] | None = None,
    should_stop: Stop = None,
) -> Explanation:
    """As ``gaitopt.explain``; ``progress`` is called with what is done next."""
    say = progress or (lambda _: None)
    say(f"solving {problem.name}")
    try:
        gait = solve(problem, should_stop=should_stop)
    except SolveError as error:
        cause = Cause(what="reference", words=str(error))
        return Explanation(problem=problem, gait=None, exists=False, causes=(cause,))
    if gait.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    refuted = _refuted(gait)
    if gait.converged and not refuted:
        return Explanation(problem=problem, gait=gait, exists=True)
    say("searching for gaits of any mode sequence")
    jobs = ResumableJobs(workers=Workers(count=workers), should_stop=should_stop)

    def gaits_at(given: Problem) -> Gaits:
        plan = SearchPlan(problem=opened(given), starts=starts, seed=seed)
        return search(plan, jobs)

    instead = gaits_at(problem)
    walk = None if problem.start is None else simulate(problem, steps=WALK, dense=False)
    gait_of_file, nearest = _begins(problem, gait, instead, gaits_at, say, should_stop)
    causes = _causes(problem, gait, refuted or gait.causes, nearest, gait_of_file)
    return Explanation(
        problem=problem, gait=gait, exists=False, causes=causes, instead=instead, walk=walk, nearest=tuple(nearest)
    )


def _begins(
    problem: Problem,
    attempt: Gait,
    instead: Gaits,
    gaits_at: Callable[[Problem], Gaits],
    say: Callable[[str], None],
    should_stop: Stop,
) -> tuple[Gait | None, list[Nearest]]:
    """The gait of the problem's own file, and the nearest values at which the mode sequence begins to exist."""
    given = _given(problem, attempt)
    if given is None:
        return None, []
    say("following families of gaits to where the mode sequence begins")
    gait_of_file = file_gait(problem, should_stop=should_stop)
    others: Sequence[Gait] = instead
    if given is not problem:  # where the mode sequence exists at all, only constraints exclude the design
        others = () if solve(given, should_stop=should_stop).converged else gaits_at(given)
    return gait_of_file, nearest_values(given, gait_of_file, others, problem.free, should_stop)


def _given(problem: Problem, gait: Gait) -> Problem | None:
    """The problem with its free numbers as in the attempt, and nothing required of them; None without a sequence.

    A curve that is to be designed has no numbers that could be given one by one.
    """
    if problem.is_open or free_parameters(problem, gait.system).keys() != problem.free.keys():
        return None
    if not problem.free:
        return problem
    return problem.with_fixed(gait.dynamics.parameters)


def _refuted(gait: Gait) -> tuple[Cause, ...]:
    """The claims about a gait that the simulator does not confirm."""
    if not gait.converged:
        return ()
    claims = [claim for claim in verify(gait).claims if not claim.passed]
    return tuple(
        Cause(
            what=claim.name,
            words=f"the simulator disagrees: {claim.words}",
            needed=claim.tolerance,
            available=claim.figure,
        )
        for claim in claims
    )


def _causes(
    problem: Problem, gait: Gait, direct: tuple[Cause, ...], nearest: list[Nearest], gait_of_file: Gait | None
) -> tuple[Cause, ...]:
    """The violated conditions. If they only say where the solver ended, the end of the family comes first.

    The end is that of the gait of the problem's file along a changed parameter, or else the nearest of all. It also
    comes first if the gait could not be followed to the problem's values.
    """
    causes = direct or (Cause(what="search", words=gait.message),)
    here = gait.solver.get("followed", 1.0) == 1.0
    if (here and causes[0].what not in INDIRECT) or not nearest:
        return causes
    values, changed = problem.parameters, [] if gait_of_file is None else changed_parameters(problem, gait_of_file)
    along = [n for n in nearest if n.parameter in changed] or nearest
    first = min(along, key=lambda n: abs(n.value - values[n.parameter]) / max(abs(n.value), abs(values[n.parameter])))
    words = f"{first.reason} at {first.parameter} = {first.value:.6g}; here it is {values[first.parameter]:.6g}"
    cause = Cause(what=first.type, words=words, needed=first.value, available=values[first.parameter])
    return (cause, *causes)


def changed_parameters(problem: Problem, gait: Gait) -> list[str]:
    """Dotted keys whose values in the problem are not those of the gait."""
    values = gait.dynamics.parameters
    return [key for key, value in problem.parameters.items() if key in values and values[key] != value]


def end_of_family(gait: Gait, parameter: str, value: float, should_stop: Stop) -> Nearest | None:
    """Where a gait's mode sequence ends on the way to a value of a parameter; None where it gets there."""
    cycle, request = gait.problem.cycle, _request(parameter, value)
    for record in follow_family(gait, request, should_stop=should_stop):
        if isinstance(record, SpecialPoint) and record.type in ENDS:
            is_there = np.isclose(record.value, value, rtol=1e-12, atol=1e-14)
            return None if is_there else _nearest(parameter, record)
        if isinstance(record, BranchPoint) and record.gait.problem.cycle != cycle:
            return None
    return None


def begin_of_sequence(gait: Gait, parameter: str, value: float, cycle: Cycle, should_stop: Stop) -> Nearest | None:
    """Where the family of a gait changes to a mode sequence on the way to a value of a parameter."""
    for record in follow_family(gait, _request(parameter, value), should_stop=should_stop):
        if isinstance(record, SpecialPoint) and record.after == cycle:
            return _nearest(parameter, record)
    return None


def nearest_values(
    problem: Problem,
    gait_of_file: Gait | None,
    others: Iterable[Gait],
    free: Mapping[str, Free],
    should_stop: Stop = None,
) -> list[Nearest]:
    """For friction, slope, free numbers and what differs from the file the nearest value at which the modes exist.

    Parameters
    ----------
    problem : with all its numbers given.
    gait_of_file : the gait of the problem's own file.
    others : gaits of other mode sequences at the problem's parameters.
    free : numbers that a design leaves free, with their ranges.
    """
    changed = [] if gait_of_file is None else changed_parameters(problem, gait_of_file)
    gaits, values = list(others), problem.parameters
    ranges = {key: _widened(problem, key, span) for key, span in free.items()}
    ranges |= {key: (0.0, WIDEST_FRICTION) for key in values if key.partition(".")[0] == "friction"}
    ranges |= {key: (-WIDEST_SLOPE, WIDEST_SLOPE) for key in values if key == "walker.slope"}
    answers = list[Nearest]()
    for parameter in dict.fromkeys([*changed, *ranges]):
        best: Nearest | None = None
        if gait_of_file is not None and changed == [parameter]:
            best = _attempt(end_of_family, gait_of_file, parameter, values[parameter], should_stop)
        for gait in gaits:
            for bound in ranges.get(parameter, ()):
                target = _no_further(values[parameter], bound, best)
                if target != values[parameter]:
                    closer = _attempt(begin_of_sequence, gait, parameter, target, problem.cycle, should_stop)
                    best = closer or best
        if best is not None:
            answers.append(best)
    return answers


def _no_further(value: float, bound: float, best: Nearest | None) -> float:
    """The bound, or the value on its side that is as far from ``value`` as what is known already."""
    reach = np.inf if best is None else abs(best.value - value)
    return float(np.clip(bound, value - reach, value + reach))


def _attempt(follow: Callable[..., Nearest | None], gait: Gait, *arguments: Any) -> Nearest | None:
    """The answer of a family; None where the family cannot be followed in this parameter at all."""
    try:
        return follow(gait, *arguments)
    except (ProblemError, SolveError):
        return None


def _widened(problem: Problem, key: str, span: Free) -> tuple[float, ...]:
    """The range of a free number and as much again on either side, where the walker can have it."""
    width = span.upper - span.lower
    wide = ((span.lower - width, span.lower), (span.upper + width, span.upper))
    return tuple(bound if problem.objection(key, beyond) else beyond for beyond, bound in wide)


def _request(parameter: str, value: float) -> Request:
    return Request(parameter=parameter, to=(value,), max_points=MAX_POINTS, verify_every=0)


def _nearest(parameter: str, special: SpecialPoint) -> Nearest:
    return Nearest(
        parameter=parameter, value=special.value, type=special.type, reason=special.reason, gait=special.gait
    )
