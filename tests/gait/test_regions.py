"""The arrangement of branches into regions, curves and the points where curves meet, on families with closed forms."""

from itertools import pairwise
from math import pi

import numpy as np
import pytest

from gaitopt.gait.regions import NO_GAIT, UNKNOWN, Arrangement, Slice, Traced, arrange, families, open_gaps, ordered

SPAN = (0.0, 1.0)
MODES = {"phases": [{"mode": "stick", "duration": 1.0}], "impact": "stick"}
SLIPS = {"phases": [{"mode": "slip_forward", "duration": 1.0}], "impact": "slip_forward"}


def gait(a: float, radius: float, modes=MODES) -> dict:
    """What is known of a gait with one multiplier."""
    return {"value": a, "multipliers": [{"re": radius, "im": 0.0}], "spectral_radius": radius, **modes}


def branch(b: float, cuts: list[tuple[str, float]], radii: list[float], modes=None) -> Slice:
    """A branch whose special points are ``cuts``, with one gait in the middle of every segment."""
    specials = [{"type": kind, "value": a, "bound": kind == "end"} for kind, a in cuts]
    middles = [(first + last) / 2 for (_, first), (_, last) in pairwise(cuts)]
    every = modes or [MODES] * len(radii)
    segments = [[gait(a, radius, m)] for a, radius, m in zip(middles, radii, every, strict=True)]
    return Slice.from_record({"value": b, "segments": segments, "specials": specials})


def areas(found: Arrangement) -> list[float]:
    return [region.area for region in found.regions]


def test_a_straight_curve_divides_the_range_into_two_regions_of_known_area() -> None:
    slices = [
        branch(b, [("end", 0.0), ("period_doubling", 0.2 + 0.4 * b), ("end", 1.0)], [2.0, 0.5])
        for b in np.linspace(0, 1, 4).tolist()
    ]
    found = arrange(slices, SPAN)
    assert [(region.unstable, region.sheet) for region in found.regions] == [(0, 0), (1, 0)]
    assert areas(found) == pytest.approx([0.6, 0.4])
    (curve,) = found.curves
    assert curve.type == "period_doubling"
    assert curve.points[:, 0] == pytest.approx(0.2 + 0.4 * curve.points[:, 1])
    assert not found.junctions


def crossing(b: float) -> Slice:
    """Two margins, a = b and a = 1 - b, of which the first also ends the stability."""
    low, high = sorted((b, 1 - b))
    middle = 2.0 if b < 0.5 else 0.25
    first = "mode_change" if b < 0.5 else "period_doubling"
    last = "period_doubling" if b < 0.5 else "mode_change"
    modes = [MODES, SLIPS if b < 0.5 else MODES, SLIPS]
    radii = [2.0, middle, 0.5]
    return branch(b, [("end", 0.0), (first, low), (last, high), ("end", 1.0)], radii, modes)


def test_curves_meet_where_their_tangents_do_and_regions_fill_the_range() -> None:
    slices = [crossing(b) for b in (0.1, 0.2, 0.3, 0.65, 0.8, 0.9)]
    found = arrange(slices, SPAN)
    (junction,) = found.junctions
    assert junction.values == pytest.approx((0.5, 0.5))
    assert junction.name == "margin_period_doubling"
    assert junction.within == pytest.approx(0.175)
    assert sum(areas(found)) == pytest.approx(0.8)  # of the slices between 0.1 and 0.9
    assert open_gaps(slices, [], SPAN) == [2]


def test_a_trace_gives_a_curve_its_points_and_meetings_their_places() -> None:
    bent = np.linspace(0, 1, 41)
    line = np.column_stack([0.5 + 0.1 * np.sin(pi * bent), bent])
    slices = [branch(b, [("end", 0.0), ("fold", 0.5 + 0.1 * np.sin(pi * b))], [0.5]) for b in (0.0, 0.5, 1.0)]
    cubic, traced = (arrange(slices, SPAN, traces) for traces in ([], [Traced(type="fold", points=line, specials=())]))
    exact = 0.5 + 0.2 / pi
    assert traced.regions[0].area == pytest.approx(exact, abs=2e-4)
    assert abs(cubic.regions[0].area - exact) > 1e-3
    slices = [crossing(b) for b in (0.1, 0.3, 0.65, 0.9)]
    located = (("margin_period_doubling", (0.5, 0.5)),)
    for along in (bent, bent[[0, -1]]):  # a chord may also lead beyond the next branch
        traces = [Traced(type="mode_change", points=np.column_stack([along, along]), specials=located)]
        found = arrange(slices, SPAN, traces)
        assert [(j.name, j.values, j.within) for j in found.junctions] == [(*located[0], 0.0)]
        assert open_gaps(slices, traces, SPAN) == []


def test_a_curve_that_turns_back_and_leaves_the_range_bounds_its_region_exactly() -> None:
    """a = 0.3 - 5 (b - 0.45)^2 between two branches; the bound a = 0 ends where it leaves."""
    b = np.linspace(0.3, 0.45 + np.sqrt(0.06), 400)
    fold = Traced(type="impact_change", points=np.column_stack([0.3 - 5 * (b - 0.45) ** 2, b])[::-1], specials=())
    low = branch(0.3, [("end", 0.0), ("impact_change", fold.points[-1, 0]), ("end", 1.0)], [0.5, 0.5], [SLIPS, MODES])
    high = branch(0.8, [("end", 0.0), ("end", 1.0)], [0.5], [MODES])
    found = arrange([low, high], SPAN, [fold])
    inside = np.trapezoid(fold.points[::-1, 0], fold.points[::-1, 1])
    assert sorted(areas(found)) == pytest.approx([inside, 0.5 - inside], rel=1e-9)
    assert open_gaps([low, high], [fold], SPAN) == []
    assert [meeting.types for meeting in found.meetings] == [("bound", "impact_change")]


