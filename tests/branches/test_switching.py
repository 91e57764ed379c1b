"""Other branches through special points: doubled families, crossing branches, and where they come from."""

import json
from dataclasses import replace
from functools import cache
from math import radians

import numpy as np
import pytest
from named import named, special_of, steep

import gaitopt as go
from gaitopt import Branch, Cycle, Gait, Mode, continuation
from gaitopt.branches import continuation as walks
from gaitopt.branches.change import exchanged_half, in_turn
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.curve import Metric
from gaitopt.branches.request import Request
from gaitopt.branches.switching import beginnings
from gaitopt.errors import ProblemError
from gaitopt.gait.branch import SpecialPoint, cascades
from gaitopt.store.branch import resumable, stored_continuations
from gaitopt.store.gaits import special_point

DOUBLING = radians(5.34641438276)
"""Slope at which the period of the sticking compass doubles, at friction 0.6."""
AGREEMENT = 1e-9
SLOPE, ATTACK = "walker.slope", "walker.attack"


@cache
def stick() -> Branch:
    return continuation(steep("compass-passive-stick"), SLOPE, radians(5.5), max_points=4, verify_every=0)


@cache
def doubled() -> Branch:
    (doubling,) = stick().special("period_doubling")
    return continuation(doubling, SLOPE, radians(5.5), max_points=6, verify_every=4)


def unlikeness(gait: Gait) -> float:
    """Distance between the states after the impacts of a cycle of two steps."""
    first, second = (step.arcs[0].states[0] for step in gait.steps)
    return float(np.linalg.norm(first - second))


def test_a_doubled_family_begins_at_the_doubling_like_a_square_root() -> None:
    near = doubled()[:4]
    amplitudes = np.array([unlikeness(point.gait) for point in near])
    coefficients = amplitudes**2 / (near.values - DOUBLING)
    assert coefficients == pytest.approx(coefficients[0], rel=0.02)
    assert np.all(near.column("spectral_radius") < 1)
    gait = doubled()[-2].gait
    assert len(gait.steps) == 2
    assert go.verify(gait).passed
    assert doubled()[4].gait.verification is not None


def runs() -> tuple[SpecialPoint, Gait, float]:
    """The doubling of running, a gait of the doubled family, and an angle of attack beyond the doubling."""
    beyond = radians(68.6)
    doubling = special_of(named("slip-run"), ATTACK, beyond, "period_doubling")
    return doubling, continuation(doubling, ATTACK, radians(67), max_points=4, verify_every=0)[3].gait, beyond


def walks_of_a_compass() -> tuple[SpecialPoint, Gait, float]:
    """The same of the sticking compass and its slope."""
    (doubling,) = stick().special("period_doubling")
    return doubling, doubled()[1].gait, radians(5.2)


@pytest.mark.parametrize(
    ("family", "parameter"), [(walks_of_a_compass, SLOPE), pytest.param(runs, ATTACK, marks=pytest.mark.slow)]
)
def test_a_doubled_family_ends_where_its_halves_become_equal(family, parameter) -> None:
    """It ends at the doubling, with the cycle of one step."""
    doubling, start, beyond = family()
    (end,) = continuation(start, parameter, beyond, verify_every=0).special("end")
    assert (end.type, end.status) == ("end", "converged")
    assert end.value == pytest.approx(doubling.value, abs=AGREEMENT)
    assert (end.before, end.after) == (Cycle(doubling.gait.cycle.steps * 2), doubling.gait.cycle)


def test_a_gait_walked_twice_meets_the_doubled_family_at_a_branch_point() -> None:
    """Its other branch has two halves: long and short steps in turn, and short and long ones."""
    start = steep("compass-passive-two-step")
    twice = continuation(start, SLOPE, radians(5.5), max_points=4, verify_every=0)
    (crossing,) = twice.special("branch_point")
    assert crossing.value == pytest.approx(DOUBLING, abs=AGREEMENT)
    assert not twice.special("fold")
    halves = continuation(crossing, SLOPE, radians(5.5), max_points=1, verify_every=0)
    first, second = (halves.branch(number)[-1].gait for number in (0, 1))
    assert unlikeness(first) > 1e-4
    assert [s.period for s in first.steps] == pytest.approx([s.period for s in reversed(second.steps)], rel=1e-5)
    step = Cycle(first.cycle.steps[:1])
    assert exchanged_half(first, second) == step
    assert exchanged_half(first, first) is None


