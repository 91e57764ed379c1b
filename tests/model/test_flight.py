"""Walkers that fly: runners and hoppers against closed forms and against equations written out by hand."""

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from casadi import cos, pi, sin, vertsplit
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import gaitopt as go
from gaitopt import Mode
from gaitopt.model.walkers.slip_runner import SlipRunner
from gaitopt.problem.statement import problem_data

Array = NDArray[np.float64]


@pytest.mark.parametrize(
    ("body", "foot", "stiffness", "thrust"),
    [(8.0, 2.0, 4000.0, 200.0), (10.0, 1.0, 3000.0, 120.0), (5.0, 2.5, 9000.0, 300.0)],
)
def test_hopper_lands_with_the_speed_and_the_multiplier_of_its_closed_form(body, foot, stiffness, thrust):
    g, rho = 9.81, body / (body + foot)
    depth = (rho**-2 - 1) * body / (2 * thrust)  # by the square of the speed: the thrust gives what the stop takes
    speed = np.sqrt(body * (1 + 2 * depth * g) / (stiffness * depth**2))
    walker = {"body_mass": body, "foot_mass": foot, "stiffness": stiffness, "thrust": thrust}
    changes = {f"walker.{key}": value for key, value in walker.items()} | {
        "gait.guess.state": {"dshortening": 0.9 * speed}
    }
    gait = go.solve(go.load_problem("hopper").replace(changes))
    assert gait.converged, gait.message
    assert gait.state[gait.system.state_names.index("dshortening")] == pytest.approx(speed, rel=1e-11)
    assert gait.multipliers == pytest.approx([rho**2 + (1 - rho**2) / (2 * (1 + depth * g))], rel=1e-9)


def _apex_map(height: float, energy: float, attack: float, stiffness: float) -> float:
    """Height of the next apex of a spring-mass model of unit mass, leg and gravity, in Cartesian terms."""

    def stance(t: float, s: Array) -> Array:
        length = np.hypot(s[0], s[1])
        pull = stiffness * (1 - length) / length
        return np.array([s[2], s[3], pull * s[0], pull * s[1] - 1])

    def takes_off(t: float, s: Array) -> float:
        return float(np.hypot(s[0], s[1]) - 1)

    takes_off.terminal, takes_off.direction = True, 1  # type: ignore[attr-defined]
    fall = -np.sqrt(2 * (height - np.sin(attack)))
    start = np.array([-np.cos(attack), np.sin(attack), np.sqrt(2 * (energy - height)), fall])
    s = solve_ivp(stance, (0, 5), start, "DOP853", events=takes_off, rtol=1e-13, atol=1e-14).y[:, -1]
    return float(s[1] + s[3] ** 2 / 2)


@pytest.mark.parametrize(("rate", "height", "multiplier"), [(1.1, 0.9349, 0.368), (0.93, 1.0159, 1.3325)])
def test_runner_returns_to_its_apex_as_a_spring_mass_model_does(rate: float, height: float, multiplier: float) -> None:
    attack, energy = np.radians(68), 1.7
    gait = go.solve(go.load_problem("slip-run").replace({"gait.guess.state": {"dtheta": rate}}))
    apex = np.sin(attack) + gait.measures["foot_clearance"]  # the next foot is highest with the body
    assert apex == pytest.approx(height, abs=1e-4)
    assert _apex_map(apex, energy, attack, 20.0) == pytest.approx(apex, abs=1e-10)
    slope = (_apex_map(apex + 1e-5, energy, attack, 20.0) - _apex_map(apex - 1e-5, energy, attack, 20.0)) / 2e-5
    assert gait.multipliers == pytest.approx([slope], abs=1e-6)  # a central difference
    assert slope == pytest.approx(multiplier, abs=1e-3)
    assert gait.measures["required_friction"] == pytest.approx(1 / np.tan(attack), rel=1e-9)


@pytest.mark.parametrize(("shortening", "foot"), [(0.1, (0.3, 0.0)), (-0.1, (0.3 + np.cos(1.2), 1.1 - np.sin(1.2)))])
def test_the_leg_of_a_runner_is_drawn_on_its_foothold_and_in_flight_at_the_angle_of_attack(shortening, foot):
    """Upright above 0.3 m: in flight, the next foot is one leg length ahead of the body, 1.2 rad below the ground."""
    q, p = SimpleNamespace(theta=0.0, shortening=shortening, x=0.3, y=0.0), SimpleNamespace(leg_length=1.0, attack=1.2)
    ((first, *_, last),) = SlipRunner.outline(q, p)
    assert [*map(float, vertsplit(first)), *map(float, vertsplit(last))] == pytest.approx([*foot, 0.3, 1 - shortening])


class LandingRunner(SlipRunner):
    """The runner with the closed form of its landing: only the velocity across the leg counts, and the energy."""

    model = "landing_runner"

    @classmethod
    def landing(cls, q: SimpleNamespace, dq: SimpleNamespace, p: SimpleNamespace) -> Any:
        """The velocity of the body in polar coordinates about the new foot."""
        leg, theta = p.leg_length - q.shortening, p.attack - pi / 2
        along = -dq.shortening * sin(q.theta) + leg * dq.theta * cos(q.theta)
        up = -dq.shortening * cos(q.theta) - leg * dq.theta * sin(q.theta)
        free = SimpleNamespace(dtheta=(along * cos(theta) - up * sin(theta)) / p.leg_length)
        return cls.after_impact(free, p), cls.rates_after_impact(free, p)


