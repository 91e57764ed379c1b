"""Where a walk along a family stops."""

from dataclasses import dataclass

from gaitopt.families.request import Request

LARGEST_LENGTH = 0.025
"""Arclength is scaled so that the range of the parameter has length one: at least forty points for it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """A request, and the range of the parameter in which one of its walks stays."""

    request: Request
    lower: float
    upper: float

    def crossed(self, before: float, after: float) -> float | None:
        """The bound that a step of the parameter reaches or passes."""
        if after >= self.upper > before:
            return self.upper
        return self.lower if after <= self.lower < before else None

    def reached(self, value: float) -> str | None:
        """Why a walk ends at a value, if that is a bound."""
        if self.lower < value < self.upper:
            return None
        return f"reached {self.request.parameter} = {self.lower if value <= self.lower else self.upper:.12g}"

    def exhausted(self, points: int, seconds: float) -> str | None:
        """Why a walk of so many points pauses after so long, if it does."""
        return self.request.exhausted(points, seconds)
