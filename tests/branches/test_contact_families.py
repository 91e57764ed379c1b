"""Families of gaits of walkers with several contacts: changes of what any contact does, located and named."""

from pathlib import Path

import numpy as np
import pytest
from contact_problems import contact_gait, settled, sled
from named import named

from gaitopt import Gait, verify
from gaitopt.api.families import continuation
from gaitopt.api.stored import load_run
from gaitopt.search.solve import solve
from gaitopt.simulation.simulator import Simulator


def test_the_heel_begins_to_slip_where_its_friction_is_what_sticking_needs() -> None:
    gait = contact_gait("heel-toe")
    needed = gait.to_record()["contacts"]["heel"]["required_friction"]
    close = solve(gait.problem.replace({"friction": needed + 1e-3}))
    near = continuation(close, "friction", to=needed - 0.02, max_points=6)
    change = near.specials[0]
    assert (change.type, change.contact, change.status) == ("mode_change", "heel", "converged")
    assert change.value == pytest.approx(needed, abs=1e-10)
    assert [mode.brief for mode in change.after.phases] == ["heel slip_forward", "heel stick", "toe stick"]
    assert change.to_record()["contact"] == "heel"
    assert verify(near.points[-1].gait).passed


def test_a_force_that_vanishes_ends_the_family_rather_than_the_edge_of_its_cone() -> None:
    """In mid-stance the spring leg is vertical: both edges of the cone are reached where the force vanishes."""
    close = solve(contact_gait("slip-walk-stable").problem.replace({"walker.energy": 837.9}))
    end = continuation(close, "walker.energy", to=842.0).specials[-1]
    assert (end.type, end.contact) == ("end", "front")
    assert end.value == pytest.approx(837.991652808, abs=1e-8)
    assert end.reason.startswith("phase 2 (front stick): the contact front lifts off: its normal force falls to zero")
    assert end.gait.to_record()["contacts"]["front"]["min_normal_force"] == pytest.approx(0, abs=1e-6)


@pytest.mark.slow
def test_with_less_friction_the_heel_slips_then_the_toe_and_then_the_strike() -> None:
    branch = continuation(contact_gait("heel-toe"), "friction", to=0.25)
    assert [(s.type, s.contact, s.status) for s in branch.specials[:-1]] == [
        ("mode_change", "heel", "converged"),
        ("mode_change", "toe", "converged"),
        ("impact_change", "heel", "converged"),
    ]
    assert [s.value for s in branch.specials] == pytest.approx([0.274837608, 0.265109192, 0.258732126, 0.25], abs=1e-8)
    strike = branch.specials[2]
    assert strike.gait.measures["impulse_ratio"] == pytest.approx(strike.value, abs=1e-9)
    assert verify(branch.points[-1].gait).passed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameter", "to", "contacts"),
    [
        ("crawler", "friction.rear", 0.3, ["rear", "front", "front"]),
        ("inchworm", "friction.front", 0.38, ["rear"]),  # two phases of a thousandth of the period vanish at once
    ],
)
def test_a_crawl_goes_on_where_several_phases_change_at_once(name, parameter, to, contacts):
    branch = continuation(contact_gait(name), parameter, to=to)
    assert branch.specials[-1].value == to
    assert [special.contact for special in branch.specials[:-1]] == contacts
    assert all(special.status == "converged" for special in branch.specials)
    assert verify(branch.points[-1].gait).passed


@pytest.mark.slow
@pytest.mark.parametrize("to", [0.3, 0.35])
def test_a_family_passes_the_end_of_a_slip_from_rest_in_both_directions(to: float) -> None:
    """The slip ends with half the digits where it vanishes, and Newton's method may fail, or pass to negative times."""
    down, up = (
        continuation(contact_gait("heel-toe"), "friction", to=0.27),
        continuation(named("heel-toe-slip"), "friction", to=to),
    )
    vanishes, end = up.specials[-2:]
    assert (vanishes.type, vanishes.contact, vanishes.status) == ("mode_change", "heel", "converged")
    assert vanishes.value == pytest.approx(down.specials[0].value, rel=0, abs=1e-11)
    assert end.value == to
    assert min(phase["duration"] for point in up for phase in point.gait.to_record()["phases"]) > -1e-6


