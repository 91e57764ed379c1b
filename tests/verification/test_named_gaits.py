"""Eleven named gaits: every published or closed-form figure, by the NLP, by the simulator, and by differences.

Figures are those of Gamus & Or (2013), or recomputed where the paper's text leaves a choice open; they are asserted
with the digits that are known of them.
"""

from collections.abc import Callable
from math import cos, pi, radians, sin, sqrt, tan

import numpy as np
import pytest
from named import named, solved, verification
from oracles import differences
from samples import sampled
from scipy.optimize import minimize_scalar

import gaitopt as go
from gaitopt import Mode
from gaitopt.gait.gait import floquet_multipliers, multiplier_distance
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.return_map import FixedPoint, ReturnMap

STICK, FORWARD, BACKWARD = Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD
AGREEMENT, MULTIPLIER_AGREEMENT = 1e-9, 1e-7
DIFFERENCE = 2e-5
"""Step of the differences: rounding of a simulated step over it is some 1e-8."""

NAMED = {
    "rimless-wheel-stick": ((STICK,), STICK),
    "rimless-wheel-slip": ((STICK, FORWARD), STICK),
    "compass-passive-stick": ((STICK,), STICK),
    "compass-passive-a": ((FORWARD, STICK, BACKWARD), STICK),
    "compass-passive-b": ((FORWARD, STICK), FORWARD),
    "compass-torque-stick": ((STICK,), STICK),
    "compass-torque-slip": ((FORWARD, STICK, BACKWARD), STICK),
    "compass-torque-impact-slip": ((FORWARD, STICK), FORWARD),
    "compass-pd-impact-slip": ((FORWARD, STICK), FORWARD),
    "compass-virtual-constraint": ((STICK,), STICK),
    "compass-virtual-constraint-slip": ((STICK, BACKWARD, STICK), STICK),
}
FIGURES = [
    ("rimless-wheel-stick", "required_friction", 0.9141, 4),
    ("rimless-wheel-stick", "impulse_ratio", 0.2374, 4),
    ("rimless-wheel-stick", "spectral_radius", 0.734, 3),
    ("rimless-wheel-stick", "period", 0.7931, 4),
    ("rimless-wheel-slip", "spectral_radius", 0.755, 3),
    ("compass-passive-stick", "period", 0.7446, 4),
    ("compass-passive-stick", "spectral_radius", 0.709, 3),
    ("compass-passive-stick", "required_friction", 0.1749, 4),
    ("compass-passive-stick", "impulse_ratio", 0.1447, 4),
    ("compass-passive-stick", "state.theta2", -0.1478, 4),
    ("compass-passive-stick", "state.dtheta1", 0.7328, 4),
    ("compass-passive-stick", "state.dtheta2", -0.5007, 4),
    ("compass-passive-stick", "state.dx", 0.0, 12),
    ("compass-passive-a", "spectral_radius", 0.8206, 4),
    ("compass-passive-a", "period", 0.7519621750, 9),
    ("compass-passive-b", "spectral_radius", 1.823, 3),
    ("compass-torque-stick", "cost_of_transport", 0.01747, 5),
    ("compass-torque-stick", "speed", 0.634, 3),
    ("compass-torque-stick", "spectral_radius", 0.7148, 4),
    ("compass-torque-stick", "required_friction", 0.1946, 4),
    ("compass-torque-slip", "spectral_radius", 0.8325, 4),
    ("compass-torque-impact-slip", "cost_of_transport", 0.0044, 4),
    ("compass-torque-impact-slip", "spectral_radius", 1.157, 3),
    ("compass-torque-impact-slip", "speed", 0.405, 3),
    ("compass-pd-impact-slip", "cost_of_transport", 0.00565, 5),
    ("compass-pd-impact-slip", "spectral_radius", 0.904, 3),
    ("compass-virtual-constraint", "spectral_radius", 0.8975168792973263, 12),  # delta_zero squared in closed form
    ("compass-virtual-constraint", "required_friction", 0.1696, 4),
    ("compass-virtual-constraint-slip", "spectral_radius", 0.8620, 4),
]
OTHERS = [
    ("compass-passive-a", {"friction": 0.17}),
    ("compass-passive-a", {"walker.slope": "0.9 deg"}),
    ("compass-passive-a", {"walker.hip_mass": 2.5}),
    ("compass-passive-b", {"friction": 0.2}),
    ("compass-passive-b", {"friction": 0.3}),
    ("compass-passive-stick", {"walker.slope": "2 deg", "friction": 0.4}),
    ("compass-passive-stick", {"walker.hip_mass": 10, "friction": 0.4}),
    ("compass-passive-stick", {"walker.leg_length": 1.2, "walker.leg_com": 0.6}),
    ("compass-torque-impact-slip", {"friction": 0.15}),
    ("rimless-wheel-slip", {"friction": 0.914}),
    ("rimless-wheel-slip", {"walker.spokes": 12}),
    ("rimless-wheel-slip", {"walker.inertia_ratio": 0.5}),
]


