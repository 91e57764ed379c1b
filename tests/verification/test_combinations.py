"""Stops, switches, push-off, massless, rolling and unequal feet, flight, several steps and clocks with named contacts.

Each combination is a small walker that is solved, verified by the simulator, and compared with the same walker on one
foot at a time, or with itself: seen from the other side, in other units, with its contacts in another order, with
another contact that is never near the ground, or from its other leg on.
"""

import json
import re
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from combined_walkers import (
    Crutch,
    KneedPush,
    Limper,
    NamedCompass,
    NamedHopper,
    NamedKneed,
    NamedPush,
    NamedRound,
    NamedUnequal,
    Pogo,
    ToePush,
    mirrored,
    renumbered,
    with_spare,
)
from named import named, solved
from orbit_files import differing, written
from rescaled import factor
from samples import sampled

import gaitopt as go
from gaitopt import Gait, Walker
from gaitopt.errors import ProblemError
from gaitopt.model.walkers.slip_walker import SlipWalker
from gaitopt.problem.statement import problem_data


@dataclass(frozen=True)
class Case:
    """A walker, its problem, and the named problem of the same walker on one foot at a time, if there is one."""

    walker: type[Walker]
    text: str
    twin: str | None = None

    @property
    def gait(self) -> Gait:
        return gait_of(self.walker, self.text)


@cache
def gait_of(walker: type[Walker], text: str) -> Gait:
    return solved(go.parse_problem(text, walkers=[walker]))


def with_named_contacts(twin: str, model: str, foot: str = "foot_1", steps: int = 1, **changes: object) -> str:
    """The text of a named problem of a walker on one foot at a time, for a walker whose contact there has a name."""
    data = {**problem_data(go.load_problem(twin)), **changes}
    data["walker"] |= {"model": model}
    state = data["gait"]["guess"]["state"]
    del state["x"]
    if "theta1" in state:  # all legs are in line when a foot lands
        state |= dict.fromkeys(("theta2", "theta3")[: 2 if "kneed" in twin else 1], state["theta1"])
    if steps > 1:
        step = {key: data["gait"].pop(key) for key in ("phases", "impact")}
        data["gait"]["steps"] = [step] * steps
    return re.sub(r'"(stick|slip_\w+)"', rf'{{"{foot}": "\1"}}', json.dumps(data)).replace('"flight"', "{}")


