"""Return map and its derivative: closed forms of the wheel, differences, Newton's method, and what does not return."""

from functools import cache
from math import cos, pi, radians, sin, sqrt

import numpy as np
import pytest
from numpy.typing import NDArray

import gaitopt as go
from gaitopt import Mode
from gaitopt.gait.gait import floquet_multipliers
from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import build_system
from gaitopt.verification.return_map import ROUNDING, ReturnMap

Array = NDArray[np.float64]

HALF, SLOPE, KAPPA = pi / 10, radians(13), 1 / 3
BETA = (cos(2 * HALF) + KAPPA) / (1 + KAPPA)
GAINED = 4 * sin(HALF) * sin(SLOPE) / (1 + KAPPA)
FIXED = BETA * sqrt(GAINED / (1 - BETA**2))


@cache
def wheel(friction: float = 2.0) -> ReturnMap:
    system = HybridSystem(RimlessWheel, NoControl())
    return ReturnMap(Simulator(Dynamics(system, np.array([10, 1, 1, KAPPA, 1, SLOPE, friction]))), Mode.STICK)


@cache
def return_map(name: str, **overrides: object) -> ReturnMap:
    problem = go.load_problem(name).replace({key.replace("__", "."): value for key, value in overrides.items()})
    system = build_system(problem)
    return ReturnMap(Simulator(Dynamics.of(system, problem.parameters)), problem.cycle.impact)


def guess(name: str) -> Array:
    problem = go.load_problem(name)
    system = build_system(problem)
    state = np.array([problem.guess.state[key] for key in system.state_names])
    return state[system.section(problem.cycle.impact).indices]


@pytest.mark.parametrize("rate", [0.6, 0.65, 0.7, FIXED])
def test_map_of_the_wheel_is_that_of_its_energy_and_momentum(rate: float) -> None:
    """Pi(rate) = beta sqrt(rate^2 + gained), and its derivative beta^2 rate / Pi."""
    result = wheel()(np.array([rate]))
    exact = BETA * sqrt(rate**2 + GAINED)
    assert result.xi is not None
    assert result.xi == pytest.approx([exact], abs=1e-13)
    assert wheel().jacobian(result.steps) == pytest.approx(np.array([[BETA**2 * rate / exact]]), abs=1e-12)


@pytest.mark.parametrize("start", [0.5, 0.7, 0.9])
def test_newton_finds_the_fixed_point_of_the_wheel_from_afar(start: float) -> None:
    point = wheel().fixed_point(np.array([start]))
    assert point.converged
    assert point.residual < ROUNDING
    assert point.xi == pytest.approx([FIXED], abs=ROUNDING / (1 - BETA**2))
    assert floquet_multipliers(point.jacobian)[0].real == pytest.approx(BETA**2, abs=1e-12)


@pytest.mark.parametrize("name", ["compass-passive-a", "compass-passive-b", "compass-pd-impact-slip"])
def test_newton_refines_three_digits_to_rounding_even_where_the_gait_is_unstable(name: str) -> None:
    point = return_map(name).fixed_point(np.round(guess(name), 3))
    assert point.converged


@pytest.mark.parametrize("beyond_end", ["flow", "linear", "hold", "off"])
def test_deviations_pass_the_breakpoints_of_a_reference_unchanged(beyond_end: str) -> None:
    """Torques or their rates jump at fixed times; differences of simulated steps know nothing of saltation."""
    name, h = "compass-pd-impact-slip", 1e-6
    mapped = return_map(name, control__reference__beyond_end=beyond_end)
    xi = guess(name)
    jacobian = mapped.jacobian(mapped(xi).steps)
    columns = [(mapped(xi + h * unit).xi - mapped(xi - h * unit).xi) / (2 * h) for unit in np.eye(xi.size)]
    assert np.abs(np.column_stack(columns) - jacobian).max() < 1e-5 * np.abs(jacobian).max()


def test_fall_does_not_return() -> None:
    result = wheel()(np.array([0.05]))
    assert result.xi is None
    assert "no longer upright" in result.message
    point = wheel().fixed_point(np.array([0.05]))
    assert not point.converged
    assert point.jacobian is None
    assert point.residual == np.inf


def test_other_kind_of_impact_is_off_the_section_and_there_is_no_fixed_point() -> None:
    """Below the friction that its impact needs there is no sticking gait to converge to."""
    result = wheel(0.2)(np.array([0.75]))
    assert result.xi is None
    assert result.steps[0].impact.mode is Mode.SLIP_FORWARD
    assert "off the section of stick" in result.message
    assert not wheel(0.2).fixed_point(np.array([0.75])).converged