def test_a_special_point_from_its_record_has_the_same_branches() -> None:
    (doubling,) = stick().special("period_doubling")
    record = json.loads(json.dumps(doubling.to_record()))
    again = special_point(stick()[0].gait, SLOPE, record)
    metric = Metric.of(doubling.gait, 0.01)
    points = [beginnings(special, SLOPE, metric)[0] for special in (doubling, again)]
    assert points[0].gait.state == pytest.approx(points[1].gait.state, abs=1e-8)
    assert points[0].value == pytest.approx(points[1].value, abs=1e-10)


def test_the_gait_of_a_special_point_is_followed_in_another_parameter_and_a_fold_begins_no_branch() -> None:
    (doubling,) = stick().special("period_doubling")
    followed = continuation(doubling, "friction", 0.5, max_points=4, verify_every=0)
    assert 0.59 < followed.values[-1] < followed.values[0] == pytest.approx(0.6)
    period = doubling.gait.measures["period"]
    assert followed.column("period") == pytest.approx(period, rel=1e-12)  # friction does not act on a sticking foot
    fold = replace(doubling, type="fold")
    with pytest.raises(ProblemError, match="no other branch begins at a special point of type fold"):
        continuation(fold, SLOPE, 0.1)


FEW = Request(parameter=SLOPE, to=(radians(5.5),), max_points=3, verify_every=0)


def with_followed(start: Gait, request: Request, done: list[dict[str, object]] = ()) -> list[dict[str, object]]:
    """Records of a family and of the other branches that begin on it that are not ``done``."""
    records = follow_family(start, request, done=stored_continuations(start, request.parameter, done))
    return [json.loads(json.dumps(record.to_record())) for record in records]


def resumed_whole(start: Gait, request: Request, *cuts: int) -> list[dict[str, object]]:
    """All these records, which are the same where the walk is cut short and goes on."""
    whole = with_followed(start, request)
    for cut in cuts:
        kept = resumable(whole[:cut], request.exhausted)
        assert [*kept, *with_followed(start, request, kept)] == whole
    return whole


def test_a_family_with_its_doubled_family_goes_on_where_it_was_cut_short() -> None:
    whole = resumed_whole(stick()[0].gait, replace(FEW, follow={"doublings": 1}), 2, -2)
    (doubling,) = (record for record in whole if record.get("type") == "period_doubling")
    assert doubling["next"] == [1]
    assert {record["branch"] for record in whole} == {0, 1}


def test_cascade_of_records_follows_changes_of_modes() -> None:
    def doubling(branch: int, value: float, following: tuple[int, ...]) -> dict[str, object]:
        return {"record": "special", "branch": branch, "type": "period_doubling", "value": value, "next": following}

    points = [{"record": "point", "branch": branch, "n_steps": n} for branch, n in ((0, 1), (1, 2), (2, 2), (3, 4))]
    change = {"record": "special", "branch": 1, "type": "mode_change", "value": 1.5, "next": (2,)}
    records = [*points, doubling(0, 1.0, (1,)), change, doubling(2, 2.0, (3,)), doubling(3, 2.2, ())]
    (cascade,) = cascades(records)
    assert cascade.n_steps == (1, 2, 4)
    assert cascade.values == (1.0, 2.0, 2.2)
    assert cascade.ratios == pytest.approx((5.0,))


def test_in_a_cycle_of_two_modes_in_turn_the_phases_follow_the_impacts_that_they_follow_alone() -> None:
    slip, stick = Mode.SLIP_FORWARD, Mode.STICK
    first = Cycle.of_one_step((slip, stick), slip)
    second = Cycle.of_one_step((stick,), stick)
    assert str(in_turn(first, second)) == "slip_forward, stick; stick | stick; slip_forward"
    assert in_turn(second, second) == Cycle(second.steps * 2)


@pytest.mark.slow
def test_branches_that_begin_at_a_branch_point_are_followed_on_the_way() -> None:
    whole = resumed_whole(steep("compass-passive-two-step"), replace(FEW, follow={"branch_points": 1}), -2)
    (crossing,) = (record for record in whole if record.get("type") == "branch_point")
    assert crossing["next"] == [1, 2]
    assert {record["branch"] for record in whole if record["record"] == "point"} == {0, 1, 2}


