"""Cycles of feet that swap roles, which end at a margin or with a free clock, with the landings within them.

Where along a gait its section lies makes no difference to the period and to the multipliers that are not zero.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from math import pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from casadi import cos, sin
from mid_stride import (
    MID_HEEL_TOE,
    SLIP,
    HipClock,
    clocked,
    entrained,
    mid_stride,
    mid_stride_gait,
    restated,
)
from named import named, solved
from orbit_files import SET, changed, differing, written
from own_laws import MidCompass
from samples import sampled

import gaitopt as go
from gaitopt import Gait, Mechanism, Problem, parse_problem
from gaitopt.engines.replay import from_landing
from gaitopt.errors import ProblemError
from gaitopt.gait.impacts import impact_records
from gaitopt.model.walkers.slip_runner import SlipRunner
from gaitopt.problem.statement import problem_data
from gaitopt.search.starts import around_guess
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import problem_dynamics
from gaitopt.verification.return_map import ReturnMap

GAIT_A = "compass-passive-a"
STORED = "evaluation/resets/end of cycle/state"


class ApexRunner(SlipRunner):
    """The runner on a massless leg, with a margin that falls to zero where its body is highest."""

    model = "apex_runner"
    sections = ("apex",)

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The mechanism of the runner; (x, y) is the foot on the ground, or the last one that was there."""
        leg = p.leg_length - q.shortening
        rise = {"apex": lambda dq: -dq.shortening * cos(q.theta) - leg * dq.theta * sin(q.theta)}
        return replace(super().mechanism(q, p), sections=rise)


@pytest.mark.parametrize("name", [GAIT_A, "compass-unequal", "compass-passive-two-step"])
def test_a_gait_whose_steps_end_with_landings_is_replayed_as_it_is(name: str) -> None:
    gait = named(name)
    assert from_landing(gait) is gait


def test_a_section_in_mid_stride_has_the_period_and_the_multipliers_of_the_gait() -> None:
    gait, plain = mid_stride_gait(GAIT_A), named(GAIT_A)
    assert gait.problem.section_names == ("theta2", "dtheta1", "dtheta2")
    for name in ("period", "step_length", "speed", "slip_distance", "required_friction", "foot_clearance"):
        assert gait.scalar(name) == pytest.approx(plain.scalar(name), rel=1e-10), name
    np.testing.assert_allclose(gait.multipliers, plain.multipliers, atol=1e-10)
    assert go.verify(gait).passed
    turned = from_landing(gait)  # the cycle in which an engine replays it
    assert turned.cycle == plain.cycle
    assert turned.state == pytest.approx(plain.state, abs=1e-12)
    impacts, others = ([*impact_records(go.simulate(each, steps=2).trajectory)] for each in (gait, plain))
    assert [(entry["of"], entry["impact"]) for entry in impacts] == [(["swing_foot"], "stick")] * 2
    assert np.diff([entry["time"] for entry in impacts]) == pytest.approx(np.diff([each["time"] for each in others]))
    assert impacts[0]["impulse"] == pytest.approx(others[0]["impulse"], rel=1e-9)


def test_a_cycle_with_a_landing_in_it_is_read_back_from_its_file_and_its_record(tmp_path: Path) -> None:
    gait = mid_stride_gait(GAIT_A)
    again = parse_problem(json.dumps(problem_data(gait.problem)), walkers=[MidCompass])
    assert (again.digest, again.cycle) == (gait.problem.digest, gait.problem.cycle)
    assert str(again.cycle) == "stick, slip_backward (stick), slip_forward, stick; stick"
    phases = gait.to_record()["phases"]
    assert [phase.get("impact") for phase in phases] == [None, None, "stick", None]
    stored = go.load_run(gait.save(tmp_path / "run"), walkers=[MidCompass])
    assert stored.cycle == gait.cycle
    for ours, theirs in zip(gait.arcs, stored.arcs, strict=True):
        np.testing.assert_allclose(ours.states[[0, -1]], theirs.states[[0, -1]], atol=1e-9)


