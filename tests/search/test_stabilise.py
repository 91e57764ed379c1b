"""Feedback laws that walk known gaits: invariance, optimality of the curves, what the simulator says of the result."""

import json
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from driven_walkers import DrivenHeelToe, DrivenHopper
from named import named as gait
from named import solved

import gaitopt as go
from gaitopt.api.stored import check_problem_file, write_problem_file
from gaitopt.design.sensitivity import invariance, invariance_labels
from gaitopt.errors import ProblemError, SolveError, StorageError
from gaitopt.model.curve import bernstein_matrix
from gaitopt.problem.problem import restore_problem
from gaitopt.problem.statement import problem_data
from gaitopt.problem.writing import ExactValues, write_problem
from gaitopt.search.joint_curves import CLOCK, FittedCurves, Joints, invariant_curves, tracked_curves
from gaitopt.solver.rollout import guessed_motion
from gaitopt.systems import problem_dynamics

MOTORS = ("stance_hip", "stance_knee", "swing_hip", "swing_knee")
SLIPPERY = go.load_problem("compass-torque-stick").replace({"friction": 0.05})


@pytest.fixture(scope="module")
def optimal():
    return gait("rabbit-optimal")


@pytest.fixture(scope="module")
def walked(optimal):
    return go.stabilise(optimal, progress=False)


@pytest.fixture(scope="module")
def slipping():
    return go.solve(go.load_problem("compass-torque-slip").replace({"friction": 0.1}), progress=False)


def test_an_unstable_optimum_becomes_a_stable_gait_that_is_invariant_under_its_impact(optimal, walked):
    assert optimal.spectral_radius > 100
    assert walked.objections == ()
    assert go.verify(walked.gait).passed
    assert walked.invariance < 1e-10
    zero = walked.gait.to_record()["zero_dynamics"]
    assert zero["invariant"]
    assert walked.gait.spectral_radius == pytest.approx(zero["delta_squared"], abs=1e-8)
    assert walked.gait.spectral_radius < 1
    assert walked.distance < 0.05
    assert walked.gait.measures["speed"] == pytest.approx(optimal.measures["speed"], rel=0.01)
    squared = walked.gait.measures["torque_squared"] / optimal.measures["torque_squared"]
    assert squared == pytest.approx(1 + walked.fitted.deviation**2, abs=0.02)  # of an optimum, to second order
    walk, control, system = go.simulate(walked.gait, steps=3), walked.gait.system.control, walked.gait.system
    names = [system.angle_names.index(name) for name in (*control.outputs, control.phase)]
    for arc in walk.trajectory.steps[0].arcs:  # the outputs stay zero
        angles = np.array([np.asarray(system.angles(z, walked.gait.p)[0]).ravel() for z in arc.states])[:, names]
        assert np.abs(angles[:, :-1].T - control.curve(angles[:, -1])[0]).max() < 1e-9


@pytest.fixture(scope="module")
def joints(optimal):
    return Joints.of(optimal, MOTORS, MOTORS, "stance_leg")


@pytest.mark.parametrize("degree", [4, 7])
def test_curves_pass_through_the_postures_and_rates_beside_the_impact(joints, degree):
    curve, (start, end) = invariant_curves(joints, degree, {}), joints.span
    at = np.array([0.0, 1.0])
    values = bernstein_matrix(degree, at) @ curve.points.T
    slopes = bernstein_matrix(degree, at, 1) @ curve.points.T / (end - start)
    assert np.abs(values - joints.angles[0][[0, -1]]).max() < 1e-12
    assert np.abs(slopes - (joints.angles[1] / joints.phase[:, 1:2])[[0, -1]]).max() < 1e-12


def test_curves_of_more_points_deviate_less_and_keep_a_limit_of_the_torques(joints):
    deviations = [invariant_curves(joints, degree, {}).deviation for degree in (4, 6, 8, 10, 12)]
    assert deviations == sorted(deviations, reverse=True)
    free, limited = (invariant_curves(joints, 8, limits) for limits in ({}, dict.fromkeys(MOTORS, 26.0)))
    assert limited.violation < 1e-6
    assert limited.deviation > free.deviation
    assert invariant_curves(joints, 8, dict.fromkeys(MOTORS, 5.0)).violation > 0.1


