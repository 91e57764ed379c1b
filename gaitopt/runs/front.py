"""Trade-offs: a series of designs along one number of the problem, each started from its neighbour's gait.

The series is computed in both directions, because a design is a local optimum that depends on its start. If both
directions give a gait for the same value, the better one counts. The Pareto front consists of the points that no other
point beats in both aims.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, overload

from gaitopt.display import Plotted, counted
from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.gait.frames import data_frame
from gaitopt.gait.records import FrontEntryRecord, FrontRecord, OutcomeRecord, SolvedRecord, is_gait
from gaitopt.problem.faults import nearest_keys
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import DESIGN_SCALARS, SCALARS, unit_of
from gaitopt.runs.grid import Axis, at_point, check_jobs_fit
from gaitopt.runs.jobs import SOLVED, Plan, problem_job, solve_all
from gaitopt.store.formats import damaged, json_text
from gaitopt.store.run import Run
from gaitopt.workers.jobs import Job, ResumableJobs, Workers

if TYPE_CHECKING:
    from pandas import DataFrame


SAME_OBJECTIVE = 1e-9
"""Relative difference below which two objectives are equal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrontPoint:
    """One design of a front.

    Attributes
    ----------
    value : value of the varied number.
    gait : record of the better gait of both directions, verified if it converged.
    pareto : whether no other point is better in one aim and no worse in the other.
    """

    value: float
    gait: OutcomeRecord
    pareto: bool

    @property
    def converged(self) -> bool:
        """Whether there is a gait."""
        return is_gait(self.gait)

    def to_record(self) -> dict[str, Any]:
        """The gait's record with ``value``, ``objective`` and ``pareto``."""
        objective = _objective(self.gait) if is_gait(self.gait) else None
        return {"value": self.value, "objective": objective, "pareto": self.pareto, **self.gait}


