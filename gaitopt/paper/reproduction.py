"""The reproduction: compute the gaits and families of the paper on all cores, and write figures and table.

Every figure, and the table, needs some gaits and families. Missing ones are computed, the longest first. A figure is
written as soon as everything that it needs exists. Gaits and families are stored in run folders, so that a second
reproduction computes nothing.
"""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from pathlib import Path

import gaitopt as go
from gaitopt.errors import UnknownNameError
from gaitopt.paper import table
from gaitopt.paper.gaits import (
    FAMILIES,
    RESULTS,
    ROUNDED,
    SHOWN,
    SOURCES,
    Archive,
    family_of,
    gait_of,
    problem_of,
    rounded_torques,
)

PAPER = "gamus-or-2013"
TABLE = "table"
"""Name of the table, which is reproduced beside the figures."""
OVER_FRICTION = ("fig4", "fig9", "fig11", "fig12")
"""Figures that show families; the others show gaits."""


class Kind(StrEnum):
    """The kinds of results that can be computed for the short name of a gait."""

    FAMILY = "family"
    ROUNDED = "rounded torques"
    GAIT = "gait"


Need = tuple[Kind, str]
"""A result that a figure needs: its kind, and the short name of its gait."""
EVERYTHING: Sequence[Need] = (
    *((Kind.FAMILY, name) for name in reversed(tuple(FAMILIES))),
    *((Kind.ROUNDED, name) for name in ROUNDED),
    *((Kind.GAIT, name) for name in SOURCES),
)
"""All results in the order of computation: the longest first, and families before their gaits, which they contain."""
COSTS = {Kind.FAMILY: 3, Kind.ROUNDED: 1, Kind.GAIT: 1}
"""Processor time of a result relative to that of a figure; the progress depends on it."""
CLOSED_LOOP_COST = 3
"""Factor of the processor time for gaits that track a reference."""


def outputs() -> tuple[str, ...]:
    """Names of all figures, and of the table."""
    return (*SHOWN, TABLE)


