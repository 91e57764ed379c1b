"""Regions of a family of gaits over two parameters (a, b), from its branches in a at ascending values of b.

Special points cut each branch into segments of one mode sequence and one number of unstable multipliers. Segments of
neighbouring branches are matched in the order of the branch, the longest common sequence of labels first:

    branch at b_j+1      s0  |  s1  |      s3       |  s4          | special points: curves pass through them
    branch at b_j        s0  |  s1  |  s2  |   s3   |  s4          X where s2 begins: curves meet there

A *region* is a connected set of matched segments, a *sheet* one of regions between which no branch turns back, and a
*curve* passes through the special points between two segments. Curves that were traced have the points of their trace,
and meet where it has located a codimension-two point, turns back, or leaves the range. Others are monotone cubics
through the special points of the branches, and meet between two branches where their tangents do.

Families of doubled gaits, which begin at a period doubling of another family, are arranged by themselves, on sheets of
their own.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import SequenceMatcher
from functools import partial
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from gaitopt.arrays import Array
from gaitopt.model.cycle import Cycle

Record = Mapping[str, Any]
Node = tuple[int, int]
"""A special point: numbers of its branch, and of the point on it."""

SAMPLES = 8
"""Smallest number of points with which a curve is drawn between two branches."""
PARALLEL = 1e-6
"""Relative difference of slopes below which tangents are parallel, so that they do not determine where curves meet."""
ON_CURVE = 2e-3
"""Largest distance of a point of a curve from its trace, relative to the ranges; chords are closer to their arcs."""
SAME_POINT = 1e-5
"""Distance, relative to the ranges, below which two codimension-two points are the same."""
EDGE = 0.02
"""Smallest distance of an estimated meeting from a branch, relative to the distance of the two branches around it."""
MEETINGS = {
    frozenset(("fold",)): "cusp",
    frozenset(("neimark_sacker", "period_doubling")): "resonance_1_2",
    frozenset(("neimark_sacker", "fold")): "resonance_1_1",
    frozenset(("fold", "period_doubling")): "fold_flip",
}
"""Types of codimension-two points by those of the bifurcations that meet there."""
PASSED = ("resonance_1_3", "resonance_1_4", "generalised_flip", "chenciner")
"""Types of codimension-two points at which no other curve of the family begins or ends."""
MARGINS = ("mode_change", "impact_change", "lift_off", "painleve", "vanishing", "end", "margin")
END = "end"
NO_GAIT, UNKNOWN = "no gait", "unknown"


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """Gaits of a branch between two special points, with one mode sequence and stability.

    Attributes
    ----------
    modes : the mode sequence.
    unstable : number of multipliers outside the unit circle.
    points : records of its gaits in the order of the branch, each with ``value``, its first parameter.
    """

    modes: str
    unstable: int
    points: Sequence[Record]

    @property
    def label(self) -> tuple[str, int]:
        """Mode sequence and number of unstable multipliers."""
        return self.modes, self.unstable

    @property
    def length(self) -> float:
        """Length of the range of its values."""
        return float(np.ptp([point["value"] for point in self.points]))

    @property
    def middle(self) -> Record:
        """The gait nearest to the middle of its values."""
        values = [point["value"] for point in self.points]
        centre = (min(values) + max(values)) / 2
        return min(self.points, key=lambda point: abs(point["value"] - centre))


@dataclass(frozen=True, slots=True, kw_only=True)
class Slice:
    """The branch at one value of the second parameter.

    Attributes
    ----------
    value : value of the second parameter.
    segments : its segments in the order of the branch; empty if no gait was found.
    specials : one more than segments; the first and the last one are its ends.
    reason : why there is no segment.
    doubled : branches of doubled gaits that begin on this one; the first special point of each is the period doubling.
    """

    value: float
    segments: tuple[Segment, ...]
    specials: tuple[Record, ...]
    reason: str = ""
    doubled: tuple["Slice", ...] = ()

    @classmethod
    def from_record(cls, record: Record) -> "Slice":
        """The slice from its record, as a job of an atlas has stored it."""
        segments = tuple(
            Segment(modes=str(Cycle.from_record(points[0])), unstable=unstable_count(points), points=points)
            for points in record["segments"]
        )
        return cls(
            value=record["value"],
            segments=segments,
            specials=tuple(record["specials"]),
            reason=record.get("reason", ""),
            doubled=tuple(cls.from_record({"value": record["value"], **each}) for each in record.get("doubled", ())),
        )

    @property
    def reversed(self) -> "Slice":
        """The same branch in the opposite order."""
        swapped = tuple(
            {k: v for k, v in special.items() if k not in ("from", "to")}
            | {side: special[other] for side, other in (("from", "to"), ("to", "from")) if other in special}
            for special in self.specials[::-1]
        )
        segments = tuple(replace(segment, points=segment.points[::-1]) for segment in self.segments[::-1])
        return replace(self, segments=segments, specials=swapped)

    def turns(self, k: int) -> bool:
        """Whether the branch turns back at an inner special point: at a fold, or where modes change at a margin."""
        special, sides = self.specials[k], [each.middle["value"] for each in self.segments[k - 1 : k + 1]]
        return special["type"] == "fold" or bool(np.prod(np.array(sides) - special["value"]) > 0)

    @property
    def steps(self) -> int:
        """Number of steps of a cycle; 0 without a gait."""
        return len(self.segments[0].middle.get("steps", (1,))) if self.segments else 0

    @property
    def labels(self) -> list[tuple[str, int]]:
        """Labels of the segments."""
        return [segment.label for segment in self.segments]

    @property
    def types(self) -> list[str]:
        """Types of the special points; an end at a bound of the range has the type ``bound``."""
        return [type_of(special) for special in self.specials]


def type_of(special: Record) -> str:
    """Type of a special point; ``bound`` for an end that is a bound of the range."""
    return "bound" if special.get("bound") else str(special["type"])


def unstable_count(points: Sequence[Record]) -> int:
    """Number of multipliers outside the unit circle, that of most of the gaits."""
    counts = [sum(abs(complex(m["re"], m["im"])) > 1 for m in point["multipliers"]) for point in points]
    return max(set(counts), key=counts.count)


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """A curve of special points.

    Attributes
    ----------
    type : type of its special points.
    points : ndarray, shape (n, 2) - along the curve, in both parameters.
    located : ndarray, shape (m, 2) - its special points on branches, located to rounding.
    records : these special points.
    sheet : number of the sheet on which it lies or which it bounds.
    """

    type: str
    points: Array
    located: Array
    records: tuple[Record, ...]
    sheet: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Junction:
    """A point at which curves meet.

    Attributes
    ----------
    name : its type; empty where curves only leave the range.
    values : both parameters.
    types : types of the curves.
    within : half the distance of the branches between which it lies; zero if it is located.
    sheet : number of its sheet.
    """

    name: str
    values: tuple[float, float]
    types: tuple[str, ...]
    within: float
    sheet: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A connected set of gaits with one mode sequence and stability; or one without a gait.

    Attributes
    ----------
    modes : the mode sequence, ``no gait`` or ``unknown``.
    unstable : number of multipliers outside the unit circle; None without a gait.
    sheet : number of its sheet; -1 without a gait.
    pieces : polygons, one per pair of neighbouring branches; shape (n, 2) each.
    segments : its segments, each by the number of its branch and its own number there.
    """

    modes: str
    unstable: int | None
    sheet: int
    pieces: tuple[Array, ...]
    segments: tuple[tuple[int, int], ...] = ()

    @property
    def area(self) -> float:
        """Area in both parameters."""
        return sum(abs(signed_area(piece)) for piece in self.pieces)


