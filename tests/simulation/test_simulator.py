"""The forward simulator on motions with known answers: closed forms, conservation laws, published gaits."""

from functools import cache

import numpy as np
import paper_walkers
import pytest
from numpy.typing import NDArray
from paper_walkers import (
    COMPASS_START,
    HALF_ANGLE,
    KAPPA,
    SLOPE,
    compass_numbers,
    compass_system,
    rolling_period,
    rolling_rate,
    wheel_system,
)
from scipy.integrate import solve_ivp

from gaitopt import Mode
from gaitopt.gait import curves
from gaitopt.gait.trajectory import Step
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.transitions import Ending
from gaitopt.simulation.events import LINEAR
from gaitopt.simulation.simulator import Simulator

pytestmark = pytest.mark.portable

Array = NDArray[np.float64]

STICK, FORWARD, BACKWARD = Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD


def wheel(friction: float = 1.0, **options: float) -> Simulator:
    return Simulator(paper_walkers.wheel(friction), **options)


def compass(friction: float, **options: float) -> Simulator:
    return Simulator(paper_walkers.compass(friction), **options)


@cache
def compass_gait(friction: float) -> Array:
    """State after impact of a stable passive gait, by iterating the return map."""
    return compass(friction).run(COMPASS_START, 200).section_states[-1]


def rolling(rate: float) -> Array:
    return np.array([-HALF_ANGLE, 0, rate, 0])


def modes(step: Step) -> list[Mode]:
    return [mode for mode, _ in step.phases]


# closed forms of the rimless wheel


@pytest.mark.parametrize("rate", [0.5, 0.7, 0.7587])
def test_the_wheel_touches_down_at_the_time_of_the_energy_integral(rate: float) -> None:
    step = wheel().run(rolling(rate)).steps[0]
    assert modes(step) == [STICK]
    assert step.period == pytest.approx(rolling_period(rate), rel=1e-12)
    assert step.arcs[-1].states[-1][0] == pytest.approx(HALF_ANGLE, abs=1e-15)
    assert step.arcs[-1].states[-1][2] == pytest.approx(rolling_rate(HALF_ANGLE, rate), rel=1e-12)


def test_a_wheel_too_slow_to_pass_over_its_spoke_falls_back_with_the_rate_it_had() -> None:
    trajectory = wheel().run(rolling(0.05))
    assert trajectory.ending is Ending.FALL
    assert trajectory.steps[0].impact is None
    assert trajectory.steps[0].arcs[-1].states[-1][0] == pytest.approx(-HALF_ANGLE, abs=1e-15)
    assert trajectory.steps[0].arcs[-1].states[-1][2] == pytest.approx(-0.05, abs=1e-12)
    assert "no longer upright" in trajectory.message
    assert "dtheta = -0.05" in trajectory.message


# endings


@pytest.mark.parametrize(
    ("numbers", "state", "ending", "words"),
    [
        ({}, (-HALF_ANGLE, 0, -0.3, 0), Ending.FALL, "no longer upright"),
        ({}, (-HALF_ANGLE, 0, 1.5, 0), Ending.LIFT_OFF, "0 s after the impact"),
        (
            {"friction": 1.3, "kappa": 0.2, "slope": 0.3, "spokes": 3},
            (-np.pi / 3, 0, 0.8, 0),
            Ending.DOUBLE_SUPPORT,
            "former stance foot",
        ),
    ],
)
def test_a_wheel_that_starts_backwards_or_too_fast_or_has_three_spokes_does_not_complete_a_step(
    numbers: dict[str, float], state: tuple[float, ...], ending: Ending, words: str
) -> None:
    trajectory = Simulator(paper_walkers.wheel(**numbers)).run(np.array(state))
    assert trajectory.ending is ending
    assert trajectory.steps == () or ending is Ending.DOUBLE_SUPPORT
    assert words in trajectory.message


def test_lift_off_in_mid_step_is_where_the_free_foot_would_rise() -> None:
    """Contact forces vanish together: gravity no longer bends the hub's path as much as the foot's circle does."""
    trajectory = wheel(0.5).run(rolling(0.99))
    last = trajectory.steps[0].arcs[-1]
    theta, _, rate, _ = last.states[-1]
    assert trajectory.ending is Ending.LIFT_OFF
    assert modes(trajectory.steps[0]) == [BACKWARD, STICK, FORWARD]
    assert rate**2 * np.cos(theta) == pytest.approx(np.cos(SLOPE), abs=1e-12)
    assert "mode slip_forward" in trajectory.message


def test_a_slip_in_the_paradox_of_painleve_is_not_integrated() -> None:
    """Backward slip of the wheel is unique where kappa + sin^2 theta > mu sin theta cos theta."""
    theta, slipping = 0.25, np.array([0.25, 0, 0.5, -0.1])
    critical = (KAPPA + np.sin(theta) ** 2) / (np.sin(theta) * np.cos(theta))
    assert wheel(critical * 0.999).run(slipping).ending is not Ending.PAINLEVE
    trajectory = wheel(critical * 1.001).run(slipping)
    assert trajectory.ending is Ending.PAINLEVE
    assert "no unique solution" in trajectory.message


