"""Everything that is wrong with a problem file is said at once: place, key, what is wrong, what is allowed."""

import re
from pathlib import Path

import pytest

from gaitopt.errors import ProblemError
from gaitopt.model.registry import registered_walkers
from gaitopt.problem.faults import OverridePlace
from gaitopt.problem.problem import load_problem, parse_problem

GAIT = """\
name: walk
walker:
  model: compass_biped
  leg_length: 1.6
  leg_mass: 4
  leg_com: 0.8
  hip_mass: 2
  gravity: 9.8
  slope: 1 deg
friction: 0.2
control: {type: constant_torque, ankle: 0.1, hip: 0.2}
gait:
  phases: [slip_forward, stick]
  impact: stick
  guess:
    state: {theta1: -0.15, dtheta1: 0.7, dtheta2: -0.5}
    durations: [0.1, 0.6]
"""
WHEEL = """\
name: roll
walker: {model: rimless_wheel, spokes: 10, radius: 1, mass: 1, inertia_ratio: 0.5, gravity: 1, slope: 13 deg}
friction: 1
gait: {phases: [stick], impact: stick, guess: {state: {dtheta: 0.76}}}
"""
TORQUES = "{type: constant_torque, ankle: 0.1, hip: 0.2}"
HIP = "hip: {free: [-1, 1], guess: 0.2}"
WHOLE = "spokes: {free: [5, 12], guess: 10}"


def faults(text):
    with pytest.raises(ProblemError) as caught:
        parse_problem(text, Path("gait.yaml"))
    assert caught.value.exit_code == 3
    return str(caught.value).splitlines()


def changed(*pairs, text=GAIT, add=""):
    for old, new in pairs:
        assert text.count(old) >= 1
        text = text.replace(old, new, 1)
    return text + add


def only(text):
    (line,) = faults(text)
    return line


def test_the_examples_of_this_file_are_right():
    assert parse_problem(GAIT).walker.leg_mass == 4.0
    assert parse_problem(WHEEL).walker.spokes == 10