def test_tracked_curves_reproduce_the_torques_of_a_gait(slipping):
    joints = Joints.of(slipping, ("theta1", "theta2"), ("ankle", "hip"), CLOCK)
    kp, kd = 117.2, 31.56
    curve = tracked_curves(joints, 14, (kp, kd), {})
    values, slopes, _ = joints.basis(14)
    reference, rates = values @ curve.points.T, slopes @ curve.points.T
    torques = -kp * (joints.angles[0] - reference) - kd * (joints.angles[1] - rates)
    assert np.sqrt(joints.weights @ ((torques - joints.torques) ** 2).sum(axis=1)) < 0.1
    assert np.abs(reference - joints.angles[0]).max() < 0.2


def test_responses_to_torques_are_those_of_finite_differences(optimal, joints):
    """The rate of an angle after a short time under a unit torque more, from the simulated flow."""
    other = optimal.problem.control.values
    system, arc = optimal.system, optimal.arcs[3]
    k = sum(each.times.size for each in optimal.arcs[:3]) + 5
    names = [system.angle_names.index(name) for name in MOTORS]
    flows = []
    for bump in (0.0, 1.0):
        row = {f"control.{m}.{n}": v + bump * (m == "swing_hip") for m in MOTORS for n, v in enumerate(other[m])}
        p = system.values({**optimal.dynamics.parameters, **row})
        dz = np.asarray(system.flow(arc.mode)(arc.times[5], arc.states[5], p, system.data(arc.segment))).ravel()
        rate = [np.asarray(system.angles(arc.states[5] + h * dz, p)[1]).ravel()[names] for h in (-1e-6, 1e-6)]
        flows.append((rate[1] - rate[0]) / 2e-6)
    assert flows[1] - flows[0] == pytest.approx(joints.response[k][:, 2], abs=1e-5)


def test_pd_control_with_the_least_gains_stabilises_a_slipping_gait(slipping):
    assert slipping.spectral_radius > 1
    made = go.stabilise(slipping, progress=False)
    assert (made.law, made.phase, made.objections) == ("pd", "clock", ())
    assert made.gait.spectral_radius < 1
    assert all("spectral radius" in words for words in made.attempts)
    assert made.gait.problem.cycle == slipping.problem.cycle
    assert made.distance < 1e-3


@pytest.mark.slow
def test_a_bound_of_the_radius_that_no_gains_reach_is_an_objection(slipping):
    made = go.stabilise(slipping, radius=1e-9, degree=14, progress=False)
    assert made.objections
    assert "must be below 1e-09" in made.objections[0]


@pytest.mark.slow
def test_a_bound_that_the_postures_at_the_impact_exclude_leads_to_a_design_of_the_curves(optimal):
    made = go.stabilise(optimal, radius=0.55, progress=False)
    assert made.objections == ()
    assert "spectral radius 0.6039, must be below 0.55" in made.attempts[0]
    assert made.gait.spectral_radius < 0.55
    assert made.invariance < 1e-10
    assert made.gait.measures["speed"] == pytest.approx(optimal.measures["speed"], rel=1e-6)


@pytest.mark.slow
def test_pd_control_over_the_phase_stabilises_what_the_clock_does_not(optimal):
    made = go.stabilise(optimal, law="pd", phase="stance_leg", progress=False)
    assert made.objections == ()
    assert made.gait.verification["passed"]
    assert made.phase == "stance_leg"


def test_the_range_of_a_joint_is_an_objection(walked, monkeypatch):
    limits = {"swing_knee": ((0.0, 0.5), None), "stance_hip": (None, 10.0)}
    monkeypatch.setattr("gaitopt.gait.measures.joint_limits", lambda walker: limits)
    turned, pulled = walked.objections
    assert "swing_knee turns from" in turned
    assert "stance_hip takes" in pulled


