"""Gaits and families of gaits: taken from their run folders, or computed, verified and stored there."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gaitopt.errors import SolveError
from gaitopt.families import Request, follow_family, resumable
from gaitopt.gait import TERMINAL, Gait
from gaitopt.gait.table import trajectory_header, trajectory_rows
from gaitopt.problem import Problem
from gaitopt.runs.restore import restore_gait
from gaitopt.search.solve import solve
from gaitopt.store import (
    BRANCH_FILE,
    Table,
    begin_branch,
    branch_folder,
    find_run,
    growing,
    read_run,
    run_folder,
    stored_records,
    write_run,
    writing,
)
from gaitopt.store.run import RESULTS
from gaitopt.study.verify import verify

Records = list[dict[str, Any]]


class Archive:
    """What has been computed, by problem; nothing is computed twice.

    Parameters
    ----------
    results : folder of the run folders.
    narrate : told in words what is being computed, which takes its time.
    should_stop : polled while computing.
    """

    def __init__(
        self,
        results: Path = RESULTS,
        *,
        narrate: Callable[[str], None] = lambda words: None,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self._results, self._narrate, self._should_stop = results, narrate, should_stop
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
            folder = find_run(problem, self._results)
            self._gaits[problem.digest] = self._solved(problem) if folder is None else restore_gait(read_run(folder))
        return self._gaits[problem.digest]

    def family(self, problem: Problem, parameter: str, to: Sequence[float]) -> Records:
        """Records of the family of a problem's gait, continued in a parameter towards each value of ``to``.

        Raises
        ------
        SolveError, StorageError
            As ``gait``.
        """
        request = Request(parameter=parameter, to=tuple(to))
        folder = self._results / branch_folder(problem, request.to_record()).name
        if folder not in self._families:
            done = stored_records(folder, problem, request.to_record())
            if sum(record.get("type") in TERMINAL for record in done) < len(to):
                self._continue(problem, request, folder, done)
            self._families[folder] = stored_records(folder, problem, request.to_record())
        return self._families[folder]

    def _solved(self, problem: Problem) -> Gait:
        self._narrate(f"solving {problem.name}{_changes(problem)}")
        gait = solve(problem, should_stop=self._should_stop)
        self._check_interrupt()
        if not gait.steps:
            raise SolveError(f"{problem.name} is {gait.status}: {gait.message}")
        verification = verify(gait)
        if not verification.passed:
            raise SolveError(f"{problem.name}: the forward simulation refutes the gait; see gaitopt verify")
        table = Table(header=trajectory_header(gait.system), rows=trajectory_rows(gait.system, gait.p, gait.steps))
        gait = gait.verified(verification.to_record())
        write_run(run_folder(problem, self._results), problem=problem, gait=gait.to_record(), trajectory=table)
        return gait

    def _continue(self, problem: Problem, request: Request, folder: Path, stored: Records) -> None:
        """Walk along a family, from where an earlier walk was stopped; every record is on the disk at once."""
        gait, done = self.gait(problem), resumable(stored)
        targets = " and ".join(f"{value:g}" for value in request.to)
        self._narrate(f"continuing {problem.name}{_changes(problem)} in {request.parameter} to {targets}")
        with writing(folder, problem):
            begin_branch(folder, problem, request.to_record(), done)
            with growing(folder, BRANCH_FILE) as lines:
                for record in follow_family(gait, request, done=done, should_stop=self._should_stop):
                    lines.append(record.to_record())
        self._check_interrupt()

    def _check_interrupt(self) -> None:
        if self._should_stop():
            raise KeyboardInterrupt


def _changes(problem: Problem) -> str:
    """What tells problems of one name apart in the narration."""
    return f" (friction {problem.friction_data}, {problem.impact_law} impact)"
