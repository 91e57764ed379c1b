"""Natural units of a walker, in which every tolerance, time limit and step length is stated.

    length l,      time sqrt(l / g),      mass m,      force m g,      speed sqrt(g l)

l is the distance from the stance foot to the farthest body with all shape coordinates zero: the length of a
straight leg. Dimensionless results then do not depend on the units in which a problem is stated.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Scales:
    """Natural units of one walker at given parameters.

    Attributes
    ----------
    length : [m]; time : [s]; mass : [kg].
    """

    length: float
    time: float
    mass: float

    @property
    def speed(self) -> float:
        """Length per time, sqrt(g l) [m/s]."""
        return self.length / self.time

    @property
    def force(self) -> float:
        """The weight m g [N]."""
        return self.mass * self.length / self.time**2

    @property
    def impulse(self) -> float:
        """Force times time [N s]."""
        return self.force * self.time

    @property
    def energy(self) -> float:
        """Weight times length, also the unit of torque [J]."""
        return self.force * self.length