@dataclass(frozen=True, slots=True, kw_only=True)
class Front(Plotted, Sequence[FrontPoint]):
    """A chain of designs over one key of a problem.

    Attributes
    ----------
    problem : the design.
    key : dotted key of the varied number.
    points : designs in the order of the values.
    file : file in which it is stored.
    """

    problem: Problem
    key: str
    points: tuple[FrontPoint, ...]
    file: Path | None = None

    def __repr__(self) -> str:
        solved, best = sum(point.converged for point in self), sum(point.pareto for point in self)
        designs = counted(len(self), "design")
        return f"<Front {self.problem.name} over {self.key}: {designs}, {solved} solved, {best} on the front>"

    def __len__(self) -> int:
        return len(self.points)

    @overload
    def __getitem__(self, key: int) -> FrontPoint: ...

    @overload
    def __getitem__(self, key: slice) -> tuple[FrontPoint, ...]: ...

    def __getitem__(self, key: int | slice) -> FrontPoint | tuple[FrontPoint, ...]:
        return self.points[key]

    def to_records(self) -> list[dict[str, Any]]:
        """The JSON objects of all points."""
        return [point.to_record() for point in self.points]

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of the command line."""
        lower, upper = (float(self.points[k].value) for k in (0, -1))
        over = Axis(key=self.key, lower=lower, upper=upper, count=len(self))
        return {"problem": self.problem.name, "over": str(over), "points": self.to_records()}

    def to_frame(self) -> "DataFrame":
        """One row per design: value, objective, whether it is on the front, status and the scalars of its gait."""
        header = ["value", "objective", "pareto", "status", *SCALARS]
        rows = [[record.get(name) for name in header] for record in self.to_records()]
        units = {name: unit_of(name, self.problem) for name in header}
        return data_frame(header, rows, units, problem=self.problem.name, over=self.key)


@dataclass(frozen=True, kw_only=True)
class FrontPlan(Plan[Front]):
    """Designs to be computed for every value of an axis.

    Attributes
    ----------
    problem : the design.
    axis : the varied number.
    """

    results = SOLVED
    axis: Axis

    def check(self) -> None:
        """Refuse a front without an objective, one along a key that is not a number, or one with too many designs."""
        problem, key = self.problem, self.axis.key
        if not problem.objective:
            raise ProblemError(f"{problem.name}: a front needs an objective to trade against {key}")
        keys = (*problem.parameters, *(f"constraints.{name}" for name in DESIGN_SCALARS))
        if key not in keys and "." not in key:
            message = f"{key}: no number of {problem.name}{nearest_keys(key, keys)}"
            raise UnknownNameError(message).concerning("over")
        check_jobs_fit(2 * self.axis.count, self.folder)
        for value in self.axis.numbers(problem)[:: max(self.axis.count - 1, 1)]:
            at_point(problem, {key: value})

    def result(self, jobs: ResumableJobs) -> Front:
        """The better design of both directions for every value."""
        key = self.axis.key
        problems = {value: at_point(self.problem, {key: value}) for value in self.axis.numbers(self.problem)}
        walk, best = [*problems, *reversed(problems)], dict[float, OutcomeRecord]()

        def chain() -> Iterator[Job]:
            """The jobs in order; each design starts from the best gait of its neighbour, or from the guess."""
            neighbour: str | None = None
            for value in walk:
                job = problem_job(problems[value], neighbour)
                yield job
                gait = jobs.results[job.key]
                if is_gait(gait) and not isinstance(gait["solver"].get("objective"), int | float):
                    raise damaged(self.run.path(SOLVED.name), f"{job.key}: a design that is solved has an objective")
                best[value] = gait if value not in best or _beats(gait, best[value]) else best[value]
                neighbour = best[value]["job"] if is_gait(best[value]) else neighbour

        serial = replace(jobs, workers=Workers(count=1))  # each design needs the one before
        solve_all(serial, chain(), len(walk))
        points = (FrontPoint(value=v, gait=best[v], pareto=_undominated(v, best, key)) for v in problems)
        file = self.run.path(front_file(key))
        front = Front(problem=self.problem, key=key, points=tuple(points), file=file)
        self.run.write({file.name: json_text(front.to_record()) + "\n"})
        return front


def front_file(key: str) -> str:
    """Name of the file of a front over a key."""
    return f"front-{key}.json"


def read_fronts(folder: Path) -> list[Front]:
    """The fronts in a run folder."""
    run, fronts = Run(folder), list[Front]()
    problem = run.problem()
    for path in sorted(folder.glob(front_file("*"))):
        record = run.read_record(path.name, FrontRecord, states=problem.walker.state_names())
        key, entries = record["over"].partition("=")[0], cast(list[FrontEntryRecord], record["points"])
        gaits = {entry["value"]: gait for entry, gait in zip(entries, record["points"], strict=True)}
        pareto = {value: _undominated(value, gaits, key) for value in gaits}
        axis = Axis(key=key, lower=entries[0]["value"], upper=entries[-1]["value"], count=len(gaits))
        same_pareto = all(entry["pareto"] is pareto[entry["value"]] for entry in entries)
        if not same_pareto or record["over"] != str(axis) or path.name != front_file(key):
            raise damaged(path, "over, or pareto of a point, is not what its points give")
        points = (FrontPoint(value=v, gait=gait, pareto=pareto[v]) for v, gait in gaits.items())
        fronts.append(Front(problem=problem, key=key, points=tuple(points), file=path))
    return fronts


def _objective(gait: SolvedRecord) -> float:
    return float(cast(float, gait["solver"]["objective"]))


def _beats(gait: OutcomeRecord, other: OutcomeRecord) -> bool:
    if is_gait(gait) and is_gait(other):
        return _objective(gait) < _objective(other) - SAME_OBJECTIVE * abs(_objective(other))
    return is_gait(gait)


def _undominated(value: float, gaits: Mapping[float, OutcomeRecord], key: str) -> bool:
    """Whether there is a gait at the value, and no other gait is stricter in the varied number at no higher cost."""
    costs = {other: _objective(gait) for other, gait in gaits.items() if is_gait(gait)}
    strictness = -1.0 if key.endswith(".max") else 1.0
    return value in costs and not any(
        cost <= costs[value] and strictness * other > strictness * value for other, cost in costs.items()
    )
