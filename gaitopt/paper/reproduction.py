"""The reproduction of a paper: its figures and its table, written into one folder."""

from collections.abc import Sequence
from pathlib import Path

from gaitopt.callbacks import Counted
from gaitopt.errors import UnknownNameError
from gaitopt.paper import table
from gaitopt.paper.gaits import EVERYTHING, SHOWN, TABLE, Archive, Need, cost, needs, prepared
from gaitopt.store.files import clear_leftovers, json_file, make_folder, write_whole
from gaitopt.workers.jobs import Workers

PAPERS = ("gamus-or-2013",)


def parts() -> tuple[str, ...]:
    """Names of everything that is reproduced."""
    return (*SHOWN, TABLE)


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
    progress : called with the part of the work that is done, in percent, and 100.
    workers : processes that compute gaits and families; this very one unless given.

    Returns
    -------
    paths : of the files, in the order of ``parts()``.
    """
    make_folder(folder)
    clear_leftovers(folder)
    waiting = needs([name for name in parts() if not only or name in only])
    every, names = set().union(*waiting.values()), tuple(waiting)
    needed, met = [need for need in EVERYTHING if need in every], set[Need]()
    written: dict[str, list[Path]] = {}
    workers = workers or Workers(count=1)
    if progress is not None:
        progress(0, 100)
    for need in prepared(archive, needed, workers):
        met.add(need)
        for name in [name for name, own in waiting.items() if own <= met]:
            written[name] = _table(archive, folder) if name == TABLE else _figure(archive, folder, name)
            del waiting[name]
        if progress is not None:
            progress(_percent([need in met for need in needed], needed, workers.count, len(written), len(names)), 100)
    return [path for name in names for path in written[name]]


def _percent(met: Sequence[bool], needed: Sequence[Need], count: int, written: int, parts: int) -> int:
    """How much of the work is done; what several processes are at counts half."""
    costs = [cost(need) for need in needed]
    done = sum(own for own, is_met in zip(costs, met, strict=True) if is_met)
    going = [own for own, is_met in zip(costs, met, strict=True) if not is_met][: count if count > 1 else 0]
    return int(100 * (done + sum(going) / 2 + written) / (sum(costs) + parts))


def _figure(archive: Archive, folder: Path, name: str) -> list[Path]:
    from gaitopt.paper.figures import draw
    from gaitopt.show.style import save  # Matplotlib, which the processes that compute need not wait for

    return save(draw(archive, name), folder / name)


def _table(archive: Archive, folder: Path) -> list[Path]:
    record = table.record(archive)
    paths = [folder / f"{TABLE}.md", folder / f"{TABLE}.json"]
    write_whole(paths[0], table.markdown(record))
    write_whole(paths[1], json_file(record))
    return paths
