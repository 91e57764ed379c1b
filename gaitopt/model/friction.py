"""Friction between a foot and the ground: the force that holds a sticking foot, and the force on a slipping foot.

    sticking    |f_t| <= mu_s f_n
    slipping    f_t = -s mu_k f_n - c dx,    s = sgn dx

A sticking impact has the same cone for its impulses, a slipping impact F_t = -s mu_k F_n: drag has no effect within an
instant. If mu_s > mu_k, the force jumps when a foot begins to slip, and sticking and slipping may both be consistent;
then the foot sticks. Gamus & Or (2013), eqs (4), (5) have mu_s = mu_k and c = 0.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from gaitopt.model.modes import FOOT


@dataclass(frozen=True, slots=True)
class Friction:
    """The dotted keys of the coefficients mu_s, mu_k and c [N s/m].

    Motions, impacts and margins always have all three coefficients; only ``coefficients`` knows how they are written.
    Parameters hold each written number once, so that a derivative by a dotted key is one column. Three entries in all
    cases would give the same numbers in the same time, but every such derivative would be a sum of columns, and the
    equations would still depend on ``may_drop``: where mu_s and mu_k are one number, a slip from rest begins with no
    acceleration, and its velocity has a zero of second order instead of first.

    Attributes
    ----------
    static, kinetic : keys of mu_s >= mu_k; the same key if one number is both.
    viscous : key of c; None if there is no drag.
    """

    static: str
    kinetic: str
    viscous: str | None = None

    @property
    def parameters(self) -> tuple[str, ...]:
        """The keys in order, each once."""
        keys = (self.static, self.kinetic, self.viscous)
        return tuple(dict.fromkeys(key for key in keys if key is not None))

    @property
    def may_drop(self) -> bool:
        """Whether friction may drop when a foot begins to slip, because mu_s and mu_k are different parameters."""
        return self.static != self.kinetic

    def coefficients(self, values: Any) -> tuple[Any, Any, Any]:
        """(mu_s, mu_k, c) from the values of ``parameters``, as numbers or symbols."""
        by_key = {key: values[k] for k, key in enumerate(self.parameters)}
        return by_key[self.static], by_key[self.kinetic], 0.0 if self.viscous is None else by_key[self.viscous]

    def of(self, values: Any) -> dict[str, tuple[Any, Any, Any]]:
        """``coefficients`` by contact: those of the single foot."""
        return {FOOT: self.coefficients(values)}

    def exchanged(self, partners: Mapping[str, str]) -> tuple[int, ...]:
        """Indices of the parameters after feet have swapped places, which changes nothing: both have this law."""
        return tuple(range(len(self.parameters)))


@dataclass(frozen=True, slots=True)
class ContactFriction:
    """Friction of a walker with several contacts: a law of its own for each.

    Attributes
    ----------
    laws : (contact, law) in the order of the walker's contacts.
    of_ground : whether the numbers are those of the ground under each contact, so that they do not change when contacts
        swap places.
    """

    laws: tuple[tuple[str, Friction], ...]
    of_ground: bool = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """The keys of all laws in order, each once."""
        return tuple(dict.fromkeys(key for _, law in self.laws for key in law.parameters))

    @property
    def may_drop(self) -> bool:
        """Whether friction of a contact may drop when it begins to slip."""
        return any(law.may_drop for _, law in self.laws)

    def of(self, values: Any) -> dict[str, tuple[Any, Any, Any]]:
        """(mu_s, mu_k, c) of every contact from the values of ``parameters``, as numbers or symbols."""
        index = {key: k for k, key in enumerate(self.parameters)}
        return {name: law.coefficients([values[index[key]] for key in law.parameters]) for name, law in self.laws}

    def exchanged(self, partners: Mapping[str, str]) -> tuple[int, ...]:
        """Indices of the parameters after contacts have swapped places, when each contact has the law of its partner.

        Raises
        ------
        ValueError
            If a contact has one coefficient and its partner has several.
        """
        laws, keys = dict(self.laws), self.parameters
        if self.of_ground:
            return tuple(range(len(keys)))
        index = dict[str, int]()
        for name, law in self.laws:
            other = laws[partners.get(name, name)]
            if len(law.parameters) != len(other.parameters):
                raise ValueError(f"{name} and {partners[name]} swap places: give both one number, or both coefficients")
            index |= zip(law.parameters, map(keys.index, other.parameters), strict=True)
        return tuple(index[key] for key in keys)


def shared_friction(contacts: tuple[str, ...], law: Friction) -> "Friction | ContactFriction":
    """One law for all contacts of a walker, or for its foot if it names none."""
    return ContactFriction(tuple((name, law) for name in contacts)) if contacts else law


COULOMB = Friction("friction", "friction")
"""One coefficient for sticking and slipping."""
STATIC_KINETIC = Friction("friction.static", "friction.kinetic", "friction.viscous")
"""Two coefficients and drag."""


class ImpactLaw(StrEnum):
    """Tangential impulse of a slipping impact: by Coulomb's law, eq. (11), or zero."""

    COULOMB = "coulomb"
    FRICTIONLESS = "frictionless"
