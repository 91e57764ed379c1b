"""A sweep: a problem solved and verified at every point of a grid of its parameters, and the table of the results.

The gaits are in the file of solved problems of the run. Table and figures are in a subfolder whose name depends on the
grid.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gaitopt.display import Plotted, counted
from gaitopt.errors import StorageError
from gaitopt.gait.frames import columns_of, data_frame, data_set
from gaitopt.gait.gait import Status
from gaitopt.gait.records import OutcomeRecord, SweepRecord, is_gait
from gaitopt.model.modes import Mode
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import SCALARS, unit_of
from gaitopt.requests import SweepRequest
from gaitopt.runs.grid import Grid, at_point, check_jobs_fit, check_parameters
from gaitopt.runs.jobs import SET_ASIDE, SOLVED, Plan, neighbour_job, problem_job, solve_all, solve_job, sweep_job
from gaitopt.store.formats import (
    Table,
    cell_rows,
    check_agrees,
    csv_text,
    json_file,
    parse_cell,
    parsed,
    validated,
)
from gaitopt.store.run import Run
from gaitopt.threads import cached_property
from gaitopt.workers.jobs import Job, ResumableJobs, key_of

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


TABLE_FILE, SWEEP_FILE = "table.csv", "sweep.json"
TEXT_COLUMNS = ("status", "verified", "start", "modes", "gaits")
"""The columns of text, between the parameters and the scalars."""
STOPS_SEPARATOR = "; "
"""The text between two modes if modes state their stops, which contain commas; other modes have a space between."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep(Plotted):
    """The gaits of a problem over a grid of its parameters.

    Attributes
    ----------
    problem, grid : the problem, and the grid of its parameters.
    records : one record per point in the order of the grid: ``at`` (values by dotted key), ``status``, and the scalars
        of the gait if there is one. A sweep that was just computed has all keys of the gaits.
    folder : folder of its table.
    """

    problem: Problem
    grid: Grid
    records: Sequence[Mapping[str, Any]]
    folder: Path | None = None

    def __repr__(self) -> str:
        axes = ", ".join(f"{axis.key} {axis.lower:g} to {axis.upper:g} ({axis.count})" for axis in self.grid.axes)
        solved = sum(record["status"] == Status.CONVERGED for record in self.records)
        return f"<Sweep {self.problem.name} over {axes}: {solved} of {len(self)} points have a gait>"

    def __len__(self) -> int:
        return len(self.records)

    def column(self, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
        """A scalar at every point, NaN where there is no gait; shape of the grid."""
        values = [record.get(name) if record["status"] == Status.CONVERGED else None for record in self.records]
        return np.array([np.nan if value is None else value for value in values], dtype=float).reshape(self.grid.shape)

    def to_record(self) -> dict[str, Any]:
        """The summary as one JSON object with the keys of the command line."""
        statuses = [record["status"] for record in self.records]
        verified = [(record.get("verification") or {}).get("passed") for record in self.records]
        return {
            "problem": self.problem.name,
            "over": [asdict(axis) for axis in self.grid.axes],
            "jobs": len(self.records),
            "statuses": {status: statuses.count(status) for status in sorted(set(statuses))},
            "verified": verified.count(True),
            "refuted": verified.count(False),
            **({"several": ambiguous} if (ambiguous := sum("gaits" in record for record in self.records)) else {}),
            "set_aside": [
                {"at": record["at"], "reason": record.get("message", "")}
                for record in self.records
                if record["status"] == SET_ASIDE
            ],
        }

    def to_frame(self) -> "DataFrame":
        """One row per point: the columns of ``table.csv``, units in ``attrs["units"]``."""
        table = sweep_table(self)
        units = {name: unit_of(name, self.problem) for name in table.header}
        return data_frame(table.header, table.rows, units, problem=self.problem.name)

    def to_xarray(self) -> "Dataset":
        """The points as an xarray dataset over the parameters, with units as attributes."""
        table = sweep_table(self)
        keys = tuple(axis.key for axis in self.grid.axes)
        columns = columns_of(table.header, table.rows)
        variables = {n: (keys, v.reshape(self.grid.shape)) for n, v in columns.items() if n not in keys}
        coordinates = {axis.key: ((axis.key,), axis.values) for axis in self.grid.axes}
        units = {name: unit_of(name, self.problem) for name in table.header}
        return data_set(variables, coordinates, units, problem=self.problem.name)


def sweep_table(sweep: Sweep) -> Table:
    """One row per point: the grid's values, status, whether it was verified, start, modes and the scalars."""
    keys = [axis.key for axis in sweep.grid.axes]
    scalars = [name for name in SCALARS if name not in keys]
    rows = list[list[Any]]()
    for record in sweep.records:
        verification, phases = record.get("verification"), record.get("phases") or ()
        passed = "" if verification is None else str(verification["passed"]).lower()
        names = [Mode.from_record(phase) for phase in phases]
        modes = (STOPS_SEPARATOR if any(mode.stops for mode in names) else " ").join(names)
        sequence = f"{modes} / {record['impact']}" if names else ""
        values = [float("nan") if record.get(name) is None else record[name] for name in scalars]
        gait_count = str(record.get("gaits", 1)) if names and record["status"] == Status.CONVERGED else ""
        texts = (record["status"], passed, record.get("start", ""), sequence, gait_count)
        rows.append([*record["at"].values(), *texts, *values])
    return Table(header=(*keys, *TEXT_COLUMNS, *scalars), rows=rows)


def read_sweep(folder: Path) -> Sweep:
    """The sweep in a subfolder of the run of its problem: status and scalars of every point."""
    run, path = Run.at(folder), folder / TABLE_FILE
    record = run.read_record(SWEEP_FILE, SweepRecord)
    grid = validated(Grid, {"axes": record["over"]}, folder / SWEEP_FILE)
    rows = parsed(_parse_rows, run.read(TABLE_FILE)[0], path)
    if len(rows) != grid.size:
        raise StorageError(
            f"{path} has {counted(len(rows), 'row')} for {counted(grid.size, 'point')}; it was not changed"
        )
    points = grid.points(np.arange(grid.size)).tolist()
    keys = [axis.key for axis in grid.axes]
    records = [{**row, "at": dict(zip(keys, point, strict=True))} for row, point in zip(rows, points, strict=True)]
    swept = Sweep(problem=run.problem(), grid=grid, records=records, folder=folder)
    expected = {key: value for key, value in swept.to_record().items() if key != "set_aside"}  # not in the table
    check_agrees(folder / SWEEP_FILE, record, expected, TABLE_FILE)
    return swept


def _parse_rows(text: str) -> list[dict[str, Any]]:
    """Text and scalars of every row of the table.

    Raises
    ------
    ValueError
        If a column is missing or a cell is not a number; the message names the line.
    """
    reader, rows = csv.DictReader(text.splitlines()), list[dict[str, Any]]()
    known = [name for name in SCALARS if name in (next(cell_rows(csv.reader(text.splitlines())), ()))]
    for row in cell_rows(reader):
        try:
            passed = {"true": {"passed": True}, "false": {"passed": False}}.get(row["verified"])
            phases, _, impact = row["modes"].partition(" / ")
            texts = {"status": row["status"], "start": row["start"], "verification": passed, "impact": impact}
            if row.get("gaits") not in (None, "", "1"):  # version 0.1 had no such column
                texts["gaits"] = int(row["gaits"])
            modes = {"phases": [Mode(mode).record for mode in phases.split(STOPS_SEPARATOR if "," in phases else None)]}
            rows.append(texts | modes | {name: parse_cell(row[name]) for name in known})
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"line {reader.line_num}: {error!r}") from error
    return rows