UNLIKE = {"foot_1": 0.14, "foot_2": 0.1402}
COMPASS = with_named_contacts("compass-passive-a", "named_compass", steps=2, friction=UNLIKE)
UNEQUAL = with_named_contacts("compass-unequal", "named_unequal")
PUSH = with_named_contacts("compass-push-off", "named_push")
ROUND = with_named_contacts("round-feet-passive", "named_round")
KNEED = with_named_contacts("kneed-passive", "named_kneed")
KNEED_PUSH = KNEED.replace('"named_kneed"', '"kneed_push", "push": 0.05').replace("0.05036851690374748", "0.04")
HOPPER = with_named_contacts("hopper", "named_hopper", "toe")
POGO = """
name: pogo
walker: {model: pogo, leg_length: 1.0, body_mass: 8.0, slider_mass: 2.0, leg_stiffness: 4000, slider_stiffness: 1250,
  thrust: 60, gravity: 9.81}
friction: 0.5
gait:
  phases:
    - {mode: {toe: stick}, slider: free, thrust: off}
    - {mode: {toe: stick}, slider: free, thrust: on}
    - {mode: {}, slider: free, thrust: on}
    - {mode: {}, slider: locked, thrust: on}
  impact: {toe: stick}
  guess:
    state: {dy: -1.4, dx: 0}
"""
RUN = """
name: run
walker: {model: slip_walker, mass: 1.0, leg_length: 1.0, stiffness: 20.0, attack: 68 deg, energy: 1.7, gravity: 1.0}
friction: 0.6
gait:
  phases: [{front: stick}, {}]
  impact: {front: stick}
  guess:
    state: {dx: 1.237, dy: -0.124, y: 0.9272, front_x: 0.3746, front_y: -0.9272}
"""
TOE_PUSH = """
name: toe-push
walker: {model: toe_push, push: 0.5, leg_length: 1.0, leg_mass: 5.0, leg_com: 0.5, hip_mass: 10.0, heel: 0.02,
  toe: 0.04, gravity: 9.81, slope: 0.0524}
friction: 0.5
gait:
  phases: [{heel: stick}, {toe: stick}]
  impact: {heel: stick}
  guess:
    state: {theta1: -0.2949672, dtheta1: 1.156405, dtheta2: -0.3439323, theta2: -0.3170646}
    durations: [0.43506, 0.30934]
"""
LIMPER = """
name: limper
walker: {model: limper, mass: 80.0, leg_length: 1.0, stiffness: 14000.0, other_stiffness: 14140.0, attack: 69 deg,
  energy: 816.0, gravity: 9.81}
friction: 1.0
gait:
  steps:
    - {phases: [{front: stick, back: stick}, {front: stick}], impact: {front: stick, back: stick}}
    - {phases: [{front: stick, back: stick}, {front: stick}], impact: {front: stick, back: stick}}
  guess:
    state: {back_x: -0.1033696, dy: -0.3950325, dx: 1.13226, y: 0.9335804, front_x: 0.3583679, front_y: -0.9335804,
      back_y: -0.9335804}
    durations: [0.17576, 0.23402, 0.17576, 0.23402]
"""
CRUTCH = """
name: crutch
walker: {model: crutch, rear_mass: 1.0, front_mass: 1.5, stiffness: 20.0, damping: 1.5, rest: 0.5, gravity: 9.81,
  slope: 0, crutch_stiffness: 100, height: 0.2, ahead: 0.2, placed: 0.6}
friction: {rear: 0.9, front: 0.2, tip: 4.0}
control: {type: alternating, cycle: 2.0, first: {drive: 4.95}, second: {drive: -4.95}}
gait:
  section: clock
  phases:
    - {rear: slip_backward, front: slip_forward}
    - {rear: stick, front: slip_forward}
    - {rear: stick, front: slip_forward, tip: stick}
    - {rear: stick, front: stick, tip: stick}
    - {rear: slip_forward, front: slip_backward, tip: stick}
    - {rear: stick, front: slip_backward, tip: stick}
    - {rear: stick, front: slip_backward}
    - {rear: stick, front: slip_forward}
  guess:
    state: {gap: 0.0788, dgap: 0.0582}
    durations: [0.3199, 0.1256, 0.5504, 0.0041, 0.3529, 0.0317, 0.4566, 0.1588]
"""
CASES = {
    "push-off": Case(NamedPush, PUSH, "compass-push-off"),
    "stop": Case(NamedKneed, KNEED, "kneed-passive"),
    "stop, switch, flight": Case(NamedHopper, HOPPER, "hopper"),
    "rolling feet": Case(NamedRound, ROUND, "round-feet-passive"),
    "massless foot, flight": Case(SlipWalker, RUN, "slip-run"),
    "unequal legs": Case(NamedUnequal, UNEQUAL, "compass-unequal"),
    "push-off, stop": Case(KneedPush, KNEED_PUSH),
    "push-off, four contacts": Case(ToePush, TOE_PUSH),
    "massless foot, stop, switch, flight": Case(Pogo, POGO),
    "massless foot, slip, clock": Case(Crutch, CRUTCH),
    "massless unequal legs, double support": Case(Limper, LIMPER),
    "slip, unequal friction": Case(NamedCompass, COMPASS),
}


def assert_alike(gait: Gait, other: Gait) -> None:
    """Assert that two gaits have the same period, work and multipliers."""
    assert gait.period == pytest.approx(other.period, rel=1e-10)
    assert gait.measures["work"] == pytest.approx(other.measures["work"], rel=1e-9, abs=1e-11)
    size = 1e-8 * max(1.0, other.spectral_radius)
    assert np.poly(gait.multipliers) == pytest.approx(np.poly(other.multipliers), abs=size)


@pytest.mark.parametrize("name", sampled(CASES, 2))
def test_solver_and_simulator_agree(name: str) -> None:
    assert go.verify(CASES[name].gait).passed


