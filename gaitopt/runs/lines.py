"""Work that appends its results line by line to one file of a run folder; each line is on the disk before it is used.

The first line is the request; every further line is a point or special point. The line of a point holds all bits of the
solution, the tangent, the mesh and the step length. Interrupted work resumes from its last point; special points after
that point are located again. On the same machine the file then has the same bits as without the interruption.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from gaitopt.callbacks import Stop
from gaitopt.errors import StorageError
from gaitopt.problem.problem import Problem
from gaitopt.store.files import lines_text
from gaitopt.store.formats import Table, csv_text
from gaitopt.store.run import Run

Start = TypeVar("Start", contravariant=True)
Line = TypeVar("Line", bound=Mapping[str, Any])


class Recorded(Protocol):
    """A point or special point."""

    def to_record(self) -> Mapping[str, Any]:
        """One JSON object."""


@dataclass(frozen=True, kw_only=True)
class LinesPlan(ABC, Generic[Start, Line]):
    """A curve of points that is followed, and the run folder in which it is stored.

    It is not a ``Plan`` of jobs, because the number of points is only known at the end, every point starts from the one
    before, and a walk resumes from the end of its file instead of a set of results.

    Attributes
    ----------
    problem : problem of the gait with which the curve starts.
    output : the run folder; None for the default folder of problem and request.
    """

    noun: ClassVar[str]
    file: ClassVar[str]
    table: ClassVar[str]
    effort: ClassVar[tuple[str, ...]]
    """Name of the result, its file and table, and the entries of the request that only limit the work of one call."""

    problem: Problem
    output: Path | None = None

    @property
    @abstractmethod
    def head(self) -> dict[str, Any]:
        """The first line of the file."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the default folder beside that of the problem."""

    @abstractmethod
    def read(self) -> tuple[Mapping[str, Any] | None, list[Line]]:
        """The stored request and the records after it; None and no records if there is none."""

    @abstractmethod
    def resumable(self, records: list[Line]) -> list[Line]:
        """The records from which an unfinished walk goes on."""

    @abstractmethod
    def follow(self, start: Start, done: list[Line], should_stop: Stop) -> Iterable[Recorded]:
        """The new points after those that are ``done``.

        Raises
        ------
        StorageError
            If the walk cannot be resumed from a stored point.
        """

    @abstractmethod
    def rows(self, records: list[Line]) -> tuple[list[str], list[list[Any]]]:
        """Header and rows of the table of all records."""

    @property
    def run(self) -> Run:
        """The run folder."""
        if self.output is not None:
            return Run(self.output)
        folder = Run.of(self.problem).folder
        return Run(folder.with_name(f"{folder.name}-{self.name}"))

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self.run.folder

    def stored(self) -> list[Line]:
        """All records that are on the disk, without the request; empty if there are none.

        Raises
        ------
        StorageError
            If the folder contains other results, or the records of another request.
        """
        self.run.check(self.problem)
        if not self.run.path(self.file).is_file():
            return []
        request, records = self.read()
        if request is None:
            return []
        before, now = ({k: v for k, v in head.items() if k not in self.effort} for head in (request, self.head))
        if before != now:
            stated = ", ".join(f"{key} {value}" for key, value in before.items() if value is not None)
            words = f"contains another {self.noun} ({stated}); it was not changed: delete it, or choose another"
            raise StorageError(f"{self.folder} {words}").concerning("output")
        return records

    def walk(self, start: Start, *, should_stop: Stop = None) -> tuple[list[Line], Iterator[Mapping[str, Any]]]:
        """The stored records, and an iterator over new ones, which are on the disk before they are yielded.

        The caller must hold the lock of the folder.
        """
        done = self.resumable(self.stored())
        with self.run.begun(self.problem):
            self.run.write({self.file: lines_text((self.head, *done))})
        return done, self._new(start, done, should_stop)

    def records(self, start: Start, *, should_stop: Stop = None) -> Iterator[dict[str, Any]]:
        """The request with ``folder`` and the number ``stored`` of records of earlier calls, then all records."""
        with self.run.writing(self.problem):
            stored, new = self.walk(start, should_stop=should_stop)
            yield {**self.head, "folder": str(self.folder), "stored": len(stored)}
            yield from map(dict, stored)
            yield from map(dict, new)

    def _new(self, start: Start, done: list[Line], should_stop: Stop) -> Iterator[Mapping[str, Any]]:
        try:
            points = self.follow(start, done, should_stop)
        except StorageError as error:
            words = f"{self.run.path(self.file)}: {error}; delete the folder, or name another one"
            raise StorageError(words) from error
        with self.run.appending(self.file) as lines:
            for point in points:
                record = point.to_record()
                lines.append(record)
                yield record
        if should_stop is not None and should_stop():
            raise KeyboardInterrupt
        header, rows = self.rows(self.read()[1])
        self.run.write({self.table: csv_text(Table(header=tuple(header), rows=rows))})
