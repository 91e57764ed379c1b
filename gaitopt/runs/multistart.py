"""A problem solved from many random guesses, to find its distinct solutions and how often each one is found.

A start changes every section coordinate of the guess, the guess of every freed number and the control points of a free
curve at random. The starts depend on the seed alone, not on the number of processes.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby, islice
from typing import Any, cast

import numpy as np

from gaitopt.display import counted
from gaitopt.gait.records import SolvedRecord, is_gait
from gaitopt.problem.problem import Problem
from gaitopt.requests import StartsRequest
from gaitopt.runs.grid import check_jobs_fit
from gaitopt.runs.jobs import SOLVED, Plan, problem_job, solve_all
from gaitopt.search.find import grouped
from gaitopt.systems import build_system
from gaitopt.workers.jobs import ResumableJobs

SAME_OBJECTIVE, SAME_VALUES = 1e-6, 1e-3
"""Relative differences of the objectives, and of the states and freed values, below which two solutions are the same.
Near a flat optimum, values differ by the root of the difference of the objectives."""
RANKING_DIGITS = 6
"""Objectives that agree to this number of digits count as equal when solutions are ranked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """One distinct solution.

    Attributes
    ----------
    record : record of the verified gait, see ``Gait.to_record``.
    problem : the problem with the first guess that led to the solution.
    starts : numbers of all starts that led to the solution; start 0 is the problem's own guess.
    """

    record: SolvedRecord
    problem: Problem
    starts: tuple[int, ...]

    def __repr__(self) -> str:
        starts = counted(len(self.starts), "start")
        numbers = f"period {self.record['period']:.6g} s, radius {self.radius:.4g}, {starts}"
        return f"<Optimum {self.problem.name}: objective {self.objective:.9g}, {numbers}>"

    @property
    def objective(self) -> float:
        """The objective; 0 if nothing is minimised."""
        return _objective(self.record)

    @property
    def verified(self) -> bool:
        """Whether the simulation confirms it."""
        verification = self.record["verification"]
        return verification is not None and verification["passed"]

    @property
    def radius(self) -> float:
        """Spectral radius; below one the gait is stable."""
        return float(cast(float, self.record["spectral_radius"]))

    @property
    def rank(self) -> tuple[bool, float, bool, float]:
        """Sort key: verified solutions first, then better objectives; among equal objectives, stable gaits first."""
        objective = float(f"{self.objective:.{RANKING_DIGITS}g}")
        return not self.verified, objective, not self.radius < 1, self.radius

    def to_record(self) -> dict[str, Any]:
        """The numbers that distinguish the solution from others."""
        return {
            "objective": self.objective,
            "kkt": self.record["solver"].get("kkt"),
            "verified": self.verified,
            "starts": list(self.starts),
            "state": self.record["state"],
            "parameters": self.record["parameters"],
            "period": self.record["period"],
            "spectral_radius": self.record["spectral_radius"],
        }


@dataclass(frozen=True, kw_only=True)
class StartsPlan(Plan[list[Optimum]], StartsRequest):
    """A problem to be solved from many guesses."""

    results = SOLVED

    def check(self) -> None:
        """Refuse more starts than fit."""
        check_jobs_fit(self.starts, self.folder, "starts")

    def result(self, jobs: ResumableJobs) -> list[Optimum]:
        """The distinct solutions, the best first."""
        records = solve_all(jobs, map(problem_job, self.sampled()), self.starts)
        gaits = {k: record for k, record in enumerate(records) if is_gait(record)}
        groups = {group[0]: group for group in grouped(gaits, lambda a, b: _same(gaits[a], gaits[b]))}
        guessed = enumerate(islice(self.sampled(), max(groups, default=-1) + 1))
        optima = [
            Optimum(record=gaits[k], problem=start, starts=tuple(groups[k])) for k, start in guessed if k in groups
        ]
        return sorted(optima, key=lambda optimum: optimum.rank)

    def sampled(self) -> Iterator[Problem]:
        """The problem itself, then copies with random guesses, which are made one by one."""
        problem, spread = self.problem, self.spread
        yield problem
        control = build_system(problem).control
        spans, values = control.unknowns(type(problem.walker)), control.parameters
        rows = [list(row) for _, row in groupby(spans, key=lambda name: name.rpartition(".")[0])]
        names = problem.section_names
        sizes = {key: abs(free.guess) or free.upper - free.lower for key, free in problem.free.items()}
        for number in range(1, self.starts):
            rng = np.random.default_rng([self.seed, number])
            changes: dict[str, object] = {
                f"gait.guess.state.{name}": problem.guess.state[name] * (1 + spread * rng.uniform(-1, 1))
                for name in names
            }
            guesses = {key: problem.free[key].guess + spread * size * rng.uniform(-1, 1) for key, size in sizes.items()}
            changes |= problem.free_guesses(guesses)
            moved = dict[str, float]()
            for row in rows:
                points = np.array([values[name] for name in row])
                points += spread * np.ptp(points) * rng.uniform(-1, 1, len(points))
                moved |= {f"control.{name}": np.clip(c, *spans[name]) for name, c in zip(row, points, strict=True)}
            changes |= problem.control.guesses(moved, type(problem.walker))
            yield problem.replace(changes)


def _objective(record: SolvedRecord) -> float:
    return float(cast(float, record["solver"].get("objective", 0.0)))


def _same(first: SolvedRecord, second: SolvedRecord) -> bool:
    values = [np.array([*record["state"].values(), *record["parameters"].values()]) for record in (first, second)]
    objectives = [_objective(record) for record in (first, second)]
    near = bool(np.all(np.abs(values[0] - values[1]) <= SAME_VALUES * (1 + np.abs(values[0]))))
    return near and abs(objectives[0] - objectives[1]) <= SAME_OBJECTIVE * abs(objectives[0])
