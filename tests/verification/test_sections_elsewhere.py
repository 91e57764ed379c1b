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
from typing import Annotated, Any

import numpy as np
import pytest
from casadi import SX, cos, sin
from named import named
from orbit_files import SET, changed, differing, written
from own_laws import MidCompass
from pydantic import Field
from samples import sampled

import gaitopt as go
from gaitopt import Control, Gait, Instant, Mechanism, Problem, parse_problem
from gaitopt.engines.replay import from_landing
from gaitopt.errors import ProblemError
from gaitopt.gait import curves
from gaitopt.gait.impacts import impact_records
from gaitopt.model.clocked import Period
from gaitopt.model.units import Finite
from gaitopt.model.walkers.heel_toe import HeelToe
from gaitopt.model.walkers.slip_runner import SlipRunner
from gaitopt.model.walkers.unequal_compass import UnequalCompass
from gaitopt.problem.statement import problem_data
from gaitopt.search.starts import around_guess
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import problem_dynamics
from gaitopt.verification.return_map import ReturnMap

SLIP = {"mode": "slip_forward", "impact": "stick"}
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


class HipClock(Control):
    """A spring in the hip whose rest length oscillates, whatever the feet do."""

    type = "hip_clock"
    restarts = False

    cycle: Period
    stiffness: Annotated[Finite, Field(description="torque per angle [N m/rad]")] = 0.3
    size: Annotated[Finite, Field(description="amplitude [rad]")] = 0.3
    shift: Annotated[Finite, Field(description="phase at the start of the cycle [rad]")] = 0.0

    @property
    def period(self) -> float:
        return self.cycle

    def torques(self, now: Instant) -> dict[str, SX]:
        """The torque that pulls the joint towards the sine."""
        angle = now.robot.mechanism.motors[now.robot.walker.actuators.index("hip")]
        return {"hip": now.p.stiffness * (now.p.size * sin(2 * pi * now.t / self.cycle + now.p.shift) - angle)}


def restated(name: str, **changes: Any) -> Problem:
    """A named problem with other keys."""
    data = problem_data(named(name).problem)
    return parse_problem(json.dumps(data | changes), walkers=[MidCompass, UnequalCompass], controls=[HipClock])


def mid_stride() -> Problem:
    """Gait A of the paper, from mid-stride to mid-stride."""
    plain = problem_data(named("compass-passive-a").problem)
    state = {"theta2": 0.1603, "dtheta1": 0.2451, "dtheta2": 0.7388}
    phases = ["stick", "slip_backward", SLIP, "stick"]
    gait = {"section": {"margin": "middle"}, "phases": phases, "guess": {"state": state}}
    return restated("compass-passive-a", walker=plain["walker"] | {"model": "mid_compass"}, gait=gait)


class MidHeelToe(HeelToe):
    """The walker on heels and toes, with a margin that falls to zero while it rolls over its toe."""

    model = "mid_heel_toe"
    sections = ("middle",)

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return replace(super().mechanism(q, p), sections={"middle": lambda dq: 0.1 - q.theta1})


def rolling(name: str) -> Problem:
    """A walker on heels and toes from one rolling over its toe to the next one."""
    plain = named(name)
    arc = next(arc for arc in plain.arcs if arc.states[0, 0] < 0.1 < arc.states[-1, 0])
    (at,) = curves.evaluate(curves.coefficients(arc.states), curves.roots(arc.states[:, 0] - 0.1))
    phases, impact = [mode.data for mode in plain.cycle.phases], plain.cycle.impact
    first = [mode for mode, _ in plain.steps[0].phases].index(arc.mode)
    swap = {"heel": impact.contacts["heel"], "toe": "leaves", "feet": "swapped"}
    data = problem_data(plain.problem)
    state = {n: float(value) for n, value in zip(plain.system.state_names, at, strict=True) if n != "x"}
    gait = {
        "section": {"margin": "middle"},
        "phases": [*phases[first:], {**plain.cycle.phases[0].contacts, "impact": swap}, *phases[1 : first + 1]],
        "guess": {"state": state},
    }
    changed = data | {"walker": data["walker"] | {"model": "mid_heel_toe"}, "gait": gait}
    return parse_problem(json.dumps(changed), walkers=[MidHeelToe])