@pytest.mark.parametrize("name", sampled(CASES, 5))
def test_the_orbit_file_is_recomputed_by_a_program_without_gaitopt(name: str) -> None:
    assert differing(written(CASES[name].gait)) == []


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.twin])
def test_a_walker_on_one_foot_moves_the_same_with_named_contacts(name: str) -> None:
    case = CASES[name]
    assert_alike(case.gait, named(case.twin))


@pytest.mark.parametrize("name", sampled(["push-off, four contacts", "massless foot, slip, clock"], 2))
def test_the_order_of_the_contacts_makes_no_difference(name: str) -> None:
    case = CASES[name]
    assert_alike(gait_of(renumbered(case.walker), case.text), case.gait)


@pytest.mark.parametrize("name", ["push-off, stop", "massless foot, stop, switch, flight"])
def test_a_contact_that_is_never_near_the_ground_makes_no_difference(name: str) -> None:
    case = CASES[name]
    assert_alike(gait_of(with_spare(case.walker), case.text), case.gait)


@pytest.mark.parametrize("name", ["push-off", "slip, unequal friction", "rolling feet"])
def test_a_mirrored_walker_walks_as_its_mirror_image(name: str) -> None:
    case, other = CASES[name], {"forward": "backward", "backward": "forward"}
    text = re.sub("slip_(forward|backward)", lambda word: f"slip_{other[word[1]]}", case.text)
    gait = gait_of(mirrored(case.walker), text)
    assert_alike(gait, case.gait)
    assert gait.measures["step_length"] == pytest.approx(-case.gait.measures["step_length"], rel=1e-9)


@pytest.mark.parametrize("name", ["slip, unequal friction", "massless unequal legs, double support"])
def test_a_cycle_of_two_steps_may_start_with_either_leg(name: str) -> None:
    case = CASES[name]
    keys = (
        {"friction.foot_1", "friction.foot_2"} if "friction" in name else {"walker.stiffness", "walker.other_stiffness"}
    )
    one, other = (key for key in case.gait.problem.parameters if key in keys)
    values, start = case.gait.problem.parameters, case.gait.steps[0].final_impact.state
    state = dict(zip(case.gait.system.state_names, map(float, start), strict=True))
    del state["x"]
    swapped = case.gait.problem.replace({one: values[other], other: values[one], "gait.guess.state": state})
    gait = go.solve(swapped)
    assert_alike(gait, case.gait)
    assert [step.period for step in gait.steps] == pytest.approx(
        [step.period for step in case.gait.steps[::-1]], rel=1e-10
    )
    assert abs(gait.steps[0].period - gait.steps[1].period) > 1e-4


def test_a_massless_foot_with_a_stop_and_a_switch_moves_alike_in_other_units() -> None:
    gait, units = CASES["massless foot, stop, switch, flight"].gait, (4.0, 2.0, 100.0)
    changes = {f"walker.{name}": value * factor(name, units) for name, value in gait.problem.walker}
    state = {"dy": gait.problem.guess.state["dy"] * units[0] / units[1], "y": units[0], "leg_y": -units[0]}
    other = go.solve(gait.problem.replace({**changes, **{f"gait.guess.state.{k}": v for k, v in state.items()}}))
    assert other.period == pytest.approx(units[1] * gait.period, rel=1e-10)
    assert other.multipliers == pytest.approx(gait.multipliers, rel=1e-8)


def test_with_the_push_the_family_ends_where_the_contact_slips() -> None:
    """The push along the leg needs friction tan(theta1), as on one foot; on level ground it does all work."""
    level = CASES["push-off"].gait
    assert level.measures["work"] == pytest.approx(level.steps[0].final_impact.push_work, rel=1e-12)
    assert level.measures["work"] > 0.1
    downhill = CASES["push-off"].gait.problem.replace({"walker.slope": "0.3 deg", "friction": 1})
    gait = go.solve(downhill)
    needed = np.tan(gait.arcs[-1].states[-1][0])
    end = go.continuation(gait, "friction", 0.15).specials[-1]
    assert end.value == pytest.approx(needed, abs=1e-8)
    state = dict(zip(gait.system.state_names, map(float, gait.state), strict=True))
    for part, ending in ((1 + 1e-9, "completed"), (1 - 1e-9, "push_slips")):
        walk = go.simulate(downhill.replace({"friction": part * needed, "gait.guess.state": state}), steps=1)
        assert walk.trajectory.ending == ending
    failed = go.solve(downhill.replace({"friction": 0.999 * needed, "gait.guess.state": state}))
    assert not failed.converged
    assert "push-off: foot_1 needs friction 0.2272" in failed.message