def simulated(name: str) -> tuple[ReturnMap, FixedPoint]:
    """Fixed point of the simulator's return map, by Newton's method from three digits of the gait."""
    gait = named(name)
    return_map = ReturnMap(Simulator(gait.dynamics), gait.problem.cycle.impact)
    section = gait.state[gait.system.section(gait.problem.cycle.impact).indices]
    return return_map, return_map.fixed_point(np.round(section, 3))


@pytest.mark.parametrize("name", NAMED)
def test_gait_has_the_modes_of_the_paper_and_every_claim_about_it_holds(name: str) -> None:
    gait, check = named(name), verification(name)
    assert gait.converged
    assert (tuple(mode for mode, _ in gait.phases), gait.steps[-1].impact.mode) == NAMED[name]
    assert [claim for claim in check.claims if not claim.passed] == []
    assert check.to_record()["mode_sequence_matches"]


MECHANISMS = ("compass-push-off", "round-feet-passive", "compass-unequal", "telescopic-passive", "hopper", "slip-run")
LONG = ("torso-passive", "rabbit-optimal", "rabbit-tracked", "rabbit-hzd", "rabbit-hzd-slip")


@pytest.mark.parametrize(
    "name", [*sampled(MECHANISMS, 2), *(pytest.param(name, marks=pytest.mark.slow) for name in LONG)]
)
def test_both_engines_confirm_gaits_of_other_mechanisms(name: str) -> None:
    assert verification(name).passed
    pytest.importorskip("heyoka")
    assert go.verify(named(name), engine="heyoka").passed


@pytest.mark.portable
@pytest.mark.parametrize(("name", "figure", "value", "digits"), FIGURES)
def test_figure_is_the_known_one_to_all_its_digits(name: str, figure: str, value: float, digits: int) -> None:
    assert named(name).scalar(figure) == pytest.approx(value, abs=0.5000001 * 10**-digits)


@pytest.mark.portable
@pytest.mark.parametrize("name", NAMED)
def test_simulator_finds_the_same_gait_by_itself_and_multipliers_agree_three_ways(name: str) -> None:
    """A slip velocity after the impact is forgotten when the foot sticks: one multiplier is zero."""
    gait, (return_map, point) = named(name), simulated(name)
    central = differences(lambda xi: return_map(xi).xi, point.xi, DIFFERENCE)
    assert point.converged
    assert np.abs(gait.dynamics.lift(point.xi) - gait.state).max() < AGREEMENT
    assert point.cycle.steps[0].period == pytest.approx(gait.period, abs=AGREEMENT)
    assert return_map.section is gait.system.section(gait.problem.cycle)
    assert np.abs(central - point.jacobian).max() < 1e-7 * np.abs(point.jacobian).max()
    saltation = floquet_multipliers(point.jacobian)
    assert multiplier_distance(gait.multipliers, saltation) < MULTIPLIER_AGREEMENT
    assert multiplier_distance(floquet_multipliers(central), saltation) < 1e-6
    assert multiplier_distance(floquet_multipliers(central), gait.multipliers) < 1e-6
    assert abs(gait.multipliers[-1]) < 1e-9 or NAMED[name][1] is STICK


@pytest.mark.parametrize(("name", "radius"), [("compass-passive-b", 2.758), ("compass-torque-impact-slip", 1.241)])
def test_frictionless_slipping_impact_gives_the_multiplier_that_is_printed(name: str, radius: float) -> None:
    """For this law the paper also states that gait B takes half the angle of gait A."""
    gait = go.solve(go.load_problem(name).replace({"impact_law": "frictionless"}))
    assert gait.spectral_radius == pytest.approx(radius, abs=5e-4)
    assert go.verify(gait).passed
    if name == "compass-passive-b":
        assert gait.state[0] / named("compass-passive-a").state[0] == pytest.approx(0.5, abs=0.05)


BEYOND = [
    ("flow", 0.904, 0.00565, 5),
    ("linear", 0.636, 0.0060, 4),
    ("hold", 0.414, 0.0027, 4),
    ("off", 0.553, 0.0051, 4),
]


@pytest.mark.parametrize(("beyond_end", "radius", "cost", "digits"), sampled(BEYOND, 4))
def test_what_the_reference_does_beyond_its_end_decides_the_multiplier(beyond_end, radius, cost, digits):
    gait = go.solve(go.load_problem("compass-pd-impact-slip").replace({"control.reference.beyond_end": beyond_end}))
    assert gait.spectral_radius == pytest.approx(radius, abs=5e-4)
    assert gait.measures["cost_of_transport"] == pytest.approx(cost, abs=0.5 * 10**-digits)
    assert go.verify(gait).passed


# other parameters than those of the table


