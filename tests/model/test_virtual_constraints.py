"""Virtual constraints against the oracle of a compass and a feedback that is written out by hand."""

from dataclasses import replace
from math import comb

import numpy as np
import pytest
from named import named
from oracles import compass_oracle
from scipy.integrate import quad

import gaitopt as go
from gaitopt import Mode
from gaitopt.errors import ProblemError
from gaitopt.problem.problem import restore_problem
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import problem_dynamics
from gaitopt.verification.return_map import ReturnMap
from gaitopt.verification.verify import zero_dynamics_claims

NAME = "compass-virtual-constraint"
L, M_LEG, COM, M_HIP, G = 1.6, 4.0, 0.8, 2.0, 9.8
POINTS = np.array([-0.1, -0.12706416905448156, -0.045, 0.419, 0.156, 0.139, 0.1])
TABLE = {"theta1": [-0.1, 0.1], "theta2": [-0.1, 0.1]}
END, KP, KD = 0.1, 36.0, 12.0
ORACLE = compass_oracle(leg_length=L, leg_mass=M_LEG, leg_com=COM, hip_mass=M_HIP, gravity=G, slope=0.0)
ALONG = np.array([1.0, -1.0])  # both legs turn about the foot as one body: the hip motor has no part in it


def inertia(q):
    return ORACLE.M(np.array([*q, 0, 0]))[:2, :2]


def forces(q, v):
    """Velocity and gravity terms."""
    q, v = np.array([*q, 0, 0]), np.array([*v, 0, 0])
    return (ORACLE.B(q, v) + ORACLE.G(q))[:2]


def bezier(points, s, order=0):
    for _ in range(order):
        points = np.diff(points) * (len(points) - 1)
    n = len(points) - 1
    return sum(comb(n, k) * c * s**k * (1 - s) ** (n - k) for k, c in enumerate(points))


def curve(theta1):
    """Angle of the swing leg on the constraint, with two derivatives."""
    s = (theta1 + END) / (2 * END)
    return tuple(bezier(POINTS, s, order) / (2 * END) ** order for order in range(3))


def torque(q, v, known=None):
    """The linearising hip torque of a foot that sticks; ``known`` are angle, slope and bend of another curve."""
    h, slope, bend = known or curve(q[0])
    J, inverse = np.array([-slope, 1.0]), np.linalg.inv(inertia(q))
    y, dy = q[1] - h, v[1] - slope * v[0]
    free = J @ (-inverse @ forces(q, v)) - bend * v[0] ** 2
    return (-free - KP * y - KD * dy) / (J @ inverse @ [1.0, 1.0])


def impact(q, v):
    """State after the plastic impact."""
    _, after = ORACLE.impulse(np.array([*q, 0, 0]), np.array([*v, 0, 0]), 0, 0.0)
    return -q[::-1], -after[1::-1]


def closed_form():
    """delta_zero squared, V_zero over theta1, and the fixed point sigma^2 / 2 just before the impact."""
    before = np.array([END, END])
    q, v = impact(before, np.array([1.0, curve(END)[1]]))

    def momentum(theta1):
        h, slope, _ = curve(theta1)
        return ALONG @ inertia((theta1, h)) @ [1.0, slope]  # per rate of theta1

    delta = ALONG @ inertia(q) @ v / momentum(END)

    def potential(theta1):
        integrand = lambda x: ALONG @ forces((x, curve(x)[0]), (0, 0)) * momentum(x)  # noqa: E731
        return quad(integrand, -END, theta1, epsabs=1e-12, epsrel=1e-12)[0]

    return delta**2, potential, -potential(END) / (1 - delta**2)


def spread(gait):
    """States of a gait at all points of its arcs."""
    return np.vstack([arc.states for arc in gait.arcs])


def dynamics_of(changes):
    return problem_dynamics(go.load_problem(NAME).replace(changes))


def known(dynamics, mode, z, kind="observation"):
    """Observed numbers of a state, or quantities of the law."""
    return getattr(dynamics.system, kind)(mode)(t=0, z=z, p=dynamics.p, r=dynamics.system.data(0))