def test_all_faults_of_a_file_come_at_once_in_the_order_of_their_lines():
    text = changed(
        ("leg_mass: 4", "leg_mas: 4"),
        ("leg_com: 0.8", "leg_com: true"),
        ("friction: 0.2", "friction: -1\nfrction: 0.3"),
        ("ankle: 0.1", "knee: 0.1"),
        ("slip_forward, stick]", "stick, stick]"),
        ("theta1: -0.15", "theta: -0.15"),
        ("[0.1, 0.6]", "[0.1]"),
    )
    assert faults(text) == [
        "gait.yaml:2:1 walker.leg_mass: is missing (point mass on each leg [kg])",
        "gait.yaml:5:3 walker.leg_mas: unknown key; did you mean leg_mass or leg_com?",
        "gait.yaml:6:3 walker.leg_com: true is not a number (distance of the leg's mass from its foot [m])",
        "gait.yaml:10:1 friction: -1 must be at least 0 and at most 1000 (coefficient of friction mu)",
        "gait.yaml:11:1 frction: unknown key; did you mean friction?",
        "gait.yaml:12:1 control.ankle: is missing (torque of the ankle [N m])",
        "gait.yaml:12:34 control.knee: unknown key; allowed: ankle, hip, limits, step_feedback; a knee is a joint "
        "stop: kneed_walker has one, and its phases state it, {mode: stick, knee: free}",
        "gait.yaml:14:3 gait.phases: phases 1 and 2 are both stick: merge them into one",
        "gait.yaml:17:13 gait.guess.state.theta: unknown key; did you mean theta2 or theta1?",
        "gait.yaml:18:5 gait.guess.durations: 1 given, but the gait needs one duration per phase (stick, stick); "
        "or leave durations out",
    ]


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("leg_mass: 4", "leg_mass: -4", "5:3 walker.leg_mass", "-4 must be greater than 0"),
        ("leg_mass: 4", "leg_mass: 4 kg", "5:3 walker.leg_mass", "'4 kg' is not a number"),
        ("leg_mass: 4", "leg_mass:", "5:3 walker.leg_mass", "nothing (null) is not a number"),
        ("gravity: 9.8", "gravity: .nan", "8:3 walker.gravity", "nan is not a finite number"),
        ("gravity: 9.8", "gravity: 1e999", "8:3 walker.gravity", "inf is not a finite number"),
        ("friction: 0.2", "friction: {static: 0.1, kinetic: 0.2}", "10:1 friction", "static = 0.1 is below kinetic = "),
        ("friction: 0.2", "friction: {static: 0.1}", "10:1 friction.kinetic", "is missing (coefficient mu_k of a sli"),
        ("friction: 0.2", "friction: {static: 1, kinetic: -1}", "10:23 friction.kinetic", "-1 must be at least 0"),
        ("friction: 0.2", "friction: {static: 1, kinetic: 1, dynamic: 0}", "10:35 friction.dynamic", "unknown key;"),
        ("slope: 1 deg", "slope: 90 deg", "9:3 walker.slope", "'90 deg' must be at least -1.39626 and at most 1.39626"),
        ("slope: 1 deg", "slope: 1 grad", "9:3 walker.slope", "write an angle as a number in rad, or with its unit:"),
        ("compass_biped", "compas_biped", "3:3 walker.model", "no walker is called 'compas_biped'; did you mean"),
        (
            "compass_biped",
            "centaur",
            "3:3 walker.model",
            f"no walker is called 'centaur'; allowed: {', '.join(registered_walkers())}",
        ),
        ("stick]", "slp_forward]", "13:26 gait.phases[1]", "'slp_forward' is not one of the choices; did you mean"),
        ("[slip_forward, stick]", "stick", "13:3 gait.phases", "'stick' is not a list"),
        ("[0.1, 0.6]", "[0.1, -0.6]", "17:22 gait.guess.durations[1]", "-0.6 must be greater than 0"),
        ("theta1: -0.15, ", "", "16:5 gait.guess.state.theta1", "is missing; after this impact the section is"),
        ("theta1: -0.15", "theta1: -0.15, theta2: 0.15", "16:28 gait.guess.state.theta2", "0.15 contradicts the"),
        ("dtheta2: -0.5", "dtheta2: -0.5, dx: 0.2", "16:57 gait.guess.state.dx", "0.2 contradicts the impact: after"),
        ("name: walk", "name: ../walk", "1:1 name", "'../walk' has characters that are not allowed"),
        ("friction: 0.2", "friction: 0.2\nimpact_law: columb", "11:1 impact_law", "'columb' is not one of the"),
        ("type: constant_torque", "type: constant_torq", "11:11 control.type", "no control law is called"),
        (TORQUES, "{ankle: 1}", "11:1 control.type", "is missing; allowed: none, constant_torque, pd"),
        (TORQUES, "{type: none, ankle: 1}", "11:23 control.ankle", "unknown key; allowed: none"),
    ],
)
def test_a_wrong_value_is_named_with_place_range_and_remedy(old, new, place, words):
    line = only(changed((old, new)))
    assert line.startswith(f"gait.yaml:{place}: {words}")


WHEEL_ONLY = "\n".join(line for line in WHEEL.splitlines() if not line.startswith("gait"))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("until: 3", "until: 3 is not a mapping; keys: time, steps, events"),
        ("until: {}", "until: is empty: give time, steps or events"),
        ("until: {time: -1}", "until.time: -1"),
        ("until: {events: 1.5}", "until.events: 1.5"),
        ("until: {times: 1}", "until.times: unknown key"),
        ("state: {theta: 0.1}", "state.dtheta: is missing; just after an impact give dtheta alone; else a state needs"),
        ("state: {dtheta: 1e9}", "state.dtheta: 1e+09"),
        ("state: 3", "state: 3 is not a mapping; keys: theta, x, dtheta, dx"),
    ],
)
def test_a_wrong_simulation_is_named(more, words):
    assert f" {words}" in only(f"{WHEEL_ONLY}\n{more}")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{WHEEL}\nstate: {{dtheta: 1}}", " state: is for simulations without a gait"),
        (changed(("leg_com: 0.8", "leg_com: 1.8")), ":2:1 walker: leg_com = 1.8 m must be less than leg_length = 1.6"),
        (changed(("spokes: 10", "spokes: 10.5"), text=WHEEL), "10.5 is not an integer"),
        (changed(text=WHEEL, add="control: {type: pd}"), ":5:11 control.type: rimless_wheel has no actuators, so pd"),
        (changed(("[slip_forward, stick]", "[]")), "a step needs at least one phase"),
        (
            changed(("impact: stick", "impact: slip_forward"), ("dtheta2: -0.5", "dtheta2: -0.5, dx: -0.2")),
            "gait.guess.state.dx: -0.2 contradicts the impact: after slip_forward it is > 0",
        ),
        (changed(("spokes: 10", WHOLE), text=WHEEL, add="objective: speed\n"), "walker.spokes: cannot be free"),
    ],
)
def test_what_a_walker_a_law_or_a_simulation_cannot_have_is_named(text, words):
    line, *others = faults(text)
    assert words in line
    assert not others or "at least one phase" in line  # which leaves durations of other phases


