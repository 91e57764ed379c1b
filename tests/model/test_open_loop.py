"""Open-loop torques: the law as a function of time, its keys, and what is wrong with them."""

import re

import numpy as np
import pytest
from refusals import refusal

import gaitopt as go
from gaitopt import Mode
from gaitopt.systems import problem_dynamics

KNOWN = """
name: known-torques
walker: {{model: compass_biped, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, hip_mass: 2, gravity: 9.8, slope: 0}}
friction: 0.3
control: {{type: open_loop, {control}}}
gait: {{phases: [stick], impact: stick, guess: {{state: {{theta1: -0.15, dtheta1: 0.73, dtheta2: -0.5}}}}}}
"""
UNKNOWN = KNOWN + "objective: cost_of_transport\nconstraints: {{speed: 0.4{more}}}\n"


def known(order):
    values = {"constant": ("[1, 2, -1]", "[0.5, 0, 3]"), "linear": ("[1, 2, -1, 4]", "[0.5, 0, 3, 3]")}[order]
    keys = f"intervals: 3, order: {order}, duration: 0.6, ankle: {values[0]}, hip: {values[1]}"
    return go.parse_problem(KNOWN.format(control=keys))


@pytest.mark.parametrize("order", ["constant", "linear"])
def test_torques_are_pieces_in_time_and_the_last_one_goes_on(order):
    dynamics = problem_dynamics(known(order))
    law, system, z = dynamics.system.control, dynamics.system, np.full(6, 0.1)
    assert law.breakpoints == pytest.approx((0.2, 0.4))
    rows = {name: np.array(row) for name, row in law.values.items()}
    for t in (0.0, 0.1, 0.19, 0.25, 0.5, 0.6, 0.75):
        segment = min(int(t / 0.2 + 1e-12), 2)
        u = np.asarray(system.torques(Mode.STICK)(t, z, dynamics.p, system.data(segment))).ravel()
        for value, row in zip(u, rows.values(), strict=True):
            s = t / 0.2 - segment
            expected = row[segment] if order == "constant" else row[segment] + s * (row[segment + 1] - row[segment])
            assert value == pytest.approx(expected, abs=1e-13)


def test_values_are_parameters_that_can_be_set():
    problem = known("linear")
    assert problem.parameters["control.hip.2"] == 3.0
    assert not problem.is_design
    assert problem.replace({"control.hip.2": 2.5}).parameters["control.hip.2"] == 2.5


@pytest.mark.parametrize(
    ("control", "more", "words"),
    [
        ("intervals: 4, bounds: {ankle: [5, -5]}", "", "bounds.ankle: [5, -5] is empty: the lower bound comes first"),
        ("intervals: 4, bounds: {knee: [-5, 5]}", "", "control.bounds.knee: no actuator is called knee"),
        ("intervals: 4, hip: [1, 2]", "", "control.hip: has 2 values, must have 5 for 4 linear intervals"),
        ("intervals: 0", "", "control.intervals: 0 must be at least 1"),
        ("intervals: 4, order: cubic", "", "control.order: 'cubic' is not one of the choices"),
        ("intervals: 4, order: constant, rates: {hip: 3}", "", "control.rates: limits the rate of torques"),
        ("intervals: 2, hip: [9, 0, 0], bounds: {hip: [-5, 5]}", "", "control.hip[0]: 9 is outside of the bounds"),
        ("intervals: 4", ", spectral_radius: {min: 0.5}", "spectral_radius: has a largest value only for open-loop"),
        ("intervals: 4", ", spectral_radius: 0.5", "spectral_radius: has a largest value only for open-loop torques"),
        ("intervals: 4", ", foot_clearance: {min: 0.1}", "with open-loop torques state clearance: {min: height}"),
        ("intervals: 4", ", clearance: 0.1", "constraints.clearance: is a height of the swing foot along the step"),
        ("intervals: 4", ", angle.hip: 0.1", "constraints.angle.hip: is a range along the whole step"),
        ("intervals: 4", ", angle.knee: {min: 0}", "constraints.angle.knee: is not a scalar of a gait"),
    ],
)  # fmt: skip
def test_each_fault_is_one_sentence_with_its_key(control, more, words):
    text = UNKNOWN.replace("{control}", control).replace("{more}", more).replace("{{", "{").replace("}}", "}")
    assert words in refusal(go.parse_problem, text)


def test_constraints_along_the_step_need_unknown_torques():
    text = go.load_problem("compass-torque-efficient").text
    told = refusal(go.parse_problem, text.replace("constraints:", "constraints:\n  clearance: {min: 0}"))
    assert re.search(r"constraints\.clearance: .*only open-loop torques can have", told)