def test_curves_that_leave_the_range_between_the_same_branches_do_not_meet() -> None:
    bent = np.linspace(0, 1, 41)
    lines = [
        Traced(type="mode_change", points=np.column_stack([bent - c, bent])[bent >= c], specials=())
        for c in (0.25, 0.5)
    ]
    below = branch(0.1, [("end", 0.0), ("end", 1.0)], [0.5])
    above = branch(
        0.9,
        [("end", 0.0), ("mode_change", 0.4), ("mode_change", 0.65), ("end", 1.0)],
        [2.0, 0.5, 0.5],
        [MODES, SLIPS, MODES],
    )
    found = arrange([below, above], SPAN, lines)
    assert not found.junctions
    assert sorted(meeting.values for meeting in found.meetings) == [(0.0, 0.25), (0.0, 0.5)]
    assert sum(areas(found)) == pytest.approx(0.8)


def test_what_traces_do_not_explain_calls_for_another_branch() -> None:
    unseen = np.column_stack([np.full(5, 0.3), np.linspace(0.4, 0.6, 5)])
    slices = [branch(b, [("end", 0.0), ("end", 1.0)], [0.5]) for b in (0.0, 1.0)]
    assert open_gaps(slices, [], SPAN) == []
    assert open_gaps(slices, [Traced(type="fold", points=unseen, specials=())], SPAN) == [0]
    other = [slices[0], branch(1.0, [("end", 0.0), ("end", 1.0)], [2.0])]  # a bifurcation in between
    assert open_gaps(other, [], SPAN) == [0]


def test_families_of_doubled_gaits_lie_on_sheets_of_their_own() -> None:
    two = {**MODES, "n_steps": 2, "steps": [MODES, MODES]}

    def doubling(b: float) -> Slice:
        origin, last = {"type": "period_doubling", "value": 0.6}, {"type": "lift_off", "value": 0.2}
        doubled = {"segments": [[gait(0.4, 0.5, two)]], "specials": [origin, last], "doubled": []}
        base = branch(b, [("end", 0.0), ("period_doubling", 0.6), ("end", 1.0)], [2.0, 0.5])
        records = [list(segment.points) for segment in base.segments]
        return Slice.from_record({"value": b, "segments": records, "specials": base.specials, "doubled": [doubled]})

    slices = [doubling(b) for b in (0.0, 0.5, 1.0)]
    assert [len(family) for family in families(slices)] == [3, 3]
    found = arrange(slices, SPAN)
    assert [(region.sheet, round(region.area, 9)) for region in found.regions] == [(0, 0.6), (0, 0.4), (1, 0.4)]
    assert found.regions[2].segments == ((3, 0), (4, 0), (5, 0))


def test_folds_separate_sheets_and_beyond_a_fold_there_is_no_gait() -> None:
    for kind in ("fold", "impact_change"):  # a branch may also turn back where its modes change
        cuts = [("end", 0.0), ("fold", 0.8), (kind, 0.3), ("end", 1.0)]
        regions = arrange([branch(b, cuts, [0.5, 2.0, 0.5], [SLIPS, SLIPS, MODES]) for b in (0.0, 1.0)], SPAN).regions
        assert sorted((region.sheet, round(region.area, 9)) for region in regions) == [(0, 0.8), (1, 0.5), (2, 0.7)]
    slices = [branch(b, [("end", 0.0), ("lift_off", 0.75)], [0.5]) for b in (0.0, 1.0)]
    end = Traced(type="lift_off", points=np.array([(0.75, 0.0), (0.75, 1.0)]), specials=())
    for traces, words in (([end], NO_GAIT), ([], UNKNOWN)):
        regions = arrange(slices, SPAN, traces).regions
        assert [(region.modes, round(region.area, 9)) for region in regions] == [("stick; stick", 0.75), (words, 0.25)]


def test_a_branch_that_was_followed_from_its_other_end_is_turned_round() -> None:
    cuts = [("end", 0.0), ("fold", 0.8), ("period_doubling", 0.4), ("lift_off", 0.3)]
    slices = [branch(b, cuts, [0.5, 2.0, 0.5], [MODES, MODES, SLIPS]) for b in (0.0, 0.5, 1.0)]
    assert ordered([slices[2], slices[1].reversed, slices[0]]) == slices
    assert ordered([slices[0], slices[1].reversed]) == slices[:2]


def test_an_end_that_nothing_explains_leaves_the_rest_unknown() -> None:
    lost = [{"type": "end", "value": 0.0, "bound": True}, {"type": "end", "value": 0.6}]
    slices = [Slice.from_record({"value": b, "segments": [[gait(0.3, 0.5)]], "specials": lost}) for b in (0.0, 1.0)]
    nothing = Slice.from_record({"value": 2.0, "segments": [], "specials": [], "reason": "no gait"})
    found = arrange([*slices, nothing], SPAN)
    assert [(region.modes, round(region.area, 9)) for region in found.regions] == [
        ("stick; stick", 0.6),
        ("unknown", 1.4),
    ]
