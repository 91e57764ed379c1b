"""Return map and its derivative: closed forms of the wheel, differences, Newton's method, and what does not return."""

from math import cos, sin, sqrt

import numpy as np
import paper_walkers
import pytest

from gaitopt import Mode
from gaitopt.gait.gait import floquet_multipliers
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.return_map import ROUNDING, ReturnMap

HALF, SLOPE, KAPPA = paper_walkers.HALF_ANGLE, paper_walkers.SLOPE, paper_walkers.KAPPA
BETA = (cos(2 * HALF) + KAPPA) / (1 + KAPPA)
GAINED = 4 * sin(HALF) * sin(SLOPE) / (1 + KAPPA)
FIXED = BETA * sqrt(GAINED / (1 - BETA**2))


def wheel(friction: float = 2.0) -> ReturnMap:
    return ReturnMap(Simulator(paper_walkers.wheel(friction)), Mode.STICK)


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


def test_a_fall_and_another_kind_of_impact_do_not_return() -> None:
    """Below the friction that its impact needs there is no sticking gait to converge to."""
    for friction, rate, words in ((2.0, 0.05, "no longer upright"), (0.2, 0.75, "off the section of stick")):
        result, point = wheel(friction)(np.array([rate])), wheel(friction).fixed_point(np.array([rate]))
        assert result.xi is None
        assert words in result.message
        assert not point.converged
        assert point.jacobian is None
        assert point.residual == np.inf
    assert result.steps[0].impact.mode is Mode.SLIP_FORWARD
