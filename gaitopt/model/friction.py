"""Friction between a foot and the ground: what holds a sticking foot, and what a slipping foot feels.

    sticking    |f_t| <= mu_s f_n
    slipping    f_t = -s mu_k f_n - c dx,    s = sgn dx

A sticking impact has the same cone for its impulses, a slipping impact F_t = -s mu_k F_n: drag has no effect within an
instant. Where mu_s > mu_k the force jumps when a foot begins to slip, and sticking and slipping may both be
consistent; then the foot sticks. Gamus & Or (2013), eqs (4), (5) have mu_s = mu_k.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar


class Friction(ABC):
    """Base of the friction laws; ``c`` below are the law's own numbers, as floats or CasADi symbols.

    Class attributes
    ----------------
    parameters : dotted keys of the law's numbers.
    two_coefficients : whether static and kinetic friction may differ.
    """

    parameters: ClassVar[tuple[str, ...]]
    two_coefficients: ClassVar[bool] = False

    @abstractmethod
    def static(self, c: Any) -> Any:
        """Largest |f_t| / f_n of a sticking foot, and |F_t| / F_n of a sticking impact."""

    @abstractmethod
    def kinetic(self, c: Any) -> Any:
        """|f_t| / f_n of a slipping foot without drag, and |F_t| / F_n of a slipping impact."""

    def drag(self, c: Any, velocity: Any) -> Any:
        """Force against a slip besides that of ``kinetic`` [N]; zero at rest."""
        return 0.0


@dataclass(frozen=True, slots=True)
class CoulombFriction(Friction):
    """One coefficient mu for sticking and slipping."""

    parameters = ("friction",)

    def static(self, c: Any) -> Any:
        """The coefficient."""
        return c[0]

    def kinetic(self, c: Any) -> Any:
        """The coefficient."""
        return c[0]


@dataclass(frozen=True, slots=True)
class StaticKineticFriction(Friction):
    """Two coefficients, mu_s >= mu_k, and a viscous drag c of the slip [N s/m]."""

    parameters = ("friction.static", "friction.kinetic", "friction.viscous")
    two_coefficients = True

    def static(self, c: Any) -> Any:
        """mu_s."""
        return c[0]

    def kinetic(self, c: Any) -> Any:
        """mu_k."""
        return c[1]

    def drag(self, c: Any, velocity: Any) -> Any:
        """c dx."""
        return c[2] * velocity
