"""One mode on one segment of the control as an autonomous vector field with everything that is observed along it.

    dy/dt = F(y),   y = (z, t)      or  y = (z, t, mu),  dmu/dt = 0

t, the time since the last impact, is a state like the others, so that events at fixed times and events of the state
are treated alike; and so is a parameter that varies, so that derivatives in it are derivatives in the state.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

from casadi import SX, Function, cse, jacobian, sum1, vertcat
from flint import arb

from gaitopt.mechanics import HybridSystem, Mode, margin_names
from gaitopt.proof.graph import Graph


@dataclass(frozen=True, slots=True)
class States:
    """The states y of a system in the steps of one side.

    Attributes
    ----------
    varied : index of the parameter that is a state, if one is.
    side : which leg stands, see ``Walker.side``.
    """

    system: HybridSystem
    varied: int | None
    side: int

    @property
    def n(self) -> int:
        """Their number."""
        return self.system.n_z + 1 + (self.varied is not None)

    def symbols(self) -> tuple[SX, SX, SX]:
        """y, p, and the parameters of this side, with the one that varies taken from y."""
        y, p = SX.sym("y", self.n), SX.sym("p", len(self.system.parameters))
        return y, p, self.side_of(y, p, self.side)

    def side_of(self, y: SX, p: SX, side: int) -> SX:
        """The parameters of a side."""
        values = vertcat(*(y[-1] if k == self.varied else p[k] for k in range(p.numel())))
        return self.system.walker.standing(values, side)


class Field:
    """The flow of a mode, its Jacobian, and its margins, force and power, in balls.

    Parameters
    ----------
    states : in which the field lives.
    p, r : parameters and segment data.
    """

    def __init__(self, states: States, mode: Mode, p: Sequence[arb], r: Sequence[arb]) -> None:
        self.mode, self.n = mode, states.n
        self._states, self._constants = states, (p, r)

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
    def apparent_masses(self) -> Graph:
        """y -> apparent mass of the foot if it slipped forward, and if it slipped backward."""
        return self._graph("apparent_masses")

    @cached_property
    def observation(self) -> Graph:
        """y -> contact force f_t, f_n, and the power of all motors."""
        return self._graph("observation")

    def _graph(self, name: str) -> Graph:
        return Graph(_function(self._states, self.mode, name), self._constants)


@lru_cache(maxsize=256)
def _function(states: States, mode: Mode, name: str) -> Function:
    system, r = states.system, SX.sym("r", states.system.n_r)
    y, p, values = states.symbols()
    of_state = (y[system.n_z], y[: system.n_z], values, r)
    if name in ("rate", "jacobian"):
        expression = vertcat(system.flow(mode)(*of_state), 1, SX.zeros(int(states.varied is not None)))
    elif name == "margins":
        expression = system.margins(mode)(*of_state)
    elif name == "apparent_masses":
        slips = (Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD)
        expression = vertcat(*(system.margins(slip)(*of_state)[margin_names(slip).index("painleve")] for slip in slips))
    else:
        force, _, power, *_ = system.observation(mode)(*of_state)
        expression = vertcat(force, sum1(power))
    if name == "jacobian":
        expression = jacobian(expression, y)
    return Function(name, [y, p, r], cse([expression]))
