"""What figures and table need, computed by all cores while finished figures are drawn; it is kept in run folders."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from gaitopt.paper.archive import Archive
from gaitopt.paper.needs import Kind, Need, compute, is_kept
from gaitopt.workers.jobs import Job, Workers, key_of, run_jobs


def prepared(archive: Archive, needed: Sequence[Need], workers: Workers) -> Iterator[Need]:
    """Compute what is not kept yet, and hand over each need when it is met.

    One that fails in another process is left to whoever needs it.
    """
    missing = [need for need in needed if not is_kept(archive, need)]
    yield from (need for need in needed if need not in missing)
    count, results = min(workers.count, len(missing)), str(archive.results.resolve())
    if count < 2:
        for need in missing:
            compute(archive, need)
            yield need
        return
    archive.narrate(f"computing {len(missing)} gaits and families in {count} processes")
    jobs = {key_of([*need, results]): need for need in missing}
    every = [Job(key=key, argument=(*need, results)) for key, need in jobs.items()]
    for key, _ in run_jobs(_compute, every, Workers(count=count), should_stop=archive.should_stop):
        yield jobs[key]
    if archive.should_stop():
        raise KeyboardInterrupt


def _compute(argument: tuple[str, str, str], parent: object) -> None:
    kind, name, results = argument
    compute(Archive(Path(results)), (Kind(kind), name))