def torques(dynamics, mode, z):
    return np.asarray(known(dynamics, mode, z)["torque"]).ravel()


def random_states(count=5):
    rng = np.random.default_rng(3)
    shape, rates = rng.uniform(-0.1, 0.1, (count, 2)), rng.uniform(-0.5, 0.5, (count, 2))
    return [np.array([*q, 0.0, *v, dx]) for q, v, dx in zip(shape, rates, rng.uniform(0.1, 0.5, count), strict=True)]


@pytest.mark.portable
def test_the_torque_is_that_of_the_formula_written_out_by_hand():
    dynamics = dynamics_of({})
    for z in random_states():
        z[-1] = 0.0
        assert torques(dynamics, Mode.STICK, z) == pytest.approx([0.0, torque(z[:2], z[3:5])], rel=1e-11)


@pytest.mark.parametrize(
    ("model", "mode", "exact"),
    [
        ("stick", Mode.STICK, True),
        ("actual", Mode.STICK, True),
        ("stick", Mode.SLIP_FORWARD, False),
        ("actual", Mode.SLIP_FORWARD, True),
        ("actual", Mode.SLIP_BACKWARD, True),
    ],
)
def test_outputs_obey_a_linear_equation_in_the_mode_that_the_law_knows(model, mode, exact):
    dynamics = dynamics_of({"control.model": model})

    def output(z, name="rates"):
        return float(known(dynamics, mode, z, "quantities")[name])

    for z in random_states():
        z[-1] *= mode.direction
        dz, h = np.asarray(known(dynamics, mode, z, "flow")["dz"]).ravel(), 1e-5
        second = (output(z + h * dz) - output(z - h * dz)) / (2 * h)
        error = abs(second + KD * output(z) + KP * output(z, "outputs"))
        assert error < 1e-7 * (1 + abs(second)) if exact else error > 1e-3


def test_pd_torques_are_gains_times_outputs_of_the_motor_that_is_named():
    law = {"type": "virtual_constraints", "law": "pd", "gains": {"kp": 40, "kd": 3}, "outputs": ["hip"]}
    curve = {"phase": "theta1", "span": ["-10 deg", "10 deg"], "reference": {"bezier": {"hip": [-0.3, "5 deg", 0.25]}}}
    dynamics, width = dynamics_of({"control": law | curve}), np.radians(20)
    points = np.array([-0.3, np.radians(5), 0.25])
    for z in random_states():
        s = z[0] / width + 0.5
        y = z[0] + z[1] - bezier(points, s)
        dy = z[3] + z[4] - bezier(points, s, 1) * z[3] / width
        assert torques(dynamics, Mode.SLIP_FORWARD, z) == pytest.approx([0.0, -40 * y - 3 * dy], rel=1e-12)


@pytest.mark.parametrize("width", [0.2, 0.01])
def test_a_clamp_holds_the_curves_outside_of_their_span(width):
    """The torque of a linearising law with c(s), its slope and bend written out, inside, at an end and far outside."""
    dynamics = dynamics_of({"control.clamp": width})
    for theta1 in (0.03, 0.1, 0.3, -0.4):
        z = np.array([theta1, 0.05, 0, 0.4, -0.2, 0])
        s = (theta1 + END) / (2 * END)
        first, second = np.hypot(s, width), np.hypot(s - 1, width)
        clamped, slope = (1 + first - second) / 2, (s / first - (s - 1) / second) / 2
        bend = width**2 / 2 * (first**-3 - second**-3)
        curves = [bezier(POINTS, clamped, order) for order in range(3)]
        chain = (curves[0], curves[1] * slope / (2 * END), (curves[2] * slope**2 + curves[1] * bend) / (2 * END) ** 2)
        expected = torque(z[:2], z[3:5], chain)
        assert torques(dynamics, Mode.STICK, z) == pytest.approx([0.0, expected], rel=1e-10)
        if abs(s - 0.5) > 1:
            assert curves[0] == pytest.approx(POINTS[0 if s < 0 else -1], abs=width**2)


