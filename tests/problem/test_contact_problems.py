"""Problem files of walkers with several contacts: their modes, friction, sections and guesses."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gaitopt.errors import ProblemError
from gaitopt.model.cycle import Cycle
from gaitopt.model.lagrangian import equations_of_motion
from gaitopt.model.mechanism import Mechanism
from gaitopt.model.modes import Mode
from gaitopt.model.section import Section, section_of
from gaitopt.model.transitions import transitions
from gaitopt.model.walkers.heel_toe import HeelToe
from gaitopt.model.walkers.slip_walker import SlipWalker
from gaitopt.problem.problem import Problem, load_problem, parse_problem, restore_problem
from gaitopt.problem.statement import cycle_data
from gaitopt.verification.walk import simulate

PHASES = "{heel: slip_forward}, {heel: stick}, {toe: stick}, {toe: slip_backward}"
HEEL_TOE = """
name: heel-toe
walker:
  {model: heel_toe, leg_length: 1, leg_mass: 5, leg_com: 0.5, hip_mass: 10, heel: 0.02, toe: 0.04, gravity: 9.81,
   slope: 0.0524}
friction: 0.265
gait:
  phases: [{heel: slip_forward}, {heel: stick}, {toe: stick}, {toe: slip_backward}]
  impact: {heel: stick}
  guess:
    state: {theta1: -0.29492113, theta2: -0.317, dtheta1: 1.15637229, dtheta2: -0.34413086}