def test_a_slipping_impact_is_followed_by_its_slip_and_needs_a_slip_velocity():
    lines = faults(changed(("impact: stick", "impact: slip_backward")))
    assert lines == [
        "gait.yaml:13:3 gait.phases: after an impact with slip_backward the foot is already slipping: "
        "the first phase must be slip_backward, not slip_forward",
        "gait.yaml:16:5 gait.guess.state.dx: is missing; after this impact the section is theta1, dtheta1, dtheta2, dx",
    ]


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "a\\\\b", "/a", "a\\n", "-a", "a" * 81])
def test_a_name_cannot_leave_the_folder_of_its_runs(name):
    assert only(changed(("name: walk", f'name: "{name}"'))).startswith("gait.yaml:1:1 name: ")


@pytest.mark.parametrize(
    ("law", "key", "words"),
    [
        ("kd: 1", "reference", "is missing (motion that the joints track)"),
        ("kd: 1, reference: {gait: compass-passive-x, beyond_end: off}", "reference.gait", "the reference 'compass-pa"),
        ("kd: 1, reference: {gait: nowhere.yaml, beyond_end: off}", "reference.gait", "the reference 'nowhere.yaml'"),
        ("kd: 1, reference: {gait: rimless-wheel-slip, beyond_end: off}", "reference.gait", "the reference 'rimless-w"),
        (
            "kd: 1, reference: {curve: {degree: 0, start: compass-passive-b}, beyond_end: hold}",
            "reference.curve.degree",
            "0 must be at least 1 and at most 20 (degree of the curve of each joint)",
        ),
    ],
)
def test_a_wrong_pd_law_is_named(law, key, words):
    place, line = only(changed((TORQUES, f"{{type: pd, kp: 1, {law}}}"))).split(" ", 1)
    assert place.startswith("gait.yaml:11:")
    assert line.startswith(f"control.{key}: {words}")


def test_a_wrong_gain_and_a_wrong_reference_come_at_once():
    lines = faults(changed((TORQUES, "{type: pd, kp: x, kd: 1, reference: {curve: {degree: 2.5}, beyond_end: flow}}")))
    assert [line.split()[1] for line in lines] == [
        "control.kp:",
        "control.reference.curve.degree:",
        "control.reference.beyond_end:",
    ]


@pytest.mark.parametrize(
    ("new", "place", "words"),
    [
        ("hip: {free: [1, 1], guess: 1}", "11:52 control.hip.free", "is empty: [1, 1] needs lo < hi"),
        ("hip: {free: [-1, 1], guess: 2}", "11:67 control.hip.guess", "2 is outside of its bounds [-1, 1]"),
        ("hip: {free: [-1, x], guess: 0}", "11:63 control.hip.free[1]", "'x' is not a number"),
        ("hip: {free: [-1, .inf], guess: 0}", "11:63 control.hip.free[1]", "inf is not a finite number"),
        ("hip: {free: [-1, 1], guess: y}", "11:67 control.hip.guess", "'y' is not a number"),
        ("hip: {free: [-1], guess: 0}", "11:52 control.hip.free[1]", "is missing (bounds [lo, hi] of"),
        ("hip: {free: [-1, 1]}", "11:46 control.hip.guess", "is missing"),
    ],
)
def test_a_wrong_unknown_is_named(new, place, words):
    line = only(changed(("hip: 0.2", new), add="objective: speed\n"))
    assert line.startswith(f"gait.yaml:{place}: {words}")


def test_the_bounds_of_an_unknown_are_held_to_the_range_of_its_parameter():
    text = changed(("friction: 0.2", "friction: {free: [-0.1, 0.3], guess: 0.2}"), add="objective: friction\n")
    assert (
        only(text)
        == "gait.yaml:10:19 friction.free[0]: -0.1 must be at least 0 and at most 1000 (coefficient of friction mu)"
    )
    text = changed(("leg_com: 0.8", "leg_com: {free: [0.5, 1.7], guess: 0.8}"), add="objective: speed\n")
    assert only(text).startswith("gait.yaml:6:25 walker.leg_com.free[1]: leg_com = 1.7 m must be less than")


