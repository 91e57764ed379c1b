"""A control law of one's own, a walker whose damper does the same as the law, and one with a section in mid-stride."""

from dataclasses import replace
from typing import Annotated, Any

from casadi import SX
from pydantic import Field

from gaitopt.model.control import Control
from gaitopt.model.instant import Instant
from gaitopt.model.mechanism import Damper, Mechanism
from gaitopt.model.units import TurningDamping
from gaitopt.model.walkers.compass_biped import CompassBiped


class HipDamper(Control):
    """The hip motor brakes like a viscous damper between the legs."""

    type = "hip_damper"

    damping: Annotated[TurningDamping, Field(description="torque per rate of the hip [N m s/rad]")] = 0.01

    def torques(self, now: Instant) -> dict[str, SX]:
        """Against the rate of the angle between the legs."""
        return {"hip": -now.p.damping * (now.dq.theta1 + now.dq.theta2)}


class DampedCompass(CompassBiped):
    """A passive compass with a damper in its hip."""

    model = "damped_compass"

    damping: TurningDamping = 0.01

    @classmethod
    def mechanism(cls, q: Any, p: Any) -> Mechanism:
        """The compass with a damper between the legs."""
        damper = Damper(coefficient=p.damping, across=q.theta1 + q.theta2)
        return replace(super().mechanism(q, p), dampers=(damper,))


class MidCompass(CompassBiped):
    """The compass, with a margin that falls to zero where the stance leg is normal to the slope."""

    model = "mid_compass"
    sections = ("middle",)

    @classmethod
    def mechanism(cls, q: Any, p: Any) -> Mechanism:
        """That of the compass."""
        return replace(super().mechanism(q, p), sections={"middle": lambda dq: -q.theta1})