@pytest.mark.parametrize(
    ("start", "words", "options"),
    [
        (lambda: gait("kneed-passive"), "has no motors", {}),
        (lambda: gait("crawler"), "ends with the clock of its law", {"law": "pd"}),
        (lambda: gait("compass-torque-stick"), "one motor less than shape coordinates", {"law": "virtual_constraints"}),
        (lambda: gait("rabbit-optimal"), "'hip' is no phase variable of the rabbit", {"phase": "hip"}),
        (lambda: gait("rabbit-optimal"), r"no phase is monotone .* torso", {"phase": "torso"}),
        (lambda: go.solve(SLIPPERY, progress=False), "there is no gait to stabilise", {}),
    ],
)
def test_gaits_that_no_law_repeats_are_refused_in_one_sentence(start, words, options):
    with pytest.raises((ProblemError, SolveError), match=words):
        go.stabilise(start(), progress=False, **options)


def test_the_written_problem_has_the_same_gait_and_no_file_is_overwritten(walked, tmp_path):
    file = tmp_path / "new" / "stable.yaml"
    write_problem_file(walked.problem, file)
    again = solved(file)
    assert again.state == pytest.approx(walked.gait.state, abs=1e-10)
    assert again.problem.digest == walked.problem.digest
    with pytest.raises(StorageError, match="it exists"):
        check_problem_file(file)


def test_the_phase_variable_and_its_rate_are_columns_of_the_frame_and_drawn(walked):
    above, below = walked.gait.plot("phase").figure.axes
    frame = walked.gait.to_frame()
    phase, rate, t = (frame[name].to_numpy() for name in ("stance_leg", "dstance_leg", "t"))
    assert phase[[0, -1]] == pytest.approx(walked.gait.system.control.span, abs=1e-9)
    assert np.gradient(phase, t)[5:-5] == pytest.approx(rate[5:-5], abs=1e-3)
    for axes, name in ((above, "stance_leg"), (below, "dstance_leg")):
        ((_, drawn),) = (line.get_data() for line in axes.lines if line.get_xdata().size > 2)
        assert drawn[[0, -1]] == pytest.approx(frame[name].to_numpy()[[0, -1]], abs=1e-9)
    with pytest.raises(ValueError, match="no figure 'phase'"):
        gait("compass-passive-a").plot("phase")


def test_feedback_from_step_to_step_keeps_the_law_and_the_motion_of_a_gait():
    given = gait("compass-torque-impact-slip")
    made = go.stabilise(given, law="step_feedback", progress=False)
    assert made.objections == ()
    assert made.gait.spectral_radius < 1 < given.spectral_radius
    assert made.distance < 1e-10
    assert go.solve(made.problem, progress=False).spectral_radius == pytest.approx(made.gait.spectral_radius, abs=1e-9)
    smaller = go.stabilise(given, law="step_feedback", radius=0.3, progress=False)
    assert smaller.gait.spectral_radius < 0.3
    assert "lqr with weight 1 of the parameters: spectral radius 0.7865" in smaller.attempts[0]


@pytest.mark.parametrize("name", ["compass-passive-two-step", "crawler"])
def test_cycles_of_several_steps_and_of_a_clock_are_corrected_once_per_cycle(name):
    made = go.stabilise(gait(name), law="step_feedback", progress=False)
    assert made.objections == ()
    assert made.gait.verification["passed"]
    assert made.gait.spectral_radius < gait(name).spectral_radius
    assert made.distance < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("name", ["compass-unequal", "compass-passive-two-step"])
