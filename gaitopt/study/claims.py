"""A claim about a gait: the figure that was measured, the tolerance it must keep, and whether it does.

Figures are dimensionless: errors in the natural units of the walker (``mechanics.scales``).
"""

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from gaitopt.display import Tabulated


class Outcome(StrEnum):
    """How the examination of a claim ended; only ``holds`` is a pass."""

    HOLDS = "holds"
    FAILS = "fails"
    NOT_EXAMINED = "not_examined"
    NO_LINEAR_RANGE = "no_linear_range"


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """One statement about a gait, the figure that was measured for it, and the tolerance it must keep.

    Attributes
    ----------
    name : what was examined.
    figure, tolerance : the error that was measured, infinite if none could be, and its limit.
    passed : whether the claim holds.
    note : what the figure measures, or why there is none.
    outcome : ``holds``, ``fails``, ``not_examined`` (the motion to be examined does not exist) or ``no_linear_range``
        (rounding and curvature leave no deviation from which a derivative could be judged).
    """

    name: str
    figure: float
    tolerance: float
    passed: bool
    note: str = ""
    outcome: Outcome = Outcome.HOLDS


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification(Tabulated):
    """All claims about one gait."""

    claims: tuple[Claim, ...]

    def __repr__(self) -> str:
        failed = [claim.name for claim in self.claims if not claim.passed]
        words = f"FAILED: {', '.join(failed)}" if failed else "passed"
        return f"<Verification: {len(self.claims)} claims, {words}>"

    @property
    def passed(self) -> bool:
        """Whether every claim holds."""
        return all(claim.passed for claim in self.claims)

    def figure(self, name: str) -> float | None:
        """Figure of one claim, or None if it could not be examined."""
        return next((claim.figure for claim in self.claims if claim.name == name and np.isfinite(claim.figure)), None)

    def to_record(self) -> dict[str, Any]:
        """JSON-able record with the keys of the command line."""
        sequence = next(claim for claim in self.claims if claim.name == "mode sequence")
        return {
            "passed": self.passed,
            "period_error": self.figure("period"),
            "state_error": self.figure("state"),
            "multiplier_error": self.figure("multipliers"),
            "mode_sequence_matches": sequence.passed,
            "claims": [_claim_record(c) for c in self.claims],
        }


def _claim_record(c: Claim) -> dict[str, Any]:
    return {**asdict(c), "figure": c.figure if np.isfinite(c.figure) else None, "outcome": str(c.outcome)}


def claim(name: str, figure: float, tolerance: float, note: str = "") -> Claim:
    """The claim that ``figure`` does not exceed ``tolerance``; it fails where the figure is no number."""
    passed = bool(figure <= tolerance)
    outcome = Outcome.HOLDS if passed else Outcome.FAILS
    return Claim(name=name, figure=float(figure), tolerance=tolerance, passed=passed, note=note, outcome=outcome)


def failed_claim(name: str, tolerance: float, note: str, outcome: Outcome = Outcome.NOT_EXAMINED) -> Claim:
    """A claim that could not be examined."""
    return Claim(name=name, figure=np.inf, tolerance=tolerance, passed=False, note=note, outcome=outcome)