def clocked(**control: float) -> dict[str, Any]:
    """The control of a compass whose hip follows a clock with the period of gait A."""
    return {"type": "hip_clock", "cycle": named("compass-passive-a").scalar("period"), **control}


def entrained() -> Gait:
    """Gait A with a hip that follows a clock, from the middle of a stride."""
    state = {"theta1": -0.0751, "theta2": -0.1479, "dtheta1": 0.3936, "dtheta2": 0.3549}
    gait = {"section": "clock", "phases": ["stick", "slip_backward", SLIP, "stick"], "guess": {"state": state}}
    return go.solve(restated("compass-passive-a", control=clocked(), gait=gait), progress=False)


def test_a_section_in_mid_stride_has_the_period_and_the_multipliers_of_the_gait() -> None:
    gait, plain = go.solve(mid_stride(), progress=False), named("compass-passive-a")
    assert gait.converged, gait.message
    assert gait.problem.section_names == ("theta2", "dtheta1", "dtheta2")
    for name in ("period", "step_length", "speed", "slip_distance", "required_friction", "foot_clearance"):
        assert gait.scalar(name) == pytest.approx(plain.scalar(name), rel=1e-10), name
    np.testing.assert_allclose(gait.multipliers, plain.multipliers, atol=1e-10)
    assert go.verify(gait).passed
    turned = from_landing(gait)  # the cycle in which an engine replays it
    assert turned.cycle == plain.cycle
    assert turned.state == pytest.approx(plain.state, abs=1e-12)


def test_a_cycle_with_a_landing_in_it_is_read_back_from_its_file_and_its_record(tmp_path: Path) -> None:
    problem = mid_stride()
    again = parse_problem(json.dumps(problem_data(problem)), walkers=[MidCompass])
    assert (again.digest, again.cycle) == (problem.digest, problem.cycle)
    assert str(problem.cycle) == "stick, slip_backward (stick), slip_forward, stick; stick"
    gait = go.solve(problem, output=tmp_path, progress=False)
    phases = gait.to_record()["phases"]
    assert [phase.get("impact") for phase in phases] == [None, None, "stick", None]
    stored = go.load_run(tmp_path, walkers=[MidCompass])
    assert stored.cycle == gait.cycle
    for ours, theirs in zip(gait.arcs, stored.arcs, strict=True):
        np.testing.assert_allclose(ours.states[[0, -1]], theirs.states[[0, -1]], atol=1e-9)


def test_every_landing_within_a_cycle_has_its_impulse() -> None:
    starts = go.solve(mid_stride(), progress=False), named("compass-passive-a")
    impacts, plain = ([*impact_records(go.simulate(gait, steps=2).trajectory)] for gait in starts)
    assert [(entry["of"], entry["impact"]) for entry in impacts] == [(["swing_foot"], "stick")] * 2
    assert np.diff([entry["time"] for entry in impacts]) == pytest.approx(np.diff([each["time"] for each in plain]))
    assert impacts[0]["impulse"] == pytest.approx(plain[0]["impulse"], rel=1e-9)


def test_a_free_clock_entrains_a_gait_wherever_its_period_begins() -> None:
    first = entrained()
    assert first.converged, first.message
    assert first.scalar("period") == pytest.approx(named("compass-passive-a").scalar("period"), rel=1e-12)
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
    second = go.solve(restated("compass-passive-a", control=clocked(shift=shift), gait=gait), progress=False)
    assert second.converged, second.message
    assert go.verify(second).passed
    assert second.multipliers.size == 5  # dx is free there, and a deviation in it vanishes where the foot sticks
    np.testing.assert_allclose(second.multipliers, [*first.multipliers, 0.0], atol=1e-9)
    assert second.scalar("step_length") == pytest.approx(first.scalar("step_length"), rel=1e-10)


