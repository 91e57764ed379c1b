"""Jobs whose results are kept in a file of a run folder, one line each, so that no job is ever done twice.

A result is on the disk before the next one is taken in.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gaitopt.callbacks import Counted, Stop
from gaitopt.store import growing, stored_lines
from gaitopt.store.records import validated
from gaitopt.workers.jobs import FailedJob, Job, Workers, run_jobs


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultFile:
    """A file of results: its name, the entry of a line that holds the key of its job, and what a line must have."""

    name: str
    key: str
    model: Any


def kept_results(
    task: Callable[..., Any],
    jobs: list[Job],
    workers: Workers,
    folder: Path,
    file: ResultFile,
    *,
    known: Mapping[str, Any] | None = None,
    progress: Counted = None,
    should_stop: Stop = None,
    states: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Results of all jobs by their keys, those that the folder holds included; a ``FailedJob`` is not kept.

    Parameters
    ----------
    folder : of the run, held for writing by the caller.
    known : results of parents that are not among the jobs.
    states : names that every state of a result must have.
    progress : called with the number of jobs done and their total.
    """
    by_key, results = {job.key: job for job in jobs}, dict[str, Any]()
    for number, record in enumerate(stored_lines(folder, file.name), start=1):
        validated(file.model, record, folder / file.name, number, states=states)
        if record[file.key] in by_key:
            results[record[file.key]] = record
    missing = [job for key, job in by_key.items() if key not in results]
    with growing(folder, file.name) as log:
        done = {**(known or {}), **results}
        for key, result in run_jobs(task, missing, workers, done=done, should_stop=should_stop):
            results[key] = result if isinstance(result, FailedJob) else {file.key: key, **result}
            if not isinstance(result, FailedJob):
                log.append(results[key])
            if progress is not None:
                progress(len(results), len(by_key))
    if len(results) < len(by_key):
        raise KeyboardInterrupt
    return results