@pytest.mark.parametrize(
    ("stated", "place", "words"),
    [
        ("objective: cost_of_transpor", "18:1 objective", "cost_of_transpor is not a scalar of a gait and no freed"),
        ("objective: {control.ankle: 1}", "18:13 objective.control.ankle", "is not a scalar of a gait and no freed"),
        ("objective: {speed: 0}", "18:13 objective.speed", "0 is not a weight: give a number, negative to maximise,"),
        ("objective: 3", "18:1 objective", "3 is neither a NAME nor a mapping {NAME: weight}"),
        ("constraints: [speed]", "18:1 constraints", "['speed'] is not a mapping {NAME: value} or {NAME: {min, max}}"),
        ("constraints: {speed: {min: 1, max: 0.5}}", "18:15 constraints.speed", "is empty: min = 1 is above max = 0.5"),
        ("constraints: {control.hip: {min: 2}}", "18:15 constraints.control.hip", "contradicts the bounds [-1, 1] of"),
        ("constraints: {speed: {}}", "18:15 constraints.speed", "has neither min nor max: give one or both"),
        ("constraints: {speed: {minimum: 1}}", "18:23 constraints.speed.minimum", "unknown key; did you mean min?"),
        ("constraints: {speed: {max: .inf}}", "18:23 constraints.speed.max", "inf is not a finite number"),
        ("constraints: {speed: fast}", "18:15 constraints.speed", "'fast' is not a constraint: a number or {min: a,"),
        ("constraints: {speed: 0.4, period: 0.7}", "18:1 constraints", "too few unknowns: 2 equalities (speed,"),
    ],
)
def test_a_wrong_demand_is_named(stated, place, words):
    line = only(changed(("hip: 0.2", HIP), add=f"{stated}\n"))
    assert line.startswith(f"gait.yaml:{place}: {words}")


def test_too_few_and_too_many_unknowns_are_said_plainly():
    objective = only(changed(add="objective: speed\n"))
    assert objective.startswith("gait.yaml:18:1 objective: too few unknowns")
    assert "free a parameter of walker, friction or control" in objective
    assert "over: is for designs, and nothing is an unknown" in only(GAIT + "over: {friction: [0.1, 0.3]}\n")
    assert only(changed(add="constraints: {speed: 0.4}\n")).startswith("gait.yaml:18:1 constraints: too few unknowns")
    assert only(changed(("hip: 0.2", HIP))).startswith("gait.yaml:11:46 control.hip: too many unknowns")


@pytest.mark.parametrize(
    "name", ["work", "cost_of_transport", "absolute_cost_of_transport", "torque_squared", "peak_torque"]
)
def test_a_passive_walker_has_no_torque_to_ask_for(name):
    text = changed(("slope: 13 deg", "slope: {free: [5 deg, 15 deg], guess: 13 deg}"), text=WHEEL)
    assert "this walker is passive" in only(f"{text}objective: {name}\n")
    assert "this walker is passive" in only(f"{text}constraints: {{{name}: {{max: 1}}}}\n")


def test_required_friction_cannot_be_constrained_where_a_gait_never_sticks():
    text = changed(("hip: 0.2", HIP), ("[slip_forward, stick]", "[slip_forward]"), ("[0.1, 0.6]", "[0.7]"))
    assert "is defined for sticking phases" in only(f"{text}objective: required_friction\n")


def test_a_fault_is_one_printable_line_whatever_the_file_says():
    (line,) = faults(changed(add='"bad\\x1b[31m\\nkey": 1\n'))
    assert line.isprintable()
    assert line.startswith("gait.yaml:18:1 'bad\\x1b[31m\\nkey': unknown key")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"gait.phases": ["knee"]}, r"\{mode: stick, knee: free\}"),
        ({"gait.phases": ["double_support"]}, "both feet on the ground, such as slip_walker"),
        ({"gait.phases": ["jump"]}, "phases called flight"),
        ({"gait.impact": "bounce"}, "impacts are plastic"),
        ({"walker.hip_damping": 1.0}, "torso_walker"),
        ({"control": {"type": "cpg"}}, "time since the impact"),
    ],
)
def test_what_belongs_elsewhere_or_cannot_be_expressed_is_said(change, words):
    with pytest.raises(ProblemError, match=words):
        load_problem("compass-passive-a").replace(change)


LOCKED = {"mode": "stick", "knee": "locked"}