def reproduce(
    paper: str = PAPER,
    only: Sequence[str] = (),
    *,
    output: str | Path | None = None,
    workers: int | None = None,
    narrate: Callable[[str], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> list[Path]:
    """Reproduce the figures of a paper, and compare its printed numbers with computed ones in a table.

    Gaits and families are read from the run folders in ``results``, or computed and stored there.

    Parameters
    ----------
    paper : ``gamus-or-2013``.
    only : names of figures such as ``fig9``, and ``table``; empty for everything.
    output : folder of figures and table, by default ``results/PAPER``.
    workers : number of processes; by default one per core.
    narrate : called with a description of the next computation.
    progress : called with the percentage done, and 100.
    should_stop : polled; True ends the call with a KeyboardInterrupt.

    Returns
    -------
    paths : paths of the files.

    Raises
    ------
    UnknownNameError
        If there is no such paper, or no such figure in it.
    SolveError
        If a gait is not found, or the forward simulation refutes it.
    StorageError
        If a run folder is damaged, or a folder cannot be written.
    """
    if paper != PAPER:
        raise UnknownNameError(f"no paper is called {paper!r}; choose from {PAPER}")
    unknown = [name for name in only if name not in outputs()]
    if unknown:
        raise UnknownNameError(f"{paper} has no {unknown[0]!r}; choose from {', '.join(outputs())}")
    archive = Archive(narrate=narrate or (lambda description: None), should_stop=should_stop or (lambda: False))
    folder = RESULTS / paper if output is None else Path(output)
    return write(archive, folder, only, progress or (lambda done, total: None), workers or os.cpu_count() or 1)


def write(
    archive: Archive,
    folder: Path,
    only: Sequence[str],
    progress: Callable[[int, int], None],
    workers: int = 1,
) -> list[Path]:
    """Write figures and table into a folder; see ``reproduce``.

    Returns
    -------
    paths : paths of the files, in the order of ``outputs()``.
    """
    waiting = needs([name for name in outputs() if not only or name in only])
    every, names = set().union(*waiting.values()), tuple(waiting)
    needed, met = [need for need in EVERYTHING if need in every], set[Need]()
    written: dict[str, list[Path]] = {}
    progress(0, 100)
    for need in prepared(archive, needed, workers):
        met.add(need)
        for name in [name for name, required in waiting.items() if required <= met]:
            written[name] = _table(archive, folder) if name == TABLE else _figure(archive, folder, name)
            del waiting[name]
        costs = {need: COSTS[need[0]] * (CLOSED_LOOP_COST if need[1].startswith("III") else 1) for need in needed}
        unmet = [cost for need, cost in costs.items() if need not in met]
        begun = sum(unmet[: workers if workers > 1 else 0]) / 2  # results that are being computed count half
        done = sum(costs.values()) - sum(unmet) + begun + len(written)
        progress(int(100 * done / (sum(costs.values()) + len(names))), 100)
    return [path for name in names for path in written[name]]


def needs(names: Sequence[str]) -> dict[str, set[Need]]:
    """The gaits and families that every output needs; of two with the same problem, the first in ``EVERYTHING``."""
    kinds = {name: Kind.FAMILY if name in OVER_FRICTION else Kind.GAIT for name in names}
    needed = {n: {*EVERYTHING} if n == TABLE else {(kinds[n], gait) for gait in SHOWN[n]} for n in names}
    every = set().union(*needed.values())

    def identity(need: Need) -> str:
        kind, name = need
        return f"{kind} {name}" if kind is Kind.ROUNDED else problem_of(name).digest

    first: dict[str, Need] = {}
    for need in EVERYTHING:
        if need in every:
            first.setdefault(identity(need), need)
    return {name: {first[identity(need)] for need in required} for name, required in needed.items()}


def prepared(archive: Archive, needed: Sequence[Need], workers: int) -> Iterator[Need]:
    """Compute the missing results, and yield every result once it is stored.

    A result that fails in another process is yielded too; the error appears when it is used.
    """
    missing = [need for need in needed if not _is_stored(archive, need)]
    yield from (need for need in needed if need not in missing)
    count, results = min(workers, len(missing)), str(archive.results.resolve())
    if count < 2:
        for need in missing:
            _compute(archive, need)
            yield need
        return
    archive.narrate(f"computing {len(missing)} gaits and families in {count} processes")
    arguments = [(*need, results) for need in missing]
    stop = archive.should_stop
    for number, _ in go.run_parallel(_compute_in_process, arguments, workers=count, should_stop=stop):
        yield missing[number]
    if stop():
        raise KeyboardInterrupt


def _is_stored(archive: Archive, need: Need) -> bool:
    kind, name = need
    if kind is Kind.FAMILY:
        return archive.has_family(problem_of(name), FAMILIES[name])
    return kind is Kind.GAIT and archive.has_gait(problem_of(name))


def _compute(archive: Archive, need: Need) -> None:
    """Compute and store a result unless it is stored already."""
    kind, name = need
    compute = {Kind.FAMILY: family_of, Kind.ROUNDED: rounded_torques, Kind.GAIT: gait_of}[kind]
    compute(archive, name)


def _compute_in_process(argument: tuple[str, str, str]) -> None:
    kind, name, results = argument
    _compute(Archive(Path(results)), (Kind(kind), name))


def _figure(archive: Archive, folder: Path, name: str) -> list[Path]:
    from gaitopt.paper.figures import draw  # imports Matplotlib, which the computing processes do not need

    return go.save_figures(draw(archive, name).figure, folder, [name])


def _table(archive: Archive, folder: Path) -> list[Path]:
    record = table.record(archive)
    texts = {f"{TABLE}.md": table.markdown(record), f"{TABLE}.json": json.dumps(record, indent=2) + "\n"}
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (partial := folder / f"{name}.part").write_text(text, encoding="utf-8")
        partial.replace(folder / name)  # which appears whole or not at all
    return [folder / name for name in texts]
