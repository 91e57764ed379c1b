"""Special points followed in two parameters, against closed forms, branches in one parameter and each other."""

import json
import re
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice, pairwise
from math import cos, radians, sin
from types import SimpleNamespace

import numpy as np
import pytest
from named import named, special_of
from oracles import crawl, wheel_friction
from scipy.optimize import brentq

import gaitopt as go
from gaitopt import Cycle, continuation, load_run, trace
from gaitopt.api.stored import load_curve_start
from gaitopt.branches.conditions import Eigenvalue, MarginZero, Pair
from gaitopt.branches.curve import Curve, Metric
from gaitopt.branches.monitors import MonitorValue, monitor_values
from gaitopt.branches.normal_forms import local_map
from gaitopt.branches.trace import CurveWalk, follow_curve, traced_start
from gaitopt.errors import ProblemError, StorageError, UnknownNameError
from gaitopt.gait.trace import CurveStart, MonitorKey, TracePoint, TraceSpecial
from gaitopt.requests import TraceRequest
from gaitopt.runs.trace import TRACE_FILE, traced_family
from gaitopt.simulation.simulator import Simulator
from gaitopt.solver.assembly import solution_of
from gaitopt.solver.newton import Solution, polish
from gaitopt.store.branch import resumable_trace, stored_traces
from gaitopt.store.files import lines_text, read_lines
from gaitopt.store.gaits import trace_special
from gaitopt.store.run import Run

SLOPE, ANKLE, HIP = "walker.slope", "control.ankle", "control.hip"
AGREEMENT = 1e-9
"""Largest difference between a curve and a branch, relative to the first parameter, at least 1."""
ASIDE = 2e-4
"""Distance from a curve at which a branch begins, relative to the first parameter, at least 1."""


@cache
def special(name, kind, parameter, to, index=0, changes=()):
    """A special point of the family of a named gait, at other values of some parameters."""
    gait = named(name) if not changes else go.solve(go.load_problem(name).replace(dict(changes)), progress=False)
    return special_of(gait, parameter, to, kind, index)


def doubling():
    return special("compass-passive-b", "period_doubling", "friction", 0.146)


def torus():
    return special("compass-passive-a", "neimark_sacker", "friction", 0.108)


@cache
def torque_branch():
    return continuation(named("compass-torque-stick"), HIP, 0.3, max_points=60, verify_every=0, progress=False)


def fold():
    return torque_branch().special("fold")[0]


def impact_change():
    return torque_branch().special("impact_change")[0]


def jump():
    return special("compass-passive-a", "impact_change", "friction", 0.06)


def cut(point, first, kind):
    """The value of the first parameter at which a branch in it has the special point; None if it has none."""
    value, found = point.values[first], []
    aside = ASIDE * max(1.0, abs(value))
    options = {"verify_every": 0, "progress": False}
    for side in (aside, -aside):
        away = continuation(point.gait, first, value + side, max_points=40, **options)
        if not found and len(away) > 1:
            back = continuation(away.points[-1].gait, first, value - side, max_points=60, **options)
            found = [each.value for each in back.special(kind) if not each.bound]
    return min(found, key=lambda other: abs(other - value), default=None)


# ---- conditions


def conditions(gait):
    monitors = [key for key in monitor_values(gait) if key.kind != "touchdown"]  # which stays far from the ground
    return [Eigenvalue(1.0), Eigenvalue(-1.0), Pair(-0.15), *map(MarginZero, monitors)]


def test_conditions_have_the_slopes_of_their_values_on_the_surface_of_gaits():
    gait, step = torus().gait, 1e-6
    at = solution_of(gait, ("friction", SLOPE))
    curve = Curve(gait.problem, SLOPE, at.equations, at.p, Metric.of(gait, 0.05, (0.1,)), Eigenvalue(1.0))
    plane = curve.solutions.equations.at(at.w).plane
    assert max(np.abs(at.jacobian @ direction).max() for direction in plane) < 1e-13
    sides = [[polish(Solution(at.equations, at.w + side * each, at.p)) for side in (step, -step)] for each in plane]
    for condition in conditions(gait):
        expected = [(condition.value(plus) - condition.value(minus)) / (2 * step) for plus, minus in sides]
        assert condition.slopes(at, plane) == pytest.approx(expected, rel=1e-4, abs=1e-7), condition


def test_monitors_have_the_values_of_those_of_a_branch():
    gait = torus().gait
    at = solution_of(gait, ("friction", SLOPE))
    for condition in conditions(gait)[3:]:
        assert condition.value(at) == pytest.approx(monitor_values(gait)[condition.key].value, rel=1e-9, abs=1e-11)
    toe, gait = MonitorKey("gap.swing_toe", 1), named("heel-toe")  # lowest in an arc that does not begin with the step
    at = solution_of(gait, ("friction", SLOPE))
    assert MarginZero(toe).value(at) == pytest.approx(monitor_values(gait)[toe].value, rel=1e-9)


