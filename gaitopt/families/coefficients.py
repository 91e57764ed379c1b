"""One or two coefficients of friction: a gait restated so that the one that is varied is a parameter of its system.

Where static and kinetic friction are equal, a gait of the one law is a gait of the other.
"""

from dataclasses import replace

import numpy as np

from gaitopt.errors import ProblemError
from gaitopt.gait import Gait
from gaitopt.mechanics import CoulombFriction, Dynamics, HybridSystem, StaticKineticFriction
from gaitopt.mechanics.friction import Friction
from gaitopt.problem.sections import FrictionCoefficients


def with_friction(gait: Gait, parameter: str) -> Gait:
    """The same gait under the friction law that has ``parameter``; unchanged for all other parameters.

    Raises
    ------
    ProblemError
        If both coefficients are to be moved but differ, or there is viscous drag besides.
    """
    if parameter in gait.system.parameters or parameter.partition(".")[0] != "friction":
        return gait
    friction = gait.problem.friction
    if isinstance(friction, float):
        value = gait.dynamics.static_friction
        if parameter not in StaticKineticFriction().parameters:
            return gait
        return _restated(gait, FrictionCoefficients(static=value, kinetic=value), StaticKineticFriction())
    if friction.static != friction.kinetic or friction.viscous:
        numbers = ", ".join(f"{name} = {value:g}" for name, value in friction)
        raise ProblemError(
            f"friction has several coefficients, {numbers}: vary friction.static, friction.kinetic or friction.viscous"
        )
    return _restated(gait, friction.static, CoulombFriction())


def coefficient_bounds(gait: Gait, parameter: str) -> tuple[float, float]:
    """Range of a parameter that the other coefficient of friction leaves, static being at least kinetic."""
    known = gait.dynamics.parameters
    if parameter == "friction.static":
        return known["friction.kinetic"], np.inf
    return -np.inf, known["friction.static"] if parameter == "friction.kinetic" else np.inf


def _restated(gait: Gait, coefficients: float | FrictionCoefficients, law: Friction) -> Gait:
    problem = replace(gait.problem, friction=coefficients)
    system = HybridSystem(gait.system.walker, gait.system.control, gait.system.law, law)
    p = system.values({**problem.parameters, **gait.dynamics.parameters})
    return replace(gait, problem=problem, dynamics=Dynamics(system, p))
