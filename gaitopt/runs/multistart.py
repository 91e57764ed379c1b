"""Many starts: a problem solved from random guesses, to find its distinct solutions and how often each is found.

A start changes every section coordinate of the guess, the guess of every freed number and the control points of a free
curve at random. The starts depend on the seed alone, not on how many processes work on them.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
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
from gaitopt.store.run import Run
from gaitopt.systems import build_system
from gaitopt.workers.jobs import Job, Workers

SAME_OBJECTIVE, SAME_PLACE = 1e-6, 1e-3
"""Relative differences of the objective, and of state and freed values, within which two solutions are the same: near a
flat optimum, places differ by the root of the difference of the objectives."""
DECIDING_DIGITS = 6
"""Objectives that agree to this number of digits do not rank two solutions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """One distinct solution.

    Attributes
    ----------
    record : of its gait, verified, as ``Gait.to_record``.
    problem : with the first guess that led to it.
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
        """Whether the simulation confirms it."""
        return bool(self.record["verification"]["passed"])

    @property
    def radius(self) -> float:
        """Spectral radius; below one the gait is stable."""
        return float(self.record["spectral_radius"])

    def to_record(self) -> dict[str, Any]:
        """The numbers that distinguish it from the other solutions."""
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
    """As ``gaitopt.multistart``; ``folder`` keeps the results of all starts, on all cores by default."""
    check_jobs_fit(starts, folder, "starts")

    def jobs(_: Mapping[str, Any]) -> Iterator[Job]:
        return map(problem_job, sampled(problem, starts, seed=seed, spread=spread))

    records = solve_all(
        Run(folder), problem, jobs, starts, workers or Workers(), progress=progress, should_stop=should_stop
    )
    converged = [k for k, record in enumerate(records) if record["status"] == Status.CONVERGED]
    groups = {group[0]: group for group in grouped(converged, lambda a, b: _same(records[a], records[b]))}
    guessed = enumerate(islice(sampled(problem, starts, seed=seed, spread=spread), max(groups, default=-1) + 1))
    optima = [Optimum(record=records[k], problem=start, starts=tuple(groups[k])) for k, start in guessed if k in groups]
    return sorted(optima, key=_rank)


def sampled(problem: Problem, count: int, *, seed: int, spread: float) -> Iterator[Problem]:
    """The problem, and then ``count - 1`` times the same with another guess; made one by one as they are drawn."""
    yield problem
    control = build_system(problem).control
    curves = control.points if isinstance(control, BezierTracking) else {}
    names = problem.walker.section_names(slipping=problem.cycle.impact.slips)
    for number in range(1, count):
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
        yield problem.replace(changes)


def _rank(optimum: Optimum) -> tuple[bool, float, bool, float]:
    """Verified solutions first, then better objectives; of equal objectives the stable gaits first."""
    objective = float(f"{optimum.objective:.{DECIDING_DIGITS}g}")
    return not optimum.verified, objective, not optimum.radius < 1, optimum.radius


def _same(first: dict[str, Any], second: dict[str, Any]) -> bool:
    values = [np.array([*record["state"].values(), *record["parameters"].values()]) for record in (first, second)]
    objectives = [record["solver"].get("objective", 0.0) for record in (first, second)]
    near = bool(np.all(np.abs(values[0] - values[1]) <= SAME_PLACE * (1 + np.abs(values[0]))))
    return near and abs(objectives[0] - objectives[1]) <= SAME_OBJECTIVE * abs(objectives[0])