def test_no_touchdown_within_the_time_limit_is_an_ending(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gaitopt.simulation.simulator.MAX_STEP_TIME", 0.3 / compass(0.2).dynamics.scales.time)
    trajectory = compass(0.2).run(COMPASS_START)
    assert trajectory.ending is Ending.NO_TOUCHDOWN
    assert trajectory.steps[0].period == pytest.approx(0.3, rel=1e-15)
    assert "within 0.3 s" in trajectory.message


def test_more_switches_than_allowed_is_chattering() -> None:
    start = compass_gait(0.14)
    assert compass(0.14, max_switches=2).run(start).ending is Ending.COMPLETED
    trajectory = compass(0.14, max_switches=1).run(start)
    assert trajectory.ending is Ending.CHATTERING
    assert "more than 1 mode switches" in trajectory.message


# gaits of the compass biped


@pytest.mark.parametrize(("arc", "margin"), [(0, "slip_velocity"), (1, "cone_backward"), (2, "touchdown")])
def test_events_agree_with_a_brute_force_integration(arc: int, margin: str) -> None:
    """Scipy's own events, on steps so short that its interpolant is exact to 1e-13."""
    p, expected = compass_numbers(0.14), compass(0.14).run(compass_gait(0.14)).steps[0].arcs[arc]
    flow, margins = compass_system().flow(expected.mode), compass_system().margins(expected.mode)
    k = compass_system().transitions.margin_names(expected.mode).index(margin)

    def rate(t: float, z: Array) -> Array:
        return np.asarray(flow(t, z, p, [])).ravel()

    def rises(t: float, z: Array) -> float:
        return -float(margins(t, z, p, [])[k])

    rises.__dict__.update(terminal=True, direction=1)
    precise = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "max_step": 5e-3}
    away = expected.start + 1e-3  # the margin may be zero at the start
    ahead = solve_ivp(rate, (expected.start, away), expected.states[0], **precise).y[:, -1]
    found = solve_ivp(rate, (away, 1), ahead, events=rises, **precise)
    assert found.t_events[0][0] == pytest.approx(expected.end, abs=1e-12)
    assert found.y_events[0][0] == pytest.approx(expected.states[-1], abs=1e-11)


# conservation laws along the arcs


def test_dense_arcs_are_resolved_chebyshev_curves() -> None:
    start = compass_gait(0.14)
    coarse, fine = (compass(0.14).run(start, dense=dense).steps[0] for dense in (False, True))
    assert [arc.times.size for arc in coarse.arcs] == [2, 2, 2]
    for ends, arc in zip(coarse.arcs, fine.arcs, strict=True):
        nodes = (2 * arc.times - arc.start - arc.end) / arc.duration
        assert nodes == pytest.approx(curves.points(arc.times.size), abs=1e-13 / arc.duration)
        assert curves.tail(arc.states) < 1e-12
        assert np.array_equal(ends.times, arc.times[[0, -1]])
        assert np.array_equal(ends.states, arc.states[[0, -1]])


# slips of any shortness


def threshold() -> tuple[float, float, float]:
    """Friction at which the passive gait's foot just stays at rest after impact; f_n there, and its margin's rate."""
    system, start = compass_system(), compass_gait(0.2)
    f_t, f_n = np.asarray(system.observation(STICK)(0, start, compass_numbers(0.2), [])[0]).ravel()
    _, rates = system.events(STICK)(0, start, compass_numbers(-f_t / f_n), [])
    return -f_t / f_n, f_n, float(rates[system.transitions.margin_names(STICK).index("cone_forward")])


ROUNDING_OF_FORCES = 1e-13
"""Seven units in the last place of the weight of 98 N."""


@pytest.mark.parametrize("depth", [1e-4, 1e-5, 1e-6, 1e-7, 1e-8])
def test_a_slip_from_rest_lasts_twice_the_time_in_which_the_cone_recovers(depth: float) -> None:
    """v is in proportion to the integral of (missing force - rate t), however short the slip.

    The end of the slip is reached by a linear move of up to LINEAR; on v = t (T - t) that is off by LINEAR^2 / T.
    Rounding of the force, some units in the last place of the weight, moves the time at which the cone has recovered.
    """
    friction, f_n, rate = threshold()
    step = compass(friction - depth).run(compass_gait(0.2)).steps[0]
    assert modes(step) == [FORWARD, STICK]
    exact = 2 * depth * f_n / rate
    rounding = 2 * ROUNDING_OF_FORCES / rate
    assert step.phases[0][1] == pytest.approx(exact, rel=10 * depth, abs=LINEAR**2 / exact + rounding)


@pytest.mark.parametrize("depth", [1e-10, 1e-12, 1e-15, 0, -1e-15, -1e-12, -1e-6])
def test_a_slip_shorter_than_an_instant_is_none(depth: float) -> None:
    step = compass(threshold()[0] - depth).run(compass_gait(0.2)).steps[0]
    assert modes(step) == [STICK]


# rejected input


def test_a_state_of_the_wrong_length_or_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="one value is needed for each of theta, x, dtheta, dx"):
        wheel().run(np.zeros(3))
    with pytest.raises(ValueError, match="state must be finite, not dtheta = nan"):
        wheel().run(np.array([0, 0, np.nan, 0]))
    with pytest.raises(ValueError, match="steps = 0"):
        wheel().run(rolling(0.7), 0)
    with pytest.raises(ValueError, match="parameters of shape"):
        Simulator(Dynamics(wheel_system(), np.ones(3)))


def test_a_slip_velocity_that_is_only_rounding_is_none() -> None:
    for rounding in (1e-16, -1e-14):
        start = compass_gait(0.2) + np.array([0, 0, 0, 0, 0, rounding])
        assert modes(compass(0.2).run(start).steps[0]) == [STICK]


def test_simulation_does_not_depend_on_where_the_foot_stands() -> None:
    moved = compass_gait(0.14).copy()
    moved[2] = 5.0
    assert compass(0.14).run(moved).steps[0].period == compass(0.14).run(compass_gait(0.14)).steps[0].period