def test_pd_control_repeats_two_steps_that_differ(name):
    """Walks that start next to the gait approach it with the multiplier of the equations."""
    given = gait(name)
    made = go.stabilise(given, law="pd", progress=False)
    assert made.objections == ()
    assert made.distance < 1e-4
    steps = made.gait.steps
    assert [step.arcs[0].dynamics.parameters["control.reference.theta2.3"] for step in steps] == [
        made.problem.parameters[f"control.{which}.theta2.3"] for which in ("reference", "other_reference")
    ]
    section = made.gait.system.section(made.gait.cycle)
    start = made.gait.state[section.indices] * (1 + 1e-5)
    walked = go.simulate(made.gait, state=dict(zip(section.names, start, strict=True)), steps=8)
    ends = walked.trajectory.section_states[:: len(steps)][:, section.indices] - made.gait.state[section.indices]
    sizes = np.linalg.norm(ends, axis=1)
    assert sizes[-1] < 0.1 * sizes[0]
    assert made.gait.spectral_radius < given.spectral_radius
    # the reference ends within 3e-9 s of the landing of the first step
    assert go.solve(made.problem, method="ipopt", progress=False).period == pytest.approx(made.gait.period, rel=1e-9)


TWO_STEPS = """
name: two-steps
walker: {model: compass_biped, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, hip_mass: 2, gravity: 9.8, slope: 1 deg}
friction: 0.3
control:
  {type: pd, kp: 1, kd: 1, reference: {bezier: {theta2: [0, 0.1]}, duration: 0.7, beyond_end: hold},
  other_reference: {bezier: {theta2: [0, 0.2]}, duration: 0.7, beyond_end: hold}}
gait: {phases: auto}
"""
TWO_CONSTRAINTS = """
name: two-steps
walker: {model: compass_biped, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, hip_mass: 2, gravity: 9.8, slope: 1 deg}
friction: 0.3
control:
  type: virtual_constraints
  outputs: [theta2]
  phase: theta1
  span: [-0.15, 0.15]
  reference: {bezier: {theta2: [0, 0.1]}}
  other_reference: {bezier: {theta2: [0, 0.2]}}
  gains: {kp: 36, kd: 12}
gait: {phases: auto}
"""


@pytest.mark.parametrize("problem", [TWO_STEPS, TWO_CONSTRAINTS])
def test_a_second_reference_needs_two_steps_and_differs_in_its_control_points_only(problem):
    opened = go.parse_problem(problem)
    assert opened.modes.steps == 2
    key = "control.other_reference.theta2.1"
    changed = opened.replace({key: 0.25})
    assert changed.parameters[key] == 0.25
    assert changed.parameters["control.reference.theta2.1"] == 0.1
    assert restore_problem(changed.resolved()).digest == changed.digest
    text = write_problem(changed)
    assert text.changes == {key: 0.25}
    assert ExactValues(text)(key, 0.25) == "0.25"
    with pytest.raises(ProblemError, match="other_reference: applies in every second step"):
        opened.replace({"gait": {"phases": ["stick"], "impact": "stick", "guess": {"state": {"theta1": -0.2}}}})
    with pytest.raises(ProblemError, match="other_reference: differs from the reference in more than its control po"):
        go.parse_problem(problem.replace("[0, 0.2]", "[0, 0.1, 0.2]"))
    with pytest.raises(ProblemError, match="other_reference"):
        go.parse_problem(problem.replace("{theta2: [0, 0.2]}", "{theta1: [0, 0.2]}"))


def test_two_references_over_time_have_one_duration():
    with pytest.raises(ProblemError, match="other_reference: differs from the reference in more than its control po"):
        go.parse_problem(TWO_STEPS.replace("0.2]}, duration: 0.7", "0.2]}, duration: 0.8"))


def test_curves_over_another_span_are_the_same_polynomials():
    points = np.random.default_rng(0).uniform(-1, 1, (2, 7))
    fit = FittedCurves(points=points, deviation=0.0, violation=0.0)
    other = fit.over((-0.2, 0.3), (-0.25, 0.28))
    assert fit.over((-0.2, 0.3), (-0.2, 0.3)) is fit
    x = np.linspace(-0.3, 0.3, 9)
    values = [bernstein_matrix(6, (x - a) / (b - a)) @ each.points.T
              for each, (a, b) in ((fit, (-0.2, 0.3)), (other, (-0.25, 0.28)))]  # fmt: skip
    np.testing.assert_allclose(values[1], values[0], atol=1e-12)