def test_a_gait_that_leaves_the_span_of_clamped_curves():
    changes = {"control.span": [-0.1, 0.08], "control.law": "pd", "control.gains": {"kp": 60, "kd": 10}}
    guess = {"gait.guess.state.dtheta1": 0.48}
    gait = go.solve(go.load_problem(NAME).replace({"control.clamp": 0.02, **changes, **guess}))
    assert spread(gait)[:, 0].max() > 0.081
    assert go.verify(gait).passed
    assert gait.to_record()["zero_dynamics"]["delta_squared"] is None


@pytest.mark.portable
def test_closed_form_of_the_zero_dynamics_agrees_with_the_gait():
    gait, (delta_squared, potential, kinetic) = named(NAME), closed_form()
    found = gait.constraints
    assert found.invariant
    assert found.delta_squared == pytest.approx(delta_squared, abs=1e-12)
    tops = [potential(theta1) for theta1 in spread(gait)[:, 0]]
    assert found.potential_max == pytest.approx(max(tops), rel=1e-3)
    assert found.potential_max >= max(tops) - 1e-9
    z = spread(gait)[-1]
    assert (ALONG @ inertia(z[:2]) @ z[3:5]) ** 2 / 2 == pytest.approx(kinetic, rel=1e-10)
    assert delta_squared * kinetic > found.potential_max  # the walker passes the top
    assert np.abs(gait.multipliers - delta_squared).min() < 1e-10
    assert found.decoupling_min_singular_value == pytest.approx(
        min(abs(np.array([-curve(q[0])[1], 1.0]) @ np.linalg.inv(inertia(q)) @ [1, 1]) for q in spread(gait)[:, :2]),
        rel=1e-3,
    )


def test_the_zero_dynamics_are_a_claim_that_rejects_another_multiplier():
    gait = named(NAME)
    return_map = ReturnMap(Simulator(gait.dynamics), gait.problem.cycle.impact)
    point = return_map.fixed_point(gait.state[[0, 3, 4]])
    (claim,) = zero_dynamics_claims(gait, return_map, point)
    assert claim.passed
    assert claim.tolerance == 1e-8
    (claim,) = zero_dynamics_claims(replace(gait, multipliers=gait.multipliers * (1 + 1e-7)), return_map, point)
    assert not claim.passed
    (claim,) = zero_dynamics_claims(gait, return_map, replace(point, jacobian=point.jacobian * (1 + 1e-7)))
    assert not claim.passed


@pytest.mark.parametrize(
    "changes",
    [
        {"control.law": "pd", "control.gains": {"kp": 400, "kd": 30}},
        {"control.limits": {"hip": 40.0}},
        {"control.reference.theta2.1": -0.1265},
    ],
)
def test_zero_dynamics_are_null_where_they_are_not_defined(changes):
    problem = go.load_problem(NAME).replace(changes)
    record = go.solve(problem).to_record()
    assert record["zero_dynamics"] == {"delta_squared": None, "potential_max": None, "invariant": False}
    assert record["decoupling_min_singular_value"] > 0.4


def test_a_simulated_walk_has_the_entries_of_its_gait():
    gait = named(NAME)
    solved, walked = gait.to_record(), go.simulate(gait, steps=2).to_record()
    assert walked["zero_dynamics"] == pytest.approx(solved["zero_dynamics"], rel=1e-9)
    for key in ("decoupling_min_singular_value", "peak_torque"):
        assert walked[key] == pytest.approx(solved[key], rel=1e-9)
    assert walked["control"] == solved["control"]
    assert solved["control"]["gains.kp"] == 36
    for record in (walked, solved):
        assert record["tracking_errors"]["theta2"] == pytest.approx({"start": 0, "end": 0}, abs=1e-10)


