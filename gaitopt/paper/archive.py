"""Gaits and families of gaits: taken from their run folders, or computed, verified and stored there."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gaitopt.errors import SolveError
from gaitopt.families import Request
from gaitopt.gait import TERMINAL, Gait
from gaitopt.library.stored import save
from gaitopt.problem import Problem
from gaitopt.runs.branch_run import BranchRun
from gaitopt.runs.restore import restore_gait
from gaitopt.search.solve import solve
from gaitopt.store import find_run, run_folder, writing
from gaitopt.store.run import RESULTS
from gaitopt.study.verify import verify

Records = list[dict[str, Any]]


class Archive:
    """What has been computed, by problem; nothing is computed twice.

    Parameters
    ----------
    results : folder of the run folders.
    narrate : called with a description of what is computed next.
    should_stop : polled while computing.
    """

    def __init__(
        self,
        results: Path = RESULTS,
        *,
        narrate: Callable[[str], None] = lambda words: None,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self.results, self.narrate, self.should_stop = results, narrate, should_stop
        self._gaits: dict[str, Gait] = {}
        self._families: dict[Path, Records] = {}

    def gait(self, problem: Problem) -> Gait:
        """The verified gait of a problem.

        Raises
        ------
        SolveError
            If there is none, or the forward simulation refutes it.
        StorageError
            If its run folder is broken or taken, or cannot be written.
        """
        if problem.digest not in self._gaits:
            folder = find_run(problem, self.results)
            self._gaits[problem.digest] = self._solved(problem) if folder is None else restore_gait(folder)
        return self._gaits[problem.digest]

    def has_gait(self, problem: Problem) -> bool:
        """Whether that gait is kept."""
        return problem.digest in self._gaits or find_run(problem, self.results) is not None

    def family(self, problem: Problem, parameter: str, to: Sequence[float]) -> Records:
        """Records of the family of a problem's gait, continued in a parameter towards each value of ``to``."""
        run = self._run(problem, parameter, to)
        if run.folder not in self._families:
            if not _is_complete(run):
                self._continue(run)
            self._families[run.folder] = run.stored()
        return self._families[run.folder]

    def has_family(self, problem: Problem, parameter: str, to: Sequence[float]) -> bool:
        """Whether that family is kept as a whole."""
        return _is_complete(self._run(problem, parameter, to))

    def _run(self, problem: Problem, parameter: str, to: Sequence[float]) -> BranchRun:
        run = BranchRun(problem=problem, request=Request(parameter=parameter, to=tuple(to)))
        return replace(run, output=self.results / run.folder.name)

    def _solved(self, problem: Problem) -> Gait:
        self.narrate(f"solving {problem.name}{_changes(problem)}")
        gait = solve(problem, should_stop=self.should_stop)
        if self.should_stop():
            raise KeyboardInterrupt
        if not gait.steps:
            raise SolveError(f"{problem.name} is {gait.status}: {gait.message}")
        verification = verify(gait)
        if not verification.passed:
            raise SolveError(f"{problem.name}: the forward simulation refutes the gait; see gaitopt verify")
        gait = gait.verified(verification.to_record())
        save(gait, run_folder(problem, self.results))
        return gait

    def _continue(self, run: BranchRun) -> None:
        """Walk along a family, from where an earlier walk was stopped."""
        gait = self.gait(run.problem)
        targets = " and ".join(f"{value:g}" for value in run.request.to)
        self.narrate(f"continuing {run.problem.name}{_changes(run.problem)} in {run.request.parameter} to {targets}")
        with writing(run.folder, run.problem):
            _, to_come = run.walk(gait, should_stop=self.should_stop)
            deque(to_come, maxlen=0)


def _is_complete(run: BranchRun) -> bool:
    """Whether the walks towards all targets have come to an end."""
    return sum(record.get("type") in TERMINAL for record in run.stored()) >= len(run.request.to)


def _changes(problem: Problem) -> str:
    """What distinguishes problems of one name in the narration."""
    return f" (friction {problem.friction_data}, {problem.impact_law} impact)"
