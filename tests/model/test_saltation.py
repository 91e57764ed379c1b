"""Saltation: systems whose flow through an event is known in closed form."""

import numpy as np
import pytest

from gaitopt.model.dynamics import projection, saltation

GRAVITY = 9.8


def drift(t: float) -> np.ndarray:
    """Transition matrix of free motion, alone or under a constant acceleration; state (x, v)."""
    return np.array([[1.0, t], [0.0, 1.0]])


def test_ball_that_rolls_onto_a_slope_has_the_sensitivities_of_its_closed_form() -> None:
    """Level for x < 0, decelerated by a for x > 0: x = v0 s - a s^2 / 2, v = v0 - a s, with s = T + x0 / v0."""
    a, x0, v0, T = 0.8, -0.6, 1.1, 1.4
    s = T + x0 / v0
    S = saltation(np.array([v0, 0.0]), np.array([v0, -a]), np.array([1.0, 0.0]), v0)
    by_saltation = drift(s) @ S @ drift(T - s)
    ds = np.array([1 / v0, -x0 / v0**2])
    exact = np.array([(v0 - a * s) * ds + [0, s], [0, 1] - a * ds])
    np.testing.assert_allclose(by_saltation, exact, rtol=1e-14)


def test_flow_that_is_continuous_at_the_switch_passes_deviations_unchanged() -> None:
    f = np.array([1.0, -0.3, 0.2])
    np.testing.assert_array_equal(saltation(f, f, np.array([0.3, 1.0, 2.0]), 0.4), np.eye(3))


def test_saltation_maps_the_flow_before_to_the_flow_after() -> None:
    rng = np.random.default_rng(1)
    f_minus, f_plus, gradient = rng.normal(size=(3, 4))
    S = saltation(f_minus, f_plus, gradient, gradient @ f_minus)
    np.testing.assert_allclose(S @ f_minus, f_plus, rtol=1e-13)


def test_saltation_leaves_deviations_along_the_guard_alone() -> None:
    S = saltation(np.array([1.0, 2.0]), np.array([3.0, -1.0]), np.array([1.0, 0.0]), 1.0)
    np.testing.assert_array_equal(S @ [0.0, 1.0], [0.0, 1.0])


def test_switch_at_a_moving_guard_uses_the_total_rate() -> None:
    """Acceleration a from the moment when the guard x - c t is reached: the switching time is -x0 / (v0 - c)."""
    a, c, x0, v0, T = 0.5, 0.4, -0.3, 1.0, 1.2
    t1 = -x0 / (v0 - c)
    S = saltation(np.array([v0, 0.0]), np.array([v0, a]), np.array([1.0, 0.0]), v0 - c)
    v_T = (drift(T - t1) @ S @ drift(t1))[1]
    np.testing.assert_allclose(v_T, [a / (v0 - c), 1 - a * x0 / (v0 - c) ** 2], rtol=1e-14)


@pytest.mark.parametrize("restitution", [0.5, 0.9])
def test_bouncing_ball_has_its_restitution_for_a_multiplier(restitution: float) -> None:
    """From bounce to bounce the speed is multiplied by the restitution, whatever it was."""
    v0 = 2.0
    flight = 2 * v0 / GRAVITY
    f_minus = np.array([-v0, -GRAVITY])
    reset = np.diag([1.0, -restitution])
    deviation = reset @ projection(f_minus, np.array([1.0, 0.0]), -v0) @ drift(flight) @ [0.0, 1.0]
    np.testing.assert_allclose(deviation, [0.0, restitution], atol=1e-15)


def test_projected_deviation_lies_on_the_guard() -> None:
    rng = np.random.default_rng(2)
    f, gradient = rng.normal(size=(2, 5))
    P = projection(f, gradient, gradient @ f)
    np.testing.assert_allclose(gradient @ P, 0, atol=1e-13)
    np.testing.assert_allclose(P @ f, 0, atol=1e-13)
    np.testing.assert_allclose(P @ P, P, atol=1e-12)