def test_a_free_clock_entrains_a_gait_wherever_its_period_begins() -> None:
    first = entrained()
    assert first.scalar("period") == pytest.approx(named(GAIT_A).scalar("period"), rel=1e-12)
    assert go.verify(first).passed
    assert first.multipliers.size == 4  # one more than without a clock, whose phase counts
    slips = first.arcs[2]
    passed = slips.start + slips.duration / 2
    state = go.simulate(first, dense=True).trajectory.at(passed)
    gait = {
        "section": "clock",
        "phases": ["slip_forward", "stick", "slip_backward", SLIP],
        "guess": {"state": {name: state[name] for name in first.system.state_names if name != "x"}},
    }
    shift = 2 * pi * passed / first.scalar("period")
    second = solved(restated(GAIT_A, control=clocked(shift=shift), gait=gait))
    assert go.verify(second).passed
    assert second.multipliers.size == 5  # dx is free there, and a deviation in it vanishes where the foot sticks
    np.testing.assert_allclose(second.multipliers, [*first.multipliers, 0.0], atol=1e-9)
    assert second.scalar("step_length") == pytest.approx(first.scalar("step_length"), rel=1e-10)


def from_apex() -> Gait:
    """The runner on a massless leg from apex to apex."""
    state = {"theta": 0.5145, "shortening": -0.074, "dtheta": 1.0027, "dshortening": -0.6088}
    phases = ["flight", {"mode": "stick", "impact": "stick"}, "flight"]
    stated = {"section": {"margin": "apex"}, "phases": phases, "guess": {"state": state}}
    return solved(restated("slip-run", ApexRunner, gait=stated))


def test_a_runner_has_the_same_multiplier_from_apex_to_apex() -> None:
    gait, plain = from_apex(), named("slip-run")
    assert gait.scalar("period") == pytest.approx(plain.scalar("period"), rel=1e-11)
    np.testing.assert_allclose(gait.multipliers, [*plain.multipliers, 0.0], atol=1e-10)
    assert go.verify(gait).passed


def test_feet_with_several_contacts_swap_within_a_cycle() -> None:
    gait, plain = mid_stride_gait("heel-toe-slip"), named("heel-toe-slip")
    assert gait.scalar("period") == pytest.approx(plain.scalar("period"), rel=5e-13)
    np.testing.assert_allclose(gait.multipliers, plain.multipliers[: gait.multipliers.size], atol=1e-9)
    for quantity in ("step_length", "required_friction", "foot_clearance", "min_normal_force"):
        assert gait.scalar(quantity) == pytest.approx(plain.scalar(quantity), rel=1e-10), quantity
    assert go.verify(gait).passed
    swings = "toe stick, toe slip_backward (heel stick), heel slip_forward, heel stick, toe stick"
    assert str(gait.cycle) == f"{swings}; toe stick"
    again = parse_problem(json.dumps(problem_data(gait.problem)), walkers=[MID_HEEL_TOE])
    assert (again.digest, again.cycle) == (gait.problem.digest, gait.problem.cycle)
    impacts, others = ([*impact_records(go.simulate(each, steps=2).trajectory)] for each in (gait, plain))
    assert [entry["of"] for entry in impacts] == [["swing_heel"], ["toe"]] * 2
    assert impacts[0]["impact"] == others[1]["impact"]
    assert impacts[0]["impulse"]["swing_heel"] == pytest.approx(others[1]["impulse"]["swing_heel"], rel=1e-9)


def two_strides() -> Gait:
    """The gait of two steps that differ, from mid-stride to mid-stride."""
    state = {"theta2": 0.5252779, "dtheta1": 0.8197383, "dtheta2": -0.0820203}
    step = {"phases": ["stick", {"mode": "stick", "impact": "stick"}]}
    stated = {"section": {"margin": "middle"}, "steps": [step, step], "guess": {"state": state}}
    return solved(restated("compass-passive-two-step", MidCompass, gait=stated))


def test_a_cycle_of_two_steps_from_mid_stride_to_mid_stride_is_that_from_landing_to_landing() -> None:
    gait, plain = two_strides(), named("compass-passive-two-step")
    for quantity in ("period", "step_length", "foot_clearance"):
        assert gait.scalar(quantity) == pytest.approx(plain.scalar(quantity), rel=1e-12), quantity
    np.testing.assert_allclose(gait.multipliers, plain.multipliers, atol=1e-9)
    assert go.verify(gait).passed


ELSEWHERE: dict[str, Callable[[], Gait]] = {
    "margin": lambda: mid_stride_gait(GAIT_A),
    "clock": entrained,
    "margin, several contacts": lambda: mid_stride_gait("heel-toe-slip"),
    "margin, flight": from_apex,
    "margin, two steps": two_strides,
}