def test_a_crawl_vanishes_where_the_friction_stops_both_ends() -> None:
    gait = contact_gait("crawler")
    branch = continuation(contact_gait("crawler"), "friction.front", to=0.5)
    end = branch.specials[-1]
    drive, slope, weights = 4.95, gait.dynamics.parameter("walker.slope"), 9.81 * np.array([1.0, 1.5])
    stopped = (2 * drive + weights.sum() * np.sin(slope)) / np.cos(slope)  # at the same gap in both halves of the cycle
    assert (end.type, end.status) == ("vanishing", "converged")
    assert end.value == pytest.approx((stopped - 0.6 * weights[0]) / weights[1], abs=1e-8)


@pytest.mark.slow
def test_with_less_energy_a_flight_between_the_stances_becomes_an_overlap(tmp_path: Path) -> None:
    branch = continuation(contact_gait("bounding"), "walker.energy", to=85.0, output=tmp_path)
    assert load_run(tmp_path).to_records() == branch.to_records()  # the flight has no duration where it vanishes
    change, end = branch.specials
    assert (change.type, change.status, change.contact) == ("impact_change", "converged", "front")
    assert change.reason == "phase 3 (flight) vanishes"
    assert change.value == pytest.approx(85.718884880, abs=1e-8)
    assert end.value == 85
    flights, overlap = ([mode.brief for mode in side.phases] for side in (change.before, change.after))
    assert flights == ["flight", "front stick", "flight", "back stick", "flight"]
    assert overlap == ["flight", "front stick", "front stick + back stick", "back stick", "flight"]
    assert verify(branch.points[-1].gait).passed


@pytest.mark.slow
def test_with_less_friction_the_heel_of_a_flat_foot_slips_in_its_strike() -> None:
    branch = continuation(named("flat-foot"), "friction", to=1.15)
    change, end = branch.specials
    assert (change.type, change.contact, change.status) == ("impact_change", "heel", "converged")
    assert change.value == pytest.approx(named("flat-foot").measures["impulse_ratio"], abs=1e-9)
    assert end.value == 1.15
    assert verify(branch.points[-1].gait).passed


@pytest.mark.slow
def test_a_bounding_gait_whose_section_would_be_passed_twice_ends_there() -> None:
    """With less inertia the trunk rises and falls between the stances, too, so that it has an apex more."""
    (end,) = continuation(named("bounding-overlap"), "walker.inertia", to=1.0, verify_every=0).specials
    assert (end.type, end.reason, end.contact) == ("end", "apex falls to zero earlier in the step", "")
    assert end.value == pytest.approx(1.1458, abs=1e-4)


OSCILLATING = """{type: oscillating, cycle: 1.90995, kp: 78.3597, kd: 5.89262, mean: {pull: 0.5, push: 0.5},
  amplitude: {pull: -0.190261, push: 0.172378}}"""


def sled_gait(friction: float) -> Gait:
    """The gait of a sled that is driven to and fro alike."""
    problem = sled((1.49175, 0.977701, 0.657363), 0, OSCILLATING)
    return settled(problem.replace({"friction": friction}), 10)


@pytest.mark.parametrize(
    ("start", "to", "points"),
    [
        (0.39618, 0.39, 4),
        pytest.param(0.39618, 0.3961, 400, marks=pytest.mark.slow),  # the new slip is short as far as to a near target
        pytest.param(0.4, 0.39, 400, marks=pytest.mark.slow),
    ],
)
def test_a_slip_of_a_sled_crosses_the_section(start: float, to: float, points: int) -> None:
    """Both halves of the cycle of this sled are alike: one changes where the other crosses the end of the clock."""
    branch = continuation(sled_gait(start), "friction", to=to, verify_every=0, max_points=points)
    change, last = branch.specials[0], branch.points[-1].gait
    assert (change.type, change.status) == ("impact_change", "converged")
    assert change.value == pytest.approx(0.39612997, abs=1e-7)
    assert change.before.impact.contacts["front"] == "stick"
    assert change.after.impact.contacts["front"] == "slip_backward"
    (step,) = Simulator(last.dynamics).run(last.state).steps
    assert step.sequence == last.cycle.steps[0] == change.after.steps[0]
    assert step.final_impact.state == pytest.approx(last.state, abs=1e-8)
    if start == 0.4:
        assert branch.specials[-1].reason == f"reached friction = {to}"
        alone = sled_gait(to)
        assert last.cycle == alone.cycle
        assert last.state == pytest.approx(alone.state, abs=1e-9)
        assert verify(last).passed