# ---- closed forms


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "targets", "options", "friction"),
    [
        (("stick", "mode_change", "friction", 0.91), (12, 13.4), {"upper": 1.6}, wheel_friction),
        # the family ends where the slip no longer comes to rest; that end is a margin, and has a curve
        (("slip", "end", "friction", 0.22), (13.2, 12.8), {"max_points": 12}, np.tan),
    ],
)
def test_friction_of_a_wheel_is_that_of_the_closed_form_on_every_slope(start, targets, options, friction):
    """That which it needs to stick, and that on which it slides without end."""
    name, *place = start
    curve = trace(special(f"rimless-wheel-{name}", *place), SLOPE, (*np.radians(targets),), progress=False, **options)
    assert len(curve) > 20
    for point in curve:
        assert point.values["friction"] == pytest.approx(friction(point.values[SLOPE]), rel=0, abs=AGREEMENT)


def crawler_friction(front, slope):
    """Friction of the rear mass that holds it while the front one slides, where their gap is least."""
    along, normal = 9.81 * sin(slope), 9.81 * cos(slope)

    def missing(rear):
        return 4.95 + 20 * (0.5 - crawl(front, rear, slope).smallest) - along - rear * normal

    return brentq(missing, 0.1, 2.0, xtol=1e-14)


@pytest.mark.parametrize(
    ("key", "points"),
    [(SLOPE, 6), *(pytest.param(key, 100, marks=pytest.mark.slow) for key in ("friction.front", SLOPE))],
)
def test_friction_that_holds_the_crawler_is_that_of_the_closed_form(key, points):
    slips = special("crawler", "mode_change", "friction.rear", 0.57)
    value = slips.gait.dynamics.parameter(key)
    curve = trace(slips, key, (value + 0.01, value - 0.008), max_points=points, progress=False)
    if points > 6:
        ends = {f"reached {key} = {value + d:.12g}" for d in (0.01, -0.008)}
        assert {end.reason for end in curve.specials} == ends
    for point in curve:
        parameters = point.gait.dynamics.parameters
        expected = crawler_friction(parameters["friction.front"], parameters[SLOPE])
        assert point.values["friction.rear"] == pytest.approx(expected, rel=0, abs=AGREEMENT)


# ---- bifurcations


@pytest.mark.slow
def test_the_neimark_sacker_curve_passes_two_resonances_and_ends_in_the_third_where_the_period_doubles():
    curve = trace(torus(), SLOPE, (radians(0.5), radians(2.6)), progress=False)
    assert curve.points[0].values["friction"] == pytest.approx(0.1103495808, rel=0, abs=1e-10)
    known = {
        "resonance_1_4": (0.0930353699, 0.6513085669, 0.0),
        "resonance_1_3": (0.1301103020, 1.5988287339, -0.5),
        "resonance_1_2": (0.1450186084, 2.2489269257, -1.0),
    }
    for name, (friction, slope, kappa) in known.items():
        (found,) = curve.special(name)
        assert found.status == "converged"
        assert found.values["friction"] == pytest.approx(friction, rel=0, abs=1e-8)
        assert np.degrees(found.values[SLOPE]) == pytest.approx(slope, rel=0, abs=1e-8)
        pair = sorted(found.gait.multipliers, key=lambda value: abs(abs(value) - 1))[:2]
        assert (pair[0] + pair[1]).real / 2 == pytest.approx(kappa, abs=1e-10)
        assert found.coefficients == {"re_d": None, "im_d": None}
    (strong,) = curve.special("resonance_1_2")
    (begins,) = strong.next
    assert begins.type == "period_doubling"
    doubled = trace(begins, SLOPE, (radians(3.0), radians(2.0)), progress=False)
    for point in doubled:
        assert np.abs(point.gait.multipliers + 1).min() < 1e-6
    assert doubled.points[0].values == pytest.approx(strong.values, abs=1e-9)
    assert not doubled.special("resonance_1_2")  # it begins there


@pytest.mark.slow
def test_a_fold_meets_the_change_of_its_impact_where_that_curve_meets_the_fold():
    ankle = named("compass-torque-stick").dynamics.parameter(ANKLE)
    folds, changes = (trace(begin, ANKLE, ankle + 1.6, progress=False) for begin in (fold(), impact_change()))
    places = [curve.special("margin_fold")[0].values for curve in (folds, changes)]
    assert places[0] == pytest.approx(places[1], rel=0, abs=1e-8)
    meeting = folds.special("margin_fold")[0]
    assert meeting.before != meeting.after
    assert [start.type for start in meeting.next] == ["margin"]
    past = [point for point in folds if point.curve > meeting.curve]
    assert len(past) > 3
    assert all(np.abs(point.gait.multipliers - 1).min() < 1e-9 for point in past)
    (crossing,) = changes.special("margin_crossing")
    assert (crossing.codimension, crossing.status) == (2, "converged")
    other = trace(crossing.next[0], ANKLE, ankle + 1.2, progress=False, max_points=5)
    assert other.points[0].values == pytest.approx(crossing.values, rel=0, abs=1e-8)


