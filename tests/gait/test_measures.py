"""Scalars of a step: the wheel's closed forms, and work, clearance and slip against methods without curves."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from foot_impacts import foot_impact
from oracles import numbers
from scipy.integrate import solve_ivp, trapezoid

from gaitopt.gait import curves
from gaitopt.gait.measures import measure
from gaitopt.gait.trajectory import Arc, ImpactRecord, Step
from gaitopt.model.control import ConstantTorque, NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rimless_wheel import RimlessWheel

Array = np.ndarray
TORQUES = np.array([0.3, -0.2])
POINTS = 65
SLIPPING, STICKING = 0.09, 0.64


def arc(system: HybridSystem, p: Array, mode: Mode, start: Array, duration: float, since: float = 0.0) -> Arc:
    """An arc of a given duration, integrated by scipy."""
    times = duration * (curves.points(POINTS) + 1) / 2
    solution = solve_ivp(
        lambda t, z: numbers(system.flow(mode)(t, z, p, []))[0],
        (0, duration),
        start,
        t_eval=times,
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    )
    return Arc(dynamics=Dynamics(system, p), mode=mode, segment=0, times=since + times, states=solution.y.T)


def impact_of(system: HybridSystem, p: Array, z: Array) -> ImpactRecord:
    z_plus, impulse, *_ = numbers(foot_impact(system, Mode.STICK)(z, p))
    length, z_plus[system.n_shape] = z_plus[system.n_shape], 0.0
    return ImpactRecord(mode=Mode.STICK, state=z_plus, step_length=length, impulse=impulse, stick_impulse=impulse)


@cache
def wheel_step() -> tuple[RimlessWheel, HybridSystem, Array, Step]:
    """The periodic step of a wheel; its duration by the quadrature of the energy integral."""
    wheel = RimlessWheel(spokes=10, radius=1.0, mass=1.0, inertia_ratio=1 / 3, gravity=1.0, slope=np.radians(13))
    system = HybridSystem(RimlessWheel, NoControl())
    p = np.array([*(float(value) for _, value in wheel), 1.0])
    angle, kappa = np.pi / wheel.spokes, wheel.inertia_ratio
    beta = (np.cos(2 * angle) + kappa) / (1 + kappa)
    rate = 2 * beta * np.sqrt(np.sin(wheel.slope) * np.sin(angle) / (1 - beta**2))  # eq. (16), in its time unit
    nodes, weights = np.polynomial.legendre.leggauss(60)
    theta = angle * nodes
    rates = np.sqrt(rate**2 + 2 * np.cos(wheel.slope - angle) - 2 * np.cos(wheel.slope + theta))
    unit = np.sqrt(1 + kappa)
    period = unit * angle * weights @ (1 / rates)
    rolling = arc(system, p, Mode.STICK, np.array([-angle, 0, rate / unit, 0]), period)
    return wheel, system, p, Step(arcs=(rolling,), impact=impact_of(system, p, rolling.states[-1]))


@cache
def compass_step() -> tuple[HybridSystem, Array, Step]:
    """A driven compass: it slips for a while, then sticks; nothing says that it is a gait."""
    system = HybridSystem(CompassBiped, ConstantTorque(ankle=TORQUES[0], hip=TORQUES[1]))
    p = np.array([1.6, 4.0, 0.8, 2.0, 9.8, np.radians(1), 0.14, *TORQUES])
    first = arc(system, p, Mode.SLIP_FORWARD, np.array([-0.148, -0.148, 0, 0.73, -0.5, 0.0]), SLIPPING)
    held = first.states[-1] * [1, 1, 1, 1, 1, 0]
    second = arc(system, p, Mode.STICK, held, STICKING, since=SLIPPING)
    return system, p, Step(arcs=(first, second), impact=impact_of(system, p, second.states[-1]))


def dense(quantity: int) -> list[tuple[Array, Array]]:
    """Times and one of the observed quantities on fine grids of both arcs."""
    system, p, step = compass_step()
    samples = []
    for piece in step.arcs:
        s = np.linspace(-1, 1, 20001)
        states = np.polynomial.chebyshev.chebval(s, curves.coefficients(piece.states))
        times = piece.start + piece.duration * (s + 1) / 2
        values = np.asarray(system.observation(piece.mode)(times[None, :], states, p, [])[quantity])
        samples.append((times, values))
    return samples


def test_wheel_step_closes_and_has_its_known_period() -> None:
    _, _, _, step = wheel_step()
    np.testing.assert_allclose(step.impact.state, step.arcs[0].states[0], atol=1e-11)
    assert measure([step])["period"] == pytest.approx(0.7931, abs=5e-5)


def test_wheel_advances_by_the_distance_of_its_spokes() -> None:
    wheel, _, _, step = wheel_step()
    measures = measure([step])
    assert measures["step_length"] == pytest.approx(2 * np.sin(np.pi / wheel.spokes), rel=1e-13)
    assert measures["speed"] == pytest.approx(measures["step_length"] / measures["period"], rel=1e-15)


def test_wheel_needs_the_friction_and_the_impulse_ratio_of_equations_18_and_19() -> None:
    wheel, _, _, step = wheel_step()
    kappa, angle, alpha = wheel.inertia_ratio, np.pi / wheel.spokes, wheel.slope
    theta = np.linspace(-angle, angle, 200001)
    squared = step.arcs[0].states[0, 2] ** 2 * (1 + kappa) + 2 * np.cos(alpha - angle) - 2 * np.cos(alpha + theta)
    pull = np.cos(alpha + theta) - squared
    normal = pull * np.cos(theta) + kappa * np.cos(alpha)
    sigma = (pull * np.sin(theta) - kappa * np.sin(alpha)) / normal
    measures = measure([step])
    assert measures["required_friction"] == pytest.approx(np.abs(sigma).max(), rel=1e-9)
    assert measures["required_friction"] == pytest.approx(0.9141, abs=5e-5)
    assert measures["min_normal_force"] == pytest.approx(normal.min() / (1 + kappa), rel=1e-9)
    assert measures["impulse_ratio"] == pytest.approx(np.sin(2 * angle) / (2 * (kappa + np.cos(angle) ** 2)), rel=1e-12)


def test_passive_walker_does_no_work_and_asks_for_no_torque() -> None:
    _, _, _, step = wheel_step()
    measures = measure([step])
    effort = ("work", "cost_of_transport", "absolute_cost_of_transport", "torque_squared", "peak_torque")
    assert [measures[name] for name in effort] == [0, 0, 0, 0, 0]


def test_constant_torques_do_the_work_of_torque_times_angle() -> None:
    system, p, step = compass_step()
    turned = sum(piece.states[-1, :2] - piece.states[0, :2] for piece in step.arcs)
    work = TORQUES @ [turned[0], turned.sum()]
    measures = measure([step])
    assert measures["work"] == pytest.approx(work, rel=1e-11)
    weight = numbers(system.weight(p))[0].item()
    assert measures["cost_of_transport"] == pytest.approx(work / (weight * step.impact.step_length), rel=1e-11)


def test_absolute_cost_counts_braking_as_work() -> None:
    system, p, step = compass_step()
    absolute = sum(trapezoid(np.abs(power), times).sum() for times, power in dense(2))
    measures = measure([step])
    scale = numbers(system.weight(p))[0].item() * step.impact.step_length
    assert measures["absolute_cost_of_transport"] * scale == pytest.approx(absolute, rel=1e-7)
    assert measures["absolute_cost_of_transport"] > abs(measures["cost_of_transport"])


def test_constant_torques_are_squared_over_the_whole_period() -> None:
    _, _, step = compass_step()
    measures = measure([step])
    assert measures["torque_squared"] == pytest.approx(TORQUES @ TORQUES * (SLIPPING + STICKING), rel=1e-12)
    assert measures["torque_cost"] == pytest.approx(measures["torque_squared"] / measures["step_length"], rel=1e-12)
    assert measures["peak_torque"] == pytest.approx(0.3, rel=1e-13)


def test_slip_is_the_way_of_the_foot_in_slipping_phases_only() -> None:
    _, _, step = compass_step()
    assert measure([step])["slip_distance"] == pytest.approx(step.arcs[0].states[-1, 2], rel=1e-13)


def test_foot_clearance_is_the_height_after_the_legs_have_passed() -> None:
    _, _, step = compass_step()
    _, foot = dense(3)[1]
    ahead = foot[0] > step.arcs[1].states[0, 2]
    assert not ahead[0]
    assert ahead[-1]
    assert measure([step])["foot_clearance"] == pytest.approx(foot[1][ahead].max(), abs=1e-8)


def test_foot_that_is_high_only_behind_the_stance_foot_has_no_credit_for_it() -> None:
    """A prescribed motion, high at its start; the feet pass where theta2 = -theta1, three eighths on."""
    _, _, step = compass_step()
    s = curves.points(POINTS)
    states = np.zeros((POINTS, 6))
    states[:, 0], states[:, 1] = 0.05 * s, 0.35 * s - 0.15
    prescribed = replace(step.arcs[-1], times=s + 1, states=states)
    clearance = measure([Step(arcs=(prescribed,), impact=step.impact)])["foot_clearance"]
    assert clearance == pytest.approx(1.6 * (np.cos(0.05) - np.cos(0.2)), rel=1e-12)


def test_required_friction_is_that_of_sticking_phases_only() -> None:
    _, _, step = compass_step()
    _, force = dense(0)[1]
    measures = measure([step])
    assert measures["required_friction"] == pytest.approx(np.abs(force[0] / force[1]).max(), rel=1e-7)
    slipping = Step(arcs=step.arcs[:1], impact=step.impact)
    assert measure([slipping])["required_friction"] is None


def test_phases_across_a_breakpoint_of_the_control_are_one() -> None:
    _, _, step = compass_step()
    first, second = step.arcs
    middle = replace(second, segment=1, times=second.times + STICKING)
    phases = Step(arcs=(first, second, middle), impact=None).phases
    assert [mode for mode, _ in phases] == [Mode.SLIP_FORWARD, Mode.STICK]
    assert [duration for _, duration in phases] == pytest.approx([SLIPPING, 2 * STICKING])
