"""Labels on axes and pages: the words of ``problem.scalars`` with symbols and typeset units."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import degrees
from typing import Any

from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import FRICTION_LABELS, SCALARS, label_of, unit_of
from gaitopt.problem.source import parse_source


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """How a quantity is written."""

    words: str
    unit: str = ""

    def __str__(self) -> str:
        return f"{self.words} [{self.unit}]" if self.unit else self.words


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """The parameter of a branch as figures and pages show it: in degrees where the problem's file gives degrees."""

    key: str
    in_degrees: bool = False

    @property
    def label(self) -> Label:
        """Its label with the unit in which it is shown."""
        return replace(label(self.key), unit="°") if self.in_degrees else label(self.key)

    def shown(self, records: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        """Points and special points with their ``value`` in this unit."""
        if not self.in_degrees:
            return list(records)
        return [{**r, "value": degrees(r["value"])} if r.get("value") is not None else r for r in records]


def parameter_of(problem: Problem, key: str) -> Parameter:
    """How the continued parameter of a problem is shown."""
    value: Any = parse_source(problem.text, problem.name).data if problem.text else None
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return Parameter(key=key, in_degrees=isinstance(value, str) and value.rstrip().endswith("deg"))


SYMBOLS = {"spectral_radius": "|λ|", "friction": "μ"}

_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def symbol(state: str) -> str:
    """A state's name as it is written: ``dtheta1`` becomes θ̇₁."""
    rate = state.startswith("d") and len(state) > 1
    name = state[1:] if rate else state
    stem = name.rstrip("0123456789")
    greek = {"theta": "θ", "phi": "φ", "psi": "ψ", "alpha": "α"}.get(stem, stem)
    written = greek + name[len(stem) :].translate(_SUBSCRIPTS)
    if not rate:
        return written
    return written[0] + "\u0307" + written[1:] if len(greek) == 1 else f"rate of {written}"


def label(key: str) -> Label:
    """Label of a scalar, a state or a parameter by its key; what is unknown keeps its key."""
    if key == "time":
        return Label(words="time since impact", unit="s")
    if key in SCALARS or key in FRICTION_LABELS:
        return Label(words=f"{label_of(key)} {SYMBOLS.get(key, '')}".rstrip(), unit=typeset(unit_of(key)))
    last, unit = key.rpartition(".")[2], unit_of(key)
    words = last.replace("_", " ")
    return Label(words=f"{words} torque" if unit == "N m" else words, unit=typeset(unit))


def typeset(unit: str) -> str:
    """A unit with raised exponents."""
    return unit.replace("^2", "²")