def test_mode_sequences_that_begin_at_a_change_of_modes_are_followed_on_the_way(monkeypatch) -> None:
    """No named gait has a third sequence at a change: here the one that is followed anyway counts as another one."""
    monkeypatch.setattr(walks, "beginnings", lambda special, *place: beginnings(replace(special, after=None), *place))
    start = go.solve(go.load_problem("rimless-wheel-stick").replace({"friction": 0.93}))
    request = Request(parameter="friction", to=(0.9,), max_points=80, verify_every=0, follow={"mode_changes": 1})
    whole = resumed_whole(start, request, -3)
    (change,) = (record for record in whole if record.get("type") == "mode_change")
    assert change["next"] == [1, 2]
    cycles = {record["branch"]: str(Cycle.from_record(record)) for record in whole if record["record"] == "point"}
    assert cycles == {0: "stick; stick", 1: "stick, slip_forward; stick", 2: "stick, slip_forward; stick"}
    ends = [record for record in whole if record.get("type") == "end"]
    assert [(end["branch"], end["value"]) for end in ends] == [(1, 0.9), (2, 0.9)]


def test_gaits_past_a_change_of_modes_do_not_depend_on_how_far_the_family_is_continued() -> None:
    start = go.solve(go.load_problem("rimless-wheel-stick").replace({"friction": 0.93}))
    firsts, changes = list[float](), list[SpecialPoint]()
    for to in (0.9, 0.5):
        records = follow_family(start, Request(parameter="friction", to=(to,), verify_every=0))
        changes.append(next(record for record in records if getattr(record, "type", "") == "mode_change"))
        firsts.append(next(records).value)
    change = replace(changes[0], after=None)  # the sequence that follows counts as another
    spans = (1e-3, 0.1, 10.0)
    firsts += [beginnings(change, "friction", Metric.of(change.gait, span))[0].value for span in spans]
    assert firsts == pytest.approx([firsts[0]] * len(firsts), rel=0, abs=1e-12)
    assert 0 < change.value - firsts[0] < 1e-3


@pytest.mark.slow
def test_cascade_of_the_sticking_compass_up_to_sixteen_steps() -> None:
    """The distances between its doublings shrink like those of the logistic map."""
    request = Request(parameter=SLOPE, to=(radians(6.1),), follow={"doublings": 4}, max_points=60)
    records = [r.to_record() for r in follow_family(steep("compass-passive-stick", 5.3), request)]
    (cascade,) = cascades(records)
    assert cascade.n_steps == (1, 2, 4, 8, 16)
    degrees = (5.346414382760, 5.890541453509, 5.999300700621, 6.022677632064, 6.027698959363)
    assert cascade.values == pytest.approx(np.radians(degrees), abs=AGREEMENT)
    assert cascade.ratios[-1] == pytest.approx(4.669, rel=0.005)
    for number, n_steps in enumerate(cascade.n_steps):
        own = [r for r in records if r["branch"] == number and r["record"] == "point"]
        assert {r["n_steps"] for r in own} == {n_steps}
        assert all(r["verification"]["passed"] for r in own if r["verification"])
        assert any(r["verification"] for r in own)


@pytest.mark.slow
def test_limping_begins_where_the_second_multiplier_of_gait_b_passes_minus_one() -> None:
    gait = go.solve(go.load_problem("compass-passive-b").replace({"friction": 0.1445}))
    branch = continuation(gait, "friction", 0.13, max_points=3, verify_every=0)
    (doubling,) = branch.special("period_doubling")
    assert doubling.value == pytest.approx(0.144302180459, abs=AGREEMENT)
    assert doubling.gait.multipliers[1] == pytest.approx(-1, abs=1e-7)
    limping = continuation(doubling, "friction", 0.16, max_points=4, verify_every=3)[-1].gait
    left, right = limping.problem.cycle.steps
    assert left == right == gait.problem.cycle.steps[0]
    assert left.impact is Mode.SLIP_FORWARD
    lengths = [step.impact.step_length for step in limping.steps]
    assert abs(lengths[0] - lengths[1]) > 1e-3
