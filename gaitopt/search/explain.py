"""Why a problem has no gait with its mode sequence, what there is instead, and what would have to change."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from textwrap import shorten
from typing import Any

from gaitopt.callbacks import Stop
from gaitopt.display import Tabulated
from gaitopt.errors import SolveError
from gaitopt.gait import Cause, Gait, Status
from gaitopt.nlp import free_parameters
from gaitopt.problem import Problem
from gaitopt.search.distinct import Gaits
from gaitopt.search.find import STARTS, SearchPlan, in_memory, opened, search
from gaitopt.search.nearest import Nearest, changed_parameters, nearest_values
from gaitopt.search.solve import file_gait, solve
from gaitopt.study.simulate import Walk, simulate
from gaitopt.study.verify import verify
from gaitopt.workers.jobs import Workers

INDIRECT = ("search", "motion", "event", "periodicity", "duration", "touchdown", "slip_velocity", "equations")
"""Causes that only state where a search ended; the end of a family of gaits comes before them."""
LONGEST = 120
"""Characters of a cause in one line."""
WALK = 20
"""Steps of the walk from the guess."""


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
    run = in_memory(Workers(count=workers), None, should_stop)

    def gaits_at(given: Problem) -> Gaits:
        plan = SearchPlan(problem=opened(given), starts=starts, seed=seed)
        return search(plan, run, should_stop=should_stop)

    instead = gaits_at(problem)
    walk = None if problem.start is None else simulate(problem, steps=WALK, dense=False)
    own, nearest = _begins(problem, gait, instead, gaits_at, say, should_stop)
    causes = _causes(problem, gait, refuted or gait.causes, nearest, own)
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
    own = file_gait(problem, should_stop=should_stop)
    others: Sequence[Gait] = instead
    if given is not problem:  # where the mode sequence exists at all, only constraints exclude the design
        others = () if solve(given, should_stop=should_stop).converged else gaits_at(given)
    return own, nearest_values(given, own, others, problem.free, should_stop)


def _given(problem: Problem, gait: Gait) -> Problem | None:
    """The problem with its free numbers as in the attempt, and nothing required of them; None without a sequence.

    A curve that is to be designed has no numbers that could be given one by one.
    """
    if problem.is_open or free_parameters(problem, gait.system).keys() != problem.free.keys():
        return None
    if not problem.free:
        return problem
    values = gait.dynamics.parameters
    return replace(problem, free={}, objective={}, constraints={}).replace({key: values[key] for key in problem.free})


def _refuted(gait: Gait) -> tuple[Cause, ...]:
    """The claims about a gait that the simulator does not confirm."""
    if not gait.converged:
        return ()
    claims = [claim for claim in verify(gait).claims if not claim.passed]
    return tuple(
        Cause(
            what=claim.name,
            words=f"the simulator disagrees: {claim.name}, {claim.note}",
            needed=claim.tolerance,
            available=claim.figure,
        )
        for claim in claims
    )


def _causes(
    problem: Problem, gait: Gait, direct: tuple[Cause, ...], nearest: list[Nearest], own: Gait | None
) -> tuple[Cause, ...]:
    """The conditions that the attempt violates; before those that only state where it ended, the end of the family.

    Along a parameter that has been changed that is the end of the file's own gait, else the nearest of all. It also
    comes before what an attempt violates that could not be followed to the problem's values.
    """
    causes = direct or (Cause(what="search", words=gait.message),)
    here = gait.solver.get("followed", 1.0) == 1.0
    if (here and causes[0].what not in INDIRECT) or not nearest:
        return causes
    values, changed = problem.parameters, [] if own is None else changed_parameters(problem, own)
    along = [n for n in nearest if n.parameter in changed] or nearest
    first = min(along, key=lambda n: abs(n.value - values[n.parameter]) / max(abs(n.value), abs(values[n.parameter])))
    words = f"{first.reason} at {first.parameter} = {first.value:.6g}; here it is {values[first.parameter]:.6g}"
    cause = Cause(what=first.type, words=words, needed=first.value, available=values[first.parameter])
    return (cause, *causes)