def test_a_massless_foot_lands_without_a_change_of_the_motion_of_the_body() -> None:
    gait = go.solve("slip-run", progress=False)
    data = problem_data(gait.problem)
    data["walker"]["model"] = LandingRunner.model
    same = go.solve(go.parse_problem(json.dumps(data), walkers=[LandingRunner]), progress=False)
    assert same.period == pytest.approx(gait.period, rel=1e-13)
    assert same.multipliers == pytest.approx(gait.multipliers, rel=1e-11)
    struck, before = SlipRunner.swapped(Mode.STICK), gait.arcs[-1].states[-1]
    landings = [each.dynamics.after_impact(struck, before, Mode.FLIGHT) for each in (gait, same)]
    np.testing.assert_allclose(*landings, atol=1e-13)


def test_a_massless_foot_needs_the_friction_of_its_angle_of_attack() -> None:
    friction = 1 / np.tan(np.radians(68))
    assert go.solve(go.load_problem("slip-run").replace({"friction": friction + 1e-6})).converged
    gait = go.solve(go.load_problem("slip-run").replace({"friction": friction - 1e-3}))
    assert not gait.converged
    assert "needs friction 0.404" in gait.message


def _by_hand(gait: go.Gait) -> Array:
    """State after a step of the runner with a foot that sticks, from equations in Cartesian coordinates."""
    v = {name.removeprefix("walker."): gait.p[k] for k, name in enumerate(gait.system.parameters)}
    m, mf, k, kh, slope = (v[name] for name in ("body_mass", "foot_mass", "stiffness", "hip_stiffness", "slope"))
    pull = np.array([np.sin(slope), -np.cos(slope)])

    def forces(arm: Array) -> Array:
        """Force of the springs on the body."""
        length = np.hypot(*arm)
        theta = np.arctan2(arm[0], arm[1])
        return k * (1 - length) * arm / length - kh * theta / length * np.array([np.cos(theta), -np.sin(theta)])

    def stance(t: float, s: Array) -> Array:
        return np.concatenate([s[2:], forces(s[:2]) / m + pull])

    def extended(t: float, s: Array) -> float:
        return float(1 - np.hypot(*s[:2]))

    def flight(t: float, s: Array) -> Array:
        # body, foot and their velocities; the rod between them holds its length
        arm, rate = s[:2] - s[2:4], s[4:6] - s[6:]
        own = forces(arm)
        reduced = m * mf / (m + mf)
        rod = -reduced * (rate @ rate) - own @ arm  # arm'' . arm = - rate^2
        push = own + rod * arm / (arm @ arm)
        return np.concatenate([s[4:], push / m + pull, -push / mf + pull])

    def down(t: float, s: Array) -> float:
        return float(s[3])

    extended.terminal, extended.direction = True, -1  # type: ignore[attr-defined]
    down.terminal, down.direction = True, -1  # type: ignore[attr-defined]
    theta, dtheta, shortens = (gait.state[gait.system.state_names.index(n)] for n in ("theta", "dtheta", "dshortening"))
    along, across = np.array([np.sin(theta), np.cos(theta)]), np.array([np.cos(theta), -np.sin(theta)])
    start = np.concatenate([along, dtheta * across - shortens * along])
    options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
    s = solve_ivp(stance, (0, 5), start, events=extended, **options).y[:, -1]
    arm = s[:2] / np.hypot(*s[:2])
    speed = m / (m + mf) * (s[2:] @ arm)  # of the foot: the stop is plastic and acts along the leg
    lost = s[2:] + (speed - s[2:] @ arm) * arm
    s = solve_ivp(flight, (0, 5), np.concatenate([arm, [0, 0], lost, speed * arm]), events=down, **options).y[:, -1]
    arm = s[:2] - s[2:4]
    after = np.array([arm[1], -arm[0]])
    return np.array([np.arctan2(arm[0], arm[1]), s[4:6] @ after, -s[4:6] @ arm])


def test_a_runner_whose_foot_sticks_moves_as_in_cartesian_equations() -> None:
    data = {"friction": 2.0, "gait.phases": [{"mode": "stick", "leg": "free"}, {"mode": "flight", "leg": "locked"}]}
    gait = go.solve(go.load_problem("slip-run-foot").replace(data))
    names = gait.system.state_names
    section = gait.state[[names.index(name) for name in ("theta", "dtheta", "dshortening")]]
    assert _by_hand(gait) == pytest.approx(section, abs=1e-9)


def test_less_friction_lets_the_foot_of_a_runner_slide_at_landing_and_then_before_take_off() -> None:
    data = {"friction": 1.6, "gait.phases": [{"mode": "stick", "leg": "free"}, {"mode": "flight", "leg": "locked"}]}
    gait = go.solve(go.load_problem("slip-run-foot").replace(data))
    branch = go.continuation(gait, "friction", 1.0, max_points=20)
    landing, take_off, _ = branch.specials
    assert (landing.type, take_off.type) == ("mode_change", "mode_change")
    assert landing.value == pytest.approx(gait.measures["required_friction"], abs=1e-9)
    assert take_off.value == pytest.approx(1.50704296, abs=1e-8)
    assert branch.points[-1].gait.phases[0][0] == "slip_backward, leg free"
    assert branch.points[-1].gait.phases[2][0] == "slip_forward, leg free"


@pytest.mark.slow
def test_a_family_over_a_short_range_passes_the_slip_at_landing_too() -> None:
    data = {"friction": 1.524, "gait.phases": [{"mode": "stick", "leg": "free"}, {"mode": "flight", "leg": "locked"}]}
    branch = go.continuation(go.solve(go.load_problem("slip-run-foot").replace(data)), "friction", 1.515)
    landing, end = branch.specials
    assert landing.value == pytest.approx(1.52285888971, abs=1e-10)
    assert (landing.type, end.value) == ("mode_change", 1.515)
