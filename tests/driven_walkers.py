"""Walkers of the package with motors, which the named problems do not have."""

from dataclasses import replace
from types import SimpleNamespace

from gaitopt.model.mechanism import Mechanism
from gaitopt.model.walkers.heel_toe import HeelToe
from gaitopt.model.walkers.hopper import Hopper


class DrivenHopper(Hopper):
    """The hopper with a motor in its leg."""

    model = "driven_hopper"
    actuators = ("leg_motor",)
    tracked = ("shortening",)

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return replace(super().mechanism(q, p), motors=(q.shortening,))


class DrivenHeelToe(HeelToe):
    """The walker on heels and toes with motors at the stance ankle and at the hip."""

    model = "driven_heel_toe"
    actuators = ("ankle", "hip")
    tracked = ("theta1", "theta2")

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return replace(super().mechanism(q, p), motors=(q.theta1, q.theta1 + q.theta2))
