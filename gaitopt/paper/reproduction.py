"""The reproduction of a paper: its figures and its table, written into one folder."""

from collections.abc import Sequence
from pathlib import Path

from gaitopt.callbacks import Counted
from gaitopt.errors import UnknownNameError
from gaitopt.figures.style import save
from gaitopt.paper import table
from gaitopt.paper.archive import Archive
from gaitopt.paper.figures import FIGURES, NEEDED
from gaitopt.paper.gaits import FAMILIES, family_of, has_family
from gaitopt.store import json_file, write_whole
from gaitopt.store.files import clear_leftovers, make_folder
from gaitopt.workers.jobs import Job, Workers, key_of, run_jobs

PAPERS = ("gamus-or-2013",)
TABLE = "table"
"""The part that is not a figure."""


def parts() -> tuple[str, ...]:
    """Names of everything that is reproduced."""
    return (*FIGURES, TABLE)


def check_names(paper: str, only: Sequence[str]) -> None:
    """Refuse a paper or a part of it that is not known."""
    if paper not in PAPERS:
        raise UnknownNameError(f"no paper is called {paper!r}; choose from {', '.join(PAPERS)}")
    unknown = [name for name in only if name not in parts()]
    if unknown:
        raise UnknownNameError(f"{paper} has no {unknown[0]!r}; choose from {', '.join(parts())}")


def reproduce(
    archive: Archive,
    folder: Path,
    only: Sequence[str] = (),
    progress: Counted = None,
    workers: Workers | None = None,
) -> list[Path]:
    """Write figures and table into a folder.

    Parameters
    ----------
    archive : where gaits and families are kept, or computed.
    only : names out of ``parts()``; everything if empty.
    progress : called with the number of parts that are done, and of all.
    workers : processes that follow the families; this very one unless given.

    Returns
    -------
    paths : of the files, in the order of ``parts()``.
    """
    make_folder(folder)
    clear_leftovers(folder)
    names = [name for name in parts() if not only or name in only]
    needed = {family for name in names for family in NEEDED.get(name, ())}
    if workers is not None:
        follow_families(archive, [family for family in reversed(tuple(FAMILIES)) if family in needed], workers)
    written: list[Path] = []
    for done, name in enumerate(names, start=1):
        if name == TABLE:
            record = table.record(archive)
            written += [folder / f"{TABLE}.md", folder / f"{TABLE}.json"]
            write_whole(written[-2], table.markdown(record))
            write_whole(written[-1], json_file(record))
        else:
            written += save(FIGURES[name](archive), folder / name)
        if progress is not None:
            progress(done, len(names))
    return written


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