@pytest.mark.slow
def test_a_branch_point_of_equal_halves_is_traced_as_the_period_doubling_of_one_half():
    gait = doubling().gait
    state = dict(zip(gait.system.state_names, gait.state, strict=True))
    twice = gait.problem.with_modes(Cycle(gait.cycle.steps * 2), state).replace({"friction": 0.1441})
    branch = continuation(go.solve(twice, progress=False), "friction", 0.1445, verify_every=0, progress=False)
    (point,) = branch.special("branch_point")
    curve = trace(point, SLOPE, radians(1.01), max_points=3, progress=False)
    assert curve.points[0].values["friction"] == pytest.approx(doubling().value, rel=0, abs=AGREEMENT)
    assert all(len(point.gait.steps) == 1 for point in curve)


@pytest.mark.slow
def test_a_bifurcation_curve_ends_where_the_multipliers_jump_and_names_both_spectra():
    """Where the impact begins to slip, the gait loses the multiplier -1; the margin goes on from there."""
    flips = special("compass-passive-a", "period_doubling", "friction", 0.08)
    curve = trace(flips, SLOPE, radians(0.6), verify_every=0, progress=False)
    meeting, end = curve.specials[-2:]
    assert (meeting.type, end.type, end.codimension, end.status) == ("margin_period_doubling", "end", 2, "converged")
    assert meeting.values == pytest.approx(end.values)
    assert np.degrees(meeting.values[SLOPE]) == pytest.approx(0.702778337, abs=1e-6)
    before, after = re.search(r"the multipliers jump there: (.+) before, (.+) after", end.reason).groups()
    assert "-1" in before.split(", ")
    assert "-1" not in after.split(", ")
    assert meeting.next[0].type == "margin"


@pytest.mark.slow
def test_a_margin_has_the_bifurcations_of_the_gaits_on_both_sides_where_the_multipliers_jump():
    """Gaits whose impact slips double on a curve that ends on the margin of the impact, and leads to less friction."""
    curve = trace(jump(), SLOPE, radians(0.25), verify_every=0, progress=False)
    sticks, slips = curve.special("margin_period_doubling")
    assert np.degrees(sticks.values[SLOPE]) == pytest.approx(0.702778337, abs=1e-8)
    assert slips.reason == f"of the gait {slips.after}"
    assert "slip_backward" in slips.after.steps[0].impact
    record, family = json.loads(json.dumps(slips.to_record())), traced_family(jump().gait.problem, "friction", SLOPE)
    (begins,) = trace_special(family, "friction", record).next
    doubled = trace(begins, SLOPE, (radians(0.233), radians(0.4)), verify_every=0, progress=False)
    down, up = doubled.special("end")
    assert down.values["friction"] == pytest.approx(0.05001, abs=1e-5)
    assert up.values == pytest.approx(slips.values, rel=0, abs=1e-9)  # it ends on the margin, located by itself
    for point in doubled:
        assert np.abs(point.gait.multipliers + 1).min() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("first", ["friction", "walker.toe"])
def test_a_curve_goes_on_where_a_phase_of_a_contact_vanishes(first):
    """Where the heel no longer slips, friction does not matter: the sticking gait doubles at one length of the toe.

    It begins to slip where the branch of this sticking gait in friction has its change of modes.
    """
    slipping = special("heel-toe", "mode_change", "friction", 0.27).after
    origin = special("heel-toe-slip", "period_doubling", "walker.toe", 0.06)
    start = CurveStart(type="period_doubling", parameter=first, gait=origin.gait)
    key, to = ("friction", 0.35) if first == "walker.toe" else ("walker.toe", 0.06)
    curve = trace(start, key, to, upper=0.35 if key == "walker.toe" else None, verify_every=0, progress=False)
    heel, end = curve.specials
    assert [heel.type, end.type] == ["margin_period_doubling", "end"]
    assert (heel.status, heel.before, len(heel.after.phases)) == ("converged", slipping, 2)
    assert "heel slip_forward" in heel.reason
    assert end.reason == "reached friction = 0.35"
    stuck = continuation(named("heel-toe"), "walker.toe", 0.06, verify_every=0, progress=False)
    length = stuck.special("period_doubling")[0].value
    assert [special.values["walker.toe"] for special in (heel, end)] == pytest.approx(
        [length] * 2, rel=0, abs=AGREEMENT
    )
    longer = stuck.special("period_doubling")[0].gait
    slips = continuation(longer, "friction", 0.27, verify_every=0, progress=False).special("mode_change")[0]
    assert heel.values["friction"] == pytest.approx(slips.value, rel=0, abs=AGREEMENT)
    durations = [arc.duration for point in curve for step in point.gait.steps for arc in step.arcs]
    assert min(durations) > -1e-6  # half the digits, where a phase vanishes
    assert not curve.special("generalised_flip")


