"""The arrangement of branches into regions, curves and the points where curves meet, on families with closed forms."""

from itertools import pairwise
from math import pi

import numpy as np
import pytest

from gaitopt.gait.regions import NO_GAIT, Arrangement, Slice, Traced, arrange, compound_gaps, open_gaps

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
    assert compound_gaps(slices) == []


def test_a_trace_gives_a_curve_its_points_and_meetings_their_places() -> None:
    bent = np.linspace(0, 1, 41)
    line = np.column_stack([0.5 + 0.1 * np.sin(pi * bent), bent])
    slices = [branch(b, [("end", 0.0), ("fold", 0.5 + 0.1 * np.sin(pi * b))], [0.5]) for b in (0.0, 0.5, 1.0)]
    cubic, traced = (arrange(slices, SPAN, traces) for traces in ([], [Traced(type="fold", points=line, specials=())]))
    exact = 0.5 + 0.2 / pi
    assert traced.regions[0].area == pytest.approx(exact, abs=2e-4)
    assert abs(cubic.regions[0].area - exact) > 1e-3
    slices = [crossing(b) for b in (0.1, 0.3, 0.65, 0.9)]
    located = {"type": "margin_period_doubling", "values": (0.51, 0.49)}
    diagonal = np.column_stack([bent, bent])
    found = arrange(slices, SPAN, [Traced(type="period_doubling", points=diagonal, specials=(located,))])
    assert [(j.values, j.within) for j in found.junctions] == [((0.51, 0.49), 0.0)]
    assert open_gaps(slices, [Traced(type="period_doubling", points=diagonal, specials=(located,))], SPAN) == []


def test_folds_separate_sheets_and_beyond_a_fold_there_is_no_gait() -> None:
    cuts = [("end", 0.0), ("fold", 0.8), ("fold", 0.3), ("end", 1.0)]
    found = arrange([branch(b, cuts, [0.5, 2.0, 0.5]) for b in (0.0, 1.0)], SPAN)
    assert sorted((region.sheet, round(region.area, 9)) for region in found.regions) == [(0, 0.8), (1, 0.5), (2, 0.7)]
    ended = arrange([branch(b, [("end", 0.0), ("lift_off", 0.75)], [0.5]) for b in (0.0, 1.0)], SPAN)
    assert [(region.words, round(region.area, 9)) for region in ended.regions] == [
        ("stick; stick", 0.75),
        (NO_GAIT, 0.25),
    ]


def test_an_end_that_nothing_explains_leaves_the_rest_unknown() -> None:
    lost = [{"type": "end", "value": 0.0, "bound": True}, {"type": "end", "value": 0.6}]
    slices = [Slice.from_record({"value": b, "segments": [[gait(0.3, 0.5)]], "specials": lost}) for b in (0.0, 1.0)]
    nothing = Slice.from_record({"value": 2.0, "segments": [], "specials": [], "reason": "no gait"})
    found = arrange([*slices, nothing], SPAN)
    assert [(region.words, round(region.area, 9)) for region in found.regions] == [
        ("stick; stick", 0.6),
        ("unknown", 1.4),
    ]
