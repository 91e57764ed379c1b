"""Designs from many sampled guesses: which optima there are, how often each is found, and whether the best is alone.

A start changes every section coordinate of the guess and the guess of every freed number at random. The starts depend
on the seed alone, not on how many processes work on them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait import Status
from gaitopt.mechanics import Mode
from gaitopt.problem import Problem
from gaitopt.study.jobs import Job, SetAside, Workers, run_jobs
from gaitopt.study.solve import solve
from gaitopt.study.verify import verify

SAME = 1e-6
"""Relative difference in objective, state and freed values within which two starts have found the same optimum."""


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


def multistart(
    problem: Problem,
    starts: int,
    *,
    seed: int = 0,
    spread: float = 0.3,
    workers: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> list[Optimum]:
    """Distinct solutions from the problem's own guess and ``starts - 1`` sampled ones, the best first.

    Parameters
    ----------
    problem : a design, or a problem without unknowns (then its distinct gaits are found).
    seed : of the samples.
    spread : how far a sample goes: coordinates and freed numbers by this part of themselves, within their bounds.
    workers : where the starts are worked on; by default all cores.
    progress : called with the number of starts done and their total.
    """
    problems = [problem, *(_sampled(problem, spread, seed, k) for k in range(1, starts))]
    jobs = [Job(key=f"start-{k}-{p.hash8}", argument=p) for k, p in enumerate(problems)]
    numbers = {job.key: k for k, job in enumerate(jobs)}
    records: dict[int, dict[str, Any]] = {}
    for key, result in run_jobs(_attempt, jobs, workers or Workers(), should_stop=should_stop):
        if not isinstance(result, SetAside) and result is not None:
            records[numbers[key]] = result
        if progress is not None:
            progress(len(records), starts)
    return _distinct(problems, dict(sorted(records.items())))


def _sampled(problem: Problem, spread: float, seed: int, number: int) -> Problem:
    rng = np.random.default_rng([seed, number])
    names = problem.walker.section_names(slipping=problem.sequence.impact is not Mode.STICK)
    changes: dict[str, object] = {
        f"gait.guess.state.{name}": problem.guess.state[name] * (1 + spread * rng.uniform(-1, 1)) for name in names
    }
    for key, free in problem.free.items():
        size = abs(free.guess) or free.upper - free.lower
        guess = float(np.clip(free.guess + spread * size * rng.uniform(-1, 1), free.lower, free.upper))
        changes[key] = {"free": [free.lower, free.upper], "guess": guess}
    return problem.replace(changes)


def _attempt(problem: Problem, _: None = None) -> dict[str, Any] | None:
    """The record of a verified gait, None where there is none."""
    try:
        gait = solve(problem)
    except (SolveError, ProblemError):
        return None
    if gait.status is not Status.CONVERGED:
        return None
    return gait.verified(verify(gait).to_record()).to_record()


def _distinct(problems: list[Problem], records: dict[int, dict[str, Any]]) -> list[Optimum]:
    groups: list[list[int]] = []
    for k, record in records.items():
        group = next((g for g in groups if _same(records[g[0]], record)), None)
        groups.append([k]) if group is None else group.append(k)
    optima = [Optimum(record=records[g[0]], problem=problems[g[0]], starts=tuple(g)) for g in groups]
    return sorted(optima, key=lambda optimum: optimum.record["solver"].get("objective", 0.0))


def _same(first: dict[str, Any], second: dict[str, Any]) -> bool:
    if first["phases"] and [p["mode"] for p in first["phases"]] != [p["mode"] for p in second["phases"]]:
        return False
    values = [np.array([*record["state"].values(), *record["parameters"].values()]) for record in (first, second)]
    return bool(np.all(np.abs(values[0] - values[1]) <= SAME * (1 + np.abs(values[0]))))
