"""Derivatives of the return map by state and parameters against walks and closed forms."""

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.return_map import (
    LARGEST_DEVIATION,
    CycleOutcome,
    FixedPoint,
    ReturnMap,
    directional_derivative,
    extrapolated,
)

DIFFERENCE = 1e-7
"""Error of an extrapolated difference of walks, relative to the largest derivative."""


def by_walks(gait, key):
    """The derivative by a parameter from walks that start at the same section coordinates."""
    section, n = gait.system.section(gait.cycle), len(gait.steps)
    xi, value = gait.state[section.indices], gait.dynamics.parameter(key)
    size = max(abs(value), 0.1)

    def returned(h):
        outcome = ReturnMap(Simulator(gait.dynamics.at({key: value + h * size})), section, n, near=gait.state)(xi)
        assert outcome.xi is not None, outcome.message
        return outcome.xi

    derivative, _ = extrapolated(lambda h: (returned(h) - returned(-h)) / (2 * h), power=2, goal=1e-9)
    return derivative / size


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("compass-torque-impact-slip", ("control.ankle", "control.hip", "friction", "walker.slope", "walker.leg_mass")),
        ("compass-pd-impact-slip", ("control.kp", "walker.leg_length")),
        pytest.param("flat-foot", ("walker.slope",), marks=pytest.mark.slow),
        pytest.param("rabbit-hzd", ("control.gains.kp", "walker.gravity"), marks=pytest.mark.slow),
        pytest.param("compass-unequal", ("walker.slope",), marks=pytest.mark.slow),
    ],
)
def test_the_derivative_by_a_parameter_is_that_of_walks(name, keys):
    gait = named(name)
    derivatives = go.return_map_derivatives(gait, keys)
    section = gait.system.section(gait.cycle)
    assert (derivatives.names, derivatives.keys) == (section.names, keys)
    for k, key in enumerate(keys):
        walked = by_walks(gait, key)
        np.testing.assert_allclose(derivatives.B[:, k], walked, atol=DIFFERENCE * max(1.0, np.abs(walked).max()))
    radius = np.abs(np.linalg.eigvals(derivatives.A)).max()
    assert radius == pytest.approx(gait.spectral_radius, rel=1e-9)


def test_the_wheel_has_the_derivatives_of_its_closed_form():
    """(dtheta+)^2 = r^2 (dtheta^2 + 2 (g / l) (cos(a - slope) - cos(a + slope)) / (1 + J)) for a sticking wheel."""
    gait = named("rimless-wheel-stick")
    derivatives = go.return_map_derivatives(gait, ["walker.slope"])
    ((a,),), ((b,),) = derivatives.A, derivatives.B
    p = gait.dynamics.parameters
    alpha, slope, inertia = np.pi / p["walker.spokes"], p["walker.slope"], p["walker.inertia_ratio"]
    r = np.sqrt(a)  # the multiplier of dtheta at the fixed point is r^2, and r the ratio of rates at the impact
    gain = p["walker.gravity"] / p["walker.radius"] / (1 + inertia)
    rise = 2 * gain * (np.cos(alpha - slope) - np.cos(alpha + slope))
    rate = gait.state[gait.system.state_names.index("dtheta")]
    assert r**2 * (rate**2 + rise) == pytest.approx(rate**2, rel=1e-10)
    by_slope = 2 * gain * (np.sin(alpha - slope) + np.sin(alpha + slope))
    assert b == pytest.approx(r**2 * by_slope / (2 * rate), rel=1e-9)


@pytest.mark.parametrize("power", [1, 2])
def test_extrapolation_removes_one_power_of_the_deviation_with_each_row(power):
    tried = []

    def quotient(h):
        tried.append((h / LARGEST_DEVIATION) ** power)
        return np.polyval([2.0, -5.0, 3.0, 1.0], tried[-1:])

    limit, error = extrapolated(quotient, power=power, goal=1e-12)
    assert limit == pytest.approx([1.0], abs=1e-12)
    assert error < 1e-12
    assert len(tried) == 5  # three powers; a fifth row confirms


@pytest.mark.parametrize(("bend", "reach"), [(-1.0, 1.0), (99.0, 1e-6)])
def test_a_map_is_differentiated_from_one_side_if_its_curvature_jumps_and_close_by_if_it_ends(bend, reach):
    """x / 2 + 99 x^2 for x > 0 and x / 2 + bend x^2 for x < 0, up to abs(x) = reach; its fixed point is 0."""

    def returned(xi):
        image = xi / 2 + np.where(xi > 0, 99.0, bend) * xi**2
        return CycleOutcome(xi=image if abs(xi) < reach else None, steps=(), message="")

    returned.unit, zero = np.ones(1), np.zeros(1)
    point = FixedPoint(xi=zero, cycle=returned(zero), residual=0.0, accuracy=1e-15, jacobian=None, message="")
    derivative, error, _ = directional_derivative(returned, point, np.ones(1), goal=1e-9, enough=1e-8)
    assert derivative == pytest.approx([0.5], abs=1e-8)
    assert error < 1e-8


def test_a_key_that_is_no_parameter_is_named():
    gait = named("compass-torque-impact-slip")
    with pytest.raises(go.GaitoptError, match=r"control\.hipp is not a parameter .*control\.hip"):
        go.return_map_derivatives(gait, ["control.hipp"])
    with pytest.raises(go.GaitoptError, match="whole number"):
        go.return_map_derivatives(named("rimless-wheel-stick"), ["walker.spokes"])
