"""An atlas: where the gaits of a family exist, slip and are stable, over two parameters.

The branch in the first parameter is computed at some values of the second. Where two neighbouring branches differ in
their segments, the value between them is added, again and again down to a smallest distance. ``gait.regions`` arranges
the branches into regions and curves. One gait in the middle of every region is solved again and verified by simulation;
a region whose gait fails is unknown.

Every branch is one job: the first one starts from the gait of the problem, each of the others from the branch next to
it.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.branches.trace import MARGINS, follow_curve
from gaitopt.callbacks import Stop
from gaitopt.display import Plotted, counted
from gaitopt.errors import ArgumentError, ProblemError, SolveError, StorageError
from gaitopt.gait.branch import BranchPoint, SpecialPoint
from gaitopt.gait.frames import data_frame
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import AtlasJobRecord, AtlasRecord
from gaitopt.gait.regions import (
    Arrangement,
    Region,
    Slice,
    Traced,
    arrange,
    compound_gaps,
    curves_between,
    open_gaps,
)
from gaitopt.gait.trace import TracePoint, TraceSpecial
from gaitopt.model.cycle import Cycle
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import unit_of
from gaitopt.requests import AtlasRequest, TraceRequest, entries
from gaitopt.runs.grid import Axis, Grid, at_point
from gaitopt.runs.jobs import Plan, ResultFile
from gaitopt.search.solve import solve
from gaitopt.store.formats import json_file, validated
from gaitopt.store.run import Run
from gaitopt.systems import solve_sequence
from gaitopt.threads import cached_property
from gaitopt.verification.verify import verify
from gaitopt.workers.jobs import FailedJob, Job, ResumableJobs, key_of

if TYPE_CHECKING:
    from pandas import DataFrame

ATLAS_FILE = "atlas.json"
ATLAS_JOBS = ResultFile(name="atlas.jsonl", key="job", model=AtlasJobRecord)
STORED_POINTS = 9
"""Gaits of a segment that are stored, evenly along it with both ends."""
INSIDE = 1e-9
"""A start is moved into the range by this part of it: a branch cannot begin at its own target."""
TRACEABLE = ("fold", "period_doubling", "neimark_sacker", *MARGINS)
"""Types of special points that have a curve."""
MOVING_POINTS = 200
"""Most points of the family from a known gait to the place where a branch begins."""
TRACING_ROUNDS = 4
"""Curves of one type are traced one after the other, because a trace may cover several of them."""
ACROSS, SAME_VALUE = 0.1, 1e-6
"""Distance up to which a special point is the same one, relative to that of its start, and to the range."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Atlas(Plotted):
    """The atlas of a family of gaits.

    Attributes
    ----------
    problem, axes : the problem, and the ranges of the two parameters.
    slices : the branches in the first parameter, ascending in the second.
    arrangement : regions, curves, and the points where curves meet.
    gaits : of the regions, in their order: the record of a verified gait; the reason if there is none.
    folder : folder of its files.
    """

    problem: Problem
    axes: tuple[Axis, Axis]
    slices: tuple[Slice, ...]
    arrangement: Arrangement
    gaits: tuple[Mapping[str, Any], ...]
    folder: Path | None = None

    def __repr__(self) -> str:
        span = " and ".join(f"{axis.key} {axis.lower:g} to {axis.upper:g}" for axis in self.axes)
        found = self.arrangement
        counts = f"{counted(len(found.regions), 'region')}, {counted(len(found.curves), 'curve')}"
        return f"<Atlas {self.problem.name} over {span}: {counts}>"

    @property
    def sheets(self) -> int:
        """Number of sheets of the family: more than one where it folds over itself."""
        return 1 + max((region.sheet for region in self.arrangement.regions), default=-1)

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of the command line."""
        keys = [axis.key for axis in self.axes]
        return {
            "problem": self.problem.name,
            "over": [asdict(axis) for axis in self.axes],
            "branches": len(self.slices),
            "sheets": self.sheets,
            "curves": [
                {
                    "type": curve.type,
                    "sheet": curve.sheet,
                    **{side: curve.records[0][side] for side in ("from", "to") if side in curve.records[0]},
                    "located": curve.located.tolist(),
                    "points": curve.points.tolist(),
                }
                for curve in self.arrangement.curves
            ],
            "points": [
                {
                    "type": junction.name,
                    "values": dict(zip(keys, junction.values, strict=True)),
                    "codimension": 2,
                    "status": "guess" if junction.within else "converged",
                    "within": junction.within,
                    "curves": list(junction.types),
                }
                for junction in self.arrangement.junctions
            ],
            "regions": [
                {
                    "modes": region.words,
                    "unstable": region.unstable,
                    "stable": None if region.unstable is None else region.unstable == 0,
                    "sheet": region.sheet,
                    "area": region.area / self.area,
                    **gait,
                }
                for region, gait in zip(self.arrangement.regions, self.gaits, strict=True)
            ],
        }

    @property
    def area(self) -> float:
        """Area of the rectangle."""
        return float(np.prod([axis.upper - axis.lower for axis in self.axes]))

    def to_frame(self) -> "DataFrame":
        """One row per region: modes, stability, sheet, part of the area, and a verified gait in it."""
        keys = [axis.key for axis in self.axes]
        header = ("modes", "stable", "sheet", "area", *keys, "spectral_radius", "period")
        rows = [
            (r["modes"], r["stable"], r["sheet"], r["area"], *(r.get("at", {}).get(key) for key in keys),
             (r.get("gait") or {}).get("spectral_radius"), (r.get("gait") or {}).get("period"))
            for r in self.to_record()["regions"]
        ]  # fmt: skip
        return data_frame(header, rows, {key: unit_of(key, self.problem) for key in keys}, problem=self.problem.name)


def read_atlas(place: Path) -> Atlas:
    """The atlas in a folder, which is a part of the run of its problem."""
    run = Run.at(place)
    stated = validated(AtlasRecord, run.read_object(ATLAS_FILE), place / ATLAS_FILE)
    grid = validated(Grid, {"axes": stated["over"]}, place / ATLAS_FILE)
    lines = {line["job"]: line for line in run.lines(ATLAS_JOBS.name)}
    for number, line in enumerate(lines.values(), start=1):
        validated(AtlasJobRecord, line, run.path(ATLAS_JOBS.name), number)
    missing = [key for key in stated["jobs"] if key not in lines]
    if missing:
        raise StorageError(f"{run.path(ATLAS_JOBS.name)} lacks the branch with the key {missing[0]}; it is unchanged")
    first, second = grid.axes
    return _assembled(run.problem(), (first, second), [lines[key] for key in stated["jobs"]], place)


def _assembled(problem: Problem, axes: tuple[Axis, Axis], records: Sequence[Mapping[str, Any]], place: Path) -> Atlas:
    """The atlas from the records of its jobs: those of branches, and those of gaits in regions."""
    slices = sorted((Slice.from_record(r) for r in records if "segments" in r), key=lambda each: each.value)
    checked = {_checked_key(record["at"]): record for record in records if "at" in record}
    traces = _traced(record for record in records if "trace" in record)
    arrangement, gaits = arrange(slices, (axes[0].lower, axes[0].upper), traces), list[Mapping[str, Any]]()
    regions = list[Region]()
    for region in arrangement.regions:
        place_of = _representative(slices, region, axes)
        known = None if place_of is None else checked.get(_checked_key(place_of[0]))
        gaits.append({} if known is None else {key: value for key, value in known.items() if key != "job"})
        wrong = known is not None and known["gait"] is None
        regions.append(replace(region, words="unknown", unstable=None) if wrong else region)
    return Atlas(
        problem=problem,
        axes=axes,
        slices=tuple(slices),
        arrangement=replace(arrangement, regions=tuple(regions)),
        gaits=tuple(gaits),
        folder=place,
    )


def _checked_key(at: Mapping[str, float]) -> tuple[float, ...]:
    return tuple(at.values())


def _representative(
    slices: Sequence[Slice], region: Region, axes: tuple[Axis, Axis]
) -> tuple[dict[str, float], Mapping[str, Any]] | None:
    """A place in the middle of the longest segment of a region, and the gait that is known there."""
    if not region.places:
        return None

    def length(place: tuple[int, int]) -> float:
        values = [point["value"] for point in slices[place[0]].segments[place[1]].points]
        return max(values) - min(values)

    j, i = max(region.places, key=length)
    gait = slices[j].segments[i].middle
    return {axes[0].key: gait["value"], axes[1].key: slices[j].value}, gait


@dataclass(frozen=True, kw_only=True)
class AtlasPlan(Plan[Atlas], AtlasRequest):
    """An atlas to be computed.

    Attributes
    ----------
    axes : the ranges of the two parameters.
    """

    results = ATLAS_JOBS
    axes: tuple[Axis, Axis]

    @cached_property
    def run(self) -> Run:
        """The part of the run with its files."""
        return Run(self.folder, f"atlas-{key_of([*map(str, self.axes), *self.identity])[:8]}")

    def check(self) -> None:
        """Refuse an atlas that is not over two continuous parameters, or has an invalid corner."""
        Run(self.folder).check(self.problem)
        parameters = self.problem.parameters
        Grid(self.axes).check_keys(tuple(parameters), f"a parameter of {self.problem.name}")
        if self.problem.is_open or self.problem.is_design:
            raise ProblemError(f"{self.problem.name}: an atlas needs a problem with phases and no free parameters")
        for axis in self.axes:
            if isinstance(parameters[axis.key], int):
                raise ArgumentError("over", f"{axis.key} is a whole number, along which there is no family")
        for first in (self.axes[0].lower, self.axes[0].upper):
            for second in (self.axes[1].lower, self.axes[1].upper):
                at_point(self.problem, {self.axes[0].key: first, self.axes[1].key: second})

    def result(self, jobs: ResumableJobs) -> Atlas:
        """The branches, refined until neighbours agree, their arrangement, and a verified gait in every region."""
        first, second = self.axes
        values = np.linspace(second.lower, second.upper, self.slices).tolist()
        begin = float(np.clip(self.problem.parameters[second.key], second.lower, second.upper))
        origin = min(range(len(values)), key=lambda k: abs(values[k] - begin))
        known = dict[float, Job]()
        known[values[origin]] = self._job(values[origin], None)
        for k in [*range(origin + 1, len(values)), *range(origin - 1, -1, -1)]:
            neighbour = values[k - 1] if k > origin else values[k + 1]
            known[values[k]] = self._job(values[k], known[neighbour])
        upward = [known[values[k]] for k in range(origin, len(values))]
        downward = [known[values[k]] for k in range(origin - 1, -1, -1)]
        records = dict(self._completed(jobs, [*_alternately(upward, downward)]))
        span, traces = (first.lower, first.upper), dict[str, Mapping[str, Any]]()
        self._refine(jobs, known, records, compound_gaps)
        for _ in range(TRACING_ROUNDS):
            fresh = [*self._untraced(_slices(records), _traced(traces.values()))]
            fresh = [job for job in fresh if job.key not in traces]
            if not fresh:
                break
            for job, record in zip(fresh, jobs.complete(trace_job, fresh, len(fresh)), strict=True):
                traces[job.key] = {"trace": [], "reason": record.reason} if _failed(record) else record
        self._refine(jobs, known, records, lambda slices: open_gaps(slices, _traced(traces.values()), span))
        slices = _slices(records)
        arrangement = arrange(slices, span, _traced(traces.values()))
        places = filter(None, (_representative(slices, region, self.axes) for region in arrangement.regions))
        checks = [
            Job(key=key_of([self.problem.digest, "check", at]), argument=(self.problem, at, dict(gait)))
            for at, gait in places
        ]
        checked = jobs.complete(check_job, checks, len(checks))
        checked = [
            {"at": job.argument[1], "gait": None, "reason": record.reason} if _failed(record) else record
            for job, record in zip(checks, checked, strict=True)
        ]
        keys = [known[value].key for value in sorted(records)] + [*traces] + [job.key for job in checks]
        self.run.write({ATLAS_FILE: json_file({"over": [asdict(axis) for axis in self.axes], "jobs": keys})})
        every = [*records.values(), *traces.values(), *checked]
        return _assembled(self.problem, self.axes, every, self.run.place)

    def _refine(
        self,
        jobs: ResumableJobs,
        known: dict[float, Job],
        records: dict[float, Mapping[str, Any]],
        gaps: Callable[[Sequence[Slice]], list[int]],
    ) -> None:
        """Add branches in the middle of some gaps, again and again."""
        second = self.axes[1]
        least = (second.upper - second.lower) / (self.slices - 1) / 2**self.refinements
        while True:
            values, fresh = sorted(records), list[Job]()
            for j in gaps(_slices(records)):
                if values[j + 1] - values[j] < 1.5 * least:
                    continue
                middle = (values[j] + values[j + 1]) / 2
                parent = max((values[j], values[j + 1]), key=lambda value: len(records[value]["segments"]))
                known[middle] = self._job(middle, known[parent])
                fresh.append(known[middle])
            if not fresh:
                return
            records |= dict(self._completed(jobs, fresh))

    def _untraced(self, slices: Sequence[Slice], traces: Sequence[Traced]) -> Iterator[Job]:
        """A job for one curve of every type that no trace covers, from the special point in its middle."""
        first, second = self.axes
        sizes, types = np.array([first.upper - first.lower, second.upper - second.lower]), set[tuple[str, ...]]()
        for chain in sorted(curves_between(slices), key=lambda chain: -len(chain)):
            j, k = chain[len(chain) // 2]
            special, value = slices[j].specials[k], slices[j].value
            if special["type"] not in TRACEABLE or special["status"] != "converged":
                continue
            kind = (special["type"], str(special.get("from")), str(special.get("to")))
            covered = any(trace.covers((special["value"], value), sizes) for trace in traces)
            if covered or kind in types:
                continue
            types.add(kind)
            near = [slices[j].segments[k - 1].points[-1]] if k else []
            near += [slices[j].segments[k].points[0]] if k < len(slices[j].segments) else []
            start = max(near, key=lambda point: 0.0 if point["value"] == special["value"] else 1.0)
            at = [special["value"], value]
            key = key_of([self.problem.digest, *map(str, self.axes), "trace", special["type"], at])
            yield Job(key=key, argument=(self.problem, self.axes, value, dict(special), dict(start)))

    def _completed(self, jobs: ResumableJobs, fresh: Sequence[Job]) -> Iterator[tuple[float, Mapping[str, Any]]]:
        for job, record in zip(fresh, jobs.complete(slice_job, fresh, len(fresh)), strict=True):
            value = job.argument[2]
            yield (
                value,
                {"value": value, "segments": [], "specials": [], "reason": record.reason}
                if _failed(record)
                else record,
            )

    def _job(self, value: float, parent: Job | None) -> Job:
        """The job of the branch at a value of the second parameter."""
        asked = AtlasRequest(**{name: getattr(self, name) for name in entries(AtlasRequest)})
        above = None if parent is None else parent.key
        key = key_of([self.problem.digest, *map(str, self.axes), self.max_points, value, above])
        return Job(key=key, argument=(self.problem, self.axes, value, asked), parent=above)


def _slices(records: Mapping[float, Mapping[str, Any]]) -> list[Slice]:
    return [Slice.from_record(records[value]) for value in sorted(records)]


def _traced(records: Iterable[Mapping[str, Any]]) -> list[Traced]:
    """The traces that were found."""
    return [
        Traced(type=record["type"], points=np.array(record["trace"]), specials=tuple(record["located"]))
        for record in records
        if len(record["trace"]) > 1
    ]


def _failed(record: Any) -> bool:
    return isinstance(record, FailedJob)


def _alternately(first: Sequence[Job], second: Sequence[Job]) -> Iterator[Job]:
    """The jobs of two chains in turn, so that both advance at once."""
    for k in range(max(len(first), len(second))):
        yield from first[k : k + 1]
        yield from second[k : k + 1]


def slice_job(
    argument: tuple[Problem, tuple[Axis, Axis], float, AtlasRequest],
    neighbour: Mapping[str, Any] | None = None,
    should_stop: Stop = None,
) -> dict[str, Any]:
    """The job of one branch, in any process; returns its record, without segments where no gait is found."""
    problem, (first, second), value, request = argument
    empty = {"value": value, "segments": [], "specials": []}
    reasons = list[str]()
    for gait in _starts(problem, first, second, value, neighbour, should_stop):
        if should_stop is not None and should_stop():
            raise KeyboardInterrupt
        if not gait.converged:
            reasons.append(gait.message)
            continue
        halves = [_followed(gait, first.key, to, request, should_stop) for to in (first.lower, first.upper)]
        segments, specials = _cut(halves, first.key)
        return {"value": value, "segments": segments, "specials": specials}
    return empty | {"reason": reasons[0] if reasons else "there is no gait on the branch next to it"}


def _starts(
    problem: Problem,
    first: Axis,
    second: Axis,
    value: float,
    neighbour: Mapping[str, Any] | None,
    should_stop: Stop,
) -> Iterator[Gait]:
    """Gaits from which a branch may be followed: that of the problem, or those next to the gaits of a neighbour.

    A gait is solved directly at the place where the branch begins, else followed there, through changes of its modes.
    """
    inside = INSIDE * (first.upper - first.lower)

    def begin(at: float) -> float:
        return float(np.clip(at, first.lower + inside, first.upper - inside))

    if neighbour is None:
        gait = solve(problem, should_stop=should_stop)
        there = {second.key: value, first.key: begin(problem.parameters[first.key])}
        if gait.converged:
            yield from _moved(gait, there, should_stop)
        else:
            yield solve(at_point(problem, there), should_stop=should_stop)
        return
    segments = sorted(Slice.from_record(neighbour).segments, key=lambda segment: segment.middle["spectral_radius"] or 0)
    for segment in segments:
        known = segment.middle
        beside = {first.key: begin(known["value"]), second.key: neighbour["value"]}
        for at in (beside | {second.key: value}, beside):
            try:
                gait = solve_sequence(at_point(problem, at).with_gait(known), should_stop=should_stop)
            except (ProblemError, SolveError):
                continue
            if gait.converged:
                yield from _moved(gait, {second.key: value}, should_stop)


def _moved(gait: Gait, there: Mapping[str, float], should_stop: Stop) -> Iterator[Gait]:
    """The gait of the family at other values of parameters, changed one after the other; none if it ends before."""
    for key, value in there.items():
        if gait.dynamics.parameter(key) == value:
            continue
        request = Request(parameter=key, to=(value,), max_points=MOVING_POINTS, verify_every=0)
        points = [r for r in follow_family(gait, request, should_stop=should_stop) if isinstance(r, BranchPoint)]
        if not points or abs(points[-1].value - value) > SAME_VALUE * abs(value):
            return
        gait = points[-1].gait
    yield gait


def _followed(
    gait: Gait, key: str, to: float, request: AtlasRequest, should_stop: Stop
) -> list[BranchPoint | SpecialPoint]:
    """The branch from a gait towards a bound."""
    asked = Request(parameter=key, to=(to,), max_points=request.max_points, verify_every=0)
    records = list(follow_family(gait, asked, should_stop=should_stop))
    if should_stop is not None and should_stop():
        raise KeyboardInterrupt
    return records


def _cut(
    halves: Sequence[Sequence[BranchPoint | SpecialPoint]], key: str
) -> tuple[list[list[dict[str, Any]]], list[dict[str, Any]]]:
    """Segments and special points of a branch, from its halves towards the lower and the upper bound.

    Between two special points that are closer than two points of the branch, the gait in their middle is solved; where
    that fails the segment is left out, with the first of the two.
    """
    chain, backwards = [*reversed(halves[0]), *halves[1][1:]], len(halves[0])
    cuts = [k for k, record in enumerate(chain) if isinstance(record, SpecialPoint)]
    segments, specials = list[list[dict[str, Any]]](), [_special(chain[cuts[0]], backwards=True)]
    for first, last in pairwise(cuts):
        points = [(r.gait, r.value) for r in chain[first + 1 : last] if isinstance(r, BranchPoint)]
        points = points or _between(chain[first], chain[last], key)
        if points:
            segments.append([_point(gait, at) for gait, at in _thinned(points)])
            specials.append(_special(chain[last], backwards=last < backwards))
        else:
            specials[-1] = _special(chain[last], backwards=last < backwards)
    return segments, specials


def _between(first: BranchPoint | SpecialPoint, last: BranchPoint | SpecialPoint, key: str) -> list[tuple[Gait, float]]:
    """The gait in the middle of two special points, from that at one of them; none if it is not found."""
    value = (first.value + last.value) / 2
    for known in (first.gait, last.gait):
        if known is not None and known.converged:
            try:
                gait = solve_sequence(known.problem.replace({key: value}).with_gait(known))
            except (ProblemError, SolveError):  # a phase has no duration
                continue
            if gait.converged:
                return [(gait, value)]
    return []


def _special(special: BranchPoint | SpecialPoint, *, backwards: bool) -> dict[str, Any]:
    """A special point as it is stored; ``backwards`` if the branch was followed towards the lower bound."""
    assert isinstance(special, SpecialPoint)
    record: dict[str, Any] = {"type": special.type, "value": special.value, "status": special.status}
    stated = dict(special.to_record())
    sides = ("to", "from") if backwards else ("from", "to")
    record |= {side: stated[other] for side, other in zip(("from", "to"), sides, strict=True) if other in stated}
    record |= {key: stated[key] for key in ("contact", "reason", "bound", "open") if stated.get(key)}
    if special.gait is not None:
        record["multipliers"] = dict(special.gait.to_record())["multipliers"]
    return record


def _thinned(points: Sequence[tuple[Gait, float]]) -> list[tuple[Gait, float]]:
    """At most ``STORED_POINTS`` points, evenly by number."""
    chosen = np.unique(np.linspace(0, len(points) - 1, STORED_POINTS).round().astype(int))
    return [points[k] for k in chosen.tolist()] if points else []


def _point(gait: Gait, value: float) -> dict[str, Any]:
    """A gait as it is stored."""
    return {"value": value, **dict(gait.to_record())}


def trace_job(
    argument: tuple[Problem, tuple[Axis, Axis], float, Mapping[str, Any], Mapping[str, Any]],
    _: None = None,
    should_stop: Stop = None,
) -> dict[str, Any]:
    """The job of one curve, in any process: it is traced from one of its special points to both bounds of the range.

    The special point is located again from a gait next to it.
    """
    problem, (first, second), value, special, start = argument
    record: dict[str, Any] = {"type": special["type"], "trace": [], "located": []}
    there = at_point(problem, {first.key: start["value"], second.key: value})
    try:
        gait = solve_sequence(there.with_gait(start), should_stop=should_stop)
        beyond = special["value"] + (special["value"] - start["value"])
        passing = Request(
            parameter=first.key, to=(float(np.clip(beyond, first.lower, first.upper)),), max_points=25, verify_every=0
        )
        near = ACROSS * abs(special["value"] - start["value"]) + SAME_VALUE * (first.upper - first.lower)
        point = next(
            found
            for found in follow_family(gait, passing, should_stop=should_stop)
            if isinstance(found, SpecialPoint)
            and found.type == special["type"]
            and abs(found.value - special["value"]) < near
        )
        targets = tuple(bound for bound in (second.lower, second.upper) if bound != value)
        request = TraceRequest(
            key=second.key, to=targets, lower=first.lower, upper=first.upper, max_points=200, verify_every=0
        )
        halves = [list(group) for group in _by_target(follow_curve(point, request, should_stop=should_stop))]
    except (ProblemError, SolveError, StopIteration) as error:
        return record | {"reason": str(error) or "the special point is not found again"}
    if should_stop is not None and should_stop():
        raise KeyboardInterrupt
    chains = [
        [[each.values[first.key], each.values[second.key]] for each in half if isinstance(each, TracePoint)]
        + [[half[-1].values[first.key], half[-1].values[second.key]]]
        for half in halves
    ]
    chain = chains[0] if len(chains) == 1 else [*reversed(chains[0]), *chains[1][1:]]
    located = [
        {
            "type": each.type,
            "values": [each.values[first.key], each.values[second.key]],
            "coefficients": dict(each.coefficients),
        }
        for half in halves
        for each in half
        if isinstance(each, TraceSpecial) and each.codimension > 1 and each.status == "converged" and each.type != "end"
    ]
    return record | {"trace": chain, "located": located}


def _by_target(records: Iterable[TracePoint | TraceSpecial]) -> Iterator[list[TracePoint | TraceSpecial]]:
    """The records of the walk towards each target, which ends with a special point of the type ``end``."""
    half = list[TracePoint | TraceSpecial]()
    for record in records:
        half.append(record)
        if isinstance(record, TraceSpecial) and record.type == "end":
            yield half
            half = []


def check_job(
    argument: tuple[Problem, dict[str, float], Mapping[str, Any]],
    _: None = None,
    should_stop: Stop = None,
) -> dict[str, Any]:
    """The job of a region, in any process: its gait, solved and verified; null with the reason where that fails."""
    problem, at, known = argument
    try:
        gait = solve_sequence(at_point(problem, at).with_gait(known), should_stop=should_stop)
    except (ProblemError, SolveError) as error:
        return {"at": at, "gait": None, "reason": str(error)}
    if should_stop is not None and should_stop():
        raise KeyboardInterrupt
    if not gait.converged:
        return {"at": at, "gait": None, "reason": gait.message}
    verification = verify(gait)
    same = str(gait.problem.cycle) == str(Cycle.from_record(known))
    if not verification.passed or not same:
        return {"at": at, "gait": None, "reason": "the simulation does not confirm the gait"}
    return {"at": at, "gait": gait.verified(verification.to_record()).to_record()}
