"""Laws with a clock of their own, whose period is fixed: a force that alternates, and a joint that oscillates.

    alternating    u = first while t < T / 2, then second
    oscillating    u = kp (r - a) + kd (dr/dt - da/dt),    r = mean + amplitude sin(2 pi t / T)

a is the angle, or the length, on which an actuator acts. If a period ends a cycle (``gait: {section: clock}``), time
starts from zero there, which makes no difference; otherwise it starts from zero at the end of every step.
"""

from collections.abc import Iterator, Mapping
from math import pi
from typing import Annotated

import numpy as np
from casadi import SX, cos, sin
from pydantic import Field

from gaitopt.arrays import Array
from gaitopt.model.control import TORQUE, Control, Fixed, unknown_actuators
from gaitopt.model.instant import Instant
from gaitopt.model.reference import Path
from gaitopt.model.units import DURATION, Duration, Finite, Within
from gaitopt.model.walker import WalkerType

Values = dict[str, Finite]
Angles = dict[str, Annotated[Finite, Field(ge=-100, le=100)]]
KP = Within(unit="torque", possible=(0, 1000), usual=(0, 100))
KD = Within(unit="damping", possible=(0, 1000), usual=(0, 100))
Period = Annotated[Duration, Fixed, Field(description="period T of the clock [s]"), DURATION]


class Alternating(Control):
    """Constant torques, or forces, of each half of a period."""

    type = "alternating"
    jumps = True

    cycle: Period
    first: Annotated[
        Values, Field(description="torque or force of each motor in the first half of the period [N m, or N]"), TORQUE
    ]
    second: Annotated[
        Values, Field(description="torque or force of each motor in the second half of the period [N m, or N]"), TORQUE
    ]

    @property
    def period(self) -> float:
        """Period of the clock [s]."""
        return self.cycle

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The middle of the period."""
        return (self.cycle / 2,)

    @property
    def horizon(self) -> float:
        """The end of the period."""
        return self.cycle

    def data(self, segment: int) -> Array:
        """A number that is 1 in the first half and 0 in the second one."""
        return np.array([1.0 - segment])

    def faults(self, walker: WalkerType) -> Iterator[tuple[Path, str]]:
        """Faults of every law, and halves that name no actuators."""
        yield from super().faults(walker)
        yield from unknown_actuators(walker, first=self.first, second=self.second)

    def torques(self, now: Instant) -> Mapping[str, SX]:
        """The parameters of the half."""
        first, second = vars(now.p.first), vars(now.p.second)
        return {
            name: now.r[0] * first.get(name, SX(0)) + (1 - now.r[0]) * second.get(name, SX(0))
            for name in now.robot.walker.actuators
        }


class Oscillating(Control):
    """PD tracking of a sine by every actuator."""

    type = "oscillating"

    cycle: Period
    kp: Annotated[Finite, Field(ge=0, description="gain on the angle or length of each motor [N m/rad, or N/m]"), KP]
    kd: Annotated[Finite, Field(ge=0, description="gain on its rate [N m s/rad, or N s/m]"), KD]
    mean: Annotated[Angles, Field(description="mean value of the sine of each motor [rad, or m]")]
    amplitude: Annotated[Angles, Field(description="amplitude of the sine of each motor [rad, or m]")]

    @property
    def period(self) -> float:
        """Period of the clock [s]."""
        return self.cycle

    def faults(self, walker: WalkerType) -> Iterator[tuple[Path, str]]:
        """Faults of every law, and sines that are not those of actuators."""
        yield from super().faults(walker)
        yield from unknown_actuators(walker, mean=self.mean, amplitude=self.amplitude)

    def torques(self, now: Instant) -> Mapping[str, SX]:
        """Feedback on the error of each actuator's angle."""
        robot, mean, amplitude = now.robot, vars(now.p.mean), vars(now.p.amplitude)
        torques, omega, rates = dict[str, SX](), 2 * pi / self.cycle, robot.E.T @ robot.dq
        for k, (name, angle) in enumerate(zip(robot.walker.actuators, robot.mechanism.motors, strict=True)):
            size = amplitude.get(name, SX(0))
            error = mean.get(name, SX(0)) + size * sin(omega * now.t) - angle
            rate = size * omega * cos(omega * now.t) - rates[k]
            torques[name] = now.p.kp * error + now.p.kd * rate
        return torques