def test_a_table_of_the_curve_gives_its_gait():
    """A polynomial of degree 6 is determined by 15 of its values; the table has a span of its own."""
    gait = named(NAME)
    s = np.linspace(0.1, 0.9, 15)
    table = {"theta1": -0.1 + 0.2 * s, "theta2": [bezier(POINTS, x) for x in s]}
    other = go.solve(gait.problem.replace({"control.reference": {"table": table, "degree": 6}}))
    assert other.period == pytest.approx(gait.period, abs=1e-9)
    assert other.multipliers == pytest.approx(gait.multipliers, abs=1e-8)
    assert other.constraints.delta_squared == pytest.approx(gait.constraints.delta_squared, abs=1e-8)


def followed(reference, **changes):
    """The walker follows a reference; a text without a path may name the problem from which it comes."""
    text = go.load_problem(NAME).text.replace(f"name: {NAME}", "name: follower")
    return go.parse_problem(text).replace({"control.reference": reference, **changes})


@pytest.mark.portable
def test_the_motion_of_a_gait_is_followed_over_the_phase():
    """The gait of a curve of degree 6 gives the curve back, and so the gait."""
    source = named(NAME)
    problem = followed({"gait": NAME, "degree": 6})
    gait = go.solve(problem)
    record = gait.to_record()
    assert gait.period == pytest.approx(source.period, abs=1e-9)
    assert gait.multipliers == pytest.approx(source.multipliers, abs=1e-9)
    assert gait.constraints.delta_squared == pytest.approx(source.constraints.delta_squared, abs=1e-9)
    assert record["fit_errors"]["theta2"] < 1e-12
    assert record["control"]["reference.theta2.3"] == pytest.approx(POINTS[3], abs=1e-9)
    assert go.verify(gait).passed
    assert restore_problem(problem.resolved()).digest == problem.digest
    assert "fit_errors" not in source.to_record()


def test_a_law_that_follows_a_gait_over_the_phase_is_refused_by_proofs():
    pytest.importorskip("flint")
    (claim,) = go.prove(go.solve(followed({"gait": NAME, "degree": 6}))).claims
    assert "tracks another gait as a function of a phase variable: not covered" in claim.finding


def test_the_error_of_the_fit_is_that_of_the_closest_polynomial():
    """The fit has degree 4; a Chebyshev series is fitted to the curve of degree 6. The span does not matter."""
    times = np.linspace(0, named(NAME).period, 101)
    (arc,) = named(NAME).arcs
    series = np.polynomial.Chebyshev.fit(arc.times, arc.states[:, 0], arc.times.size - 1)
    theta1 = series(times)
    angles = np.array([curve(x)[0] for x in theta1])
    fitted = np.polynomial.Chebyshev.fit(theta1, angles, 4)
    expected = np.abs(fitted(theta1) - angles).max()
    for span in ([-0.1, 0.1], [-0.2, 0.15]):
        law = problem_dynamics(followed({"gait": NAME, "degree": 4}, **{"control.span": span})).system.control
        assert law.curve.fit_errors["theta2"] == pytest.approx(expected, rel=1e-6)
        (piece,) = law.curve.pieces
        assert (piece.start, piece.end) == tuple(span)


def test_free_curves_start_from_points_or_from_a_gait():
    bounds, points = {"objective": "torque_squared"}, {"theta2": POINTS.tolist()}
    given = followed({"curve": {"degree": 6, "points": points, "within": 0.5}}, **bounds)
    free = [{"free": [-0.5, 0.5], "guess": c} for c in POINTS.tolist()]
    assert given.control == followed({"bezier": {"theta2": free}}, **bounds).control
    started = followed({"curve": {"degree": 6, "start": NAME, "within": 0.5}}, **bounds)
    first, other = (problem_dynamics(problem).system.control for problem in (given, started))
    walker = type(given.walker)
    assert first.unknowns(walker) == other.unknowns(walker) == started.control.unknowns(walker)
    assert [*first.parameters.values()] == pytest.approx([*other.parameters.values()], abs=1e-9)
    assert len(first.unknowns(walker)) == 7
    values = {f"control.reference.theta2.{k}": 0.1 for k in range(7)}
    assert started.with_guess(named(NAME).to_record(), values).control.reference.curve.points == {"theta2": (0.1,) * 7}


