"""The families that figures need, followed by all cores before anything is drawn; each is kept in its run folder."""

from collections.abc import Sequence
from pathlib import Path

from gaitopt.paper.archive import Archive
from gaitopt.paper.gaits import family_of, has_family
from gaitopt.workers.jobs import Job, Workers, key_of, run_jobs


def follow_families(archive: Archive, names: Sequence[str], workers: Workers) -> None:
    """Follow those of the families that are not kept yet; one that fails is left to whoever needs it."""
    missing = [name for name in names if not has_family(archive, name)]
    if len(missing) < 2 or workers.count < 2:
        return
    count, results = min(workers.count, len(missing)), str(archive.results.resolve())
    archive.narrate(f"continuing {len(missing)} families in {count} processes")
    jobs = [Job(key=key_of([name, results]), argument=(name, results)) for name in missing]
    for _ in run_jobs(_follow, jobs, Workers(count=count), should_stop=archive.should_stop):
        pass


def _follow(argument: tuple[str, str], parent: object) -> None:
    name, results = argument
    family_of(Archive(Path(results)), name)
