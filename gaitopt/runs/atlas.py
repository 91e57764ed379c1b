"""An atlas: where the gaits of a family exist, slip and are stable, over two parameters.

Branches in the first parameter are computed at some values of the second parameter. One of them begins at the gait of
the problem, each of the others at a gait of this branch or of a neighbour. Special points of the branches are traced
over both parameters, as are the curves that begin at codimension-two points, until no new curve appears. If the curves
do not explain how two neighbouring branches differ, a branch between them is added, down to a smallest distance.
``gait.regions`` arranges branches and curves into regions. One gait in the middle of every region is solved again and
verified by simulation; a region whose gait fails is unknown.

Every branch, every curve and every verified gait is one job, see ``atlas_job``.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gaitopt.arrays import Array
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.branches.trace import MARGINS, curve_start, follow_curve
from gaitopt.callbacks import Stop, raise_if_stopped
from gaitopt.display import Reported, counted
from gaitopt.errors import ArgumentError, ProblemError, SolveError
from gaitopt.gait.branch import TERMINAL, BranchPoint, SpecialPoint, split_after
from gaitopt.gait.frames import data_frame
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import AtlasJobRecord, AtlasRecord
from gaitopt.gait.regions import (
    UNKNOWN,
    Arrangement,
    Region,
    Slice,
    Traced,
    alike,
    arrange,
    curves_between,
    families,
    open_gaps,
    ordered,
)
from gaitopt.gait.trace import CurveStart, TracePoint, TraceSpecial
from gaitopt.model.cycle import Cycle
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import unit_of
from gaitopt.requests import AtlasRequest, TraceRequest
from gaitopt.runs.grid import Axis, Grid, at_point, check_parameters
from gaitopt.runs.jobs import Plan, ResultFile
from gaitopt.runs.trace import traced_family
from gaitopt.search.solve import solve
from gaitopt.store.formats import json_file, validated
from gaitopt.store.gaits import special_point, trace_special
from gaitopt.store.run import Run
from gaitopt.systems import solve_sequence
from gaitopt.threads import cached_property
from gaitopt.verification.verify import verify
from gaitopt.workers.jobs import FailedJob, Job, ResumableJobs, key_of

if TYPE_CHECKING:
    from pandas import DataFrame

Record = Mapping[str, Any]

ATLAS_FILE = "atlas.json"


def _is_outdated(line: Record) -> bool:
    """Whether an earlier version wrote the line of a branch: its special points are no records."""
    specials = line.get("specials")
    records = specials if isinstance(specials, list) else []
    return any(isinstance(special, dict) and "record" not in special for special in records)


ATLAS_JOBS = ResultFile(name="atlas.jsonl", key="job", model=AtlasJobRecord, is_outdated=_is_outdated)
STORED_POINTS = 9
"""Number of stored gaits of a segment: those at its two ends, and others evenly spaced between them."""
INSIDE = 1e-9
"""A start at an end of the range is moved inwards by this fraction of the range, as no branch begins at its target."""
TRACEABLE = ("fold", "period_doubling", "neimark_sacker", *MARGINS)
"""Types of special points that can be traced, besides ends of families at a margin."""
MOVING_POINTS = 200
"""Largest number of points of the family that leads from a known gait to the start of a branch."""
LARGEST_LENGTH = 0.05
"""Largest arclength of a step along a branch: twice that of a continuation, because only special points matter."""
MOST_TRACES, MOST_TRACED = 60, 200
"""Largest number of traced curves, and largest number of points of a curve in either direction."""
SAME_VALUE = 1e-6
"""Relative difference below which two values are the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Atlas(Reported):
    """The atlas of a family of gaits.

    Attributes
    ----------
    problem, axes : the problem, and the ranges of the two parameters.
    slices : the branches in the first parameter, ascending in the second; then those of families of doubled gaits.
    arrangement : regions, curves, and the points where curves meet.
    gaits : for every region, the record of its verified gait, or the reason why there is none.
    unexplained : ranges of the second parameter between two branches that differ more than the traced curves explain.
    folder : folder of its files.
    """

    problem: Problem
    axes: tuple[Axis, Axis]
    slices: tuple[Slice, ...]
    arrangement: Arrangement
    gaits: tuple[Record, ...]
    unexplained: tuple[tuple[float, float], ...] = ()
    folder: Path | None = None

    def __repr__(self) -> str:
        span = " and ".join(f"{axis.key} {axis.lower:g} to {axis.upper:g}" for axis in self.axes)
        regions, curves = self.arrangement.regions, self.arrangement.curves
        counts = f"{counted(len(regions), 'region')}, {counted(len(curves), 'curve')}"
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
            "branches": len({each.value for each in self.slices}),
            "sheets": self.sheets,
            "unexplained": [list(gap) for gap in self.unexplained],
            "curves": [
                {
                    "type": curve.type,
                    "sheet": curve.sheet,
                    **{side: record[side] for record in curve.records[:1] for side in ("from", "to") if side in record},
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
                    "modes": region.modes,
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
        """One row per region: modes, stability, sheet, fraction of the area, and a verified gait in it."""
        keys = [axis.key for axis in self.axes]
        header = ("modes", "stable", "sheet", "area", *keys, "spectral_radius", "period")
        rows = [
            (r["modes"], r["stable"], r["sheet"], r["area"], *(r.get("at", {}).get(key) for key in keys),
             (r.get("gait") or {}).get("spectral_radius"), (r.get("gait") or {}).get("period"))
            for r in self.to_record()["regions"]
        ]  # fmt: skip
        return data_frame(header, rows, {key: unit_of(key, self.problem) for key in keys}, problem=self.problem.name)


def read_atlas(folder: Path) -> Atlas:
    """The atlas in a subfolder of the run of its problem."""
    run = Run.at(folder)
    stated = run.read_record(ATLAS_FILE, AtlasRecord)
    grid = validated(Grid, {"axes": stated["over"]}, folder / ATLAS_FILE)
    first, second = grid.axes
    return _assembled(run.problem(), (first, second), ATLAS_JOBS.finished(run, stated["jobs"]), folder)


def _assembled(problem: Problem, axes: tuple[Axis, Axis], records: Sequence[Record], folder: Path) -> Atlas:
    """The atlas from the records of its jobs: those of branches, curves, and gaits in regions."""
    slices, traces, arrangement, known = _arranged(records, axes)
    checked = {(*record["at"].values(),): record for record in records if "at" in record}
    regions, gaits = list[Region](), list[Record]()
    for region, gait in zip(arrangement.regions, known, strict=True):
        record = checked.get((*gait[0].values(),), {}) if gait else {}
        gaits.append({key: value for key, value in record.items() if key != "job"})
        failed = record.get("gait", {}) is None
        regions.append(replace(region, modes=UNKNOWN, unstable=None) if failed else region)
    values = [each.value for each in slices]
    gaps = open_gaps(slices, traces, axes[0].ends)
    return Atlas(
        problem=problem,
        axes=axes,
        slices=tuple(each for family in families(slices) for each in family),
        arrangement=replace(arrangement, regions=tuple(regions)),
        gaits=tuple(gaits),
        unexplained=tuple((values[j], values[j + 1]) for j in gaps),
        folder=folder,
    )


def _arranged(
    records: Iterable[Record], axes: tuple[Axis, Axis]
) -> tuple[list[Slice], list[Traced], Arrangement, list[tuple[dict[str, float], Record] | None]]:
    """Branches, traces, their arrangement; for every region the gait amid its longest segment, with its parameters."""
    records = [*records]
    slices, traces = _slices(records), _traced(records)
    arrangement = arrange(slices, axes[0].ends, traces)
    segments = [[(each.value, segment) for segment in each.segments] for family in families(slices) for each in family]
    known = list[tuple[dict[str, float], Record] | None]()
    for region in arrangement.regions:
        inside = [segments[j][i] for j, i in region.segments]
        value, longest = max(inside, key=lambda pair: pair[1].length, default=(0.0, None))
        gait = None if longest is None else longest.middle
        known.append(None if gait is None else ({axes[0].key: gait["value"], axes[1].key: value}, gait))
    return slices, traces, arrangement, known


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
        """The subfolder of the run folder that contains the atlas."""
        return Run(self.folder, f"atlas-{key_of([*map(str, self.axes), *self.identity])[:8]}")

    def check(self) -> None:
        """Refuse an atlas that is not over two continuous parameters, or has an invalid corner."""
        Run(self.folder).check(self.problem)
        check_parameters(self.problem, *self.axes)
        if self.problem.is_open or self.problem.is_design:
            raise ProblemError(f"{self.problem.name}: an atlas needs a problem with phases and no free parameters")
        for axis in self.axes:
            if isinstance(self.problem.parameters[axis.key], int):
                raise ArgumentError("over", f"{axis.key} is a whole number, along which there is no family")
        for corner in product(*(axis.ends for axis in self.axes)):
            at_point(self.problem, dict(zip((axis.key for axis in self.axes), corner, strict=True)))

    def result(self, jobs: ResumableJobs) -> Atlas:
        """The branches, refined until curves explain their differences, and a verified gait in every region."""
        with jobs.kept() as workers:
            branches, traces = self._branches_and_curves(workers)
            _, _, _, known = _arranged([*branches.values(), *traces.values()], self.axes)
            checks = [
                self._job(check_job, ["check", at], {"at": at, "gait": None}, at, dict(gait))
                for at, gait in filter(None, known)
            ]
            checked = self._completed(workers, checks)
        done = {**branches, **traces, **checked}
        self.run.write({ATLAS_FILE: json_file({"over": [asdict(axis) for axis in self.axes], "jobs": [*done]})})
        return _assembled(self.problem, self.axes, [*done.values()], self.run.result_folder)

    def _branches_and_curves(self, jobs: ResumableJobs) -> tuple[dict[str, Record], dict[str, Record]]:
        """The records of all branches and of all traced curves, by the keys of their jobs."""
        second, known, branches = self.axes[1], dict[float, Job](), dict[str, Record]()
        values = np.linspace(second.lower, second.upper, self.slices).tolist()
        origin = float(np.clip(self.problem.parameters[second.key], second.lower, second.upper))
        if origin not in values:  # the first branch is where the gait of the problem is
            values[min(range(1, len(values) - 1), key=lambda k: abs(values[k] - origin))] = origin
        others = sorted({*values} - {origin}, key=lambda value: abs(value - origin))
        starts = dict.fromkeys(others, origin)
        known[origin] = self._branch(origin, None)
        branches = self._completed(jobs, [known[origin]])
        tried = set[tuple[float, float]]()
        while starts:
            known |= {value: self._branch(value, known[start]) for value, start in starts.items()}
            branches |= self._completed(jobs, [known[value] for value in starts])
            branches = {job.key: branches[job.key] for job in known.values()}
            tried |= {*starts.items()}
            # a family may end between the first branch and this value, but not between the nearest branch and it
            there = [value for value in values if branches[known[value].key]["segments"]]
            nearest = {v: min(there, key=lambda other: abs(other - v)) for v in values if there and v not in there}
            starts = {value: start for value, start in nearest.items() if (value, start) not in tried}
        traces = dict[str, Record]()
        while True:
            slices = _slices(branches.values())
            fresh = [*self._untraced(slices, traces), *self._begun(traces)] if len(traces) < MOST_TRACES else []
            between = self._between(slices, _traced(traces.values())) if traces or not fresh else {}
            known |= {value: self._branch(value, known[start]) for value, start in between.items()}
            if not (fresh or between):
                return branches, traces
            done = self._completed(jobs, [*fresh, *(known[value] for value in between)])
            traces |= {job.key: done.pop(job.key) for job in fresh}
            branches |= done

    def _between(self, slices: Sequence[Slice], traces: Sequence[Traced]) -> dict[float, float]:
        """Values of the second parameter at which a branch is missing, each with the value where its start is known."""
        second, values = self.axes[1], [each.value for each in slices]
        smallest = (second.upper - second.lower) / (self.slices - 1) / 2**self.refinements
        gaps = (j for j in open_gaps(slices, traces, self.axes[0].ends) if values[j + 1] - values[j] > 1.5 * smallest)
        return {
            (values[j] + values[j + 1]) / 2: max(slices[j : j + 2], key=lambda each: len(each.segments)).value
            for j in gaps
        }

    def _untraced(self, slices: Sequence[Slice], traces: Mapping[str, Record]) -> Iterator[Job]:
        """A job for one curve of every type that no trace covers, from the special point in its middle."""
        types, known = set[tuple[str, ...]](), _traced(traces.values())
        chains = [(family, chain) for family in families(slices) for chain in curves_between(family)]
        for family, chain in sorted(chains, key=lambda pair: -len(pair[1])):
            j, k = chain[len(chain) // 2]
            special, value = family[j].specials[k], family[j].value
            if not is_traceable(special):
                continue
            kind, point = str(special["type"]), (float(special["value"]), value)
            alone = (kind, str(special.get("from")), str(special.get("to")))
            covered = any(trace.steps == family[j].steps and trace.covers(kind, point, self.sizes) for trace in known)
            job = self._job(trace_job, ["trace", kind, point], untraced(kind), self.axes, value, dict(special))
            if not covered and alone not in types and job.key not in traces:
                types.add(alone)
                yield job

    def _begun(self, traces: Mapping[str, Record]) -> Iterator[Job]:
        """A job for every curve that begins at a codimension-two point, or passes through it, and is not traced yet."""
        for special, number in begun_curves(traces, self.sizes, self._most_steps):
            kind, point = special["next"][number]["type"], [*special["values"].values()]
            job = self._job(next_job, ["next", kind, point], untraced(kind), self.axes, dict(special), number)
            if job.key not in traces:
                yield job

    @property
    def _most_steps(self) -> int:
        return self.steps or len(self.problem.cycle.steps)

    @property
    def sizes(self) -> Array:
        """Sizes of both ranges."""
        return np.array([axis.upper - axis.lower for axis in self.axes])

    def _completed(self, jobs: ResumableJobs, fresh: Sequence[Job]) -> dict[str, Record]:
        """Records of jobs by their keys."""
        found = zip(fresh, jobs.complete(atlas_job, fresh, len(fresh)), strict=True)
        return {
            job.key: {**job.argument[1], "reason": record.reason} if isinstance(record, FailedJob) else record
            for job, record in found
        }

    def _branch(self, value: float, start: Job | None) -> Job:
        """The job of the branch at a value of the second parameter, from another one."""
        doublings = int(np.log2(max(self._most_steps // len(self.problem.cycle.steps), 1)))
        empty, above = {"value": value, "segments": [], "specials": []}, None if start is None else start.key
        identity = ["branch", self.max_points, doublings, value, above]
        job = self._job(slice_job, identity, empty, self.axes, value, self.max_points, doublings)
        return replace(job, parent=above)

    def _job(self, task: Callable[..., Any], identity: Sequence[Any], empty: Record, *inputs: Any) -> Job:
        key = key_of([self.problem.digest, *map(str, self.axes), *identity])
        return Job(key=key, argument=(task, empty, self.problem, *inputs))


def _slices(records: Iterable[Record]) -> list[Slice]:
    """The branches among some records, ascending in the second parameter."""
    return ordered(Slice.from_record(record) for record in records if "segments" in record)


def _traced(records: Iterable[Record]) -> list[Traced]:
    """The traces that were found."""
    return [
        Traced(
            type=record["type"],
            points=np.array(record["trace"]),
            specials=tuple((located["type"], tuple(located["values"].values())) for located in record["located"]),
            steps=record["steps"],
        )
        for record in records
        if len(record.get("trace", ())) > 1
    ]


def begun_curves(traces: Mapping[str, Record], sizes: Array, most: int) -> Iterator[tuple[Record, int]]:
    """The curves that begin at codimension-two points, or pass through them, and that no other trace covers.

    Parameters
    ----------
    traces : records of traces by the keys of their jobs.
    sizes : sizes of the ranges of both parameters.
    most : largest number of steps of a cycle.

    Returns
    -------
    curves : the record of the codimension-two point, and the number of the curve in its ``next``; each curve once.
    """
    known, begun = {key: _traced([record]) for key, record in traces.items()}, list[tuple[str, int, Array]]()
    for key, record in traces.items():
        others = [trace for other, found in known.items() if other != key for trace in found]
        for special in record["located"]:
            point = np.array([*special["values"].values()])
            for number, start in enumerate(special["next"]):
                kind, steps = start["type"], len(start.get("gait", special["gait"]).get("steps", (1,)))
                same = (
                    alike(kind, other) and steps == count and np.allclose(point, at, rtol=SAME_VALUE)
                    for other, count, at in begun
                )
                traced = (trace.steps == steps and trace.covers(kind, point.tolist(), sizes) for trace in others)
                if steps <= most and not any(same) and not any(traced):
                    begun.append((kind, steps, point))
                    yield special, number


def is_traceable(special: Record) -> bool:
    """Whether a special point of a branch has a curve, which includes an end where a margin vanishes."""
    within = special["type"] == "end" and not (special.get("bound") or special.get("open"))
    return special["status"] == "converged" and (special["type"] in TRACEABLE or within) and bool(special["gait"])


def atlas_job(argument: tuple[Any, ...], start: Record | None = None, should_stop: Stop = None) -> Record:
    """One job of an atlas, in any process: its function, what it returns if it fails, and its inputs."""
    task, _, *inputs = argument
    record = task(*inputs, start, should_stop)
    raise_if_stopped(should_stop)
    return {**record}


def slice_job(
    problem: Problem,
    axes: tuple[Axis, Axis],
    value: float,
    max_points: int,
    doublings: int,
    start: Record | None,
    should_stop: Stop = None,
) -> dict[str, Any]:
    """Segments and special points of a branch, from a gait of another branch; no segments if no gait is found.

    Parameters
    ----------
    doublings : number of period doublings in a row beyond which branches are followed too.
    """
    first, second = axes
    reasons = list[str]()
    for gait in _starts(problem, first, second, value, start, should_stop):
        if not gait.converged:
            reasons.append(gait.message)
            continue
        asked = Request(
            parameter=first.key, to=(first.lower,), lower=first.lower, upper=first.upper, max_points=max_points,
            verify_every=0, largest_length=LARGEST_LENGTH, follow={"doublings": doublings},
        )  # fmt: skip
        walks = [
            [*split_after(follow_family(gait, replace(asked, to=(to,)), should_stop=should_stop), _is_end)]
            for to in first.ends
        ]
        raise_if_stopped(should_stop)
        (below, *_), (above, *_) = walks
        segments, specials = _cut([*reversed(below), *above[1:]], len(below), first.key)
        branch: dict[str, Any] = {"value": value, "segments": segments, "specials": specials}
        doubled = [each for own, *others in walks for each in _doubled(branch, own, others, first.key)]
        return branch | {"doubled": doubled} if doublings else branch
    reason = reasons[0] if reasons else "the family of the gait from which it starts does not reach this value"
    return {"value": value, "segments": [], "specials": [], "reason": reason}


def _starts(
    problem: Problem, first: Axis, second: Axis, value: float, start: Record | None, should_stop: Stop
) -> Iterator[Gait]:
    """Gaits at which a branch may begin: that of the problem or those of another branch, followed to this value."""
    inside = INSIDE * (first.upper - first.lower)

    def begin(at: float) -> float:
        return float(np.clip(at, first.lower + inside, first.upper - inside))

    if start is None:
        gait = solve(problem, should_stop=should_stop)
        there = {second.key: value, first.key: begin(problem.parameters[first.key])}
        if gait.converged:
            yield from _moved(gait, there, should_stop)
        else:
            yield solve(at_point(problem, there), should_stop=should_stop)
        return
    segments = sorted(Slice.from_record(start).segments, key=lambda segment: segment.middle["spectral_radius"] or 0)
    for segment in segments:
        known = segment.middle
        beside = {first.key: begin(known["value"]), second.key: start["value"]}
        try:
            gait = solve_sequence(at_point(problem, beside).with_gait(known), should_stop=should_stop)
        except (ProblemError, SolveError):
            continue
        if gait.converged:
            yield from _moved(gait, {second.key: value}, should_stop)


def _moved(gait: Gait, there: Mapping[str, float], should_stop: Stop) -> Iterator[Gait]:
    """The gait of the family at other values of parameters, changed one after the other; none if the family ends."""
    for key, value in there.items():
        if gait.dynamics.parameter(key) == value:
            continue
        request = Request(
            parameter=key, to=(value,), max_points=MOVING_POINTS, verify_every=0, largest_length=LARGEST_LENGTH
        )
        points = [r for r in follow_family(gait, request, should_stop=should_stop) if isinstance(r, BranchPoint)]
        if not points or abs(points[-1].value - value) > SAME_VALUE * abs(value):
            return
        gait = points[-1].gait
    yield gait


def _is_end(record: BranchPoint | SpecialPoint | TracePoint | TraceSpecial) -> bool:
    """Whether a branch or a curve ends with a record."""
    return isinstance(record, SpecialPoint | TraceSpecial) and record.type in TERMINAL


def _doubled(
    branch: Record,
    own: Sequence[BranchPoint | SpecialPoint],
    others: Sequence[Sequence[BranchPoint | SpecialPoint]],
    key: str,
) -> list[dict[str, Any]]:
    """The branches of doubled gaits that begin at the period doublings of a branch.

    Parameters
    ----------
    own, others : the records of the branch, and those of the branches that were followed from it.
    """
    kept, found = {special["value"] for special in branch["specials"]}, list[dict[str, Any]]()
    origins = [r for r in own if isinstance(r, SpecialPoint) and r.type == "period_doubling" and r.value in kept]
    for origin, walk in ((origin, walk) for origin in origins for walk in others if walk[0].branch in origin.next):
        segments, specials = _cut([origin, *walk], 0, key)
        doubled = {"segments": segments, "specials": specials}
        if segments:
            found.append({**doubled, "doubled": _doubled(doubled, walk, others, key)})
    return found


def _cut(
    chain: Sequence[BranchPoint | SpecialPoint], backwards: int, key: str
) -> tuple[list[list[dict[str, Any]]], list[dict[str, Any]]]:
    """Segments and special points of a branch.

    If the branch has no point between two special points, the gait in their middle is solved. If that fails, the
    segment and the first of the two special points are left out.

    Parameters
    ----------
    backwards : number of records that were followed towards the lower bound.
    """
    cuts = [k for k, record in enumerate(chain) if isinstance(record, SpecialPoint)]
    segments, specials = list[list[dict[str, Any]]](), [_special(chain[cuts[0]], backwards=backwards > 0)]
    for first, last in pairwise(cuts):
        points = [(r.gait, r.value) for r in chain[first + 1 : last] if isinstance(r, BranchPoint)]
        points = points or _between(chain[first], chain[last], key)
        if points:
            stored = np.unique(np.linspace(0, len(points) - 1, STORED_POINTS).round().astype(int)).tolist()
            segments.append([{"value": at, **gait.to_record()} for gait, at in (points[k] for k in stored)])
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
    """The record of a special point; ``backwards`` if the branch was followed towards the lower bound."""
    assert isinstance(special, SpecialPoint)
    if backwards:
        special = replace(special, before=special.after, after=special.before)
    return dict(special.to_record())


def trace_job(
    problem: Problem, axes: tuple[Axis, Axis], value: float, special: Any, _: None = None, should_stop: Stop = None
) -> dict[str, Any]:
    """The curve of a special point of the branch at a value of the second parameter, to both bounds of the range."""
    first, second = (axis.key for axis in axes)
    family = traced_family(at_point(problem, {second: value}), first, second)
    try:
        start = curve_start(special_point(family, first, special))
    except (ProblemError, SolveError) as error:
        return untraced(special["type"]) | {"reason": str(error)}
    return _both_ways(start, special["type"], axes, should_stop)


def next_job(
    problem: Problem, axes: tuple[Axis, Axis], special: Any, number: int, _: None = None, should_stop: Stop = None
) -> dict[str, Any]:
    """A curve that begins at a codimension-two point, or passes through it, to both bounds of the range."""
    first, second = (axis.key for axis in axes)
    point = trace_special(traced_family(problem, first, second), first, special)
    return _both_ways(point.next[number], special["next"][number]["type"], axes, should_stop)


def untraced(kind: str) -> dict[str, Any]:
    """The record of a curve that was not traced."""
    return {"type": kind, "steps": 1, "trace": [], "located": []}


def _both_ways(start: CurveStart, kind: str, axes: tuple[Axis, Axis], should_stop: Stop) -> dict[str, Any]:
    """The record of a curve that is traced from its start to both bounds of the range."""
    first, second = axes
    value = start.gait.dynamics.parameter(second.key)
    targets = tuple(to for to in second.ends if abs(to - value) > SAME_VALUE * (second.upper - second.lower))
    asked = TraceRequest(
        key=second.key, to=targets, lower=first.lower, upper=first.upper, max_points=MOST_TRACED, verify_every=0
    )
    record = untraced(kind) | {"steps": len(start.gait.steps)}
    try:
        halves = [*split_after(follow_curve(start, asked, should_stop=should_stop), _is_end)]
    except (ProblemError, SolveError) as error:
        return record | {"reason": str(error)}
    raise_if_stopped(should_stop)
    chains = list[list[list[float]]]()
    for half in halves:  # a curve ends at its last point, or at a special point beyond that
        *points, last = ([*each.values.values()] for each in half if isinstance(each, TracePoint) or each is half[-1])
        chains.append([*points, last] if last != points[-1] else points)
    located = [
        each.to_record()
        for half in halves
        for each in half
        if isinstance(each, TraceSpecial) and each.codimension > 1 and each.status == "converged" and each.type != "end"
    ]
    chain = chains[0] if len(chains) == 1 else [*reversed(chains[0]), *chains[1][1:]]
    return record | {"trace": chain, "located": located}


def check_job(
    problem: Problem, at: dict[str, float], known: Record, _: None = None, should_stop: Stop = None
) -> dict[str, Any]:
    """The record of a region's gait, solved and verified; if that fails, null with the reason."""
    try:
        gait = solve_sequence(at_point(problem, at).with_gait(known), should_stop=should_stop)
    except (ProblemError, SolveError) as error:
        return {"at": at, "gait": None, "reason": str(error)}
    if not gait.converged:
        return {"at": at, "gait": None, "reason": gait.message}
    verification = verify(gait)
    same = str(gait.problem.cycle) == str(Cycle.from_record(known))
    if not verification.passed or not same:
        return {"at": at, "gait": None, "reason": "the simulation does not confirm the gait"}
    return {"at": at, "gait": gait.verified(verification.to_record()).to_record()}
