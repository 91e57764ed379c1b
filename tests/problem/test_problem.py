"""A problem is complete, in SI, and identified by what determines its gait; the catalogue holds the paper's gaits."""

import json
import math

import pytest
from samples import sampled

from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.model.curve import BeyondEnd
from gaitopt.model.friction import ImpactLaw
from gaitopt.model.modes import Mode
from gaitopt.model.reference import GaitReference
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.model.units import Free
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.problem.problem import load_problem, parse_problem, restore_problem
from gaitopt.problem.source import problem_names
from gaitopt.problem.statement import Range

FREE_TORQUES = {
    "control.ankle": {"free": [0, 2], "guess": 1.65},
    "walker.slope": {"free": ["-1 deg", "1 deg"], "guess": 0},
    "objective": "cost_of_transport",
    "constraints": {"speed": {"min": 0.3}, "walker.slope": "0.5 deg"},
}


def walking(name="walk", control="{type: none}"):
    return load_problem("compass-passive-b").text.replace(
        "name: compass-passive-b", f"name: {name}\ncontrol: {control}"
    )


def tracking(reference):
    return f"{{type: pd, kp: 15, kd: 15, reference: {{gait: {reference}, beyond_end: hold}}}}"


def error_of(problem, overrides):
    with pytest.raises(ProblemError) as caught:
        problem.replace(overrides)
    return str(caught.value)


@pytest.mark.parametrize("name", sampled(problem_names(), 3))
def test_every_named_problem_is_called_like_its_file_and_returns_from_its_record_without_remarks(name):
    problem = load_problem(name)
    assert problem.name == name
    record = json.loads(json.dumps(problem.resolved(), allow_nan=False))
    assert restore_problem(record).resolved() == problem.resolved()
    assert problem.replace({}).digest == problem.digest
    assert not problem.remarks


def test_what_the_guess_leaves_out_follows_from_the_section():
    compass = load_problem("compass-passive-a")
    assert tuple(compass.guess.state) == compass.walker.state_names()
    assert compass.guess.state["theta2"] == compass.guess.state["theta1"] == -0.1478
    assert compass.guess.state["x"] == compass.guess.state["dx"] == 0.0
    assert load_problem("rimless-wheel-stick").guess.state["theta"] == -math.pi / 10


def test_parameters_come_in_the_order_walker_friction_control():
    problem = load_problem("compass-torque-slip")
    walker = (f"walker.{key}" for key in CompassBiped.model_fields)
    assert list(problem.parameters) == [*walker, "friction", "control.ankle", "control.hip"]
    assert problem.parameters["control.ankle"] == 1.65
    freed = problem.replace(FREE_TORQUES | {"friction": {"free": [0.1, 0.2], "guess": 0.14}})
    assert list(freed.free) == ["walker.slope", "friction", "control.ankle"]
    assert list(load_problem("compass-pd-impact-slip").parameters)[-2:] == ["control.kp", "control.kd"]


def test_a_reference_in_a_file_is_that_of_its_class():
    tracked = GaitReference(gait="compass-passive-b", beyond_end=BeyondEnd.FLOW)
    assert load_problem("compass-pd-impact-slip").control == ProportionalDerivative(kp=15, kd=15, reference=tracked)


def test_unknowns_objective_and_constraints_are_read_in_si():
    problem = load_problem("compass-torque-slip").replace(FREE_TORQUES)
    assert problem.free == {
        "walker.slope": Free[float](free=(-math.radians(1), math.radians(1)), guess=0.0),
        "control.ankle": Free[float](free=(0.0, 2.0), guess=1.65),
    }
    assert problem.objective == {"cost_of_transport": 1.0}
    assert problem.constraints == {
        "speed": Range(minimum=0.3, maximum=math.inf),
        "walker.slope": Range(minimum=math.radians(0.5), maximum=math.radians(0.5)),
    }
    assert problem.parameters["control.ankle"] == 1.65
    assert restore_problem(problem.resolved()) == restore_problem(problem.replace({}).resolved())