@pytest.mark.slow
def test_heel_toe_doubles_on_one_curve_only_where_its_strike_slips_and_on_another_where_it_sticks():
    """A gait whose strike would have to slip has a multiplier -1 at friction 0.2092 and toe 0.02: it is none."""
    toe = continuation(named("heel-toe"), "walker.toe", 0.02, verify_every=0, progress=False).points[-1].gait
    (doubles,) = continuation(toe, "friction", 0.19, verify_every=0, progress=False).special("period_doubling")
    assert doubles.value == pytest.approx(0.27016431343, abs=1e-9)
    slips = special("heel-toe", "impact_change", "friction", 0.25)
    margins = trace(slips, "walker.toe", 0.06, verify_every=0, progress=False)
    (meeting,) = margins.special("margin_period_doubling")
    (flips,) = (start for start in meeting.next if start.type == "period_doubling")
    for start, to in ((flips, 0.02), (doubles, 0.06)):
        curve = trace(start, "walker.toe", to, verify_every=0, progress=False)
        end = curve.specials[-1]
        assert (end.type, end.codimension) == ("end", 2)
        assert "the multipliers jump there" in end.reason
        for point in curve:
            assert min(monitor.value for monitor in monitor_values(point.gait).values()) > -1e-6


@pytest.mark.slow
def test_the_margin_of_the_doubled_gait_is_tangent_to_the_period_doublings_that_meet_the_margin():
    """Colombo & Dercole (2010): their distance grows like the square of that between the halves of the gait."""
    changes = special("compass-passive-a", "mode_change", "friction", 0.174)
    meeting = trace(changes, SLOPE, 0.0935, verify_every=0, progress=False).special("margin_period_doubling")[0]
    flips, doubled = meeting.next
    assert (flips.type, doubled.type, len(doubled.gait.steps)) == ("period_doubling", "margin", 2)
    curve = trace(doubled, SLOPE, 0.0938, max_points=4, progress=False)
    ratios = []
    for point in curve:
        first, second = (step.arcs[0].states[0] for step in point.gait.steps)
        beside = trace(flips, SLOPE, point.values[SLOPE], verify_every=0, progress=False).special("end")[0]
        apart = point.values["friction"] - beside.values["friction"]
        ratios.append(apart / np.abs(first - second).max() ** 2)
    assert ratios == pytest.approx([ratios[0]] * len(ratios), rel=0.05)
    (end,) = trace(doubled, SLOPE, 0.0925, verify_every=0, progress=False).specials  # not a fold, as rounding says
    assert "the two halves of the cycle become equal" in end.reason
    assert end.values == pytest.approx(meeting.values, rel=0, abs=1e-6)


