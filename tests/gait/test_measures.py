"""Scalars of a step: the wheel's closed forms, and work, clearance and slip against methods without curves."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from foot_impacts import foot_impact
from oracles import numbers
from scipy.integrate import solve_ivp, trapezoid

from gaitopt import Mode
from gaitopt.gait import curves
from gaitopt.gait.measures import measure
from gaitopt.gait.trajectory import Arc, ImpactRecord, Step
from gaitopt.model.control import ConstantTorque
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped

Array = np.ndarray
TORQUES = np.array([0.3, -0.2])
POINTS = 65
SLIPPING, STICKING = 0.09, 0.64


def arc(system: HybridSystem, p: Array, mode: Mode, start: Array, duration: float, since: float = 0.0) -> Arc:
    """An arc of a given duration, integrated by scipy."""
    times = duration * (curves.points(POINTS) + 1) / 2
    precise = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
    flow = system.flow(mode)
    solution = solve_ivp(lambda t, z: numbers(flow(t, z, p, []))[0], (0, duration), start, t_eval=times, **precise)
    return Arc(dynamics=Dynamics(system, p), mode=mode, segment=0, times=since + times, states=solution.y.T)


def impact_of(system: HybridSystem, p: Array, z: Array) -> ImpactRecord:
    z_plus, impulse, *_ = numbers(foot_impact(system, Mode.STICK)(z, p))
    length, z_plus[system.n_shape] = z_plus[system.n_shape], 0.0
    return ImpactRecord(mode=Mode.STICK, state=z_plus, step_length=length, impulse=impulse, stick_impulse=impulse)


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


def test_required_friction_is_that_of_sticking_phases_and_slip_the_way_of_the_foot_in_the_others() -> None:
    _, _, step = compass_step()
    _, force = dense(0)[1]
    measures = measure([step])
    assert measures["slip_distance"] == pytest.approx(step.arcs[0].states[-1, 2], rel=1e-13)
    assert measures["required_friction"] == pytest.approx(np.abs(force[0] / force[1]).max(), rel=1e-7)
    slipping = Step(arcs=step.arcs[:1], impact=step.impact)
    assert measure([slipping])["required_friction"] is None
