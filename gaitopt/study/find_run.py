"""A search for gaits whose parts are kept line by line, so that the same search goes on where it was."""

from collections.abc import Callable
from pathlib import Path

from gaitopt.problem import Problem
from gaitopt.store import LineWriter, read_lines
from gaitopt.store.files import make_folder
from gaitopt.store.lock import only_writer
from gaitopt.study.candidates import search_part
from gaitopt.study.find import STARTS, Gaits, Within, gaits_of, opened, search_jobs
from gaitopt.study.jobs import SetAside, Workers, run_jobs

PARTS_FILE = "find.jsonl"


def find_durably(
    problem: Problem,
    folder: Path,
    workers: Workers,
    *,
    starts: int = STARTS,
    seed: int = 0,
    within: Within | None = None,
    progress: Callable[[int, int], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Gaits | None:
    """As ``find``, with the parts of the search kept in ``folder``; None if it was stopped.

    Raises
    ------
    StorageError
        If the disk is full, or another process works in this folder; finished parts are kept.
    """
    asked = opened(problem)
    jobs = search_jobs(asked, starts=starts, seed=seed, within=within or {})
    make_folder(folder)
    path = folder / PARTS_FILE
    with only_writer(path):
        known = {record["part"]: record for record in read_lines(path)} if path.exists() else {}
        parts = {job.key: known[job.key] for job in jobs if job.key in known}
        lost: dict[str, SetAside] = {}
        missing = [job for job in jobs if job.key not in parts]
        with LineWriter(path) as log:
            for key, part in run_jobs(search_part, missing, workers, should_stop=should_stop):
                if isinstance(part, SetAside):
                    lost[key] = part
                else:
                    parts[key] = {"part": key, **part}
                    log.append(parts[key])
                if progress is not None:
                    progress(len(parts) + len(lost), len(jobs))
    if len(parts) + len(lost) < len(jobs):
        return None
    return gaits_of(asked, [parts[job.key] for job in jobs if job.key in parts], should_stop=should_stop)
