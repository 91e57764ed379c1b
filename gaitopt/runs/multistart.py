"""Designs from many sampled guesses: which optima there are, how often each is found, and whether the best is alone.

A start changes every section coordinate of the guess, the guess of every freed number and the control points of a free
curve at random. The starts depend on the seed alone, not on how many processes work on them.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gaitopt.callbacks import Counted, Stop
from gaitopt.gait.gait import Status
from gaitopt.model.control import BezierTracking
from gaitopt.problem.problem import Problem
from gaitopt.runs.grid import check_jobs_fit
from gaitopt.runs.jobs import problem_job, solve_all
from gaitopt.search.find import grouped
from gaitopt.store.folder import begin_run, writing
from gaitopt.systems import build_system
from gaitopt.workers.jobs import Workers

SAME_OBJECTIVE, SAME_PLACE = 1e-6, 1e-3
"""Relative differences of the objective, and of state and freed values, within which two starts have found the same
optimum: where it is flat, places differ by the root of what objectives do."""
DECIDING_DIGITS = 6
"""Objectives that agree to so many digits do not decide between two solutions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """One distinct solution.

    Attributes
    ----------
    record : of its gait, verified, as ``Gait.to_record``.
    problem : with the guess that led to it first.
    starts : numbers of the starts that led to it; start 0 is the problem's own guess.
    """

    record: dict[str, Any]
    problem: Problem
    starts: tuple[int, ...]

    def __repr__(self) -> str:
        words = f"period {self.record['period']:.6g} s, radius {self.radius:.4g}, {len(self.starts)} starts"
        return f"<Optimum {self.problem.name}: objective {self.objective:.9g}, {words}>"

    @property
    def objective(self) -> float:
        """Its objective; 0 where nothing is minimised."""
        return float(self.record["solver"].get("objective", 0.0))

    @property
    def verified(self) -> bool:
        """Whether the simulator confirms it."""
        return bool(self.record["verification"]["passed"])

    @property
    def radius(self) -> float:
        """Spectral radius; below one the gait is stable."""
        return float(self.record["spectral_radius"])

    def to_record(self) -> dict[str, Any]:
        """What distinguishes it from the other solutions."""
        kept = {key: self.record[key] for key in ("state", "parameters", "period", "spectral_radius")}
        kkt = self.record["solver"].get("kkt")
        return {
            "objective": self.objective,
            "kkt": kkt,
            "verified": self.verified,
            "starts": list(self.starts),
            **kept,
        }


def multistart(
    problem: Problem,
    starts: int,
    folder: Path,
    *,
    seed: int = 0,
    spread: float = 0.3,
    workers: Workers | None = None,
    progress: Counted = None,
    should_stop: Stop = None,
) -> list[Optimum]:
    """As ``gaitopt.multistart``; ``folder`` keeps the results of all starts, on all cores if not said otherwise."""
    check_jobs_fit(starts, folder)
    problems = [problem, *sampled(problem, starts - 1, seed=seed, spread=spread, should_stop=should_stop)]
    jobs = [problem_job(p) for p in problems]
    with writing(folder, problem):
        begin_run(folder, problem)
        solved = solve_all(jobs, folder, workers or Workers(), progress=progress, should_stop=should_stop)
    records = [solved[job.key] for job in jobs]
    converged = [k for k, record in enumerate(records) if record["status"] == Status.CONVERGED]
    groups = grouped(converged, lambda first, second: _same(records[first], records[second]))
    optima = [Optimum(record=records[g[0]], problem=problems[g[0]], starts=tuple(g)) for g in groups]
    return sorted(optima, key=_rank)


def sampled(problem: Problem, count: int, *, seed: int, spread: float, should_stop: Stop = None) -> list[Problem]:
    """The problem with ``count`` other guesses; a KeyboardInterrupt where ``should_stop`` says so."""
    control = build_system(problem).control
    curves = control.points if isinstance(control, BezierTracking) else {}
    names = problem.walker.section_names(slipping=problem.cycle.impact.slips)
    problems = []
    for number in range(1, count + 1):
        if should_stop is not None and should_stop():
            raise KeyboardInterrupt
        rng = np.random.default_rng([seed, number])
        changes: dict[str, object] = {
            f"gait.guess.state.{name}": problem.guess.state[name] * (1 + spread * rng.uniform(-1, 1)) for name in names
        }
        sizes = {key: abs(free.guess) or free.upper - free.lower for key, free in problem.free.items()}
        guesses = {key: problem.free[key].guess + spread * size * rng.uniform(-1, 1) for key, size in sizes.items()}
        changes |= problem.free_guesses(guesses)
        for name, points in curves.items():
            row = np.array(points) + spread * np.ptp(points) * rng.uniform(-1, 1, len(points))
            within = control.unknowns[f"reference.{name}.0"]
            changes[f"control.reference.curve.points.{name}"] = np.clip(row, *within).tolist()
        problems.append(problem.replace(changes))
    return problems


def _rank(optimum: Optimum) -> tuple[bool, float, bool, float]:
    """Verified ones first, then the better objective; where that does not decide, stable gaits."""
    objective = float(f"{optimum.objective:.{DECIDING_DIGITS}g}")
    return not optimum.verified, objective, not optimum.radius < 1, optimum.radius


def _same(first: dict[str, Any], second: dict[str, Any]) -> bool:
    values = [np.array([*record["state"].values(), *record["parameters"].values()]) for record in (first, second)]
    objectives = [record["solver"].get("objective", 0.0) for record in (first, second)]
    near = bool(np.all(np.abs(values[0] - values[1]) <= SAME_PLACE * (1 + np.abs(values[0]))))
    return near and abs(objectives[0] - objectives[1]) <= SAME_OBJECTIVE * abs(objectives[0])