def from_apex() -> Gait:
    """The runner on a massless leg from apex to apex."""
    data = problem_data(named("slip-run").problem)
    state = {"theta": 0.5145, "shortening": -0.074, "dtheta": 1.0027, "dshortening": -0.6088}
    phases = ["flight", {"mode": "stick", "impact": "stick"}, "flight"]
    data["gait"] = {"section": {"margin": "apex"}, "phases": phases, "guess": {"state": state}}
    data["walker"]["model"] = ApexRunner.model
    return go.solve(parse_problem(json.dumps(data), walkers=[ApexRunner]), progress=False)


def test_a_runner_has_the_same_multiplier_from_apex_to_apex() -> None:
    gait, plain = from_apex(), named("slip-run")
    assert gait.converged, gait.message
    assert gait.scalar("period") == pytest.approx(plain.scalar("period"), rel=1e-11)
    np.testing.assert_allclose(gait.multipliers, [*plain.multipliers, 0.0], atol=1e-10)
    assert go.verify(gait).passed


def heel_toe_pair(name: str) -> tuple[Gait, Gait]:
    """The gait of a named problem on heels and toes, from mid-stance to mid-stance and from landing to landing."""
    gait, plain = go.solve(rolling(name), progress=False), named(name)
    assert gait.converged, gait.message
    assert gait.scalar("period") == pytest.approx(plain.scalar("period"), rel=5e-13)
    np.testing.assert_allclose(gait.multipliers, plain.multipliers[: gait.multipliers.size], atol=1e-9)
    for quantity in ("step_length", "required_friction", "foot_clearance", "min_normal_force"):
        assert gait.scalar(quantity) == pytest.approx(plain.scalar(quantity), rel=1e-10), quantity
    return gait, plain


def test_feet_with_several_contacts_swap_within_a_cycle() -> None:
    gait, plain = heel_toe_pair("heel-toe-slip")
    assert go.verify(gait).passed
    swings = "toe stick, toe slip_backward (heel stick), heel slip_forward, heel stick, toe stick"
    assert str(gait.cycle) == f"{swings}; toe stick"
    again = parse_problem(json.dumps(problem_data(gait.problem)), walkers=[MidHeelToe])
    assert (again.digest, again.cycle) == (gait.problem.digest, gait.problem.cycle)
    impacts, others = ([*impact_records(go.simulate(each, steps=2).trajectory)] for each in (gait, plain))
    assert [entry["of"] for entry in impacts] == [["swing_heel"], ["toe"]] * 2
    assert impacts[0]["impact"] == others[1]["impact"]
    assert impacts[0]["impulse"]["swing_heel"] == pytest.approx(others[1]["impulse"]["swing_heel"], rel=1e-9)


def two_strides() -> Gait:
    """The gait of two steps that differ, from mid-stride to mid-stride."""
    data = problem_data(named("compass-passive-two-step").problem)
    state = {"theta2": 0.5252779, "dtheta1": 0.8197383, "dtheta2": -0.0820203}
    step = {"phases": ["stick", {"mode": "stick", "impact": "stick"}]}
    data["gait"] = {"section": {"margin": "middle"}, "steps": [step, step], "guess": {"state": state}}
    data["walker"]["model"] = "mid_compass"
    return go.solve(parse_problem(json.dumps(data), walkers=[MidCompass]), progress=False)


def test_a_cycle_of_two_steps_from_mid_stride_to_mid_stride_is_that_from_landing_to_landing() -> None:
    gait, plain = two_strides(), named("compass-passive-two-step")
    assert gait.converged, gait.message
    for quantity in ("period", "step_length", "foot_clearance"):
        assert gait.scalar(quantity) == pytest.approx(plain.scalar(quantity), rel=1e-12), quantity
    np.testing.assert_allclose(gait.multipliers, plain.multipliers, atol=1e-9)
    assert go.verify(gait).passed


