"""Open-loop torques of walkers that fly, stand on massless feet, take several steps, or have several contacts."""

from dataclasses import replace
from math import pi, sin
from types import SimpleNamespace
from typing import Any

import pytest
from casadi import SX, cos, vertcat
from casadi import sin as sine
from driven_walkers import DrivenHeelToe, DrivenHopper
from named import verified

import gaitopt as go
from gaitopt.design.neighbourhood import neighbourhood
from gaitopt.model.mechanism import Mechanism, inclined
from gaitopt.model.walkers.slip_runner import SlipRunner


class TowedRunner(SlipRunner):
    """A point mass on massless springy legs, which a tow pulls along a slope; its energy is not that of a parameter."""

    model = "towed_runner"
    section_rates = ("theta", "shortening")
    actuators = ("tow",)
    external = ("tow",)

    slope: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        plain = super().mechanism(q, p)
        return replace(plain, gravity=inclined(p.gravity, p.slope), motors=(plain.bodies[0].position[0],))

    @classmethod
    def landing(
        cls, q: SimpleNamespace, dq: SimpleNamespace, p: SimpleNamespace
    ) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """The velocity of the body is continuous; the new leg has its full length."""
        along, leg = (vertcat(sine(angle), cos(angle)) for angle in (q.theta, p.attack - pi / 2))
        across, new = (vertcat(each[1], -each[0]) for each in (along, leg))
        velocity = (p.leg_length - q.shortening) * dq.theta * across - dq.shortening * along
        rates = (new.T @ velocity / p.leg_length, -leg.T @ velocity)
        return (p.attack - pi / 2, 0.0), rates

    @classmethod
    def rates_after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[SX, ...]:
        return (free.dtheta, free.dshortening)


COMPASS = """
name: compass
walker: {model: unequal_compass, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, other_leg_mass: 4, other_leg_com: 0.8,
  hip_mass: 2, gravity: 9.8, slope: 0}
friction: 0.5
control: {type: open_loop, intervals: 2}
gait:
  steps: [{phases: [stick], impact: stick}, {phases: [stick], impact: stick}]
  guess: {state: {theta1: -0.149, dtheta1: 0.733, dtheta2: -0.501}}
objective: torque_squared
constraints: {speed: 0.5}
"""
LIMPING = COMPASS.replace("other_leg_mass: 4", "other_leg_mass: 4.4")
RUNNER = """
name: runner
walker: {model: towed_runner, mass: 1, leg_length: 1, stiffness: 20, attack: 1.18682, energy: 1, gravity: 1,
  slope: -0.02}
friction: 0.6
control: {type: open_loop, intervals: 3}
gait: {phases: [stick, flight], impact: stick, guess: {state: {dtheta: 1.1, dshortening: 0.6}}}
objective: torque_squared
constraints: {speed: 1.25}
"""
HOPPER = """
name: hopper
walker: {model: driven_hopper, leg_length: 1, body_mass: 8, foot_mass: 2, stiffness: 4000, thrust: 1.0e-6,
  gravity: 9.81}
friction: 0.5
control: {type: open_loop, intervals: 12}
gait:
  phases:
    - {mode: stick, leg: free, thrust: off}
    - {mode: stick, leg: free, thrust: on}
    - {mode: flight, leg: locked, thrust: on}
  impact: stick
  guess: {state: {dshortening: 3.0}}
objective: torque_squared
constraints: {period: 0.5}
"""
HEEL_TOE = """
name: heel-toe
walker: {model: driven_heel_toe, leg_length: 1, leg_mass: 5, leg_com: 0.5, hip_mass: 10, heel: 0.02, toe: 0.04,
  gravity: 9.81, slope: 0.02}
friction: 1
control: {type: open_loop, intervals: 3}
gait:
  phases: [{heel: stick}, {toe: stick}]
  impact: {heel: stick}
  guess: {state: {theta1: -0.295, dtheta1: 1.156, dtheta2: -0.344, theta2: -0.317}, durations: [0.435, 0.309]}
objective: torque_squared
constraints: {speed: 0.55, required_friction: {max: 0.5}, min_normal_force: {min: 1}}
"""


def optimum(text: str) -> go.Gait:
    """The verified optimum of a problem."""
    walkers = [TowedRunner, DrivenHopper, DrivenHeelToe]
    return verified(go.parse_problem(text, walkers=walkers))


def test_equal_legs_take_the_optimal_step_twice() -> None:
    one = COMPASS.replace("unequal_compass", "compass_biped").replace("other_leg_mass: 4, other_leg_com: 0.8,", "")
    one = one.replace("steps: [{phases: [stick], impact: stick}, {", "").replace("impact: stick}]", "impact: stick")
    one = one.replace("  phases: [stick], impact", "  phases: [stick]\n  impact")
    single, double = optimum(one), optimum(COMPASS)
    assert double.period == pytest.approx(2 * single.period, rel=1e-9)
    assert double.measures["torque_squared"] == pytest.approx(2 * single.measures["torque_squared"], rel=1e-9)
    assert double.freed == pytest.approx(single.freed, abs=1e-8)


def test_a_tow_does_the_work_of_a_runner_against_gravity() -> None:
    """Nothing else does work on a conservative runner, so that the tow lifts it: m g L sin(slope)."""
    gait = optimum(RUNNER)
    assert gait.measures["work"] == pytest.approx(gait.measures["step_length"] * sin(0.02), rel=1e-8)
    assert gait.scalar("speed") == pytest.approx(1.25, rel=1e-8)  # the error of the collocation


@pytest.mark.slow
@pytest.mark.parametrize("text", [LIMPING, RUNNER, HOPPER, HEEL_TOE], ids=lambda text: text.split()[1])
def test_no_better_neighbour_of_the_optimum_is_found(text: str) -> None:
    searched = neighbourhood(optimum(text), directions=8)
    assert searched.optimal, searched.summary