def test_overrides_change_what_they_name_and_nothing_else():
    problem = load_problem("compass-passive-a")
    other = problem.replace(
        {"friction": 0.16, "walker.slope": "2 deg", "gait.phases": ["stick"], "gait.guess.state.theta1": -0.2}
    )
    assert (other.friction, other.walker.slope) == (0.16, math.radians(2))
    assert other.cycle.phases == (Mode.STICK,)
    assert other.guess.state["theta1"] == other.guess.state["theta2"] == -0.2
    assert other.guess.state["dtheta1"] == problem.guess.state["dtheta1"]
    assert problem.friction == 0.14


def test_a_freed_parameter_can_be_fixed_and_its_guess_changed():
    problem = load_problem("compass-torque-slip").replace(FREE_TORQUES)
    assert problem.replace({"control.ankle.guess": 1.0}).parameters["control.ankle"] == 1.0
    fixed = problem.replace({"control.ankle": 0.3})
    assert list(fixed.free) == ["walker.slope"]
    assert fixed.control.parameters["ankle"] == 0.3


def test_a_constraint_whose_name_has_dots_can_be_overridden():
    problem = load_problem("compass-torque-slip").replace(FREE_TORQUES)
    other = problem.replace({"constraints.state.theta1.max": "-5 deg", "constraints.speed.min": 0.4})
    assert other.constraints["state.theta1"] == Range(minimum=-math.inf, maximum=math.radians(-5))
    assert other.constraints["speed"].minimum == 0.4


def test_durations_go_with_the_phases_they_belonged_to():
    problem = load_problem("compass-passive-a").replace({"gait.guess.durations": [0.1, 0.6, 0.03]})
    assert problem.guess.durations == (0.1, 0.6, 0.03)
    assert problem.replace({"gait.phases": ["stick", "slip_backward", "stick"]}).guess.durations == (0.1, 0.6, 0.03)
    assert problem.replace({"gait.phases": ["stick"]}).guess.durations is None
    message = error_of(problem, {"gait.phases": ["stick"], "gait.guess.durations": [0.1, 0.6]})
    assert message.startswith("gait.guess.durations: 2 given, but the gait needs one duration per phase (stick)")


def test_the_slip_velocity_goes_with_the_slipping_impact():
    problem = load_problem("compass-passive-b")
    assert problem.replace({"gait.impact": "stick"}).guess.state["dx"] == 0.0
    assert error_of(load_problem("compass-passive-a"), {"gait.impact": "slip_forward"}).startswith(
        "gait.impact: gait.guess.state.dx: is missing"
    )


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"friction": -1}, "friction: -1 must be at least 0 and at most 1000 (coefficient of friction mu)"),
        ({"walker.leg_mas": 3}, "walker.leg_mas: unknown key; did you mean leg_mass or leg_com?"),
        ({"impact_law.x": 1}, "impact_law.x: impact_law is 'coulomb' and has no keys: set it as a whole"),
        ({"frction": 1, "name": "a/b"}, "frction: unknown key; did you mean friction?\nname: 'a/b' has"),
        ({"walker.leg_com": 2}, "walker.leg_com: walker: leg_com = 2 m must be less than leg_length = 1.6 m"),
        ({"control.type": "pd"}, "control.type: control.kd: is missing"),
        ({"gait.guess.state.theta1": "x"}, "gait.guess.state.theta1: write an angle as a number in rad"),
        ({"control": 3}, "control: control.type: is missing"),
        ({"gait": None}, "gait: nothing (null) is not a mapping"),
        ({"gait.impact": None}, "gait.impact: nothing (null) is not a mode (mode of the colliding foot"),
        ({"gait.section": "end"}, "gait.section: 'end' is not one of the choices; allowed: touchdown, clock"),
        (
            {"constraints": {"speed": {"free": [0, 1], "guess": 0.5}}},
            "constraints: constraints.speed.free: unknown key; allowed: min, max",
        ),
        ({"objective": "speed"}, "objective: too few unknowns"),
    ],
)
def test_a_wrong_override_is_reported_under_its_key(overrides, message):
    assert error_of(load_problem("compass-passive-a"), overrides).startswith(message)


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        (3, "3 is not a list (phases and impact of each step in order)"),
        ([], "has 0 entries, must have at least 1 (phases and impact of each step in order)"),
        ([3], "gait.steps[0]: 3 is not a mapping; keys: phases, impact"),
        ([{"phases": 3, "impact": "stick"}], "gait.steps[0].phases: 3 is not a list (modes of the phases in order)"),
        (
            [{"phases": ["stick"], "impact": "stick", "guess": 1}, {"phases": ["stick"], "impact": "stick"}],
            "gait.steps[0].guess: unknown key; allowed: phases, impact",
        ),
    ],
)
def test_a_mistake_in_one_step_is_the_only_one_that_is_reported(steps, message):
    assert error_of(load_problem("compass-passive-two-step"), {"gait.steps": steps}) == f"gait.steps: {message}"


