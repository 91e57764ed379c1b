"""Controlled symmetries: the motors have the effect of gravity on another slope.

    E u = G(q; g) - G(q; g_v),        g_v = |g| (sin alpha, -cos alpha)        Spong and Bullo (2005), IEEE TAC 50(7)

With one motor per coordinate of the shape, a walker whose foot sticks then moves like a passive one on the virtual
slope alpha: period and multipliers are the same. The contact force differs by m (g_v - g), so that the foot slips in
other states.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated

from casadi import SX, solve, vertsplit
from pydantic import Field

from gaitopt.model.control import Control
from gaitopt.model.instant import Instant
from gaitopt.model.mechanism import inclined
from gaitopt.model.reference import Path
from gaitopt.model.units import Slope
from gaitopt.model.walker import WalkerType


class ControlledSymmetry(Control):
    """Torques with which a walker moves as on another slope, while its foot sticks."""

    type = "controlled_symmetry"

    virtual_slope: Annotated[Slope, Field(description="slope that the motors imitate [rad]")]

    def faults(self, walker: WalkerType) -> Iterator[tuple[Path, str]]:
        """Faults of every law, and coordinates of the shape without a motor."""
        yield from super().faults(walker)
        if len(walker.actuators) != len(walker.shape):
            motors = f"{walker.model} has {', '.join(walker.actuators) or 'no motors'}"
            yield ("type",), f"{self.type} needs one motor for each of {', '.join(walker.shape)}, but {motors}"

    def torques(self, now: Instant) -> Mapping[str, SX]:
        """The solution of the equation above in the shape coordinates."""
        robot, n = now.robot, len(now.robot.walker.shape)
        virtual = inclined(robot.gravity, now.p.virtual_slope)
        missing = robot.gravity_force(robot.mechanism.gravity - virtual)
        return dict(zip(robot.walker.actuators, vertsplit(solve(robot.E[:n, :], missing[:n])), strict=True))