"""


def heel_toe(*changes: tuple[str, str]) -> Problem:
    text = HEEL_TOE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return parse_problem(text)


def test_a_state_that_is_left_out_puts_the_contacts_on_the_ground() -> None:
    problem = heel_toe()
    assert problem.section_names == ("theta1", "dtheta1", "dtheta2")
    state = problem.guess.state
    heel = state["y"] + 0.02 * np.sin(state["theta1"])
    assert heel == pytest.approx(0, abs=1e-12)
    # the heel rests: velocity of the ankle from the rotation about it
    assert state["dy"] + 0.02 * np.cos(state["theta1"]) * state["dtheta1"] == pytest.approx(0, abs=1e-12)


def test_a_problem_of_contacts_is_written_and_read_alike() -> None:
    problem = heel_toe(("{toe: stick}", "{toe: stick, impact: {toe: stick, heel: leaves}}"))
    again = restore_problem(json.loads(json.dumps(problem.resolved())))
    assert again.cycle == problem.cycle == heel_toe().cycle
    assert Cycle.from_record(json.loads(json.dumps(cycle_data(problem.cycle)))) == problem.cycle
    assert dict(again.cycle.steps[0].landings) == {2: problem.cycle.phases[2]}
    assert again.digest == problem.digest
    assert problem.replace({"friction": 0.3}).parameters["friction"] == 0.3


def test_a_simulated_record_has_modes_impacts_and_scalars_by_contact() -> None:
    walk = simulate(heel_toe())
    record = walk.to_record()
    assert [{k: v for k, v in phase["mode"].items() if v != "off"} for phase in record["phases"]] == [
        {"heel": "slip_forward"}, {"heel": "stick"}, {"toe": "stick"}, {"toe": "slip_backward"},
    ]  # fmt: skip
    assert [phase.get("impact", {}).get("toe") for phase in record["phases"]] == [None, None, "stick", None]
    assert record["impact"]["heel"] == "stick"
    assert record["contacts"]["heel"]["slip_distance"] == pytest.approx(5.8337e-5, rel=1e-3)
    assert record["contacts"]["toe"]["required_friction"] == pytest.approx(0.265, abs=1e-9)
    assert record["contacts"]["swing_toe"]["required_friction"] is None
    assert {"f_t.heel", "f_n.toe"} < {*walk.to_frame().columns}


def test_every_contact_may_have_friction_of_its_own() -> None:
    feet = "{heel: 0.3, toe: {static: 0.4, kinetic: 0.35}, swing_heel: 0.3, swing_toe: {static: 0.4, kinetic: 0.35}}"
    problem = heel_toe(("friction: 0.265", f"friction: {feet}"))
    assert problem.parameters["friction.toe.static"] == 0.4
    changed = problem.replace({"friction.heel": 0.2, "friction.swing_heel": 0.2})
    assert (changed.parameters["friction.heel"], changed.parameters["friction.toe.kinetic"]) == (0.2, 0.35)
    assert restore_problem(changed.resolved()).parameters == changed.parameters


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("{heel: stick}, {toe", "{heal: stick}, {toe", "heal: is not a contact of the heel_toe; did you mean heel?"),
        ("{heel: stick}, {toe", "{heel: rolls}, {toe", "heel: 'rolls' is not what a contact does"),
        ("{heel: stick}, {toe", "stick, {toe", "'stick' is not a mapping of contacts"),
        ("[{heel: slip", "[{heel: slip_forward, impact: {heel: stick}}, {heel: slip", "the step begins there"),
        ("impact: {heel: stick}", "impact: {toe: slip_forward}", "heel touches the ground in heel slip_forward"),
        ("impact: {heel: stick}", "impact: {heel: slip_backward}", "heel is already slipping"),
        ("impact: {heel: stick}", "impact: {heel: stick}\n  section: clock", "the cycle ends without an impact"),
        ("friction: 0.265", "friction: {heel: 0.3}", "friction.toe: is missing: every contact has its friction"),
        ("friction: 0.265", "friction: {heel: 0.3, toe: 1, swing_heel: 1, swing_toe: 1}", "swing_heel: differs from"),
        ("theta2: -0.317", "theta2: 0.9", "0.9 contradicts the section, where it is"),
        ("slope: 0.0524", "slope: {free: [0.05, 0.06], guess: 0.0524}", "too many unknowns: no objective"),
        (", dtheta2: -0.34413086", "", "dtheta2: is missing; at the end of this cycle the section is theta1, dtheta1"),
        (f"phases: [{PHASES}]", "phases: auto", "y: is missing; where the modes are open"),
        (f"phases: [{PHASES}]\n  impact: {{heel: stick}}", "phases: auto", "y: is missing; where the modes are open"),
    ],
)  # fmt: skip
def test_a_wrong_statement_is_one_sentence(old: str, new: str, words: str) -> None:
    with pytest.raises(ProblemError) as caught:
        heel_toe((old, new))
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("name", "section", "words"),
    [
        ("bounding", "clock", "clock needs a control law with a period"),
        ("bounding", "{margin: vertical}", "the bounder has no section 'vertical'; there are: apex, level"),
    ],
)
def test_a_section_that_a_walker_lacks_is_refused(name: str, section: str, words: str) -> None:
    text = re.sub(r"section: .*", f"section: {section}", load_problem(name).text)
    with pytest.raises(ProblemError, match=re.escape(words)):
        parse_problem(text)


def contacts(walker: type, **words: str) -> Mode:
    return Mode.of_contacts({name: words.get(name, "off") for name in walker.contacts})


def test_a_section_remembers_the_symbols_of_its_equations() -> None:
    """The equations of a walker are forgotten and built anew, with other symbols, where many walkers are in use."""
    heel, both = contacts(HeelToe, heel="stick"), contacts(HeelToe, heel="stick", swing_heel="stick")
    section = Section(HeelToe, both, heel, "touchdown")
    equations_of_motion.cache_clear()
    p, z = np.full(len(HeelToe.model_fields), 0.5), np.full(len(HeelToe.state_names()), 0.1)
    assert np.isfinite(np.asarray(section.projected(z, p))).all()


def test_a_section_has_the_coordinates_that_its_contacts_leave_free() -> None:
    """Spring-mass walking at touchdown is free in the position of the back foot and in the velocity."""
    both = contacts(SlipWalker, front="stick", back="stick")
    section = section_of(SlipWalker, contacts(SlipWalker, front="stick"), both, "touchdown")
    assert section.names == ("back_x", "dy")  # dx follows from the energy
    p = np.array([80.0, 1.0, 14e3, np.deg2rad(69), 816.0, 9.81])
    near = np.array([0.36, -0.93, -0.1, -0.93, 0.93, 0, *np.zeros(5), 1.0])
    z = section.lift(np.array([-0.1, -0.2]), p, near)
    names = SlipWalker.state_names()
    values = dict(zip(names, z, strict=True))
    assert values["y"] == pytest.approx(np.sin(np.deg2rad(69)))
    energy = 40 * (0.2**2 + values["dx"] ** 2) + 80 * 9.81 * values["y"] + 7e3 * (1 - np.hypot(0.1, values["y"])) ** 2
    assert (energy, values["dfront_x"]) == pytest.approx((816.0, -values["dx"]))
    assert values["back_y"] == pytest.approx(-values["y"])
    tangent, h = section.tangent(z, p), 1e-6
    for k in range(2):
        xi = z[section.indices] + h * np.eye(2)[k]
        assert (section.lift(xi, p, z) - z) / h == pytest.approx(tangent[:, k], abs=1e-5)


@pytest.mark.parametrize(
    ("before", "after", "guard"),
    [
        ({"heel": "stick"}, {"heel": "slip_forward"}, "cone_forward.heel"),
        ({"heel": "slip_forward"}, {"heel": "stick"}, "slip_velocity.heel"),
        ({"heel": "slip_forward"}, {"heel": "slip_backward"}, "slip_velocity.heel"),
        ({"heel": "slip_forward"}, {}, "normal_force.heel"),
        ({"heel": "stick"}, {"toe": "slip_forward"}, "gap.toe"),
        ({"heel": "slip_forward", "toe": "slip_forward"}, {"heel": "slip_forward"}, "normal_force.toe"),
        ({"heel": "stick", "toe": "stick"}, {"heel": "slip_forward", "toe": "slip_forward"}, "cone_forward.toe+heel"),
        ({"heel": "stick", "toe": "stick"}, {"heel": "stick"}, "normal_force.toe"),
    ],
)  # fmt: skip
def test_the_event_between_two_modes_follows_from_what_changes(before: dict, after: dict, guard: str) -> None:
    table = transitions(HeelToe)
    assert table.between(contacts(HeelToe, **before), contacts(HeelToe, **after)).guard == guard


def test_a_walker_without_landings_is_told_how_its_cycle_may_end() -> None:
    text = load_problem("crawler").text.replace("section: clock", "section: touchdown")
    with pytest.raises(ProblemError) as caught:
        parse_problem(text)
    (line,) = str(caught.value).splitlines()
    assert line.endswith(
        "has no landing contacts: write section: clock, or section: {margin: NAME}; "
        "to simulate it alone, leave gait out"
    )


class Latched(HeelToe):
    """Heel and toe with a stop."""

    model = "latched"
    stops = ("knee",)

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return replace(super().mechanism(q, p), stops={"knee": q.theta1 + 1})


@pytest.mark.parametrize(
    ("phase", "words"),
    [
        ("{heel: stick}", "heel stick does not fit the stops of the latched: write {mode: {heel: stick}, knee: free}"),
        ("{mode: {heel: stick}, knee: open}", "gait.phases[0].knee: 'open' is not possible: free or locked"),
        ("{mode: {heel: stick}, hip: free}", "hip: 'free' is not possible: no stop or switch of the latched"),
        ("{mode: stick, knee: free}", "gait.phases[0].mode: 'stick' is not a mapping of contacts: heel, toe"),
    ],
)
def test_a_phase_of_named_contacts_with_stops_says_how_it_is_written(phase: str, words: str) -> None:
    text = HEEL_TOE.replace("model: heel_toe", "model: latched")
    old = next(line for line in text.splitlines() if "phases:" in line)
    phases = f"  phases: [{phase}, {{mode: {{toe: stick}}, knee: locked}}]"
    with pytest.raises(ProblemError) as caught:
        parse_problem(text.replace(old, phases), walkers=[Latched])
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
