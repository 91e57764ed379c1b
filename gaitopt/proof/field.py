"""One mode on one segment of the control as an autonomous vector field with everything that is observed along it.

    dy/dt = F(y),   y = (z, t)

t, the time since the last impact, is a state like the others, so that events at fixed times and events of the state
are treated alike.
"""

from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import Any

from casadi import SX, Function, cse, jacobian, sum1, vertcat

from gaitopt.mechanics import HybridSystem, Mode
from gaitopt.proof.graph import Graph
from gaitopt.proof.parametric import truncated

LOW_DEGREE = 2
"""Of first variations and of what is observed along the motion."""


class Field:
    """The flow of a mode, its Jacobian, and its margins, force and power, in balls.

    Parameters
    ----------
    p, r : parameters and segment data.
    """

    def __init__(self, system: HybridSystem, mode: Mode, p: Sequence[Any], r: Sequence[Any]) -> None:
        self.system, self.mode, self.n = system, mode, system.n_z + 1
        self._constants = (p, r)

    @cached_property
    def low(self) -> "Field":
        """The same with polynomials of low degree."""
        return self._truncated(LOW_DEGREE)

    @cached_property
    def hull(self) -> "Field":
        """The same for all values of the parameter at once."""
        return self._truncated(0)

    @cached_property
    def rate(self) -> Graph:
        """y -> dy/dt."""
        return self._graph("rate")

    @cached_property
    def jacobian(self) -> Graph:
        """y -> d(dy/dt)/dy, columns one after the other."""
        return self._graph("jacobian")

    @cached_property
    def margins(self) -> Graph:
        """y -> margins of the mode in the order of ``margin_names``."""
        return self._graph("margins")

    @cached_property
    def margin_gradients(self) -> Graph:
        """y -> derivatives of the margins, columns one after the other."""
        return self._graph("gradients")

    @cached_property
    def observation(self) -> Graph:
        """y -> |f_t / f_n| without its modulus, and the power of all motors."""
        return self._graph("observation")

    def _truncated(self, degree: int) -> "Field":
        p, r = self._constants
        return Field(self.system, self.mode, [truncated(value, degree) for value in p], r)

    def _graph(self, name: str) -> Graph:
        return Graph(_function(self.system, self.mode, name), self._constants)


@lru_cache(maxsize=256)
def _function(system: HybridSystem, mode: Mode, name: str) -> Function:
    n_z, arguments = (
        system.n_z,
        [SX.sym("y", system.n_z + 1), SX.sym("p", len(system.parameters)), SX.sym("r", system.n_r)],
    )
    y, p, r = arguments
    of_state = (y[n_z], y[:n_z], p, r)
    if name in ("rate", "jacobian"):
        expression = vertcat(system.flow(mode)(*of_state), 1)
    elif name in ("margins", "gradients"):
        expression = system.margins(mode)(*of_state)
    else:
        force, _, power, *_ = system.observation(mode)(*of_state)
        expression = vertcat(force[0] / force[1], sum1(power))
    if name in ("jacobian", "gradients"):
        expression = jacobian(expression, y)
    return Function(name, arguments, cse([expression]))