@pytest.mark.slow
def test_virtual_constraints_repeat_two_steps_that_differ():
    """Each step has a curve of its own, and every impact leads from one curve to the other."""
    torque = {"type": "constant_torque", "ankle": 0.0, "hip": 0.3}
    given = go.solve(go.load_problem("compass-unequal").replace({"control": torque}), progress=False)
    made = go.stabilise(given, law="virtual_constraints", progress=False)
    assert made.objections == ()
    assert made.invariance < 1e-11
    (start, end), degree = made.problem.control.span, made.fitted.degree
    curves = [
        [made.problem.parameters[f"control.{which}.hip.{k}"] for k in range(degree + 1)]
        for which in ("reference", "other_reference")
    ]
    assert np.abs(np.subtract(*curves)).max() > 0.01
    for number, step in enumerate(go.simulate(made.gait, steps=8).trajectory.steps):
        theta1, theta2 = np.concatenate([arc.states[:, :2] for arc in step.arcs]).T
        followed = bernstein_matrix(degree, (theta1 - start) / (end - start)) @ curves[number % 2]
        np.testing.assert_allclose(theta1 + theta2, followed, atol=1e-8)
    assert made.gait.spectral_radius < 1
    # a design keeps both curves invariant
    free = {"control.reference": curves[0], "control.other_reference": curves[1]}
    points = {key: [{"free": [c - 1, c + 1], "guess": c} for c in row] for key, row in free.items()}
    changes = {key: {"bezier": {"hip": row}, "invariant": True} for key, row in points.items()}
    design = made.problem.replace({**changes, "objective": "torque_squared"})
    start = guessed_motion(design.from_guess(), problem_dynamics(design)).on_mesh()
    equations = start.equations
    rows = ca.Function("rows", [equations.w, equations.parameters], [invariance(equations)])
    assert [label.step for label in invariance_labels(equations)] == [0, 0, 1, 1]
    assert np.abs(np.asarray(rows(start.w, start.p))).max() < 1e-6
    spoiled = start.p.copy()
    spoiled[equations.system.parameters.index("control.other_reference.hip.0")] += 0.1
    assert (np.abs(np.asarray(rows(start.w, spoiled))).ravel() > 1e-3).tolist() == [False, False, True, True]


@pytest.mark.slow
def test_a_walk_that_tracks_two_motions_is_found_and_settles():
    made = go.stabilise(gait("compass-passive-two-step"), law="pd", progress=False)
    value = float(made.gait.state[0])
    for engine in ("scipy", "heyoka"):
        (attractor,) = go.basin(
            made.gait, {"theta1": (value - 1e-4, value + 1e-4, 2)}, steps=12, engine=engine, workers=1, progress=False
        ).attractors
        assert attractor.count == 2
        assert go.solve(attractor, progress=False).period == pytest.approx(made.gait.period, rel=1e-9)
    found = go.find(made.problem, starts=1, steps=2, workers=1, progress=False)
    assert made.gait.period in [pytest.approx(each.period, rel=1e-9) for each in found]


@pytest.mark.parametrize(
    ("name", "walker", "close"),
    [("hopper", DrivenHopper, 0.1), pytest.param("heel-toe", DrivenHeelToe, 1e-3, marks=pytest.mark.slow)],
)
def test_pd_control_repeats_gaits_with_flight_and_with_several_contacts(name, walker, close):
    data = problem_data(go.load_problem(name))
    data["walker"]["model"] = walker.model
    given = go.solve(go.parse_problem(json.dumps(data), walkers=[walker]), progress=False)
    made = go.stabilise(given, law="pd", progress=False)
    assert made.objections == ()
    assert made.gait.verification["passed"]
    assert made.gait.problem.cycle == given.problem.cycle
    assert made.distance < close


def test_the_decoupling_matrix_is_singular_where_the_effect_of_a_motor_changes_its_sign(joints):
    assert joints.singular_at is None
    effect = np.where(joints.t[:, None] < 0.2, [1, 1, 1, 1], [1, 1, -1, 1])
    responses = {
        "response": joints.response * effect[:, None, :],
        "phase_response": joints.phase_response * effect,
    }
    assert replace(joints, **responses).singular_at == joints.t[joints.t >= 0.2][0]
