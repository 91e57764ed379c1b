"""Families as a whole: nothing but the physics decides what is found on them."""

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from named import named, solved

import gaitopt as go
from gaitopt import Branch, Cycle, Gait, Mode, Status, continuation
from gaitopt.branches import continuation as continuer
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.curve import CurvePoint
from gaitopt.branches.monitors import stride
from gaitopt.branches.request import Request
from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.gait.branch import TERMINAL, collected
from gaitopt.verification.verify import Outcome, confirm

AGREEMENT = 1e-10
STICKING, WHEEL = "compass-passive-stick", "rimless-wheel-slip"
STICK, FORWARD, BACKWARD = Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD


@cache
def gait_of(name: str, **values: float) -> Gait:
    return solved(go.load_problem(name).replace({key.replace("_", "."): value for key, value in values.items()}))


def passive(friction: float) -> Gait:
    name = "compass-passive-stick" if friction > 0.175 else "compass-passive-a"
    return gait_of(name, friction=friction)


@cache
def downwards() -> Branch:
    return continuation(passive(0.18), "friction", 0.171)


def changes(branch: Branch) -> list[float]:
    return sorted(special.value for special in branch.special("mode_change"))


def test_the_passive_gait_walks_from_sticking_into_stick_slip_by_itself() -> None:
    branch = downwards()
    sequences = list(dict.fromkeys(point.gait.problem.cycle for point in branch))
    expected = [(STICK,), (FORWARD, STICK), (FORWARD, STICK, BACKWARD)]
    assert sequences == [Cycle.of_one_step(phases, STICK) for phases in expected]
    assert branch.specials[-1].type == "end"
    assert branch[-1].value == pytest.approx(0.171, abs=1e-14)
    verified = [point.gait.verification for point in branch if point.gait.verification is not None]
    assert len(verified) >= len(branch) // 10
    assert all(record["passed"] for record in verified)


def test_neighbours_on_a_family_are_neighbours_and_a_joint_has_the_same_motion_on_both_sides() -> None:
    branch = downwards()
    states = np.array([point.gait.state for point in branch])
    assert np.abs(np.diff(states, axis=0)).max() < 0.05 * np.abs(states).max()
    assert np.all(np.diff(branch.values) < 0)
    assert np.abs(np.diff(branch.column("spectral_radius"))).max() < 0.05
    for special in branch.special("mode_change"):
        before, after = branch.branch(special.branch)[-1], branch.branch(special.next[0])[0]
        assert before.value > special.value > after.value
        assert after.gait.state == pytest.approx(special.gait.state, rel=0, abs=1e-4)
        assert after.gait.period == pytest.approx(special.gait.period, rel=0, abs=1e-4)


@pytest.mark.parametrize(
    ("start", "to"),
    [(0.177, 0.165), *(pytest.param(*ends, marks=pytest.mark.slow) for ends in ((0.2, 0.14), (0.171, 0.18)))],
)
def test_scales_directions_and_starts_do_not_decide_where_special_points_are(start: float, to: float) -> None:
    found = changes(continuation(passive(start), "friction", to, verify_every=0))
    assert found == pytest.approx(changes(downwards()), rel=0, abs=AGREEMENT)


@pytest.mark.parametrize("intervals", [30, pytest.param(60, marks=pytest.mark.slow)])
def test_the_mesh_of_the_gait_with_which_a_family_begins_does_not_decide_what_is_found(intervals: int) -> None:
    gait = passive(0.18)
    finer = replace(gait, shooting=replace(gait.shooting, intervals=(intervals,)))
    branch = collected("friction", list(follow_family(finer, Request(parameter="friction", to=(0.171,)))))
    assert branch[0].gait.shooting.intervals == (intervals,)
    assert branch[0].gait.state == pytest.approx(gait.state, rel=0, abs=1e-12)
    assert changes(branch) == pytest.approx(changes(downwards()), rel=0, abs=AGREEMENT)
    assert branch.values[:5] == pytest.approx(downwards().values[:5], rel=0, abs=1e-8)
    assert branch[-1].gait.state == pytest.approx(downwards()[-1].gait.state, rel=0, abs=1e-9)


def test_every_point_is_a_gait_that_the_nlp_finds_too() -> None:
    for point in downwards()[::15]:
        alone = solved(point.gait.problem)
        assert alone.state == pytest.approx(point.gait.state, rel=0, abs=1e-9)
        assert alone.spectral_radius == pytest.approx(point.gait.spectral_radius, rel=0, abs=1e-7)


