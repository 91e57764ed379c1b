"""A branch in its run folder: every record is on the disk before it is used, and an interrupted walk resumes."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from gaitopt.callbacks import Stop
from gaitopt.errors import StorageError
from gaitopt.families import Request, follow_family, resumable
from gaitopt.gait import BranchPoint, Gait, SpecialPoint
from gaitopt.gait.branch import branch_header, branch_rows
from gaitopt.problem import Problem
from gaitopt.store import BRANCH_FILE, Table, growing, write_files
from gaitopt.store.branch import BRANCH_TABLE, begin_branch, branch_folder, read_branch, stored_records
from gaitopt.store.text import csv_text

Record = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class BranchRun:
    """A family that is kept in a folder.

    Attributes
    ----------
    problem : of the gait from which it starts.
    request : what is continued.
    start_type : type of the special point from which it starts; empty for a gait.
    output : the folder; by default that of problem and request.
    """

    problem: Problem
    request: Request
    start_type: str = ""
    output: Path | None = None

    @property
    def head(self) -> dict[str, Any]:
        """The first line of the file: the request, and the kind of special point from which it starts."""
        return self.request.to_record() | ({"start": self.start_type} if self.start_type else {})

    @cached_property
    def folder(self) -> Path:
        """The run folder."""
        return self.output or branch_folder(self.problem, self.head)

    def stored(self) -> list[dict[str, Any]]:
        """All records that are on the disk, without the request."""
        return stored_records(self.folder, self.problem, self.head)

    def walk(self, start: Gait | SpecialPoint, *, should_stop: Stop = None) -> tuple[list[Record], Iterator[Record]]:
        """The records that are there, and those to come, each on the disk when it is yielded.

        The folder is held for writing by the caller.
        """
        done = resumable(self.stored(), self.request)
        begin_branch(self.folder, self.problem, self.head, done)
        return done, self._new(start, done, should_stop)

    def _new(self, start: Gait | SpecialPoint, done: list[Record], should_stop: Stop) -> Iterator[Record]:
        with growing(self.folder, BRANCH_FILE) as lines:
            for point in self._found(follow_family(start, self.request, done=done, should_stop=should_stop)):
                record = point.to_record()
                lines.append(record)
                yield record
        if should_stop is not None and should_stop():
            raise KeyboardInterrupt
        _, records = read_branch(self.folder, self.problem)
        header = branch_header(records)
        table = Table(header=tuple(header), rows=branch_rows(records, header))
        write_files(self.folder, {BRANCH_TABLE: csv_text(table)})

    def _found(self, records: Iterator[BranchPoint | SpecialPoint]) -> Iterator[BranchPoint | SpecialPoint]:
        """The records of a walk; stored ones from which it cannot go on are an error that names their file."""
        try:
            yield from records
        except StorageError as error:
            raise StorageError(
                f"{self.folder / BRANCH_FILE}: {error}; delete the folder, or name another one"
            ) from error