@cache
def orbit_of(where: str) -> str:
    """The orbit file of a gait with its section elsewhere."""
    return json.dumps(written(ELSEWHERE[where]()))


@pytest.mark.parametrize("where", sampled(ELSEWHERE, 3))
def test_the_orbit_file_of_a_gait_is_recomputed_wherever_its_section_lies(where: str) -> None:
    data = json.loads(orbit_of(where))
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(data, json.loads((SET / "schema.json").read_text()))
    assert differing(data) == []


@pytest.mark.parametrize(
    ("where", "place", "change", "group"),
    sampled(
        [
            ("margin", "statement/cycle_end/margin", lambda text: f"{text} + 0.001", "margins"),
            ("margin", "orbit/events/1/impulse/F_t", lambda impulse: 1.001 * impulse, "events"),
            ("margin", "orbit/events/1/impact", lambda _: "slip_forward", "margins"),
            ("margin", "orbit/events/1/state_after/dtheta2", lambda rate: 1.001 * rate, "events"),
            ("margin", "orbit/events/3/step_length", lambda length: 1.001 * length, "events"),
            ("margin", "evaluation/arcs/1/swaps", lambda _: False, "equations"),
            ("margin", STORED, lambda texts: [*texts[:3], "1.001*dtheta1", *texts[4:]], "initial state"),
            ("margin", "statement/equations/M/0/0", lambda text: f"1.001*({text})", "equations"),
            ("margin", "orbit/multipliers", lambda multipliers: multipliers[:-1], "multipliers"),
            ("clock", "statement/cycle_end/period", lambda period: 1.001 * period, "ends of phases"),
            ("clock", "statement/control/torques/stick/1", lambda text: f"1.001*({text})", "samples"),
            ("clock", STORED, lambda texts: [*texts[:2], "x", *texts[3:]], "events"),
            ("clock", "orbit/multipliers/0/re", lambda part: part + 1e-5, "multipliers"),
        ],
        2,
    ),
)
def test_what_is_wrong_in_the_orbit_of_a_section_elsewhere_is_found(
    where: str, place: str, change: Callable[[Any], Any], group: str
) -> None:
    assert group in differing(changed(json.loads(orbit_of(where)), place, change))


SWAP = {"heel": "stick", "impact": {"heel": "stick", "feet": "swapped"}}
NO_FOOT = "feet: no foot lands with which they would swap: leave it out"


@pytest.mark.parametrize(
    ("phases", "changes", "words"),
    [
        ([{"heel": "stick"}, {"toe": "stick", "impact": {"heel": "leaves", "feet": "swapped"}}], {},
         rf"gait.phases\[1\].impact.{NO_FOOT}"),
        ([SWAP], {}, rf"gait.phases\[0\].impact.{NO_FOOT}"),
        ([{"toe": "stick"}, SWAP | {"impact": {"heel": "stick", "feet": "kept"}}], {},
         r"gait.phases\[1\].impact.feet: is not a contact of the mid_heel_toe"),
        ([{"toe": "stick"}, SWAP], {"section": "touchdown", "impact": {"heel": "stick"}},
         r"gait.phases\[1\].impact: the landing of the mid_heel_toe ends its step: leave it out"),
        ([{"toe": "stick"}, SWAP, {"toe": "stick"}],
         {"friction": {"heel": 0.3, "swing_heel": 0.4, "toe": 0.3, "swing_toe": 0.3}},
         r"friction.heel: differs from that of swing_heel, with which .*: give both the same\n"),
    ],
)  # fmt: skip
def test_what_cannot_swap_within_a_cycle_is_refused_with_its_place(phases, changes, words):
    gait = {"section": {"margin": "middle"}, "phases": phases, "guess": {}} | changes
    friction = {key: gait.pop(key) for key in changes if key == "friction"}
    with pytest.raises(ProblemError, match=words):
        restated("heel-toe", MID_HEEL_TOE, gait=gait, **friction)


@pytest.mark.slow
def test_families_from_either_section_pass_the_same_special_points() -> None:
    starts = mid_stride_gait(GAIT_A), named(GAIT_A)
    for target in (0.2, 0.1):
        ours, theirs = (go.continuation(start, "friction", to=target, progress=False).specials for start in starts)
        kinds = ["mode_change", "mode_change", "end"] if target == 0.2 else ["neimark_sacker", "end"]
        assert [special.type for special in ours] == [special.type for special in theirs] == kinds
        assert [each.value for each in ours] == pytest.approx([each.value for each in theirs], abs=1e-9)


