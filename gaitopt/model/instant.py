"""The input of a control law and its curves at one instant, in CasADi symbols."""

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace

from casadi import SX

from gaitopt.model.lagrangian import EquationsOfMotion


@dataclass(frozen=True, slots=True, kw_only=True)
class Instant:
    """Input of a control law at one instant, in CasADi symbols.

    Attributes
    ----------
    t : SX - time since the last impact, or since the start of the cycle if contacts are named [s].
    q, dq : coordinates and rates by name: the shape, x and y [rad, m, rad/s, m/s]. On the ground y = dy = 0.
    s, ds : phase variables of the walker and their rates by name; every shape coordinate is one too.
    p : fields of the law by name. Parameters are symbols, in a mapping by key, ``p.limits.hip``, in a list as a column.
        All other fields, such as those annotated with ``Fixed``, have their values.
    r : SX, shape (n_r,) - segment data.
    robot : equations of motion of the walker: M, B, G, E, W_swing, mechanism, ``parameters`` by name.
    """

    t: SX
    q: SimpleNamespace
    dq: SimpleNamespace
    s: SimpleNamespace
    ds: SimpleNamespace
    p: SimpleNamespace
    r: SX
    robot: EquationsOfMotion
    _accelerations: Callable[[bool], tuple[SX, SX]] = field(repr=False)

    def accelerations(self, actual: bool = False) -> tuple[SX, SX]:
        """Shape accelerations as a function of the torques u, ddq = drift + response u.

        Parameters
        ----------
        actual : whether they are those in the mode of the phase; by default the stance foot is taken to stick.

        Returns
        -------
        drift : SX, shape (n_shape,) [rad/s^2]
        response : SX, shape (n_shape, n_u) [rad/(s^2 N m)]
        """
        return self._accelerations(actual)