def test_a_wrong_margin_at_the_end_of_a_cycle_is_the_only_mistake_that_is_reported():
    message = "gait.section: gait.section.margin: 3 is not a text (name of one of the walker's sections)"
    assert error_of(load_problem("crawler"), {"gait.section": {"margin": 3}}) == message


def test_the_digest_covers_everything_but_the_text_about():
    problem = load_problem("compass-pd-impact-slip")
    assert problem.hash8 == problem.digest[:8]
    assert len(problem.digest) == 64
    assert problem.replace({"about": "another text"}).digest == problem.digest
    changes = [
        {"name": "other"},
        {"friction": 0.21},
        {"walker.leg_mass": 5},
        {"impact_law": "frictionless"},
        {"control.kp": 14},
        {"control.reference.beyond_end": "off"},
        {"control.reference.gait": "compass-passive-a"},
        {"gait.guess.state.theta1": -0.08},
        {"gait.guess.durations": [0.1, 0.5]},
    ]
    assert len({problem.digest, *(problem.replace(change).digest for change in changes)}) == len(changes) + 1


def test_numbers_that_are_equal_make_equal_digests():
    problem = load_problem("compass-passive-a")
    assert problem.replace({"walker.slope": "0 deg"}).digest == problem.replace({"walker.slope": 0}).digest
    assert problem.replace({"impact_law": ImpactLaw.COULOMB}).digest == problem.digest


def test_the_digest_covers_the_reference(tmp_path):
    file = tmp_path / "walk.yaml"
    file.write_text(walking())
    text = walking("track", tracking("walk.yaml"))
    before = parse_problem(text, tmp_path / "track.yaml").digest
    file.write_text(walking().replace("friction: 0.14", "friction: 0.15"))
    assert parse_problem(text, tmp_path / "track.yaml").digest != before
    file.write_text(walking() + "# only a comment\n")
    assert parse_problem(text, tmp_path / "track.yaml").digest == before


def test_overrides_never_touch_the_reference():
    problem = load_problem("compass-pd-impact-slip")
    other = problem.replace({"friction": 0.3, "walker.leg_mass": 5})
    assert other.reference.digest == problem.reference.digest
    assert other.reference.friction == 0.14
    assert load_problem("compass-passive-a").reference is None


def test_a_reference_is_found_relative_to_its_file(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "walk.yaml").write_text(walking())
    (tmp_path / "track.yml").write_text(walking("track", tracking("far/walk.yaml")))
    problem = load_problem(tmp_path / "track.yml")
    assert load_problem(str(tmp_path / "track.yml")).digest == problem.digest
    assert problem.reference.path == tmp_path / "far" / "walk.yaml"
    assert restore_problem(problem.resolved()).reference.name == "walk"


