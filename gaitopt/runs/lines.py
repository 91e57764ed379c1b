"""Curves whose points are appended line by line to a file of a run folder; each line is on the disk before it is used.

The first line is the request; every further line is a point or special point. The line of a point holds all bits of the
solution, the tangent, the mesh and the step length. Interrupted work resumes from its last point; special points after
that point are located again. On the same machine the file then has the same bits as without the interruption.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from gaitopt.callbacks import Stop, raise_if_stopped
from gaitopt.errors import StorageError
from gaitopt.problem.problem import Problem
from gaitopt.requests import Request, entries
from gaitopt.store.files import lines_text
from gaitopt.store.formats import Table, csv_text, damaged, validated
from gaitopt.store.gaits import closing_error, problem_of_record
from gaitopt.store.run import Run

Start = TypeVar("Start", contravariant=True)
Line = TypeVar("Line", bound=Mapping[str, Any])

LARGEST_CLOSING_ERROR = 1e-6
"""Largest difference between the states at the start and the end of a stored cycle, in natural units."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveFile:
    """The file of a kind of curve, and the types of its lines.

    Attributes
    ----------
    noun, command : name of a curve, and of the command that computes it.
    name, table : names of the file and of its table.
    number : entry of a record with the number of its branch or curve.
    request, point, special : types of the first line, of points, and of special points.
    fault : function of problem, request and a record that returns the fault of the record; empty if it has none.
    rows : header and rows of the table of all records.
    completed : function of request and records that adds the entries that earlier versions did not write.
    """

    noun: str
    command: str
    name: str
    table: str
    number: str
    request: Any
    point: Any
    special: Any
    fault: Callable[[Problem, Any, Any], str]
    rows: Callable[[Sequence[Any]], tuple[list[str], list[list[Any]]]]
    completed: Callable[[Any, Sequence[Any]], None] = lambda request, records: None

    def read(self, run: Run, problem: Problem) -> tuple[Any, list[Any]]:
        """The request of the curve in a run of a problem, and its records; None and no records if there is no curve."""
        path, lines, records = run.path(self.name), run.lines(self.name), list[Any]()
        if not lines:
            return None, records
        request = validated(self.request, lines[0], path, 1)
        for number, line in enumerate(lines[1:], start=2):
            model = self.special if line.get("record") == "special" else self.point
            record = validated(model, line, path, number, states=problem.walker.state_names())
            if fault := self.fault(problem, request, record):
                raise damaged(path, fault, number)
            records.append(record)
        self.completed(request, records)
        return request, records

    def stored(self, folder: Path) -> tuple[Problem, Any, list[Any]]:
        """Problem, request and records of the curve in a run folder.

        If the curve starts from an optimum over open-loop torques, the problem contains these torques.

        Raises
        ------
        StorageError
            If the folder is not a run, is damaged or newer, or if its curve has no point.
        """
        run = Run(folder)
        problem = run.problem()
        request, records = self.read(run, problem)
        first = next((record for record in records if record["record"] == "point"), None)
        if first is None:
            raise StorageError(f"{folder / self.name} contains no {self.noun} yet; `gaitopt {self.command}` writes one")
        return problem_of_record(problem, first), request, records

    def restored(
        self, folder: Path, records: Sequence[Any], point: Callable[[Any], Any], special: Callable[[Any], Any]
    ) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """The points and the special points of the records in a folder.

        Parameters
        ----------
        point, special : functions that make a point or a special point of its record.

        Raises
        ------
        StorageError
            If a record does not fit its problem, or the motion of a point is not periodic.
        """
        path, points, specials = folder / self.name, list[Any](), list[Any]()
        try:
            for record in records:
                if record["record"] == "special":
                    specials.append(special(record))
                    continue
                points.append(point(record))
                gait = points[-1].gait
                if not closing_error(gait.steps) < LARGEST_CLOSING_ERROR * max(1.0, gait.spectral_radius or 0.0):
                    point_name = f"point {record[self.number]}.{record['index']}"
                    raise damaged(path, f"{point_name}: its motion is not periodic")
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise StorageError(f"{path} does not contain a {self.noun} ({error!r})") from error
        return tuple(points), tuple(specials)


class Recorded(Protocol):
    """A point or special point."""

    def to_record(self) -> Mapping[str, Any]:
        """The point as one JSON object."""


@dataclass(frozen=True, kw_only=True)
class LinesPlan(ABC, Generic[Start, Line]):
    """A curve of points that is followed, and the run folder in which it is stored.

    It is not a ``Plan`` of jobs, because the number of points is only known at the end, every point starts from the one
    before, and a walk resumes from the end of its file instead of a set of results.

    Attributes
    ----------
    problem : problem of the gait with which the curve starts.
    request : the request of the curve.
    output : the run folder; None for the default folder of problem and request.
    """

    file: ClassVar[CurveFile]

    problem: Problem
    request: Request
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
    def resumable(self, records: list[Line]) -> list[Line]:
        """The records from which an unfinished curve is resumed."""

    @abstractmethod
    def follow(self, start: Start, done: list[Line], should_stop: Stop) -> Iterable[Recorded]:
        """The new points and special points after the stored records ``done``.

        Raises
        ------
        StorageError
            If the walk cannot be resumed from a stored point.
        """

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
        if not self.run.path(self.file.name).is_file():
            return []
        request, records = self.file.read(self.run, self.problem)
        if request is None:
            return []
        efforts = [name for name, entry in entries(type(self.request)).items() if entry.about.effort]
        before, now = ({k: v for k, v in head.items() if k not in efforts} for head in (request, self.head))
        if before != now:
            stated = ", ".join(f"{key} {value}" for key, value in before.items() if value is not None)
            raise StorageError(
                f"{self.folder} contains another {self.file.noun} ({stated}); it was not changed: delete it, or choose "
                "another"
            ).concerning("output")
        return records

    def records(self, start: Start, *, should_stop: Stop = None) -> Iterator[dict[str, Any]]:
        """The request with ``folder`` and the number ``stored`` of records of earlier calls, then all records.

        A new record is on the disk before it is yielded.
        """
        with self.run.writing(self.problem):
            stored = self.resumable(self.stored())
            with self.run.begun(self.problem):
                self.run.write({self.file.name: lines_text((self.head, *stored))})
            yield {**self.head, "folder": str(self.folder), "stored": len(stored)}
            yield from map(dict, stored)
            yield from map(dict, self._new(start, stored, should_stop))

    def _new(self, start: Start, done: list[Line], should_stop: Stop) -> Iterator[Mapping[str, Any]]:
        try:
            points = self.follow(start, done, should_stop)
        except StorageError as error:
            raise StorageError(
                f"{self.run.path(self.file.name)}: {error}; delete the folder, or name another one"
            ) from error
        with self.run.appending(self.file.name) as lines:
            for point in points:
                record = point.to_record()
                lines.append(record)
                yield record
        raise_if_stopped(should_stop)
        header, rows = self.file.rows(self.file.read(self.run, self.problem)[1])
        self.run.write({self.file.table: csv_text(Table(header=tuple(header), rows=rows))})