@pytest.mark.parametrize("engine", ["scipy", "heyoka"])
def test_many_states_return_to_the_section_as_one_does(engine: str) -> None:
    pytest.importorskip(engine)
    for gait in (mid_stride_gait(GAIT_A), entrained()):
        section = gait.system.section(gait.cycle)
        xi = gait.state[section.indices] * np.linspace(1, 1.002, 3)[:, None]
        returned = go.return_map(gait, xi, engine=engine)
        assert returned.completed.all()
        assert [returned.sequence(row) for row in range(3)] == [gait.cycle.phases] * 3
        one_by_one = ReturnMap(Simulator(gait.dynamics), section, 1, gait.state)
        np.testing.assert_allclose(returned.states, [one_by_one(row).xi for row in xi], atol=1e-10)


OSCILLATING = {"type": "oscillating", "cycle": 0.7, "kp": 0.3, "kd": 0, "mean": {}, "amplitude": {"hip": 0.3}}
AFTER_IT = ["slip_backward", SLIP, "stick"]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("control", OSCILLATING, r"gait.section: Oscillating depends on the time since the last landing"),
        ("gait.phases", [SLIP, *AFTER_IT], r"gait.phases\[0\].impact: the step begins there: leave it out"),
        (
            "gait.phases",
            [SLIP | {"impact": "flight"}, *AFTER_IT],
            r"phases\[0\].impact: .flight. is not one of the",
        ),
    ],
)
def test_what_a_cycle_with_landings_within_cannot_have_is_refused_with_its_place(key, value, words) -> None:
    with pytest.raises(ProblemError, match=words):
        mid_stride(GAIT_A).replace({key: value})


def test_legs_that_differ_cannot_swap_within_a_cycle() -> None:
    gait = {"section": "clock", "phases": ["stick", SLIP], "guess": {"state": {}}}
    with pytest.raises(ProblemError, match=r"clock. is not possible: the legs of the unequal_compass differ"):
        restated("compass-unequal", gait=gait)


def open_sequence(problem: Problem) -> Problem:
    """A problem without modes and without a guess."""
    data = problem_data(problem)
    data["gait"] = {"phases": "auto", "section": data["gait"]["section"]}
    return parse_problem(json.dumps(data), walkers=[MidCompass], controls=[HipClock])


@pytest.mark.slow
def test_gaits_of_one_foot_are_found_from_mid_stride_with_and_without_a_guess() -> None:
    found = go.find(mid_stride(GAIT_A), starts=12, workers=1, progress=False)
    expected = [named(name).scalar("period") for name in (GAIT_A, "compass-passive-b")]
    assert [gait.scalar("period") for gait in found] == pytest.approx(expected, rel=1e-9)
    for gait in (mid_stride_gait(GAIT_A), entrained()):
        found = go.find(open_sequence(gait.problem), workers=1, progress=False)
        assert gait.period in [pytest.approx(each.period, rel=1e-7) for each in found]


def test_starts_without_a_guess_stand_on_a_foot_at_rest_wherever_the_other_one_is() -> None:
    problem = open_sequence(mid_stride(GAIT_A))
    dynamics, rng = problem_dynamics(problem), np.random.default_rng(0)
    states = around_guess(problem, dynamics, 20, rng, exact=False, within={})
    heights = [float(dynamics.system.contact_points(z, dynamics.p)[0][1]) for z in states]
    assert np.isfinite(states).all()
    assert not states[:, dynamics.system.state_names.index("dx")].any()
    assert min(heights) < 0 < max(heights)


def test_feet_may_pass_where_a_cycle_begins_in_mid_stride_but_not_where_one_lands() -> None:
    state = {"theta1": 0.0, "theta2": 0.0, "dtheta1": 0.4, "dtheta2": 0.4}
    passing = mid_stride(GAIT_A).replace({"gait.guess.state": state})
    assert passing.start.state["theta2"] == 0.0
    with pytest.raises(ProblemError, match="both feet are at the same place"):
        named("compass-passive-stick").problem.replace({"gait.guess.state": {**state, "dtheta1": 0.5}})