def test_a_family_ends_at_a_target_that_is_nearer_to_a_change_than_any_successor_that_is_tried() -> None:
    start, change = gait_of("compass-torque-impact-slip", friction=0.2322), 0.2322449179938
    near = continuation(start, "friction", change + 1e-8, verify_every=0)
    assert [special.type for special in near.specials] == ["impact_change", "end"]
    assert near.points[-1].value == near.specials[-1].value == change + 1e-8


@pytest.mark.parametrize(
    ("name", "parameter", "to", "error", "words"),
    [
        (STICKING, "friction", 0.2, ProblemError, "another finite value"),
        (STICKING, "friction", float("nan"), ProblemError, "to is nan, but must be a finite number"),
        (WHEEL, "friction", -1.0, ProblemError, r"^-1: friction: -1\.0 must be at least 0"),
        (WHEEL, "walker.slope", 3.0, ProblemError, r"^3: walker\.slope: 3\.0 must be at least -1\.39626 and at most"),
        (WHEEL, "walker.mass", 0.0, ProblemError, r"^0: walker\.mass: 0\.0 must be greater than 0"),
        *((STICKING, key, 0.1, UnknownNameError, "did you mean") for key in ("frictoin", "walker.slop", "control.hip")),
    ],
)
def test_a_target_must_differ_and_be_one_that_the_walker_can_have(name, parameter, to, error, words):
    with pytest.raises(error, match=words):
        continuation(named(name), parameter, to)


def test_a_failed_attempt_a_target_beyond_a_bound_and_an_event_with_a_taken_name_are_refused() -> None:
    failed = replace(passive(0.18), status=Status.NOT_CONVERGED, steps=())
    with pytest.raises(SolveError):
        continuation(failed, "friction", 0.1)
    with pytest.raises(ProblemError, match="bound"):
        continuation(passive(0.18), "friction", 0.1, lower=0.15)
    with pytest.raises(UnknownNameError, match="fold is a special point already"):
        continuation(named("rimless-wheel-stick"), "walker.slope", 0.3, events={"fold": lambda gait: 1.0})


def test_work_is_bounded() -> None:
    few = continuation(passive(0.18), "friction", 0.1, max_points=3)
    assert (len(few), few.specials[-1].type) == (3, "end")
    assert "3 points" in few.specials[-1].reason
    none = continuation(passive(0.18), "friction", 0.1, max_seconds=0.0)
    assert "limit of 0 s" in none.specials[-1].reason
    assert (few.specials[-1].open, none.specials[-1].open) == (True, True)


@pytest.mark.slow
def test_cost_of_the_torque_gait_first_rises_and_then_falls_as_friction_falls() -> None:
    branch = continuation(gait_of("compass-torque-stick"), "friction", 0.05)
    cost = branch.column("cost_of_transport")
    top = int(np.argmax(cost))
    slips = next(k for k, point in enumerate(branch) if len(point.gait.phases) > 1)
    assert slips < top < len(branch) - 1
    assert cost[slips] < cost[top]
    assert cost[-1] < cost[top]


@pytest.mark.slow
def test_the_sticking_gait_shrinks_away_as_the_slope_does() -> None:
    branch = continuation(gait_of("compass-passive-stick", friction=1.0), "walker.slope", 0.0005)
    assert branch[-1].value == pytest.approx(0.0005, abs=1e-14)
    angle = np.abs(branch.column("state.theta1"))
    # Garcia et al. (1998): the step grows like the cube root of a small slope.
    last = slice(-6, None)
    exponent = np.polyfit(np.log(branch.values[last]), np.log(angle[last]), 1)[0]
    assert exponent == pytest.approx(1 / 3, abs=0.02)


@pytest.mark.slow
def test_the_short_period_gait_goes_on_above_its_impact_change_and_in_slope() -> None:
    joined = continuation(gait_of("compass-passive-b"), "friction", 1.0)
    (change,) = joined.special("impact_change")
    assert change.after == Cycle.of_one_step((STICK,), STICK)
    assert joined[-1].value == pytest.approx(1.0, abs=1e-14)
    down = continuation(joined[-1].gait, "walker.slope", 0.0005)
    up = continuation(joined[-1].gait, "walker.slope", 0.08)
    assert down[-1].value == pytest.approx(0.0005, abs=1e-14)
    assert abs(down[-1].gait.state[0]) < 0.5 * abs(down[0].gait.state[0])
    assert len(up) > 10


