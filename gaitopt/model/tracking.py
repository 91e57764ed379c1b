"""PD control: each motor pulls a joint towards a reference.

u = -kp (theta - theta_r(t)) - kd (dtheta - dtheta_r(t))              Gamus & Or (2013), section V, gait III
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, ClassVar

from casadi import SX, vertcat, vertsplit
from pydantic import Field

from gaitopt.arrays import Array
from gaitopt.model.control import Control
from gaitopt.model.instant import Instant
from gaitopt.model.reference import BezierReference, Followed, Path, exchanged_points, faults_of_other
from gaitopt.model.units import Finite, Within
from gaitopt.model.walker import WalkerType


class ProportionalDerivative(Control):
    """PD tracking of a reference, a function of the time since the impact or of a phase variable.

    u = -kp (theta - theta_r) - kd (dtheta - dtheta_r)
    """

    type = "pd"
    jumps: ClassVar[bool] = True

    kp: Annotated[
        Finite,
        Field(ge=0, description="gain on the error of the angle [N m/rad, or N/m]"),
        Within(unit="torque", possible=(0, 1000), usual=(0, 30)),
    ]
    kd: Annotated[
        Finite,
        Field(ge=0, description="gain on the error of the rate [N m s/rad, or N s/m]"),
        Within(unit="damping", possible=(0, 100), usual=(0, 10)),
    ]
    reference: Annotated[Followed, Field(description="motion that the joints track")]
    other_reference: Annotated[
        BezierReference | None,
        Field(
            description="motion that they track in the second, fourth, ... step of a cycle; Bezier curves with the "
            "joints, degree and argument of those of the reference"
        ),
    ] = None

    @property
    def phase_variable(self) -> str:
        """The phase variable of the reference."""
        return self.reference.phase_variable

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which pieces of the reference meet."""
        return self.reference.motion().breakpoints

    @property
    def exchanged(self) -> Mapping[str, str]:
        """The control points of both references, if there are two."""
        return exchanged_points(self.reference, self.other_reference)

    @property
    def horizon(self) -> float:
        """Time since the impact at which the reference ends [s]."""
        return self.reference.motion().horizon

    def data(self, segment: int) -> Array:
        """The numbers of the piece of the reference in this segment."""
        return self.reference.motion().data(segment)

    def faults(self, walker: WalkerType) -> Iterator[tuple[Path, str]]:
        """Faults of every law, and motors without a joint."""
        yield from super().faults(walker)
        yield from faults_of_other(self.reference, self.other_reference)
        if len(walker.tracked) != len(walker.actuators):
            yield (
                ("type",),
                f"{walker.model} does not define `tracked`, the joint of each motor: choose another control law",
            )

    def quantities(self, now: Instant) -> Mapping[str, SX]:
        """Errors theta - theta_r of the joints that follow the reference, in their order."""
        curve = self.reference.motion()
        angles, _ = _angles(now, curve.names)
        target, active = curve.weighted(now, now.p.reference, (1, 0))
        return {"outputs": active * (angles - target)}

    def torques(self, now: Instant) -> Mapping[str, SX]:
        """Feedback on the error of each tracked joint."""
        kp, kd, walker = now.p.kp, now.p.kd, now.robot.walker
        curve, motor = self.reference.motion(), dict(zip(walker.tracked, walker.actuators, strict=True))
        angles, rates = _angles(now, curve.names)
        target, active = curve.weighted(now, now.p.reference, (kp, kd))
        u = -active * (kp * angles + kd * rates - target)
        return {motor[joint]: torque for joint, torque in zip(curve.names, vertsplit(u), strict=True)}


def _angles(now: Instant, joints: Sequence[str]) -> tuple[SX, SX]:
    """Angles and rates of shape coordinates, or of motors by their names; shape (n,) each."""
    robot = now.robot
    motors = dict(zip(robot.walker.actuators, robot.mechanism.motors, strict=False))
    rates = dict(zip(robot.walker.actuators, vertsplit(robot.E.T @ robot.dq), strict=False))
    return (
        vertcat(*(getattr(now.q, joint) if joint in robot.walker.shape else motors[joint] for joint in joints)),
        vertcat(*(getattr(now.dq, joint) if joint in robot.walker.shape else rates[joint] for joint in joints)),
    )
