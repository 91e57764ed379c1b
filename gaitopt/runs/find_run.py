"""A search for gaits whose parts are kept line by line, so that the same search goes on where it was."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gaitopt.search.distinct import Gaits
from gaitopt.search.find import Part, SearchPlan, Task, search
from gaitopt.store import begin_run, growing, stored_lines, writing
from gaitopt.store.records import validated
from gaitopt.workers.jobs import FailedJob, Job, Workers, run_jobs

PARTS_FILE = "find.jsonl"


@dataclass(frozen=True, slots=True, kw_only=True)
class PartRecord:
    """What is read of a line of the file: the candidates of one part of a search, with its key."""

    part: str
    method: str
    starts: int
    candidates: list[dict[str, Any]]


def find_durably(
    plan: SearchPlan,
    folder: Path,
    workers: Workers,
    *,
    progress: Callable[[int, int], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Gaits:
    """The search of a plan, with its parts kept in a run folder of its problem.

    Raises
    ------
    StorageError
        If the disk is full, or what the folder holds is broken; finished parts are kept.
    KeyboardInterrupt
        If ``should_stop`` became true; what is finished is kept.
    """
    with writing(folder, plan.problem):
        begin_run(folder, plan.problem)
        known = _stored(folder)

        def run(task: Task, jobs: list[Job]) -> list[Part]:
            parts: dict[str, Part] = {job.key: known[job.key] for job in jobs if job.key in known}
            missing = [job for job in jobs if job.key not in parts]
            with growing(folder, PARTS_FILE) as log:
                for key, part in run_jobs(task, missing, workers, should_stop=should_stop):
                    parts[key] = part
                    if not isinstance(part, FailedJob):
                        log.append({"part": key, **part})
                    if progress is not None:
                        progress(len(parts), len(jobs))
            if len(parts) < len(jobs):
                raise KeyboardInterrupt
            return [parts[job.key] for job in jobs]

        return search(plan, run, should_stop=should_stop)


def _stored(folder: Path) -> dict[str, dict[str, Any]]:
    """The parts that a folder holds, by their keys."""
    records = {}
    for number, record in enumerate(stored_lines(folder, PARTS_FILE), start=1):
        validated(PartRecord, record, folder / PARTS_FILE, number)
        records[record["part"]] = record
    return records
