"""Control laws: joint torques u(t, q, dq) with t the time since the last impact.

A law is smooth between its breakpoints (fixed times since impact). On each segment between two breakpoints it
reads ``segment data`` r, so that one compiled function serves all of them.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from casadi import SX

from gaitopt.arrays import Array
from gaitopt.mechanics.control.reference import Reference, evaluate


class Control(ABC):
    """Base of the control laws; ``parameters`` are the scalars that may be set, freed or continued."""

    @property
    @abstractmethod
    def parameters(self) -> Mapping[str, float]:
        """Values of the law's scalars by their name in the problem file."""

    @property
    def unknowns(self) -> Mapping[str, tuple[float, float]]:
        """Bounds of those of ``parameters`` that only a design determines, not the problem file."""
        return {}

    @abstractmethod
    def torque(self, t: SX, angles: SX, rates: SX, p: SX, r: SX) -> SX:
        """Torques u of shape (n_u,) [N m].

        Parameters
        ----------
        t : SX - time since the last impact [s].
        angles, rates : SX, shape (n_u,) - tracked shape coordinates [rad] and rates [rad/s].
        p : SX - the law's scalars, in the order of ``parameters``.
        r : SX - segment data.
        """

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times since impact at which a segment ends and the next begins [s]."""
        return ()

    @property
    def horizon(self) -> float:
        """Time since impact up to which the law is defined [s]."""
        return np.inf

    def data(self, segment: int) -> Array:
        """Segment data r; always of the same length."""
        return np.zeros(0)


@dataclass(frozen=True, slots=True)
class NoControl(Control):
    """A passive walker: all torques are zero."""

    @property
    def parameters(self) -> Mapping[str, float]:
        """No scalars."""
        return {}

    def torque(self, t: SX, angles: SX, rates: SX, p: SX, r: SX) -> SX:
        """Zero."""
        return SX.zeros(angles.numel())


@dataclass(frozen=True, slots=True)
class ConstantTorque(Control):
    """Constant torques by actuator name, in the order of the walker's actuators [N m]."""

    torques: Mapping[str, float]

    @property
    def parameters(self) -> Mapping[str, float]:
        """The torques by actuator name."""
        return self.torques

    def torque(self, t: SX, angles: SX, rates: SX, p: SX, r: SX) -> SX:
        """The constants themselves."""
        return p


@dataclass(frozen=True, slots=True, kw_only=True)
class ProportionalDerivative(Control):
    """PD tracking of a reference with phase reset: u = -kp (theta - theta_r) - kd (dtheta - dtheta_r).

    Gamus & Or (2013), section V, gait III. The clock of the reference restarts at every impact.
    """

    kp: float
    kd: float
    reference: Reference

    @property
    def parameters(self) -> Mapping[str, float]:
        """The gains kp [N m/rad] and kd [N m s/rad]."""
        return {"kp": self.kp, "kd": self.kd}

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Kinks of the reference."""
        return self.reference.breakpoints

    @property
    def horizon(self) -> float:
        """End of the reference."""
        return self.reference.horizon

    def data(self, segment: int) -> Array:
        """The piece of the reference that holds in ``segment``."""
        return self.reference.data(segment)

    def torque(self, t: SX, angles: SX, rates: SX, p: SX, r: SX) -> SX:
        """Feedback on the error of each tracked joint."""
        target, active = evaluate(r, t, angles.numel(), self.reference.degree, (p[0], p[1]))
        return -active * (p[0] * angles + p[1] * rates - target)