def test_a_foot_that_comes_down_before_the_knee_locks_scuffs() -> None:
    """It ends the motion of the kneed walker at the same instant, whether its feet have names or not."""
    faster = {"gait.guess.state.dtheta1": 1.6, "gait.guess.state.dtheta2": -0.05}
    problems = go.parse_problem(KNEED, walkers=[NamedKneed]), go.load_problem("kneed-passive")
    one, other = (go.simulate(problem.replace(faster), steps=2).trajectory for problem in problems)
    assert [one.ending, other.ending] == ["scuffing", "scuffing"]
    assert one.duration == pytest.approx(other.duration, rel=1e-12)


def test_contacts_that_swap_have_one_friction_in_a_cycle_of_one_step() -> None:
    one_step = with_named_contacts("compass-passive-a", "named_compass", friction=UNLIKE)
    words = (
        "friction.foot_1: differs from that of foot_2, with which it swaps places after every step: give both the same"
    )
    with pytest.raises(ProblemError, match=re.escape(words)):
        go.parse_problem(one_step, walkers=[NamedCompass])
    gait = gait_of(NamedCompass, one_step.replace("0.1402", "0.14"))
    assert gait.period == pytest.approx(named("compass-passive-a").period, rel=1e-12)
    with pytest.raises(ProblemError, match=words):
        go.continuation(gait, "friction.foot_1", 0.15)
    two_forms = COMPASS.replace("0.1402", '{"static": 0.2, "kinetic": 0.14}')
    with pytest.raises(ProblemError, match="give both one number, or both static and kinetic friction"):
        go.parse_problem(two_forms, walkers=[NamedCompass])


def test_legs_that_close_through_a_stop_say_so() -> None:
    class Silent(NamedKneed):
        model = "silent"
        closing_stops = ()

    with pytest.raises(ProblemError, match=r"masses jump .* while knee is locked, name it in closing_stops"):
        go.parse_problem(KNEED.replace("named_kneed", "silent"), walkers=[Silent])
    early = KNEED.replace(', {"mode": {"foot_1": "stick"}, "knee": "locked"}]', "]")
    with pytest.raises(ProblemError, match="knee must lock before the foot comes down"):
        go.parse_problem(early, walkers=[NamedKneed])


@pytest.mark.parametrize(
    "law",
    sampled([{"friction": {"static": 0.16, "kinetic": 0.14, "viscous": 0.3}}, {"impact_law": "frictionless"}], 2),
)
def test_the_laws_of_a_named_contact_are_those_of_a_foot(law):
    """A frictionless impact; and drag."""
    gait = gait_of(NamedCompass, with_named_contacts("compass-passive-b", "named_compass", **law))
    one_foot = solved(go.load_problem("compass-passive-b").replace(law))
    assert_alike(gait, one_foot)
    assert go.verify(gait).passed
    assert "friction" in law or gait.steps[0].impact.impulse[2] == 0


def test_a_stop_ends_the_motion_of_contacts_where_its_gap_closes():
    """A walk of named contacts was once completed with a stop at -0.094 m."""
    gait = CASES["stop"].gait
    walk = go.simulate(gait, steps=3)
    assert walk.completed
    for step in walk.trajectory.steps:
        for arc in step.arcs:
            names = list(gait.system.state_names)
            gap = arc.states[:, names.index("theta2")] - arc.states[:, names.index("theta3")]
            assert gap.min() > -1e-12
            assert arc.mode.free or abs(gap).max() < 1e-12