@pytest.mark.parametrize(("name", "overrides"), sampled(OTHERS, 3), ids=str)
def test_both_methods_agree_for_other_parameters_from_the_same_guess(name: str, overrides: dict[str, object]) -> None:
    gait = solved(go.load_problem(name).replace(overrides))
    assert [claim for claim in go.verify(gait).claims if not claim.passed] == []


WHEELS = [(10, 1 / 3, 13.0), (8, 0.2, 14.0), (12, 0.5, 10.0), (20, 1.0, 6.0), (6, 0.9, 16.0)]


@pytest.mark.parametrize(("spokes", "kappa", "slope"), WHEELS)
def test_wheel_follows_its_closed_forms(spokes: int, kappa: float, slope: float) -> None:
    """Eqs (14)-(20), in units radius = mass = gravity = 1 and physical time."""
    shape = {"walker.spokes": spokes, "walker.inertia_ratio": kappa, "walker.slope": f"{slope} deg"}
    gait = go.solve(go.load_problem("rimless-wheel-stick").replace(shape | {"friction": 5.0}))
    half, alpha = pi / spokes, radians(slope)
    beta = (cos(2 * half) + kappa) / (1 + kappa)
    rate = beta * sqrt(4 * sin(half) * sin(alpha) / (1 - beta**2)) / sqrt(1 + kappa)

    def forces(theta: float) -> tuple[float, float]:
        """The forces along and normal to the slope by Newton's law for the hub, with its speed from the energy."""
        speed = rate**2 + 2 * (cos(alpha - half) - cos(theta + alpha)) / (1 + kappa)
        turn = sin(theta + alpha) / (1 + kappa)
        along = turn * cos(theta) - speed * sin(theta) - sin(alpha)
        return along, -turn * sin(theta) - speed * cos(theta) + cos(alpha)

    def least(function: Callable[[float], float]) -> float:
        inside = minimize_scalar(function, bounds=(-half, half), method="bounded", options={"xatol": 1e-9})
        return min(function(-half), function(half), float(inside.fun))

    required = -least(lambda theta: -abs(forces(theta)[0] / forces(theta)[1]))
    assert go.verify(gait).passed
    assert gait.state[2] == pytest.approx(rate, rel=1e-10)
    assert gait.multipliers[0].real == pytest.approx(beta**2, abs=1e-9)
    assert gait.multipliers[0].imag == 0
    assert gait.measures["step_length"] == pytest.approx(2 * sin(half), rel=1e-12)
    assert gait.measures["impulse_ratio"] == pytest.approx((1 - beta) / (1 + beta) / tan(half), rel=1e-9)
    assert gait.measures["required_friction"] == pytest.approx(required, rel=1e-9)
    assert gait.measures["min_normal_force"] == pytest.approx(least(lambda theta: forces(theta)[1]), rel=1e-9)
    assert gait.measures["speed"] == pytest.approx(2 * sin(half) / gait.period, rel=1e-12)
    assert gait.measures["work"] == gait.measures["peak_torque"] == 0


@pytest.mark.slow
def test_the_multiplier_under_virtual_constraints_is_that_of_the_zero_dynamics():
    gait = named("rabbit-hzd")
    assert gait.constraints.invariant
    assert gait.constraints.delta_squared == pytest.approx(gait.spectral_radius, abs=1e-9)
    assert gait.spectral_radius == pytest.approx(0.66617, abs=1e-5)
    assert named("rabbit-tracked").spectral_radius > 5  # over time


@pytest.mark.slow
def test_less_friction_makes_the_foot_slip_backward_then_forward_too_until_it_lifts_off():
    stick, forward, backward = Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD
    branch = go.continuation(named("rabbit-hzd"), "friction", to=0.3)
    found = [(special.type, special.value) for special in branch.specials]
    assert [kind for kind, _ in found] == ["mode_change", "impact_change", "lift_off"]
    assert [value for _, value in found] == pytest.approx([0.566667, 0.460901, 0.360218], abs=1e-6)
    sequences = [special.after for special in branch.specials[:2]]
    assert [sequence.phases for sequence in sequences] == [(stick, backward), (forward, stick, backward)]
    assert [sequence.impact for sequence in sequences] == [stick, forward]
    assert all(point.gait.spectral_radius < 1 for point in branch.points)


@pytest.mark.slow
def test_tracking_errors_of_motors_are_those_of_their_angles():
    gait, reference = named("rabbit-tracked"), named("rabbit-optimal")
    assert gait.problem.walker.tracked == gait.problem.walker.actuators
    errors = gait.to_record()["tracking_errors"]
    torso, thigh, shin = (gait.state[k] - reference.state[k] for k in (0, 1, 2))
    assert errors["stance_hip"]["start"] == pytest.approx(thigh - torso, abs=1e-9)
    assert errors["stance_knee"]["start"] == pytest.approx(shin - thigh, abs=1e-9)
