"""Trade-offs: a chain of designs along one number of the problem, each started from its neighbour's gait.

The chain is walked in both directions, because a design is a local optimum and depends on where it comes from; of two
gaits for the same number the better one is kept. Its Pareto front are the points that no other one beats in both aims.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from gaitopt.errors import ProblemError
from gaitopt.gait import Gait, Status
from gaitopt.problem import Problem
from gaitopt.study.grid import Axis
from gaitopt.study.solve import solve
from gaitopt.study.verify import verify

Progress = Callable[[int, int], None]
TIE = 1e-9
"""Relative difference of objectives below which a gait does not beat another."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrontPoint:
    """One design of a front.

    Attributes
    ----------
    value : of the number that is varied.
    gait : the better one of both directions, verified if it converged.
    pareto : whether no other point is better in one aim and no worse in the other.
    """

    value: float
    gait: Gait
    pareto: bool

    def to_record(self) -> dict[str, Any]:
        """The gait's record with ``value`` and ``pareto``."""
        return {"value": self.value, "pareto": self.pareto, **self.gait.to_record()}


def design_front(
    problem: Problem,
    axis: Axis,
    *,
    progress: Progress | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> list[FrontPoint]:
    """Designs for every value of an axis, in its order.

    Parameters
    ----------
    problem : a design with an objective.
    axis : dotted key of a number of the problem, for instance ``constraints.speed.min``, and its values.
    progress : called with the number of designs done and their total.
    should_stop : polled at every iteration; the points found so far are returned.

    Raises
    ------
    ProblemError
        If the problem has no objective, or a value is wrong for it.
    """
    if not problem.objective:
        raise ProblemError(f"{problem.name}: a front needs an objective, that is traded against {axis.key}")
    problems = {float(value): problem.replace({axis.key: float(value)}) for value in axis.values}
    best: dict[float, Gait] = {}
    neighbour: Gait | None = None
    for done, value in enumerate([*problems, *reversed(problems)], start=1):
        if should_stop is not None and should_stop():
            break
        found = _solve(problems[value], neighbour, should_stop)
        best[value] = found if value not in best or _beats(found, best[value]) else best[value]
        neighbour = best[value] if best[value].converged else neighbour
        if progress is not None:
            progress(done, 2 * len(problems))
    gaits = {value: _verified(best[value]) for value in problems if value in best}
    return [FrontPoint(value=v, gait=g, pareto=_undominated(v, g, gaits, axis.key)) for v, g in gaits.items()]


def _solve(problem: Problem, neighbour: Gait | None, should_stop: Callable[[], bool] | None) -> Gait:
    """From the neighbour's gait; from the guess where there is none or it leads nowhere."""
    if neighbour is not None:
        gait = solve(problem, start=neighbour, should_stop=should_stop)
        if gait.converged or gait.status is Status.INTERRUPTED:
            return gait
    return solve(problem, should_stop=should_stop)


def _beats(gait: Gait, other: Gait) -> bool:
    if not (gait.converged and other.converged):
        return gait.converged
    return gait.solver["objective"] < other.solver["objective"] - TIE * abs(other.solver["objective"])


def _verified(gait: Gait) -> Gait:
    return gait.verified(verify(gait).to_record()) if gait.converged else gait


def _undominated(value: float, gait: Gait, gaits: dict[float, Gait], key: str) -> bool:
    """Whether no other gait costs no more and is stricter in what is varied."""
    if not gait.converged:
        return False
    strictness = -1.0 if key.endswith(".max") else 1.0
    rivals: Iterable[tuple[float, Gait]] = ((v, g) for v, g in gaits.items() if v != value and g.converged)
    cost = gait.solver["objective"]
    return not any(g.solver["objective"] <= cost and strictness * v > strictness * value for v, g in rivals)