@pytest.mark.slow
def test_doubled_gaits_grow_as_the_coefficient_of_the_flip_says():
    """x -> mu x + c x^3 with mu = -1 - a has the doubled amplitude x^2 = a / c: extrapolated to the doubling."""
    origin = doubling()
    gait, branch = origin.gait, continuation(origin, "friction", origin.value - 1e-3, max_points=8, progress=False)
    local = local_map(solution_of(gait))
    p, q, _ = local.critical("period_doubling")
    c = trace(origin, SLOPE, radians(1.01), progress=False).special("end")[0].coefficients["c"]
    assert c < 0
    assert origin.coefficients["c"] == pytest.approx(c, rel=0.1)
    multipliers = [
        min(go.solve(gait.problem.replace({"friction": origin.value + d})).multipliers, key=lambda m: abs(m + 1)).real
        for d in (1e-5, -1e-5)
    ]
    slope, unit = (multipliers[0] - multipliers[1]) / 2e-5, gait.dynamics.state_units
    offsets, ratios = [], []
    for point in branch.points[1:5]:
        first, second = (step.arcs[0].states[0] for step in point.gait.steps)
        x = p @ ((first - second) / 2 / unit) / (p @ q)
        offsets.append(point.value - origin.value)
        ratios.append(x**2 * origin.coefficients["c"] / (-slope * offsets[-1]))
    assert np.polyfit(offsets, ratios, 1)[1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_walks_settle_on_a_torus_whose_radius_is_that_of_the_normal_form():
    """With |mu| = 1 + e the torus has the radius |z|^2 = -e / Re d: extrapolated to the Neimark-Sacker point."""
    origin = special("torso-passive", "neimark_sacker", "walker.slope", 0.15)
    assert origin.coefficients["re_d"] < 0
    offsets, ratios = [1e-4, 2e-4, 4e-4], []
    for offset in offsets:
        gait = continuation(origin.gait, SLOPE, origin.value + offset, verify_every=0, progress=False).points[-1].gait
        growth, unit = gait.spectral_radius - 1, gait.dynamics.state_units
        kappa = max(gait.multipliers, key=abs).real
        p, q, _ = local_map(solution_of(gait)).critical("neimark_sacker", kappa)
        square = -growth / origin.coefficients["re_d"]
        start = gait.state + unit * np.real(2 * square**0.5 * q)
        walk = Simulator(gait.dynamics).run(start, int(6 / growth))
        last = np.array([step.final_impact.state for step in walk.steps])[int(3 / growth) :]
        z = ((last - gait.state) / unit) @ p.conj() / (p.conj() @ q)
        ratios.append(np.mean(np.abs(z) ** 2) / square)
    assert np.polyfit(offsets, ratios, 1)[1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_folds_of_doubled_gaits_begin_at_a_generalised_flip_where_branches_of_doubled_gaits_have_them():
    """With a = c x^2 + e x^4 they leave the period doublings like c^2: a straight line in the square of the halves."""
    runner = go.solve(go.load_problem("slip-run").replace({"friction": 4}), progress=False)
    doubles = continuation(runner, "walker.attack", radians(68.6), verify_every=0, progress=False)
    flips = trace(doubles.special("period_doubling")[0], "walker.stiffness", 17.8, verify_every=0, progress=False)
    (flip,) = flips.special("generalised_flip")
    assert flip.values["walker.stiffness"] == pytest.approx(17.8021, abs=1e-4)
    (begins,) = flip.next
    assert (begins.type, len(begins.gait.steps)) == ("fold", 2)
    folds = trace(begins, "walker.stiffness", 17.7, max_points=6, progress=False)
    squares, along = [], []
    for point in folds:
        assert np.abs(point.gait.multipliers - 1).min() < 1e-8
        first, second = (step.arcs[0].states[0] for step in point.gait.steps)
        squares.append(float(np.abs(first - second).max()) ** 2)
        along.append(flip.values["walker.stiffness"] - point.values["walker.stiffness"])
    assert along == pytest.approx([along[0] / squares[0] * square for square in squares], rel=0.05)
    last = folds.points[-1]
    value, found = last.values["walker.attack"], []
    for side in (2e-5, -2e-5):
        aside = continuation(last.gait, "walker.attack", value + side, max_points=20, verify_every=0, progress=False)
        found += [abs(fold.value - value) for fold in aside.special("fold")]
    assert min(found) < AGREEMENT


# ---- walks that are interrupted

WALKS = {
    "doubling": (doubling, TraceRequest(key=SLOPE, to=(radians(1.04), radians(0.97)), max_points=4, verify_every=3)),
    "fold": (fold, TraceRequest(key=ANKLE, to=(1.66, 1.645))),
    "torus": (torus, TraceRequest(key=SLOPE, to=(radians(1.02),), verify_every=0)),
    "impact": (impact_change, TraceRequest(key="friction", to=(0.17,), verify_every=0)),
    "jump": (jump, TraceRequest(key=SLOPE, to=(radians(1.05), radians(0.95)), max_points=6, verify_every=0)),
}


def walked(name, done=()):
    """The records of a trace that are not ``done``, one by one, as they are on a disk."""
    begin, request = WALKS[name]
    start = traced_start(begin(), request)
    family = traced_family(start.gait.problem, start.parameter, request.key)
    stored = stored_traces(family, (start.parameter, request.key), done)
    for record in follow_curve(start, request, done=stored):
        yield json.loads(json.dumps(record.to_record()))


@pytest.mark.parametrize(
    ("name", "after"),
    [("doubling", 3), *(pytest.param(name, after, marks=pytest.mark.slow) for name in WALKS for after in (1, 8, -3))],
)
def test_a_trace_that_was_killed_goes_on_to_the_last_bit(name, after):
    whole = list(walked(name))
    kept = whole[:after]
    again = resumable_trace(kept, lambda points: None)
    assert whole[: len(again)] == again
    assert again + list(walked(name, again)) == whole


@pytest.mark.slow
@pytest.mark.parametrize("name", WALKS)
def test_a_trace_that_was_killed_at_any_point_goes_on_with_the_same_next_point(name):
    whole = list(walked(name))
    numbers = [number for number, record in enumerate(whole) if record["record"] == "point"]
    for last, following in pairwise([*numbers, len(whole) - 1]):
        assert list(islice(walked(name, whole[: last + 1]), following - last)) == whole[last + 1 : following + 1]


@pytest.mark.slow
def test_a_resumed_trace_takes_the_modes_beyond_a_margin_from_its_records():
    """They are decided in the first step; a trace that decides again could decide otherwise."""
    whole = list(walked("jump"))
    points = [record["condition"] for record in whole if record["record"] == "point"]
    assert "beyond" not in points[0]
    assert points[1]["beyond"]["impact"] == "slip_backward"
    stated = {**whole[1], "condition": {**points[1], "beyond": None}}
    following = next(walked("jump", [whole[0], stated]))
    assert following["condition"] == stated["condition"]
    assert following["walk"] == whole[2]["walk"]


def test_a_trace_in_a_folder_is_the_same_when_it_is_read_back(tmp_path):
    some, more = ({"to": radians(1.02), "max_points": count, "progress": False} for count in (2, 4))
    plain = trace(doubling(), SLOPE, **more)
    assert len(trace(doubling(), SLOPE, output=tmp_path / "trace", **some)) == 2
    kept = trace(doubling(), SLOPE, output=tmp_path / "trace", **more)
    assert kept.to_records() == plain.to_records()
    assert load_run(tmp_path / "trace").to_records() == plain.to_records()
    head, *lines = read_lines(tmp_path / "trace" / TRACE_FILE)
    spoiled = [
        ("values: must be those of friction and walker.slope", {"values": {"friction": 0.1, "walker.mass": 1.0}}),
        ("values.friction", {"values": {"friction": -0.1, SLOPE: 0.1}}),
        ("condition", {"condition": {"kind": "period_doubling"}}),
        ("cannot be resumed", {"values": {"friction": 0.1, SLOPE: 0.01}}),
    ]
    for words, entries in spoiled:
        Run(tmp_path / "trace").write({TRACE_FILE: lines_text((head, *lines[:1], {**lines[1], **entries}))})
        with pytest.raises(StorageError, match=words):
            trace(doubling(), SLOPE, output=tmp_path / "trace", **more)


@pytest.mark.parametrize(
    ("aside", "near"), [((0.0, 0.0), True), ((1e-3, 0.0), True), ((0.1, 0.0), False), ((0.0, 9.0), False)]
)
def test_a_point_past_an_event_is_near_if_its_parameters_and_its_state_are(aside, near):
    walk = SimpleNamespace(metric=Metric(state=np.ones(2), period=1.0, span=1.0, others=(1.0,)))
    here, there = (
        SimpleNamespace(values={"friction": 0.2, SLOPE: 0.1 + change}, gait=SimpleNamespace(state=np.full(2, moved)))
        for change, moved in ((0.0, 0.0), aside)
    )
    assert CurveWalk._is_near(walk, here, there, 1e-3) is near


def test_a_monitor_is_lost_on_a_curve_unless_it_is_zero_along_it():
    """Values before and after a step: below 1e-8 they are rounding, unless they fall below -1e-6."""
    steps = {"own": (1e-3, -1e-3), "large": (1e-3, -1e-9), "low": (1e-7, -1e-9), "zero": (1e-9, -1e-9)}
    steps["falls"] = (1e-9, -1e-5)
    before = SimpleNamespace(monitors={key: MonitorValue(value) for key, (value, _) in steps.items()})
    after = SimpleNamespace(monitors=steps, monitor=lambda key: steps[key][1], lost=lambda point: [*steps])
    assert CurveWalk._lost(SimpleNamespace(own="own"), before, after) == ["large", "low", "falls"]


@pytest.mark.parametrize("walks", [True, False])
def test_a_gait_on_a_margin_holds_if_the_simulator_walks_those_beside_it_whose_margin_is_positive(walks, monkeypatch):
    """A gait is a number here, the value of its margin."""

    def simulated(gait):
        return SimpleNamespace(passed=walks and gait > 0, to_record=dict)

    beside = SimpleNamespace(step=lambda length: SimpleNamespace(gait=length, monitor=lambda key: length))
    monkeypatch.setattr("gaitopt.branches.trace.confirm", simulated)
    walk = SimpleNamespace(own="margin", _in_first=lambda gait: beside)
    assert CurveWalk._simulated(walk, 0.0) == (walks, None if walks else {})


def test_a_limit_of_points_leaves_the_curve_open_and_its_points_say_where_they_are():
    curve = trace(doubling(), SLOPE, radians(1.5), max_points=3, progress=False)
    (end,) = curve.specials
    assert (len(curve), end.type, end.open, end.bound) == (3, "end", True, False)
    assert repr(curve).startswith("<Trace of a period_doubling over friction and walker.slope")
    point = next(iter(curve))
    assert isinstance(point, TracePoint)
    assert repr(point).startswith("<TracePoint 0.0 at friction = 0.14430218")


def test_a_bound_of_the_first_parameter_ends_the_curve_there():
    curve = trace(doubling(), SLOPE, radians(1.5), upper=0.1445, progress=False)
    (end,) = curve.specials
    assert (end.bound, end.reason) == (True, "reached friction = 0.1445")
    assert end.values["friction"] == pytest.approx(0.1445, rel=0, abs=1e-12)


def where_a_margin_meets_a_doubling():
    """A special point at which two curves of a margin begin, that of a cycle and that of twice as many steps."""
    gait, doubled = named("compass-passive-a"), named("compass-passive-two-step")
    values = {"friction": gait.problem.parameters["friction"], SLOPE: gait.problem.parameters[SLOPE]}
    margin = MonitorKey("normal_force", 0, 0)
    starts = [CurveStart(type="margin", parameter="friction", gait=each, margin=margin) for each in (gait, doubled)]
    at = {"curve": 0, "type": "margin_period_doubling", "values": values, "codimension": 2, "status": "converged"}
    return TraceSpecial(**at, next=(*starts,), gait=gait), values


def test_each_curve_that_begins_at_a_special_point_of_a_trace_has_a_number(monkeypatch):
    point, _ = where_a_margin_meets_a_doubling()
    end = replace(point, type="end", next=())
    assert repr(point).startswith("<TraceSpecial margin_period_doubling at friction = 0.14")
    monkeypatch.setattr("gaitopt.runs.results.kind_of", lambda _: "trace")
    monkeypatch.setattr("gaitopt.runs.trace.restore_trace", lambda _: SimpleNamespace(specials=[point, end]))
    numbered = [load_curve_start(f"run@special.0{n}") for n in ("", ".0", ".1")]
    assert [len(start.gait.steps) for start in numbered] == [1, 1, 2]
    for address, error, words in (
        (
            "run@special.0.2",
            UnknownNameError,
            r"no curve '2': the curves that begin there are 0 to 1 \(margin normal_force",
        ),
        ("run@special.2", UnknownNameError, "no special point '2': those of its trace are 0 to 1"),
        ("run@special.1", ProblemError, "no other curve begins at a special point of type end"),
    ):
        with pytest.raises(error, match=words):
            load_curve_start(address)


def test_the_gait_of_a_curve_that_begins_with_another_cycle_is_read_back():
    (point, values), doubled = where_a_margin_meets_a_doubling(), named("compass-passive-two-step")
    gait = point.gait
    record = json.loads(json.dumps(point.to_record()))
    assert ["gait" in start for start in record["next"]] == [False, True]
    record["next"][1]["gait"]["parameters"] = {key: doubled.problem.parameters[key] for key in values}
    restored = trace_special(traced_family(gait.problem, "friction", SLOPE), "friction", record)
    assert [len(start.gait.steps) for start in restored.next] == [1, 2]
    assert restored.next[1].gait.state == pytest.approx(doubled.state)


# ---- bad input


def test_what_cannot_be_traced_is_refused_with_one_sentence():
    walker = doubling()
    here, end = walker.gait.dynamics.parameter(SLOPE), special("compass-passive-b", "end", "friction", 0.146)
    for start, key, to, error, words in (
        (walker, "walker.slop", 0.02, UnknownNameError, r"did you mean walker\.slope"),
        (walker, "friction", 0.2, UnknownNameError, "friction is the parameter of the branch"),
        (walker, SLOPE, here, ProblemError, "the target must be another finite value"),
        (walker, "walker.gravity", 12.0, ProblemError, r"doubling lies at friction = 0.14430\d* whatever walker"),
        (end, SLOPE, 0.02, ProblemError, "a special point of type end has no curve"),
    ):
        with pytest.raises(error, match=words):
            trace(start, key, to, progress=False)


@pytest.mark.parametrize(("bound", "words"), [({"upper": 0.1}, "0.1: must be at least"), ({"lower": 0.2}, "at most")])
def test_a_bound_beyond_which_the_curve_begins_is_refused(bound, words, tmp_path):
    with pytest.raises(ProblemError, match=rf"{words}.* friction = 0.14430\d+, where the curve begins"):
        trace(doubling(), SLOPE, 0.02, output=tmp_path / "trace", progress=False, **bound)
    assert not (tmp_path / "trace").exists()


DEG = radians(1)
CUTS = 20
"""Number of values at which a traced curve is cut; half an hour of one processor for flat-foot."""


@dataclass(frozen=True)
class Case:
    """A special point of the branch of a named gait, and the parameter in which it is traced.

    Attributes
    ----------
    name, first, to : the branch.
    changes : keys and values in which the problem differs from the named one.
    kind, index : the special point.
    second, targets : the trace.
    margin : kind of the monitor that vanishes; empty for a bifurcation.
    where : where in its phase it does, from 0 to 1.
    """

    name: str
    first: str
    to: float
    kind: str
    second: str
    targets: tuple[float, float]
    index: int = 0
    margin: str = ""
    where: float = 1.0
    changes: tuple[tuple[str, float], ...] = ()

    def __str__(self) -> str:
        changes = "".join(f"-{key}={value:g}" for key, value in self.changes)
        return f"{self.name}{changes}-{self.kind}-{self.index}-over-{self.second}"


COMPASS = [
    Case("compass-passive-a", "friction", 0.1, "neimark_sacker", SLOPE, (0.4 * DEG, 2.2 * DEG)),
    Case("compass-passive-a", "friction", 0.07, "period_doubling", SLOPE, (0.75 * DEG, 1.4 * DEG)),
    Case("compass-passive-a", "friction", 0.06, "impact_change", SLOPE, (0.75 * DEG, 1.4 * DEG),
         margin="impulse_cone_backward"),
    Case("compass-passive-a", "friction", 0.18, "mode_change", SLOPE, (0.5 * DEG, 2 * DEG), margin="cone_backward"),
    Case("compass-passive-a", "friction", 0.18, "mode_change", SLOPE, (0.5 * DEG, 2 * DEG), index=1,
         margin="cone_forward", where=0.0),
    Case("compass-passive-b", "friction", 0.16, "period_doubling", SLOPE, (0.4 * DEG, 2.5 * DEG)),
    Case("compass-passive-b", "friction", 0.32, "impact_change", SLOPE, (0.5 * DEG, 2 * DEG),
         margin="impulse_cone_forward"),
]  # fmt: skip
SHORT_TOE = (("walker.toe", 0.02),)
"""With a toe this short, the doubled gaits of the heel and toe begin where the strike slips."""
OTHERS = [
    Case("rimless-wheel-stick", "friction", 0.91, "mode_change", SLOPE, (0.224, 0.229), margin="cone_forward"),
    Case("rimless-wheel-slip", SLOPE, 0.6, "lift_off", "friction", (0.35, 0.5), margin="normal_force", where=0.48),
    Case("slip-walk-stable", "walker.energy", 839.0, "end", "walker.stiffness", (13900.0, 14100.0),
         margin="cone_forward.front", where=0.5),
    Case("heel-toe", "friction", 0.27, "mode_change", "walker.toe", (0.025, 0.055), margin="cone_forward.heel",
         where=0.0),
    Case("heel-toe", "friction", 0.26, "mode_change", "walker.toe", (0.032, 0.055), index=1,
         margin="cone_backward.toe"),
    Case("heel-toe", "friction", 0.25, "impact_change", "walker.toe", (0.038, 0.042),
         margin="impulse_cone_forward.swing_heel"),
    Case("heel-toe-slip", "walker.toe", 0.06, "period_doubling", "friction", (0.262, 0.268)),
    Case("heel-toe", "friction", 0.268, "period_doubling", "walker.toe", (0.016, 0.028), changes=SHORT_TOE),
    Case("flat-foot", "friction", 1.15, "impact_change", "walker.stiffness", (24.9, 25.1),
         margin="impulse_cone_backward.swing_heel"),
    Case("bounding", "walker.energy", 85.0, "impact_change", "walker.stiffness", (7000.0, 7080.0),
         margin="duration"),
    Case("kneed-passive", "walker.shank_com", 0.15, "end", "walker.hip_mass", (0.48, 0.52),
         margin="clearance"),
    Case("compass-passive-static-kinetic", "friction.static", 0.3, "end", SLOPE, (0.0165, 0.0185),
         margin="onset", where=0.0),
    Case("crawler", "friction.rear", 0.57, "mode_change", "friction.front", (0.395, 0.41), margin="cone_backward.rear",
         where=0.0),
    Case("inchworm", "friction.front", 0.39, "mode_change", "friction.rear", (0.495, 0.505),
         margin="cone_forward.front"),
    Case("inchworm", "friction.front", 0.42, "mode_change", "friction.rear", (0.4995, 0.5005),
         margin="slip_velocity.front", where=0.25),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", [*COMPASS, *OTHERS], ids=str)
def test_a_curve_has_the_special_points_of_branches_wherever_it_is_cut(case: Case) -> None:
    start = special(case.name, case.kind, case.first, case.to, case.index, case.changes)
    curve = trace(start, case.second, case.targets, progress=False)
    assert {end.reason for end in curve.special("end")} == {f"reached {case.second} = {to:.12g}" for to in case.targets}
    checks = [point.gait.verification for point in curve if point.gait.verification is not None]
    assert all(check["passed"] for check in checks)
    if case.margin:
        key = MonitorKey(**curve.points[0].condition["margin"])
        assert key.kind == case.margin
        for point in curve:
            monitor = monitor_values(point.gait)[key]
            assert monitor.value == pytest.approx(0, abs=1e-10)
            assert monitor.where == pytest.approx(case.where, abs=0.05)
    points = [point for point in curve if point.index]
    for point in points[:: max(1, len(points) // CUTS)]:
        value, found = point.values[case.first], cut(point, case.first, case.kind)
        assert found is not None, point
        assert found == pytest.approx(value, rel=0, abs=AGREEMENT * max(1.0, abs(value)))