def test_zeros_of_functions_of_the_caller_are_located_and_named() -> None:
    start = named("rimless-wheel-stick")
    events = {
        "flat": lambda gait: gait.problem.parameters["walker.slope"] - 0.22,
        "slow": lambda gait: gait.scalar("speed") - 0.74,
        "never": lambda gait: gait.period,
    }
    branch = continuation(start, "walker.slope", 0.2, events=events, verify_every=0)
    (flat,), (slow,) = branch.special("flat"), branch.special("slow")
    assert {special.type for special in branch.specials} == {"flat", "slow", "end"}
    assert flat.value == pytest.approx(0.22, abs=1e-12)
    assert (slow.status, slow.gait.verification["passed"]) == ("converged", True)
    assert gait_of("rimless-wheel-stick", walker_slope=slow.value).scalar("speed") == pytest.approx(0.74, abs=1e-11)
    assert "events" not in Request(parameter="friction", to=(1.0,), events=events).to_record()


def test_a_coefficient_that_the_problem_lacks_is_continued_in_a_folder_too(tmp_path) -> None:
    limits = {"max_points": 3, "verify_every": 0}
    plain = continuation(named("compass-passive-a"), "friction.static", 0.145, **limits)
    stored = continuation(named("compass-passive-a"), "friction.static", 0.145, **limits, output=tmp_path)
    assert stored.values == pytest.approx(plain.values, rel=1e-12)
    assert stored[-1].gait.problem.friction.kinetic == 0.14


REQUEST = Request(parameter="friction", to=(0.8,), lower=0.2, upper=0.8, max_points=10, max_seconds=5.0)


def test_a_bound_is_crossed_from_inside_only_and_points_and_time_are_bounded_each():
    for before, after, bound in (
        (0.7, 0.9, 0.8), (0.7, 0.8, 0.8), (0.3, 0.1, 0.2), (0.3, 0.7, None), (0.8, 0.7, None), (0.8, 0.9, None),
    ):  # fmt: skip
        assert REQUEST.crossed(before, after) == bound, (before, after)
    reached = {value: REQUEST.bound_reached(value) for value in (0.8, 0.2, 0.5)}
    assert reached == {0.8: "reached friction = 0.8", 0.2: "reached friction = 0.2", 0.5: None}
    assert REQUEST.exhausted(9, 4.9) is None
    assert REQUEST.exhausted(10, 0.0) == "paused at the limit of 10 points"
    assert REQUEST.exhausted(0, 5.1) == "paused at the limit of 5 s"


def test_branch_goes_on_past_a_place_where_newton_fails(monkeypatch):
    step = CurvePoint.step

    def failing(self, length):
        found = step(self, length)
        crosses = found is not None and min(found.value, self.value) < 0.45 < max(found.value, self.value)
        return None if crosses else found

    monkeypatch.setattr(CurvePoint, "step", failing)
    branch = continuation(named(WHEEL), "friction", 0.5)
    assert branch.special("end")[0].value == pytest.approx(0.5)
    assert {point.branch for point in branch} == {0}
    assert branch[-1].gait.state == pytest.approx(gait_of(WHEEL, friction=0.5).state, abs=1e-9)


def test_branch_ends_with_a_reason_where_ipopt_fails_too(monkeypatch):
    step = CurvePoint.step
    monkeypatch.setattr(CurvePoint, "step", lambda self, length: None if self.value > 0.42 else step(self, length))
    monkeypatch.setattr("gaitopt.branches.continuation.RESCUE_DISTANCES", ())
    (end,) = continuation(named(WHEEL), "friction", 0.5).special("end")
    assert "IPOPT" in end.reason
    assert end.status == "guess"


@cache
def nearly_vanished() -> Gait:
    """Gait B on so little friction that its steps are short."""
    near = {"theta1": -0.000599, "dtheta1": -0.14525, "dtheta2": -0.14526, "dx": 0.464827}
    return go.solve(go.load_problem("compass-passive-b").replace({"friction": 0.0177, "gait.guess.state": near}))


