"""The rimless wheel and the compass of Gamus & Or (2013) with numbers, without motors."""

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad

from gaitopt import ImpactLaw
from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rimless_wheel import RimlessWheel

KAPPA, SLOPE, HALF_ANGLE = 1 / 3, np.radians(13), np.pi / 10
"""Inertia ratio of the wheel of section III, its slope, and half of the angle between its spokes."""
COMPASS = (1.6, 4, 0.8, 2, 9.8, np.radians(1))
COMPASS_START = np.array([-0.1478, -0.1478, 0, 0.7328, -0.5007, 0])


@cache
def wheel_system() -> HybridSystem:
    return HybridSystem(RimlessWheel, NoControl())


@cache
def compass_system(law: ImpactLaw = ImpactLaw.COULOMB) -> HybridSystem:
    return HybridSystem(CompassBiped, NoControl(), law)


def wheel_numbers(friction: float, kappa: float = KAPPA, slope: float = SLOPE, spokes: int = 10) -> NDArray[np.float64]:
    """Parameters in units radius = mass = gravity = 1."""
    return np.array([spokes, 1, 1, kappa, 1, slope, friction])


def compass_numbers(friction: float, slope: float = COMPASS[-1]) -> NDArray[np.float64]:
    return np.array([*COMPASS[:-1], slope, friction])


def wheel(friction: float = 1.0, **numbers: float) -> Dynamics:
    return Dynamics(wheel_system(), wheel_numbers(friction, **numbers))


def compass(friction: float, law: ImpactLaw = ImpactLaw.COULOMB, **numbers: float) -> Dynamics:
    return Dynamics(compass_system(law), compass_numbers(friction, **numbers))


def rolling_rate(theta: float, rate: float) -> float:
    """Rate of the wheel that rolls without slip from -pi/10 with a rate, by conservation of energy."""
    return np.sqrt(rate**2 + 2 * (np.cos(HALF_ANGLE - SLOPE) - np.cos(theta + SLOPE)) / (1 + KAPPA))


def rolling_period(rate: float) -> float:
    """Time in which it rolls over a spoke."""
    slowness = quad(lambda theta: 1 / rolling_rate(theta, rate), -HALF_ANGLE, HALF_ANGLE, epsabs=1e-14, epsrel=1e-13)
    return slowness[0]