def test_references_that_run_in_a_circle_are_refused(tmp_path):
    for name, other in (("one", "two"), ("two", "three"), ("three", "one")):
        (tmp_path / f"{name}.yaml").write_text(walking(name, tracking(f"{other}.yaml")))
    with pytest.raises(ProblemError, match="circular reference: one -> two -> three -> one"):
        load_problem(tmp_path / "one.yaml")
    (tmp_path / "self.yaml").write_text(walking("self", tracking("./self.yaml")))
    with pytest.raises(ProblemError, match="circular reference: self -> self"):
        load_problem(tmp_path / "self.yaml")


def test_a_fault_of_the_reference_is_reported_with_its_own_place(tmp_path):
    (tmp_path / "walk.yaml").write_text(walking().replace("friction: 0.14", "friction: -1"))
    with pytest.raises(ProblemError, match=r"control\.reference\.gait: .*walk\.yaml:\d+:1 friction: -1 must be"):
        parse_problem(walking("track", tracking("walk.yaml")), tmp_path / "track.yaml")


def test_an_unknown_name_lists_near_misses_and_says_that_a_path_will_do():
    with pytest.raises(UnknownNameError, match=r"did you mean compass-passive-a or .*path of a \.yaml file") as caught:
        load_problem("compass-passiv-a")
    assert caught.value.exit_code == 2
    with pytest.raises(UnknownNameError, match="`gaitopt list` shows all names"):
        load_problem("zzz")


@pytest.mark.parametrize(
    ("name", "short", "long"),
    [
        ("compass-passive-a", "[slip_forward, stick,", "[{foot: slip_forward}, {foot: stick, swing_foot: off},"),
        ("compass-passive-a", "impact: stick", "impact: {foot: stick, swing_foot: leaves}"),
        ("kneed-passive", "mode: stick", "mode: {foot: stick}"),
        ("slip-run", "flight]", "{foot: off}]"),
    ],
)
def test_a_mode_is_a_short_form_of_what_both_feet_do(name, short, long):
    known = load_problem(name)
    text = known.text
    assert short in text
    assert parse_problem(text.replace(short, long)).cycle == known.cycle


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("{foot: stick, swing_foot: stick}", "has no foot: stick, swing_foot: stick; its foot can stick, slip_forward"),
        ("{swing_foot: stick}", "has no foot: off, swing_foot: stick; its foot can"),
        ("{foot: fly}", r"gait.phases\[0\].foot: 'fly' is not what a contact does"),
        ("{foot: [1]}", r"gait.phases\[0\].foot: \[1\] is not what a contact does"),
    ],
)
def test_a_walker_on_one_foot_has_no_other_modes(mode, words):
    text = load_problem("compass-passive-a").text.replace("[slip_forward, stick,", f"[{mode}, stick,")
    with pytest.raises(ProblemError, match=rf"14:\d+ .*{words}"):
        parse_problem(text)


DIGESTS = {
    "compass-passive-a": "68abd7defd4bad77",
    "compass-passive-two-step": "5a49801242de47c5",
    "compass-pd-designed": "2d676001e2b94c4a",
    "compass-push-off": "cf5d2b35b5826bac",
    "compass-table": "3ee321e1a53a8a0a",
    "compass-torque-efficient": "a7faa3600abfa70a",
    "compass-unequal": "926c41d9a8fc8b38",
    "compass-virtual-constraint": "45393799c488cdab",
    "hopper": "14b0b6f8e0b35ccf",
    "kneed-passive": "f780c1770908ca77",
    "rabbit-optimal": "1d719403d7571b23",
    "rabbit-tracked": "0426cea1fe55063b",
    "rimless-wheel-slip": "cedc66dd6e45be6a",
    "slip-run": "50dea467b983579e",
    "crawler": "5ba2942668654835",
}
"""The first digits of digests of version 0.2, by which its run folders have their names."""


@pytest.mark.parametrize("name", DIGESTS)
def test_run_folders_of_version_0_2_keep_their_names(name):
    assert load_problem(name).digest.startswith(DIGESTS[name])