def test_constants_need_no_tracked_joint():
    """y = q - c; a pd law does what the law ``pd`` does with the same constants."""
    dynamics = dynamics_of({"control.outputs": ["hip"], "control.reference": {"constant": {"hip": 0.1}}})
    z = np.array([0.15, 0.3, 0, 0.4, -0.2, 0])
    assert float(known(dynamics, Mode.STICK, z, "quantities")["outputs"]) == pytest.approx(0.15 + 0.3 - 0.1, rel=1e-12)
    constant = {"reference": {"constant": {"theta2": "5 deg"}}}
    gains = {"kp": 40, "kd": 3}
    mine = dynamics_of({"control.law": "pd", "control.gains": gains, "control.reference": constant["reference"]})
    other = dynamics_of({"control": {"type": "pd", **gains, **constant}})
    assert torques(mine, Mode.STICK, z) == pytest.approx(torques(other, Mode.STICK, z), rel=1e-12)


def test_gains_and_constants_may_be_unknowns():
    gain, angle = {"free": [10, 50], "guess": 36}, {"free": [0, 0.2], "guess": 0.1}
    changes = {"control.gains.kp": gain, "control.reference": {"constant": {"theta2": angle}}, "objective": "work"}
    problem = go.load_problem(NAME).replace(changes)
    assert problem.parameters["control.gains.kp"] == 36
    assert problem.parameters["control.reference.constant.theta2"] == 0.1
    assert [*problem.free] == ["control.gains.kp"]
    assert problem.control.unknowns(type(problem.walker)) == {"reference.constant.theta2": (0, 0.2)}


def test_a_singular_decoupling_matrix_is_named():
    changes = {
        "control.outputs": ["theta2", "hip"],
        "control.reference": {"bezier": {"theta2": [-0.1, 0.1], "hip": [-0.2, 0.2]}},
    }
    with pytest.raises(ProblemError, match=r"control.outputs: the decoupling matrix of theta2, hip is singular"):
        go.load_problem(NAME).replace(changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"control.outputs": ["knee"]}, "no angle 'knee'; it has theta1, theta2, ankle, hip"),
        ({"control.outputs": ["theta2", "theta2"]}, "theta2 is listed twice"),
        ({"control.outputs": "theta2"}, "'theta2' is not a list"),
        ({"control.phase": "hip"}, "no phase variable 'hip'; it has theta1, theta2"),
        ({"control.phase": "theta2"}, "theta2 is the phase variable"),
        ({"control.span": [0.1, 0.1]}, "is empty: both ends are 0.1"),
        ({"control.clamp": 0}, "control.clamp: 0 must be at least 0.001"),
        ({"control.clamp": True}, "control.clamp: "),
        ({"control.span": [0.1, 0.2, 0.3]}, "has 3 entries, must have 2"),
        ({"control.gains": {"kp": 1}}, "control.gains.kd: is missing"),
        ({"control.gains.ki": 1}, "unknown key; allowed: kp, kd"),
        ({"control.gains.kp": -1}, "-1 must be at least 0"),
        ({"control.law": "exact"}, "'exact' is not one of the choices; allowed: linearising, pd"),
        ({"control.model": "slip"}, "'slip' is not one of the choices; allowed: stick, actual"),
        ({"control.motors": ["knee"]}, "no motor 'knee'; it has ankle, hip"),
        ({"control.motors": ["ankle", "hip"]}, "one of ankle, hip for each of theta2: 2 given for 1 outputs"),
        ({"control.reference": {"bezier": {"theta1": [0, 1]}}}, "has curves of theta1; the outputs are theta2"),
        ({"control.reference": {"motion": "compass-passive-b"}}, r"give one of \{bezier: .* or \{table: file.* or"),
        (
            {"control.reference": {"gait": "compass-passive-b", "degree": 6, "phase": "theta1"}},
            "phase does not belong to gait, which has the keys gait, joints, degree: ",
        ),
        (
            {"control.reference": {"gait": "compass-passive-b", "degree": 6, "joints": {"hip": "theta2"}}},
            "reference.gait: has curves of hip; the outputs are theta2",
        ),
        ({"control.reference": {"constant": {"hip": 0}}}, "has curves of hip; the outputs are theta2"),
        ({"control.reference": {"table": TABLE}}, "degree: is missing: curves of a phase variable are polynomials"),
        ({"control.reference": {"table": {**TABLE, "hip": [0, 1]}, "degree": 1}}, "has curves of theta2, hip; the"),
        ({"control.reference": {"table": {"t": [0, 1], "theta2": [0, 1]}, "degree": 1}}, "its first column is t, but"),
        ({"control.reference.theta2.7": 0.1}, "has no such entry: name one of 0 to 6"),
        ({"control.reference.theta2.6": "wide"}, r"bezier.theta2\[6\]: write an angle as a number in rad"),
        ({"control.reference.theta2.3": {"free": [0.4, 0.5], "guess": 0.45}}, "too many unknowns"),
    ],
)
def test_mistakes_in_the_keys_are_named(changes, message):
    with pytest.raises(ProblemError, match=message):
        go.load_problem(NAME).replace(changes)


