"""A theorem about a gait: its claims, its bounds, and whether all of it is proved."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from flint import acb, arb, ctx

from gaitopt.proof.claims import Claim
from gaitopt.proof.outward import complex_interval, interval
from gaitopt.proof.taylor import PRECISION


@dataclass(frozen=True)
class Proof:
    """What a certificate proves.

    Attributes
    ----------
    problem : its name.
    claims : the theorem's statements; all of them have to be proved.
    state : boxes of the state just after the impact, by name.
    durations : of the phases [s].
    measures : by name.
    multipliers : largest modulus first.
    certificate : the certificate itself.
    """

    problem: str
    claims: tuple[Claim, ...]
    certificate: Mapping[str, Any]
    state: Mapping[str, arb] | None = None
    durations: tuple[arb, ...] = ()
    measures: Mapping[str, arb | None] | None = None
    multipliers: tuple[acb, ...] = ()

    @property
    def proved(self) -> bool:
        """Whether every claim is."""
        return all(claim.proved for claim in self.claims)

    @cached_property
    def spectral_radius(self) -> arb | None:
        """Largest modulus of a multiplier."""
        if not self.multipliers:
            return None
        with ctx.workprec(PRECISION):
            moduli = [abs(multiplier) for multiplier in self.multipliers]
            return max(modulus.lower() for modulus in moduli).union(max(modulus.upper() for modulus in moduli))

    @property
    def stable(self) -> bool | None:
        """Whether the gait is stable, None where that is not decided."""
        radius = self.spectral_radius
        return True if radius is not None and radius < 1 else False if radius is not None and radius > 1 else None

    def to_record(self) -> dict[str, Any]:
        """One JSON object; bounds are decimal strings rounded outward."""
        values = {name: None if value is None else interval(value) for name, value in (self.measures or {}).items()}
        radius = self.spectral_radius
        return {
            "problem": self.problem,
            "proved": self.proved,
            "state": None if self.state is None else {name: interval(value) for name, value in self.state.items()},
            "durations": [interval(value) for value in self.durations],
            "period": None,
            **values,
            "multipliers": [complex_interval(value) for value in self.multipliers],
            "spectral_radius": None if radius is None else interval(radius),
            "stable": self.stable,
            "claims": [_claim_record(claim) for claim in self.claims],
        }


def _claim_record(claim: Claim) -> dict[str, Any]:
    margin = None if claim.margin is None else interval(claim.margin)[0]
    return {"claim": claim.name, "proved": claim.proved, "words": claim.words, "margin": margin}
