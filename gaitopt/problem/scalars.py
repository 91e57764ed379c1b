"""Scalars of a gait that an objective or a constraint may name: what they mean, and what they can be.

Of the ranges that are no matter of sign: feet are never farther apart than twice the leg length l, and what a foot
slips in one step is held to the same; over a period the ground carries the weight m g on average.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

from gaitopt.mechanics.ranges import Interval, Within, symmetric

POSITIVE: Interval = (0, inf)


@dataclass(frozen=True, slots=True)
class Scalar:
    """One scalar: its meaning with its unit, and its range."""

    meaning: str
    within: Within


SCALARS: Mapping[str, Scalar] = {
    "period": Scalar("time of one step [s]", Within(unit="time", possible=(1e-6, 1000), usual=(0.1, 50))),
    "step_length": Scalar(
        "distance of two footprints, slip included [m]", Within(unit="length", possible=symmetric(4))
    ),
    "speed": Scalar("step length per period [m/s]", Within(unit="speed", possible=symmetric(100), usual=symmetric(2))),
    "work": Scalar("net work of the motors [J]", Within(unit="torque", possible=symmetric(1e4), usual=symmetric(10))),
    "cost_of_transport": Scalar(
        "work per weight and step length", Within(possible=symmetric(1e6), usual=symmetric(10))
    ),
    "absolute_cost_of_transport": Scalar(
        "integral of |power| of each motor per weight and step length", Within(possible=(0, 1e6), usual=(0, 10))
    ),
    "torque_squared": Scalar(
        "integral of the squares of the torques [N^2 m^2 s]", Within(unit="torque_squared", possible=POSITIVE)
    ),
    "peak_torque": Scalar("largest torque [N m]", Within(unit="torque", possible=POSITIVE, usual=(0, 10))),
    "slip_distance": Scalar("path of the sliding foot [m]", Within(unit="length", possible=(0, 2))),
    "foot_clearance": Scalar(
        "largest height of the swing foot after mid-swing [m]", Within(unit="length", possible=symmetric(2))
    ),
    "spectral_radius": Scalar("largest modulus of the Floquet multipliers", Within(possible=POSITIVE)),
    "required_friction": Scalar("largest |f_t|/f_n while sticking", Within(possible=(0, 1000), usual=(0, 3))),
    "impulse_ratio": Scalar("|F_t|/F_n of an impact that sticks", Within(possible=POSITIVE)),
    "min_normal_force": Scalar("smallest normal force [N]", Within(unit="force", possible=(0, 1))),
}
"""By the names of the result."""
RESULT_SCALARS = tuple(SCALARS)
TORQUE_SCALARS = ("work", "cost_of_transport", "absolute_cost_of_transport", "torque_squared", "peak_torque")
PUSH_SCALARS = TORQUE_SCALARS[:3]
"""Of motors, and of a push-off."""
SLIPLESS_STEP = Within(unit="length", possible=symmetric(2))
"""Of the step length where the foot never slips."""
