"""One mode on one segment of the control as an autonomous vector field with everything that is observed along it.

    dy/dt = F(y),   y = (z, t)  or  (z, t, s)

t, the time since the last impact, is a state like the others, so that events at fixed times and events of the state
are treated alike; so is s, a parameter that varies in a family of gaits: ds/dt = 0.
"""

from collections.abc import Sequence
from functools import cached_property

from casadi import SX, Function, cse, jacobian, sum1, vertcat
from flint import arb

from gaitopt.mechanics import HybridSystem, Mode
from gaitopt.proof.graph import Graph


class Field:
    """The flow of a mode, its Jacobian, and its margins, force and power, in balls.

    Parameters
    ----------
    p, r : parameters and segment data.
    varied : index in ``p`` of the parameter that is a state; its entry in ``p`` does not matter.
    """

    def __init__(
        self, system: HybridSystem, mode: Mode, p: Sequence[arb], r: Sequence[arb], varied: int | None = None
    ) -> None:
        self.system, self.mode = system, mode
        self.names = (*system.state_names, "t", *(() if varied is None else (system.parameters[varied],)))
        self.n = len(self.names)
        self._constants = (p, r)
        self._y = SX.sym("y", self.n)
        self._p, self._r = SX.sym("p", len(p)), SX.sym("r", len(r))
        z, t, s = self._y[: system.n_z], self._y[system.n_z], self._y[system.n_z + 1 :]
        self._arguments = (t, z, with_entry(self._p, varied, s), self._r)

    @cached_property
    def rate(self) -> Graph:
        """y -> dy/dt."""
        return self._graph("rate", self._rate)

    @cached_property
    def jacobian(self) -> Graph:
        """y -> d(dy/dt)/dy, columns one after the other."""
        return self._graph("jacobian", jacobian(self._rate, self._y))

    @cached_property
    def margins(self) -> Graph:
        """y -> margins of the mode in the order of ``margin_names``."""
        return self._graph("margins", self.system.margins(self.mode)(*self._arguments))

    @cached_property
    def margin_gradients(self) -> Graph:
        """y -> derivatives of the margins, columns one after the other."""
        return self._graph("gradients", jacobian(self.system.margins(self.mode)(*self._arguments), self._y))

    @cached_property
    def observation(self) -> Graph:
        """y -> |f_t / f_n| without its modulus, and the power of all motors."""
        force, _, power, *_ = self.system.observation(self.mode)(*self._arguments)
        return self._graph("observation", vertcat(force[0] / force[1], sum1(power)))

    @cached_property
    def _rate(self) -> SX:
        return vertcat(self.system.flow(self.mode)(*self._arguments), 1, SX.zeros(self.n - self.system.n_z - 1))

    def _graph(self, name: str, expression: SX) -> Graph:
        arguments = [self._y, self._p, self._r]
        return Graph(Function(name, arguments, cse([expression])), self._constants)


def with_entry(p: SX, index: int | None, value: SX) -> SX:
    """``p`` with one entry replaced, if there is one."""
    return p if index is None else vertcat(p[:index], value, p[index + 1 :])