@pytest.mark.parametrize(
    ("name", "phases", "words"),
    [
        ("compass-passive-a", ["stick", "flight"], "has no flight"),
        ("slip-run", ["stick"], "last phase of a step must be flight"),
        ("slip-run", ["stick", "slip_forward", "flight"], "has no slip_forward"),
        ("slip-run", ["stick", "flight", "stick"], "is a flight"),
        ("hopper", ["stick", "flight"], "write {mode: stick, leg: free, thrust: off}"),
        ("kneed-passive", ["stick"], "{mode: stick, knee: free}"),
        ("kneed-passive", [{"mode": "stick", "knee": "free"}], "all stops must lock before the foot comes down"),
        ("kneed-passive", [LOCKED, {"mode": "stick", "knee": "free"}], "begins with all stops free"),
        ("kneed-passive", [{"mode": "stick", "hip": "free"}], "no stop or switch of the kneed_walker"),
        ("kneed-passive", [{"mode": "stick", "knee": "bent"}], "bent"),
    ],
)
def test_phases_that_a_walker_cannot_have_are_refused(name, phases, words):
    with pytest.raises(ProblemError, match=re.escape(words)):
        load_problem(name).replace({"gait.phases": phases})


def test_the_values_of_a_motor_are_listed_by_the_first_and_the_last():
    with pytest.raises(ProblemError, match=r"control\.stance_hip\.0 to 20, control.*; electrical work .*work: 1"):
        load_problem("rabbit-optimal").replace({"objective": "electrical_work"})


ROBUST = changed((TORQUES, f"{{type: constant_torque, ankle: 0.1, {HIP}}}"), add="objective: {worst: work}\n")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("over: {friction: [0.3, 0.4]}", "over.friction: [0.3, 0.4] must contain the problem's own value, friction ="),
        ("over: {friction: [0.3, 0.1]}", "over.friction: [0.3, 0.1] is empty: the lower limit comes first"),
        ("over: {friction: [0.1, 0.3], walker.slope: [0, 1 deg]}", "over: is 2 parameters, but a design holds over"),
        ("over: {frictoin: [0.1, 0.3]}", "over.frictoin: is not a parameter of this problem; did you mean friction?"),
        ("over: {friction: 0.3}", "over.friction: 0.3 is not a range: give two numbers, [lo, hi]"),
        ("over: {control.hip: [0, 1]}", "over.control.hip: is an unknown of the design"),
        ("over: {friction: [-1, 1]}", "over.friction: -1.0 must be at least 0"),
        ("over: {friction: [0.1, 0.3]}\nat: {friction: 0.2}", "at: contradicts objective: {worst: ...}"),
        ("over: {friction: [0.1, 0.3]}\nconstraints: {speed: 0.5}", "constraints.speed: is a single value"),
        ("at: {friction: 0.2}\nover: {friction: [0.1, 0.3]}\nconstraint: {}", "constraint: unknown key"),
        ("", "objective.worst: worst counts the values over a range"),
    ],
)
def test_a_wrong_range_of_a_design_is_named(text, line):
    assert line in "\n".join(faults(ROBUST + text + "\n"))


@pytest.mark.parametrize(
    ("objective", "line"),
    [
        ("{worst: work, mean: work}", "objective: worst and mean: worst or mean counts the whole objective"),
        ("{median: work}", "objective: 'median' is no way in which the values over a range count: give {worst: NAME}"),
        ("{mean: wrok}", "objective.mean: wrok is not a scalar of a gait"),
        ("work\nat: {friction: 0.4}", "at.friction: 0.4 lies outside of the range [0.1, 0.3]"),
        ("work\nat: {walker.slope: 0.4}", "at: {'walker.slope': 0.4} is not a value of the parameter in over"),
    ],
)
def test_a_wrong_objective_over_a_range_is_named(objective, line):
    assert line in only(changed(("{worst: work}", objective), text=ROBUST) + "over: {friction: [0.1, 0.3]}\n")


def test_a_range_is_part_of_the_problem_and_of_its_digest():
    ranged = parse_problem(ROBUST + "over: {friction: [0.1, 0.3]}\n")
    wider = ranged.replace({"over.friction": [0.1, 0.4]})
    assert (wider.over.lower, wider.over.upper, wider.over.aggregate) == (0.1, 0.4, "worst")
    assert wider.digest != ranged.digest
    assert parse_problem(ranged.text).digest == ranged.digest
    assert ranged.at_own_value().over is None
    assert ranged.at_own_value().digest == ranged.digest  # its results belong to the design


def test_a_fault_without_an_override_is_located_by_its_own_key():
    assert OverridePlace({}, "--set ").locate(("gait", "phases", 1)) == ((0, 0), "--set gait.phases[1]")


@pytest.mark.parametrize("key", ["objective", "constraints"])
def test_a_scalar_whose_name_is_no_text_is_unknown(key):
    with pytest.raises(ProblemError, match=rf"{key}.*1.*is not a scalar of a gait and no freed parameter"):
        parse_problem(GAIT).replace({key: {1: 2}})
