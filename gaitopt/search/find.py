"""All gaits at given parameters, of any mode sequence: candidates, each solved, verified and counted once.

Nothing is claimed about gaits that no start has led to: ``searched`` says what was tried.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np

from gaitopt.callbacks import Counted, Stop, Valued
from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.gait import Gait, Status
from gaitopt.problem import Problem
from gaitopt.search.candidates import GUESSES, WALKS, Record, SearchJob, search_part
from gaitopt.search.distinct import Gaits, closed, gaits_of, is_stable
from gaitopt.search.neighbours import search_family, varied
from gaitopt.study.system import problem_dynamics
from gaitopt.workers.jobs import FailedJob, Job, Workers, key_of, run_jobs

STARTS = 1000
"""Start states of the search by simulation."""
MOST_STARTS = 1_000_000
"""Start states of one search; more would be days of walking, and millions of candidates to hold."""
GUESSED = 8
"""Guesses of the search by complementarity."""
Within = Mapping[str, tuple[float, float]]
Part = Record | FailedJob
Task = Callable[..., Record]
Run = Callable[[Task, list[Job]], list[Part]]


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchPlan:
    """What is to be searched, with the arguments of ``find``; the problem leaves its mode sequence open."""

    problem: Problem
    starts: int = STARTS
    seed: int = 0
    within: Within = field(default_factory=dict)

    @property
    def n_steps(self) -> int:
        """Length of the longest cycle of the search."""
        return getattr(self.problem.modes, "steps", 1)

    def job(self, problem: Problem, method: str, number: int, parameter: str = "") -> Job:
        """A part of the search, with a key that is the same in every run."""
        part = SearchJob(
            problem=problem,
            method=method,
            number=number,
            seed=self.seed,
            within=self.within,
            parameter=parameter,
            n_steps=self.n_steps,
        )
        identity = {entry.name: getattr(part, entry.name) for entry in fields(part)}
        return Job(key=key_of(identity | {"problem": problem.digest, "within": dict(self.within)}), argument=part)


def find_best(problem: Problem, *, progress: Valued = None, should_stop: Stop = None) -> Gait:
    """The gait that a problem with an open mode sequence asks for; see ``solve``."""
    run = in_memory(Workers(count=1), None, should_stop)
    try:
        gaits = search(SearchPlan(problem=problem, starts=STARTS), run, progress=progress, should_stop=should_stop)
    except KeyboardInterrupt:
        return _none(problem, Status.INTERRUPTED, "interrupted")
    return best_gait(gaits)


def search(plan: SearchPlan, run: Run, *, progress: Valued = None, should_stop: Stop = None) -> Gaits:
    """The gaits that two searches lead to, and those on the families of these gaits that no start has led to.

    ``run`` runs a task for all jobs and returns the results; ``progress`` is that of the solver.
    """
    parts = run(search_part, search_jobs(plan))
    gaits = gaits_of(plan.problem, parts, progress=progress, should_stop=should_stop)
    jobs = family_jobs(plan, gaits)
    if not jobs:
        return gaits
    parts += run(search_family, jobs)
    return gaits_of(plan.problem, parts, known=gaits, progress=progress, should_stop=should_stop)


def in_memory(workers: Workers, progress: Counted, should_stop: Stop) -> Run:
    """A ``run`` of ``search`` that keeps nothing."""

    def run(task: Task, jobs: list[Job]) -> list[Part]:
        parts = []
        for _, part in run_jobs(task, jobs, workers, should_stop=should_stop):
            parts.append(part)
            if progress is not None:
                progress(len(parts), len(jobs))
        if len(parts) < len(jobs):
            raise KeyboardInterrupt
        return parts

    return run


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


def search_jobs(plan: SearchPlan) -> list[Job]:
    """The parts of both searches: so many start states in walks, and the guesses of the search by complementarity."""
    if not 1 <= plan.starts <= MOST_STARTS:
        raise ProblemError(f"starts: {plan.starts:,} start states; from 1 to {MOST_STARTS:,} are possible")
    names = plan.problem.walker.section_names(slipping=True)
    unknown = [name for name in plan.within if name not in names]
    if unknown:
        raise UnknownNameError(
            f"within {', '.join(unknown)}: not a coordinate just after an impact; use {', '.join(names)}"
        )
    counts = {"complementarity": -(-GUESSED // GUESSES), "simulation": -(-plan.starts // WALKS)}
    return [plan.job(plan.problem, method, number) for method, count in counts.items() for number in range(count)]


def family_jobs(plan: SearchPlan, gaits: Gaits) -> list[Job]:
    """The families of gaits; none of designs, which are no gaits at given parameters."""
    if plan.problem.free or plan.problem.objective:
        return []
    return [
        plan.job(closed(plan.problem, gait.to_record()), "families", number, parameter)
        for number, gait in enumerate(gaits)
        for parameter in varied(plan.problem)
    ]


def _none(problem: Problem, status: Status, message: str) -> Gait:
    return Gait(problem=problem, dynamics=problem_dynamics(problem), status=status, message=message)