@dataclass(frozen=True, kw_only=True)
class Arrangement:
    """Regions, curves, codimension-two points, and all points where curves meet, also at a bound of the range."""

    regions: tuple[Region, ...] = ()
    curves: tuple[Curve, ...] = ()
    junctions: tuple[Junction, ...] = ()
    meetings: tuple[Junction, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Traced:
    """A traced curve.

    Attributes
    ----------
    type : type of the special point from which it was traced.
    points : ndarray, shape (n, 2) - along the curve, in both parameters.
    specials : the codimension-two points that were located on it: type, and both parameters.
    steps : number of steps of its cycles.
    """

    type: str
    points: Array
    specials: tuple[tuple[str, tuple[float, float]], ...]
    steps: int = 1

    def covers(self, kind: str, point: Sequence[float], sizes: Array) -> bool:
        """Whether a special point lies on it, up to the distance of a chord from its arc."""
        return alike(kind, self.type) and _position(point, self.points, sizes)[0] < ON_CURVE

    @property
    def runs(self) -> list[Array]:
        """The pieces of the curve on which the second parameter is monotone, each ascending."""
        steps = np.sign(np.diff(self.points[:, 1]))
        cuts = [0, *(np.flatnonzero(np.diff(steps)) + 1), len(self.points) - 1]
        pieces = [self.points[first : last + 1] for first, last in pairwise(cuts)]
        return [piece if piece[0, 1] < piece[-1, 1] else piece[::-1] for piece in pieces if len(piece) > 1]


def ordered(slices: Iterable[Slice]) -> list[Slice]:
    """Slices ascending in the second parameter, each in the order that matches the one before it best.

    Beyond a fold a branch may have been followed from its other end.
    """
    found = list[Slice]()
    for each in sorted(slices, key=lambda each: each.value):
        before = next((other for other in reversed(found) if other.segments), None)
        if before is not None and _likeness(before, each.reversed) > _likeness(before, each):
            each = each.reversed
        found.append(each)
    return found


def _likeness(first: Slice, second: Slice) -> float:
    """How well the labels of segments and the types of special points of two branches match, from 0 to 2."""
    labels = SequenceMatcher(None, first.labels, second.labels, autojunk=False)
    return labels.ratio() + SequenceMatcher(None, first.types, second.types, autojunk=False).ratio()


def families(slices: Sequence[Slice]) -> list[list[Slice]]:
    """The slices of a family, then those of every family of doubled gaits that begins on it, and so on."""
    found, begun = [list(slices)], dict[int, list[tuple[int, Slice]]]()
    chains = curves_between(slices)
    for j, each in enumerate(slices):
        for doubled in each.doubled:
            origin = doubled.specials[0]["value"]
            for number, chain in enumerate(chains):
                if any(i == j and slices[j].specials[k]["value"] == origin for i, k in chain):
                    begun.setdefault(number, []).append((j, doubled))
    for known in begun.values():
        neighbours: list[list[Slice]] = [[]]
        for n, (j, doubled) in enumerate(known):
            if n and j != known[n - 1][0] + 1:
                neighbours.append([])
            neighbours[-1].append(doubled)
        for family in neighbours:
            found += families(family)
    return found


def curves_between(slices: Sequence[Slice]) -> list[list[Node]]:
    """The special points along every curve, upwards; without the bounds of the range."""
    links, _, _ = _linked(slices)
    return [chain for chain in _chains(slices, links) if type_of(slices[chain[0][0]].specials[chain[0][1]]) != "bound"]


def open_gaps(slices: Sequence[Slice], traces: Sequence[Traced], span: tuple[float, float]) -> list[int]:
    """Numbers of the slices that differ from the next one by more than the traces explain.

    Between the two, curves meet at a point that no trace has located, or a trace lies there between two of its
    codimension-two points or as a whole.
    """
    arrangement, values = _arranged(slices, span, traces), [each.value for each in slices]
    gaps = {int(np.searchsorted(values, j.values[1])) - 1 for j in arrangement.meetings if j.within}
    sizes = np.array([span[1] - span[0], values[-1] - values[0]])
    for trace in (trace for trace in traces if trace.steps == slices[0].steps):
        points = _distinct([point for name, point in trace.specials if name not in PASSED], sizes)
        edge, b = SAME_POINT * sizes[1], trace.points[:, 1]
        for j, (low, high) in enumerate(pairwise(values)):
            hidden = low + edge < b.min() and b.max() < high - edge
            if hidden or sum(low < b < high for _, b in points) > 1:
                gaps.add(j)
    return sorted(gaps)


def _distinct(points: Iterable[tuple[float, float]], sizes: Array) -> list[tuple[float, float]]:
    """Points without those that are the same as earlier ones."""
    found = list[tuple[float, float]]()
    for point in points:
        if all(np.abs((np.array(point) - other) / sizes).max() > SAME_POINT for other in found):
            found.append(point)
    return found


def arrange(slices: Sequence[Slice], span: tuple[float, float], traces: Sequence[Traced] = ()) -> Arrangement:
    """Regions, curves and junctions of a family and of the families of doubled gaits that begin on it.

    The numbers of slices in ``Region.segments`` are those of all ``families`` in a row.

    Parameters
    ----------
    slices : the branches, ascending in the second parameter.
    span : range of the first parameter.
    traces : the traced curves of special points.
    """
    arranged, count, sheets = list[Arrangement](), 0, 0
    for family in families(slices):
        own = [trace for trace in traces if trace.steps == family[0].steps or not family[0].steps]
        arranged.append(_arranged(family, span, own, count, sheets))
        count, sheets = count + len(family), 1 + max((r.sheet for r in arranged[-1].regions), default=sheets - 1)
    return Arrangement(
        regions=tuple(region for each in arranged for region in each.regions),
        curves=tuple(curve for each in arranged for curve in each.curves),
        junctions=tuple(junction for each in arranged for junction in each.junctions),
        meetings=tuple(meeting for each in arranged for meeting in each.meetings),
    )


def _arranged(
    slices: Sequence[Slice], span: tuple[float, float], traces: Sequence[Traced], count: int = 0, sheets: int = 0
) -> Arrangement:
    """Regions, curves and junctions of one family; earlier families have ``count`` slices and ``sheets`` sheets."""
    links, meetings, matched = _linked(slices)
    segments = [(j, i) for j, each in enumerate(slices) for i in range(len(each.segments))]
    joined = [((j, s), (j + 1, t)) for j, pairs in enumerate(matched) for s, t in pairs]
    straight = [((j, i - 1), (j, i)) for j, i in segments if i and not slices[j].turns(i)]
    region_of, sheet_numbers = _classes(segments, joined), _classes(segments, [*joined, *straight])

    def sheet_of(j: int, k: int) -> int:
        """Sheet of a special point; of a fold, that of the segment before it."""
        return sheets + sheet_numbers[j, min(max(k - 1, 0), len(slices[j].segments) - 1)]

    sizes = np.array([span[1] - span[0], slices[-1].value - slices[0].value or 1.0])
    links, meetings, tails = _explained(slices, links, meetings, traces, sizes)
    chains = list(_chains(slices, links))
    met = [_meeting_point(slices, chains, meeting) for meeting in meetings]
    met = [
        replace(at, values=(float(np.clip(at.values[0], *span)), at.values[1]), sheet=sheet_of(*meeting.nodes[0]))
        for meeting, at in zip(meetings, met, strict=True)
    ]
    curves, paths = list[Curve](), dict[tuple[Node, bool], Array]()
    for chain in chains:
        ends = [
            next((at.values for meeting, at in zip(meetings, met, strict=True) if node in meeting.sides[side]), None)
            if (node, bool(side)) not in tails
            else None
            for side, node in ((0, chain[0]), (1, chain[-1]))
        ]
        curve, own = _drawn(slices, chain, ends, traces, sizes)
        below, above = (tails.get(key, np.empty((0, 2))) for key in ((chain[0], False), (chain[-1], True)))
        curve = replace(curve, points=np.concatenate([below[:0:-1], curve.points, above[1:]]))
        paths |= own
        if curve.type != "bound":
            curves.append(replace(curve, sheet=sheet_of(*chain[0])))
    paths |= tails
    pieces: dict[int, list[Array]] = {number: [] for number in region_of.values()}
    for (j, i), polygon in _polygons(slices, matched, links, paths):
        pieces[region_of[j, i]].append(polygon)
    found = list[Region]()
    for number, polygons in pieces.items():
        inside = [(j, i) for j, i in segments if region_of[j, i] == number]
        j, i = inside[0]
        segment, numbers = slices[j].segments[i], tuple((j + count, i) for j, i in inside)
        found.append(
            Region(
                modes=segment.modes,
                unstable=segment.unstable,
                sheet=sheets + sheet_numbers[j, i],
                pieces=tuple(polygons),
                segments=numbers,
            )
        )
    junctions = [junction for junction in met if junction.name]
    for trace in traces:
        covered = (c.sheet for c in curves if any(trace.covers(c.type, point, sizes) for point in c.located.tolist()))
        sheet = next(covered, None)
        if sheet is None:  # between two branches
            sheet, empty = sheets, np.empty((0, 2))
            curves.append(Curve(type=trace.type, points=trace.points, located=empty, records=(), sheet=sheet))
        for name, point in trace.specials:
            apart = (np.abs((np.array(junction.values) - point) / sizes).max() for junction in junctions)
            if min(apart, default=np.inf) > SAME_POINT:
                junctions.append(Junction(name=name, values=point, types=(trace.type,), within=0.0, sheet=sheet))
    return Arrangement(
        regions=(
            *sorted(found, key=lambda region: -region.area),
            *(() if count else _outside(slices, span, links, paths, traces, sizes)),
        ),
        curves=tuple(curves),
        junctions=tuple(junctions),
        meetings=tuple(met),
    )


def _drawn(
    slices: Sequence[Slice],
    chain: Sequence[Node],
    ends: Sequence[tuple[float, float] | None],
    traces: Sequence[Traced],
    sizes: Array,
) -> tuple[Curve, dict[tuple[Node, bool], Array]]:
    """A curve, and its pieces from each special point upwards and downwards to the next one or to its end."""
    kind, located = type_of(slices[chain[0][0]].specials[chain[0][1]]), [_point(slices, node) for node in chain]
    known = [point for point in (ends[0], *located, ends[1]) if point is not None]
    runs = (run for trace in traces if alike(kind, trace.type) for run in trace.runs)
    covering = (run for run in runs if all(_position(point, run, sizes)[0] < ON_CURVE for point in located))
    inner = next(covering, np.empty((0, 2)))
    apart = np.abs(np.subtract.outer(inner[:, 1], [b for _, b in known])).min(axis=1, initial=np.inf)
    inner = inner[(inner[:, 1] > known[0][1]) & (inner[:, 1] < known[-1][1]) & (apart > SAME_POINT * sizes[1])]
    between = _smooth(np.concatenate([np.array(known), inner]))
    pieces = [between(first[1], last[1]) for first, last in pairwise(known)]
    paths = dict[tuple[Node, bool], Array]()
    for index, node in enumerate(chain, start=ends[0] is not None):
        if index:
            paths[node, False] = pieces[index - 1][::-1]
        if index < len(pieces):
            paths[node, True] = pieces[index]
    points = np.concatenate([*(piece[:-1] for piece in pieces), np.array(known[-1:])])
    records = tuple(slices[j].specials[k] for j, k in chain)
    return Curve(type=kind, points=points, located=np.array(located), records=records, sheet=0), paths


def _smooth(known: Array) -> Callable[[float, float], Array]:
    """The points of a curve a(b), between two values of b, that passes known points without overshoot; shape (n, 2)."""
    from scipy.interpolate import PchipInterpolator

    a, b = known[np.argsort(known[:, 1])].T
    cubic = PchipInterpolator(b, a) if len(known) > 1 else None

    def between(first: float, last: float) -> Array:
        assert cubic is not None
        values = np.unique(np.concatenate([np.linspace(first, last, SAMPLES), b[(b > first) & (b < last)]]))
        return np.column_stack([cubic(values), values])

    return between


def _polygons(
    slices: Sequence[Slice],
    matched: Sequence[Sequence[tuple[int, int]]],
    links: Mapping[Node, Node],
    paths: Mapping[tuple[Node, bool], Array],
) -> Iterator[tuple[Node, Array]]:
    """Each segment with the polygon between its branch and the next one: where it ends or begins between them."""
    side = partial(_side, links, paths)
    for j, pairs in enumerate(matched):
        partners, begun = dict(pairs), {t for _, t in pairs}
        for i in range(len(slices[j].segments)):
            t = partners.get(i)
            sides = (side((j, i + k), None if t is None else (j + 1, t + k)) for k in (0, 1))
            left, right = sides
            yield (j, i), np.concatenate([left, right[::-1]])
        for t in range(len(slices[j + 1].segments)):
            if t not in begun:
                left, right = (side(None, (j + 1, t + k)) for k in (0, 1))
                yield (j + 1, t), np.concatenate([left, right[::-1]])


def _side(
    links: Mapping[Node, Node], paths: Mapping[tuple[Node, bool], Array], below: Node | None, above: Node | None
) -> Array:
    """Between two branches, from special points of one to the other, or to where they meet others; shape (n, 2)."""
    nothing = np.empty((0, 2))
    up = nothing if below is None else paths.get((below, True), nothing)
    down = nothing if above is None or links.get(below or (-1, -1)) == above else paths.get((above, False), nothing)
    return np.concatenate([up, down[::-1]])


def alike(kind: str, traced: str) -> bool:
    """Whether a trace of this type may be that of a curve: a margin may change both phases and impact."""
    return kind == traced or (kind in MARGINS and traced in MARGINS)


def joins(name: str, kind: str) -> bool:
    """Whether a curve of a type begins, ends or is crossed at a codimension-two point of this name."""
    if name.startswith("margin_"):
        return kind in MARGINS or name.endswith(kind)
    return name not in PASSED and any(kind in kinds for kinds, known in MEETINGS.items() if known == name)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Meeting:
    """Special points of two neighbouring branches whose curves meet between them; name and point if they are known."""

    gap: int
    below: tuple[Node, ...]
    above: tuple[Node, ...]
    name: str = ""
    point: tuple[float, float] | None = None

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The special points on both sides."""
        return self.below + self.above

    @property
    def sides(self) -> tuple[tuple[Node, ...], tuple[Node, ...]]:
        """The special points from which curves leave upwards, and those at which curves arrive from below."""
        return self.above, self.below


def _linked(slices: Sequence[Slice]) -> tuple[dict[Node, Node], list[_Meeting], list[list[tuple[int, int]]]]:
    """Special points that one curve passes through, those whose curves meet, and the matched segments of every gap."""
    links, meetings, matched = dict[Node, Node](), list[_Meeting](), list[list[tuple[int, int]]]()
    for j, (first, second) in enumerate(pairwise(slices)):
        blocks = SequenceMatcher(None, first.labels, second.labels, autojunk=False).get_matching_blocks()
        pairs = [(block.a + k, block.b + k) for block in blocks for k in range(block.size)]
        matched.append(pairs)
        if not first.segments or not second.segments:
            continue
        all_pairs = [(-1, -1), *pairs, (len(first.segments), len(second.segments))]
        for (s, t), (s_next, t_next) in pairwise(all_pairs):
            below = tuple((j, k) for k in range(s + 1, s_next + 1))
            above = tuple((j + 1, k) for k in range(t + 1, t_next + 1))
            for lower, upper in _events(first, second, below, above):
                alone = (lower, upper) == (below, above) and len(lower) == len(upper) == 1
                if alone and first.types[lower[0][1]] == second.types[upper[0][1]]:
                    links[lower[0]] = upper[0]
                    continue
                meetings.append(_Meeting(gap=j, below=lower, above=upper))
    return links, meetings, matched


def _explained(
    slices: Sequence[Slice],
    links: Mapping[Node, Node],
    meetings: Sequence[_Meeting],
    traces: Sequence[Traced],
    sizes: Array,
) -> tuple[dict[Node, Node], list[_Meeting], dict[tuple[Node, bool], Array]]:
    """Links and meetings as the traces have them, and the traced curves from special points up or down to meetings.

    Curves that pass each other are linked; others meet at known points. A bound of the range ends where a curve leaves.
    """
    linked, found, tails = dict(links), list[_Meeting](), dict[tuple[Node, bool], Array]()
    for gap, group in groupby(meetings, key=lambda meeting: meeting.gap):
        together, between = list(group), (slices[gap].value, slices[gap + 1].value)
        known, through = list[tuple[str, tuple[float, float], Node]](), dict[int, Node]()
        kinds = {n: type_of(slices[n[0]].specials[n[1]]) for each in together for n in each.below + each.above}
        untraced, rest = set[Node](), set[Node]()
        for node, kind in kinds.items():
            upward = node[0] == gap
            number, event = _followed(_point(slices, node), kind, upward, between, traces, sizes)
            if event is not None:
                name, tails[node, upward] = event
                known.append((name, tuple(tails[node, upward][-1].tolist()), node))
            elif number is not None and not upward and number in through:
                linked[through[number]] = node
                rest.remove(through[number])
            else:
                rest.add(node)
                if number is None:
                    untraced.add(node)
                elif upward:
                    through[number] = node
        points = _distinct([point for _, point, _ in known], sizes)
        met = {
            point: [e for e in known if np.abs((np.array(e[1]) - point) / sizes).max() <= SAME_POINT]
            for point in points
        }
        names = {point: max((name for name, _, _ in entries), key=len) for point, entries in met.items()}
        nodes = {point: {node for _, _, node in entries} for point, entries in met.items()}
        for node in untraced & rest:
            if kinds[node] == "bound":
                a = _point(slices, node)[0]
                near = [point for point in points if abs(point[0] - a) < SAME_POINT * sizes[0]]
                near.sort(key=lambda point: point[1], reverse=node[0] > gap)
            else:
                near = [point for point in points if joins(names[point], kinds[node])]
            if near:
                nodes[near[0]].add(node)
                rest.remove(node)
        every = [*nodes.items(), *((None, {*each.below, *each.above} & rest) for each in together)]
        for at, members in every:
            below, above = (tuple(sorted(n for n in members if n[0] == gap + k)) for k in (0, 1))
            if at is None and _is_bound(slices, below, above):
                linked[below[0]] = above[0]
            elif members:
                name = "" if at is None else names[at]
                found.append(_Meeting(gap=gap, below=below, above=above, name=name, point=at))
    return linked, found, tails


def _is_bound(slices: Sequence[Slice], below: Sequence[Node], above: Sequence[Node]) -> bool:
    """Whether special points are the same bound of the range, with the same gaits beside it."""
    if len(below) != 1 or len(above) != 1:
        return False
    sides = [(slices[j], k, min(k, len(slices[j].segments) - 1)) for (j, k) in (*below, *above)]
    kinds, labels = ({each.types[k] for each, k, _ in sides}, {each.labels[i] for each, _, i in sides})
    return kinds == {"bound"} and len(labels) == 1


def _followed(
    start: tuple[float, float],
    kind: str,
    upward: bool,
    gap: tuple[float, float],
    traces: Sequence[Traced],
    sizes: Array,
) -> tuple[int | None, tuple[str, Array] | None]:
    """The number of the traced curve through a special point, and the first event on it in the gap beyond this point.

    The event is a codimension-two point at which other curves meet it, or an end of the curve, or the point where it
    turns back to the branch from which it came; it has its name and the curve that leads there, shape (n, 2). None if
    there is no such curve, or no event.
    """
    low, high = gap[0] + SAME_POINT * sizes[1], gap[1] - SAME_POINT * sizes[1]
    near = [(*_position(start, trace.points, sizes), n) for n, trace in enumerate(traces) if alike(kind, trace.type)]
    distance, at, number = min(near, default=(np.inf, 0.0, -1))
    if not distance < ON_CURVE:
        return None, None
    points = traces[number].points
    first = min(int(at), len(points) - 2)
    forward = (points[first + 1, 1] > points[first, 1]) == upward
    rest = points[first + 1 :] if forward else points[: first + 1][::-1]
    rest = rest[1:] if len(rest) and np.abs((rest[0] - start) / sizes).max() < SAME_POINT else rest
    inside = (rest[:, 1] > low) & (rest[:, 1] < high)
    count = len(rest) if inside.all() else int(np.argmin(inside))
    path = np.concatenate([[start], rest[: count + 1]])  # also the chord that leaves the gap
    events = [
        (*_position(point, path, sizes), name, point)
        for trace in traces
        for name, point in trace.specials
        if low < point[1] < high and joins(name, kind) and len(path) > 1
    ]
    on_path = [(position, name, point) for distance, position, name, point in events if distance < ON_CURVE]
    position, name, point = min(on_path, default=(np.inf, "", start))
    if on_path:
        return number, (name, np.concatenate([path[: int(np.ceil(position))], [point]]))
    if count == len(rest):
        return number, ("", path) if count else None
    if (rest[count, 1] <= low) == upward:  # it turns back
        turn = int(np.argmax(path[:, 1]) if upward else np.argmin(path[:, 1]))
        return number, ("", path[: turn + 1])
    return number, None


def _position(point: Sequence[float], points: Array, sizes: Array) -> tuple[float, float]:
    """Distance of a point from a line through points, relative to the ranges, and where it is nearest: point k at k."""
    starts, steps = points[:-1] / sizes, np.diff(points / sizes, axis=0)
    offsets = np.array(point) / sizes - starts
    fractions = np.clip((offsets * steps).sum(axis=1) / np.maximum((steps**2).sum(axis=1), np.finfo(float).tiny), 0, 1)
    distances = np.linalg.norm(offsets - fractions[:, None] * steps, axis=1)
    k = int(np.argmin(distances))
    return float(distances[k]), k + float(fractions[k])


def _events(
    first: Slice, second: Slice, below: tuple[Node, ...], above: tuple[Node, ...]
) -> Iterator[tuple[tuple[Node, ...], tuple[Node, ...]]]:
    """Special points that one event joins; what happens at a bound of the range happens elsewhere than the rest."""
    if len(below) + len(above) > 2:
        for end, rest in ((0, slice(1, None)), (-1, slice(None, -1))):
            if below and above and first.types[below[end][1]] == second.types[above[end][1]] == "bound":
                yield (below[end],), (above[end],)
                below, above = below[rest], above[rest]
    if below or above:
        yield below, above


def _chains(slices: Sequence[Slice], links: Mapping[Node, Node]) -> Iterator[list[Node]]:
    """Special points along every curve, upwards."""
    successors = set(links.values())
    for j, each in enumerate(slices):
        for k in range(len(each.specials)):
            if (j, k) in successors:
                continue
            chain = [(j, k)]
            while chain[-1] in links:
                chain.append(links[chain[-1]])
            yield chain


def _point(slices: Sequence[Slice], node: Node) -> tuple[float, float]:
    """Both parameters at a special point."""
    j, k = node
    return float(slices[j].specials[k]["value"]), slices[j].value


def _meeting_point(
    slices: Sequence[Slice],
    chains: Sequence[list[Node]],
    meeting: _Meeting,
) -> Junction:
    """The point where curves meet: a known one, else the one nearest to their tangents between the two branches."""
    if meeting.point is not None:
        kinds = {type_of(slices[j].specials[k]) for j, k in meeting.nodes}
        return Junction(name=meeting.name, values=meeting.point, types=tuple(sorted(kinds)), within=0.0, sheet=0)
    low, high = slices[meeting.gap].value, slices[meeting.gap + 1].value
    rows, nodes = list[tuple[float, float]](), meeting.nodes
    for node in nodes:
        chain = next(chain for chain in chains if node in chain)
        a, b = _point(slices, node)
        slope = 0.0
        if len(chain) > 1:
            other = _point(slices, chain[1] if node == chain[0] else chain[-2])
            slope = (other[0] - a) / (other[1] - b)
        rows.append((a - slope * b, slope))
    offsets, slopes = np.array(rows).T
    different = (high - low) * np.ptp(slopes)
    b = (low + high) / 2
    if len(nodes) > 1 and different > PARALLEL * np.ptp(offsets + slopes * b):
        _, b = np.linalg.lstsq(np.column_stack([np.ones_like(slopes), -slopes]), offsets, rcond=None)[0]
    edge = EDGE * (high - low)
    b = float(np.clip(b, low + edge, high - edge))
    estimate = np.array([np.mean(offsets + slopes * b), b])
    types = tuple(sorted({type_of(slices[j].specials[k]) for j, k in nodes}))
    values = float(estimate[0]), b
    return Junction(name=_name(types, len(nodes)), values=values, types=types, within=(high - low) / 2, sheet=0)


def _name(types: Sequence[str], count: int) -> str:
    """The type of the codimension-two point at which curves meet; empty where one turns back, or leaves the range."""
    kinds = set(types)
    bifurcations = kinds - set(MARGINS)
    if kinds & {"bound", END} or not kinds:
        return ""
    if not bifurcations:
        return "margin_crossing" if count > 2 or len(kinds) > 1 else ""
    if kinds - bifurcations:
        return f"margin_{min(bifurcations)}"
    return MEETINGS.get(frozenset(bifurcations), "")


def _outside(
    slices: Sequence[Slice],
    span: tuple[float, float],
    links: Mapping[Node, Node],
    paths: Mapping[tuple[Node, bool], Array],
    traces: Sequence[Traced],
    sizes: Array,
) -> Iterator[Region]:
    """What no gait of the family covers: without a gait beyond a traced end of the family or a fold, else unknown."""
    pieces: dict[str, list[Array]] = {NO_GAIT: [], UNKNOWN: []}
    for j, (first, second) in enumerate(pairwise(slices)):
        if not first.segments or not second.segments:
            low, high = first.value, second.value
            box = np.array([(span[0], low), (span[1], low), (span[1], high), (span[0], high)])
            pieces[UNKNOWN].append(box)
            continue
        for side, edge in ((min, span[0]), (max, span[1])):
            last = [side(range(len(e.specials)), key=lambda k, e=e: e.specials[k]["value"]) for e in (first, second)]  # type: ignore[misc]
            kinds = [each.types[k] for each, k in zip((first, second), last, strict=True)]
            if kinds == ["bound", "bound"]:
                continue
            nodes = [(j, last[0]), (j + 1, last[1])]
            ended = all(
                kind == "bound" or any(trace.covers(kind, _point(slices, node), sizes) for trace in traces)
                for kind, node in zip(kinds, nodes, strict=True)
            )
            corners = np.array([(edge, second.value), (edge, first.value)])
            up, down = paths.get((nodes[0], True)), paths.get((nodes[1], False))
            joined = up is not None and down is not None and np.abs((up[-1] - down[-1]) / sizes).max() < SAME_POINT
            closed = links.get(nodes[0]) == nodes[1] or joined
            boundary = np.concatenate([_side(links, paths, *nodes), corners])
            pieces[NO_GAIT if ended and closed else UNKNOWN].append(boundary)
    for modes, polygons in pieces.items():
        if polygons:
            yield Region(modes=modes, unstable=None, sheet=-1, pieces=tuple(polygons))


def signed_area(polygon: Array) -> float:
    """Area of a polygon, shape (n, 2); negative if it is clockwise."""
    x, y = polygon.T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2


def _classes(keys: Sequence[Node], joined: Iterable[tuple[Node, Node]]) -> dict[Node, int]:
    """The number of the class of every key, where joined keys are in one class; large classes first."""
    of = {key: [key] for key in keys}
    for first, second in joined:
        if of[first] is not of[second]:
            of[first].extend(of[second])
            of.update(dict.fromkeys(of[second], of[first]))
    classes = sorted({id(each): each for each in of.values()}.values(), key=lambda each: (-len(each), min(each)))
    return {key: number for number, members in enumerate(classes) for key in members}
