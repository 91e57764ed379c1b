"""All gaits at given parameters, whatever their mode sequence: candidates, each solved, verified and counted once.

Nothing is claimed about gaits that no start has led to: ``searched`` says what was tried.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from gaitopt.errors import UnknownNameError
from gaitopt.gait import Gait, Status
from gaitopt.nlp.ipopt import Progress
from gaitopt.problem import Problem
from gaitopt.search.candidates import GUESSES, WALKS, SearchJob, search_part
from gaitopt.search.distinct import Gaits, gaits_of, is_stable
from gaitopt.study.system import build_system
from gaitopt.workers.jobs import Job, Workers, run_jobs

STARTS = 1000
"""Start states of the search by simulation."""
GUESSED = 8
"""Guesses of the search by complementarity."""
Within = Mapping[str, tuple[float, float]]


def find(
    problem: Problem,
    *,
    starts: int = STARTS,
    seed: int = 0,
    within: Within | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Gaits:
    """All gaits at a problem's parameters that two searches lead to, whatever their mode sequence.

    Parameters
    ----------
    problem : its phases are ignored if it has some; a guess is one of the starts. Where parameters are free, the best
        gait of every mode sequence is listed.
    starts : start states of the search by simulation.
    seed : of the samples.
    within : range of the start states by name of a section coordinate, where it is not to be the walker's default.
    workers : processes.
    progress : called with the number of finished parts of the search and their total.
    should_stop : polled; True ends the search with a KeyboardInterrupt.

    Returns
    -------
    gaits : each solved to 1e-10 and verified; stable ones first, then by spectral radius.

    Raises
    ------
    UnknownNameError
        If ``within`` names something that is no section coordinate.
    """
    asked = opened(problem)
    jobs = search_jobs(asked, starts=starts, seed=seed, within=within or {})
    parts = []
    for _, part in run_jobs(search_part, jobs, Workers(count=workers), should_stop=should_stop):
        parts.append(part)
        if progress is not None:
            progress(len(parts), len(jobs))
    if len(parts) < len(jobs):
        raise KeyboardInterrupt
    return gaits_of(asked, parts, should_stop=should_stop)


def find_best(
    problem: Problem, *, progress: Progress | None = None, should_stop: Callable[[], bool] | None = None
) -> Gait:
    """The gait that a problem with an open mode sequence asks for; see ``solve``."""
    jobs = search_jobs(problem, starts=STARTS, seed=0, within={})
    parts = [part for _, part in run_jobs(search_part, jobs, Workers(count=1), should_stop=should_stop)]
    if len(parts) < len(jobs):
        return _none(problem, Status.INTERRUPTED, "interrupted")
    return best_gait(gaits_of(problem, parts, progress=progress, should_stop=should_stop))


def best_gait(gaits: Gaits) -> Gait:
    """Of a design the gait with the best objective; otherwise a stable one, nearest to the guess if there is one."""
    problem = gaits.problem
    if not gaits:
        return _none(problem, Status.NOT_CONVERGED, f"no gait was found from {gaits.searched['starts']} starts")
    best = gaits[0]
    stable = [gait for gait in gaits if is_stable(gait)]
    if problem.objective:
        best = min(gaits, key=lambda gait: gait.solver["objective"])
    elif problem.start is not None and stable:
        guess = np.array([problem.start.state[name] for name in best.system.state_names])
        best = min(stable, key=lambda gait: float(np.abs(gait.state - guess).max()))
    return replace(best, problem=replace(best.problem, origin=problem))


def opened(problem: Problem) -> Problem:
    """The problem with its mode sequence left open."""
    return problem if problem.is_open else problem.replace({"gait.phases": "auto"})


def search_jobs(problem: Problem, *, starts: int, seed: int, within: Within) -> list[Job]:
    """The parts of a search: so many start states in walks, and the guesses of the search by complementarity.

    Raises
    ------
    UnknownNameError
        If ``within`` names something that is no section coordinate.
    """
    names = problem.walker.section_names(slipping=True)
    unknown = [name for name in within if name not in names]
    if unknown:
        raise UnknownNameError(
            f"within {', '.join(unknown)}: not a coordinate just after an impact; use {', '.join(names)}"
        )
    counts = {"complementarity": -(-GUESSED // GUESSES), "simulation": -(-starts // WALKS)}
    parts = [
        SearchJob(problem=problem, method=method, number=number, seed=seed, within=within)
        for method, count in counts.items()
        for number in range(count)
    ]
    return [Job(key=_key(part), argument=part) for part in parts]


def _none(problem: Problem, status: Status, message: str) -> Gait:
    system = build_system(problem)
    return Gait(problem=problem, system=system, p=system.values(problem.parameters), status=status, message=message)


def _key(part: SearchJob) -> str:
    fields = {
        "problem": part.problem.digest,
        "method": part.method,
        "number": part.number,
        "seed": part.seed,
        "within": {name: list(span) for name, span in part.within.items()},
    }
    return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()