def test_control_points_are_parameters_that_are_followed_and_designed():
    problem = go.load_problem(NAME)
    changed = problem.replace({"control.reference.theta2.3": 0.42})
    assert changed.parameters["control.reference.theta2.3"] == 0.42
    assert changed.followed_from == problem
    middle = {"free": [0.38, 0.43], "guess": 0.419}
    design = problem.replace({"control.reference.theta2.3": middle, "objective": "torque_squared"})
    optimum = go.solve(design)
    assert optimum.converged
    assert optimum.constraints.invariant
    assert optimum.scalar("torque_squared") < named(NAME).scalar("torque_squared") - 0.01
    assert 0.38 <= optimum.freed["control.reference.theta2.3"] <= 0.43


@pytest.mark.slow
def test_below_the_friction_that_sticking_needs_the_foot_slips_until_the_walker_stops_on_top():
    branch = go.continuation(named(NAME), "friction", to=0.15)
    change = branch.specials[0]
    assert change.type == "mode_change"
    assert change.value == pytest.approx(named(NAME).scalar("required_friction"), abs=1e-9)
    assert str(change.after) == "stick, slip_backward, stick; stick"
    slipping = [point.gait for point in branch.points if len(point.gait.phases) == 3]
    periods = [gait.period for gait in slipping]
    assert (np.diff(periods) > 0).all()
    assert periods[-1] > 4
    assert branch.points[-1].value == pytest.approx(0.15907, abs=1e-5)
    assert all(gait.constraints.delta_squared is None for gait in slipping)
    assert go.verify(slipping[20]).passed


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([1000.0, -1000.0, 1000.0], r"bezier.theta2\[0\]: 1000 is impossible: control points are at most 15.708"),
        ([{"free": [-40, 0.1], "guess": 0.0}, 0.1], r"bezier.theta2\[0\]: -40 is impossible: control points are at"),
        ([0.0, 4.0, 4.0, 0.0, 4.0], r"bezier.theta2: reaches 4 rad, which is impossible: angles of compass_biped are"),
    ],
)
def test_curves_beyond_every_posture_are_impossible(points, words):
    with pytest.raises(ProblemError, match=words):
        go.load_problem(NAME).replace({"control.reference": {"bezier": {"theta2": points}}})


def test_control_points_may_lie_beyond_what_their_curve_reaches():
    points = [-0.1, 4.0, -6.0, 4.0, 0.1]  # the curve stays between -0.8 and 1.5
    problem = go.load_problem(NAME).replace({"control.reference": {"bezier": {"theta2": points}}})
    assert problem.control.parameters["reference.theta2.2"] == -6.0