def test_gait_b_vanishes_where_friction_is_the_slope() -> None:
    """With mu = tan(slope) a walker that slides forward neither gains nor loses speed."""
    (special,) = go.continuation(nearly_vanished(), "friction", to=0.0173).specials
    assert (special.type, special.status) == ("vanishing", "converged")
    assert special.type in TERMINAL
    assert special.value == pytest.approx(math.tan(math.radians(1)), rel=0, abs=1e-9)
    assert special.reason.startswith("the gait vanishes")


def test_where_steps_are_too_short_to_simulate_the_gait_vanishes_at_a_stride_of_zero(monkeypatch) -> None:
    """The simulator is made to refute the gait, and steps fail at a stride of 1e-4: the rest is extrapolated."""
    step, gait = CurvePoint.step, nearly_vanished()
    refuted = replace(go.verify(gait).claims[0], passed=False, outcome=Outcome.FAILS)
    monkeypatch.setattr(continuer, "confirm", lambda gait: replace(confirm(gait), claims=(refuted,)))
    monkeypatch.setattr(CurvePoint, "step", lambda self, h: step(self, h) if stride(self.gait) > 1e-4 else None)
    special = continuation(gait, "friction", to=0.0173).specials[-1]
    assert (special.type, special.status) == ("vanishing", "guess")
    assert special.value == pytest.approx(math.tan(math.radians(1)), rel=0, abs=1e-6)
    for name in ("compass-passive-a", "compass-passive-b"):  # the distance of the feet, whether they slip or not
        assert stride(named(name)) == pytest.approx(2 * abs(math.sin(named(name).state[0])), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "to", "place"), [("compass-torque-efficient", -0.3, None), ("compass-torque-stick", -0.5, -0.07424413041)]
)
def test_family_in_the_ankle_torque_vanishes(name: str, to: float, place: float | None) -> None:
    branch = go.continuation(named(name), "control.ankle", to=to)
    special = branch.specials[-1]
    assert special.value == pytest.approx(special.value if place is None else place, rel=0, abs=1e-9)
    assert (special.type, special.status) == ("vanishing", "converged")
    assert stride(special.gait) < 1e-6
    assert "period_doubling" not in [other.type for other in branch.specials if abs(other.value - special.value) < 1e-6]


@pytest.mark.parametrize(("parameter", "to"), [("walker.gravity", 15.0), ("friction.front", 0.8)])
def test_crawler_whose_phases_lose_their_length_vanishes(parameter, to):
    """Beside that point the equations have a solution without a return map."""
    family = go.continuation(go.solve("crawler"), parameter, to=to, max_points=60)
    assert family.specials[-1].type == "vanishing", family.specials


@pytest.fixture(scope="module")
def changing() -> Branch:
    """A short family of the wheel with a change of modes."""
    return continuation(gait_of("rimless-wheel-stick", friction=0.916), "friction", 0.913, verify_every=0)


def test_points_come_in_the_order_in_which_they_were_found_and_columns_are_their_scalars(changing: Branch) -> None:
    assert len(changing) == len(changing.points) == changing.values.size
    assert [point.value for point in changing] == changing.values.tolist()
    assert changing[0].value == 0.916
    assert changing[-1].value == pytest.approx(0.913, abs=1e-15)
    assert np.all(np.diff(changing.values) < 0)
    for name in ("spectral_radius", "period", "state.theta"):
        assert changing.column(name) == pytest.approx([point.gait.scalar(name) for point in changing])
    with pytest.raises(KeyError):
        changing.column("colour")


def test_a_slice_is_a_branch_and_special_points_join_branches_that_exist(changing: Branch) -> None:
    assert changing[:3].values.tolist() == changing.values[:3].tolist()
    assert len(changing.branch(0)) + len(changing.branch(1)) == len(changing)
    assert {special.branch for special in changing.branch(1).specials} == {1}
    assert changing[:0].specials == ()
    (change,) = changing.special("mode_change")
    assert (change.branch, change.next) == (0, (1,))
    assert changing.branch(0)[-1].gait.problem.cycle == change.before
    assert changing.branch(1)[0].gait.problem.cycle == change.after


def test_records_are_json(changing: Branch) -> None:
    for record in (*changing.points, *changing.specials):
        again = json.loads(json.dumps(record.to_record(), allow_nan=False))
        assert again["value"] == record.value
    assert {"branch", "index", "tangent", "multipliers", "phases", "state"} <= changing[0].to_record().keys()
    assert {"type", "status", "from", "to", "next"} <= changing.special("mode_change")[0].to_record().keys()