ELSEWHERE: dict[str, Callable[[], Gait]] = {
    "margin": lambda: go.solve(mid_stride(), progress=False),
    "clock": entrained,
    "margin, several contacts": lambda: heel_toe_pair("heel-toe-slip")[0],
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
)
def test_what_is_wrong_in_the_orbit_of_a_section_elsewhere_is_found(
    where: str, place: str, change: Callable[[Any], Any], group: str
) -> None:
    assert group in differing(changed(json.loads(orbit_of(where)), place, change))


NO_FOOT = "feet: no foot lands with which they would swap: leave it out"


@pytest.mark.parametrize(
    ("phases", "changes", "words"),
    [
        ([{"heel": "stick"}, {"toe": "stick", "impact": {"heel": "leaves", "feet": "swapped"}}], {},
         rf"gait.phases\[1\].impact.{NO_FOOT}"),
        ([{"heel": "stick", "impact": {"heel": "stick", "feet": "swapped"}}], {},
         rf"gait.phases\[0\].impact.{NO_FOOT}"),
        ([{"toe": "stick"}, {"heel": "stick", "impact": {"heel": "stick", "feet": "kept"}}], {},
         r"gait.phases\[1\].impact.feet: is not a contact of the mid_heel_toe"),
        ([{"toe": "stick"}, {"heel": "stick", "impact": {"heel": "stick", "feet": "swapped"}}],
         {"section": "touchdown", "impact": {"heel": "stick"}},
         r"gait.phases\[1\].impact: the landing of the mid_heel_toe ends its step: leave it out"),
        ([{"toe": "stick"}, {"heel": "stick", "impact": {"heel": "stick", "feet": "swapped"}}, {"toe": "stick"}],
         {"friction": {"heel": 0.3, "swing_heel": 0.4, "toe": 0.3, "swing_toe": 0.3}},
         r"friction.heel: differs from that of swing_heel, with which .*: give both the same\n"),
    ],
)  # fmt: skip
def test_what_cannot_swap_within_a_cycle_is_refused_with_its_place(phases, changes, words):
    data = problem_data(named("heel-toe").problem)
    gait = {"section": {"margin": "middle"}, "phases": phases, "guess": data["gait"]["guess"]}
    gait |= {key: changes[key] for key in changes if key != "friction"}
    data |= {"gait": gait, "walker": data["walker"] | {"model": "mid_heel_toe"}}
    data |= {key: changes[key] for key in changes if key == "friction"}
    with pytest.raises(ProblemError, match=words):
        parse_problem(json.dumps(data), walkers=[MidHeelToe])


@pytest.mark.slow
def test_families_from_either_section_pass_the_same_special_points() -> None:
    starts = go.solve(mid_stride(), progress=False), named("compass-passive-a")
    for target in (0.2, 0.1):
        ours, theirs = (go.continuation(start, "friction", to=target, progress=False).specials for start in starts)
        kinds = ["mode_change", "mode_change", "end"] if target == 0.2 else ["neimark_sacker", "end"]
        assert [special.type for special in ours] == [special.type for special in theirs] == kinds
        assert [each.value for each in ours] == pytest.approx([each.value for each in theirs], abs=1e-9)


@pytest.mark.parametrize("engine", ["scipy", "heyoka"])
def test_many_states_return_to_the_section_as_one_does(engine: str) -> None:
    if engine == "heyoka":
        pytest.importorskip("heyoka")
    for gait in (go.solve(mid_stride(), progress=False), entrained()):
        section = gait.system.section(gait.cycle)
        xi = gait.state[section.indices] * np.linspace(1, 1.002, 3)[:, None]
        returned = go.return_map(gait, xi, engine=engine)
        assert returned.completed.all()
        assert [returned.sequence(row) for row in range(3)] == [gait.cycle.phases] * 3
        one_by_one = ReturnMap(Simulator(gait.dynamics), section, 1, gait.state)
        np.testing.assert_allclose(returned.states, [one_by_one(row).xi for row in xi], atol=1e-10)