@dataclass(frozen=True, kw_only=True)
class SweepPlan(Plan[Sweep], SweepRequest):
    """A sweep to be computed.

    Attributes
    ----------
    problem : the problem, some of whose parameters the grid changes.
    grid : the grid over dotted keys of parameters.
    """

    results = SOLVED
    grid: Grid

    @cached_property
    def run(self) -> Run:
        """The run, with the subfolder of the sweep's table and figures."""
        return Run(self.folder, f"sweep-{key_of([*map(str, self.grid.axes), *self.identity])[:8]}")

    def check(self) -> None:
        """Refuse a sweep that is not over parameters, has an invalid point, or has too many points."""
        Run(self.folder).check(self.problem)
        check_parameters(self.problem, *self.grid.axes)
        check_jobs_fit(self.grid.size, self.folder)
        _ = self.jobs

    def result(self, jobs: ResumableJobs) -> Sweep:
        """The gaits of all points, with their table."""
        task = partial(solve_job, method=self.method)
        solved = solve_all(jobs, self.jobs, len(self.jobs), task) if self.warm else self._scanned(jobs)
        records = [{**record, "at": self.point(k)} for k, record in enumerate(solved)]
        swept = Sweep(problem=self.problem, grid=self.grid, records=records, folder=self.run.result_folder)
        self.run.write({TABLE_FILE: csv_text(sweep_table(swept)), SWEEP_FILE: json_file(swept.to_record())})
        return swept

    def _scanned(self, jobs: ResumableJobs) -> list[OutcomeRecord]:
        """Solve all points that a scan does not rule out, and then points without a gait from the gaits of neighbours.

        The order is random, so that the time of the first points predicts that of the others.
        """
        order = np.random.default_rng(0).permutation(len(self.jobs)).tolist()
        in_order = solve_all(
            jobs, [self.jobs[number] for number in order], len(order), partial(sweep_job, method=self.method)
        )
        records, keys = dict(zip(order, in_order, strict=True)), [job.key for job in self.jobs]
        tried = set[tuple[int, int]]()
        while True:
            start_of = dict[int, int]()  # the neighbour from whose gait a point is tried next
            for number in range(len(records)):
                if not is_gait(records[number]) and records[number]["status"] != SET_ASIDE:
                    untried = (n for n in self._around(number) if is_gait(records[n]) and (number, n) not in tried)
                    for neighbour in islice(untried, 1):
                        start_of[number] = neighbour
            if not start_of:
                return [records[number] for number in range(len(records))]
            tried |= set(start_of.items())
            again = [
                problem_job(self.jobs[number].argument, keys[neighbour], self.method)
                for number, neighbour in start_of.items()
            ]
            records_again = solve_all(jobs, again, len(again), partial(neighbour_job, method=self.method))
            for number, job, record in zip(start_of, again, records_again, strict=True):
                if is_gait(record):
                    records[number], keys[number] = record, job.key

    @cached_property
    def jobs(self) -> list[Job]:
        """One job per point, in the order of the grid."""
        jobs: list[Job] = []
        for number in range(self.grid.size):
            problem = at_point(self.problem, self.point(number))
            problem = problem.from_guess() if self.from_guess else problem
            before = [neighbour for neighbour in self._around(number) if neighbour < number] if self.warm else []
            jobs.append(problem_job(problem, jobs[before[0]].key if before else None, self.method))
        return jobs

    def point(self, number: int) -> dict[str, float]:
        """Values by dotted key at one point of the grid."""
        indices = np.unravel_index(number, self.grid.shape)
        return {axis.key: self._numbers[axis.key][k] for axis, k in zip(self.grid.axes, indices, strict=True)}

    @cached_property
    def _numbers(self) -> dict[str, list[float]]:
        return {axis.key: axis.numbers(self.problem) for axis in self.grid.axes}

    def _around(self, number: int) -> list[int]:
        """The points next to a point along every axis."""
        index, neighbours = np.unravel_index(number, self.grid.shape), list[int]()
        for axis, count in enumerate(self.grid.shape):
            for k in (int(index[axis]) - 1, int(index[axis]) + 1):
                if 0 <= k < count:
                    moved = [*map(int, index)]
                    moved[axis] = k
                    neighbours.append(int(np.ravel_multi_index(moved, self.grid.shape)))
        return neighbours