def test_legs_that_differ_cannot_swap_within_a_cycle() -> None:
    plain = problem_data(go.load_problem("compass-unequal"))
    gait = {"section": "clock", "phases": ["stick", SLIP], "guess": {"state": {}}}
    with pytest.raises(ProblemError, match=r"clock. is not possible: the legs of the unequal_compass differ"):
        parse_problem(json.dumps(plain | {"gait": gait}))


def test_a_law_whose_time_restarts_at_landings_ends_no_cycle_at_a_margin() -> None:
    data = problem_data(mid_stride())
    data["control"] = {"type": "oscillating", "cycle": 0.7, "kp": 0.3, "kd": 0, "mean": {}, "amplitude": {"hip": 0.3}}
    with pytest.raises(ProblemError, match=r"gait.section: Oscillating depends on the time since the last landing"):
        parse_problem(json.dumps(data), walkers=[MidCompass])


def test_a_landing_at_the_start_of_the_cycle_or_in_an_unknown_word_is_refused_with_its_place() -> None:
    data = problem_data(mid_stride())
    for phase, words in (
        ({"mode": "stick", "impact": "stick"}, r"gait.phases\[0\].impact: the step begins there: leave it out"),
        ({"mode": "stick", "impact": "flight"}, r"gait.phases\[0\].impact: .flight. is not one of the choices"),
    ):
        data["gait"]["phases"] = [phase, "slip_backward", SLIP, "stick"]
        with pytest.raises(ProblemError, match=words):
            parse_problem(json.dumps(data), walkers=[MidCompass])


@pytest.mark.slow
def test_a_search_from_mid_stride_finds_the_gaits_a_and_b_that_one_from_landing_to_landing_finds() -> None:
    found = go.find(mid_stride(), starts=12, workers=1, progress=False)
    expected = [named(name).scalar("period") for name in ("compass-passive-a", "compass-passive-b")]
    assert [gait.scalar("period") for gait in found] == pytest.approx(expected, rel=1e-9)


def open_sequence(problem: Problem) -> Problem:
    """A problem without modes and without a guess."""
    data = problem_data(problem)
    data["gait"] = {"phases": "auto", "section": data["gait"]["section"]}
    return parse_problem(json.dumps(data), walkers=[MidCompass], controls=[HipClock])


def test_starts_without_a_guess_stand_on_a_foot_at_rest_wherever_the_other_one_is() -> None:
    problem = open_sequence(mid_stride())
    dynamics, rng = problem_dynamics(problem), np.random.default_rng(0)
    states = around_guess(problem, dynamics, 20, rng, exact=False, within={})
    heights = [float(dynamics.system.contact_points(z, dynamics.p)[0][1]) for z in states]
    assert np.isfinite(states).all()
    assert not states[:, dynamics.system.state_names.index("dx")].any()
    assert min(heights) < 0 < max(heights)


def test_feet_may_pass_where_a_cycle_begins_in_mid_stride_but_not_where_one_lands() -> None:
    state = {"theta1": 0.0, "theta2": 0.0, "dtheta1": 0.4, "dtheta2": 0.4}
    data = problem_data(mid_stride())
    data["gait"]["guess"]["state"] = state
    assert parse_problem(json.dumps(data), walkers=[MidCompass]).start.state["theta2"] == 0.0
    with pytest.raises(ProblemError, match="both feet are at the same place"):
        named("compass-passive-stick").problem.replace({"gait.guess.state": {**state, "dtheta1": 0.5}})


@pytest.mark.slow
@pytest.mark.parametrize("closed", [lambda: go.solve(mid_stride(), progress=False), entrained], ids=["margin", "clock"])
def test_gaits_of_one_foot_are_found_without_a_guess_at_either_section(closed: Callable[[], Gait]) -> None:
    gait = closed()
    found = go.find(open_sequence(gait.problem), workers=1, progress=False)
    assert gait.period in [pytest.approx(each.period, rel=1e-7) for each in found]
