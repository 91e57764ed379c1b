"""A theorem about a gait or a family of gaits: its claims, its bounds, and whether all of it is proved."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from typing import Any

from flint import acb, arb, arb_mat

from gaitopt.proof.claims import Claim
from gaitopt.proof.orbit import Box
from gaitopt.proof.outward import complex_interval, interval, precision
from gaitopt.proof.taylor import PRECISION

STABILITY = "stability"


@dataclass(frozen=True, slots=True)
class Piece:
    """What is proved on one box.

    Attributes
    ----------
    outer : the box in which the orbit is unique.
    interval : ends of the parameter that varies, as texts.
    image : of the box under Krawczyk's operator, also where that proves nothing.
    inner : the image as the box that holds the orbit; None, and nothing after the claims, where something could not
        be computed.
    derivatives : of the return map, on parts of the interval.
    multipliers : largest modulus first.
    """

    outer: Box
    interval: Sequence[str]
    image: Box | None = None
    inner: Box | None = None
    claims: tuple[Claim, ...] = ()
    state: Mapping[str, arb] | None = None
    durations: tuple[arb, ...] = ()
    measures: Mapping[str, arb | None] | None = None
    derivatives: Sequence[arb_mat] = ()
    multipliers: tuple[acb, ...] = ()


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
    multipliers : largest modulus first; none for a bracket of a special point.
    certificate : the certificate itself.
    statement : what the theorem is about, and what it does not say; empty where that could not be rebuilt.
    """

    problem: str
    claims: tuple[Claim, ...]
    certificate: Mapping[str, Any]
    statement: Mapping[str, Any] = field(default_factory=dict)
    state: Mapping[str, arb] | None = None
    durations: tuple[arb, ...] = ()
    measures: Mapping[str, arb | None] | None = None
    multipliers: tuple[acb, ...] = ()

    def about(self, pieces: Sequence[Piece]) -> "Proof":
        """The same theorem with the bounds of all orbits of some boxes."""
        if not pieces or any(piece.inner is None for piece in pieces):
            return self
        states, values = [piece.state or {} for piece in pieces], [piece.measures or {} for piece in pieces]
        return replace(
            self,
            state={key: _union([state[key] for state in states]) for key in states[0]},
            durations=tuple(map(_union, zip(*(piece.durations for piece in pieces), strict=True))),
            measures={key: _union([measures[key] for measures in values]) for key in values[0]},
            multipliers=union_of_multipliers(piece.multipliers for piece in pieces if piece.multipliers),
        )

    def __repr__(self) -> str:
        stability = {True: ", stable", False: ", unstable", None: ""}[self.stable]
        proved = sum(claim.proved for claim in self.claims)
        return f"<Proof about {self.problem}: {proved} of {len(self.claims)} claims proved{stability}>"

    @property
    def proved(self) -> bool:
        """Whether every claim is, and there are claims."""
        return bool(self.claims) and all(claim.proved for claim in self.claims)

    @cached_property
    def spectral_radius(self) -> arb | None:
        """Largest modulus of a multiplier."""
        if not self.multipliers:
            return None
        with precision(PRECISION):
            moduli = [abs(multiplier) for multiplier in self.multipliers]
            return max(modulus.lower() for modulus in moduli).union(max(modulus.upper() for modulus in moduli))

    @property
    def stable(self) -> bool | None:
        """Whether the gait is stable, None where that is not decided."""
        radius = self.spectral_radius
        return True if radius is not None and radius < 1 else False if radius is not None and radius > 1 else None

    def _family(self) -> dict[str, Any]:
        """Parameter and interval of a family, and the type of the special point in it."""
        varied = self.certificate.get("varied")
        if varied is None or not self.statement:
            return {}
        interval = self.statement["parameters"][varied]
        return {"parameter": varied, "interval": interval, "special": self.certificate["special"]}

    def stability_claim(self) -> Claim:
        """That the gait is stable, or that it is unstable."""
        verdict = {True: "stable", False: "unstable", None: "whether it is stable is not shown"}[self.stable]
        words = f"{verdict}: the largest modulus of a multiplier is {self.spectral_radius}"
        return Claim(STABILITY, proved=self.stable is not None, words=words)

    def to_record(self) -> dict[str, Any]:
        """One JSON object; bounds are decimal strings rounded outward."""
        values = {name: _bounds(value) for name, value in (self.measures or {}).items()}
        radius = self.spectral_radius
        return {
            "problem": self.problem,
            "proved": self.proved,
            **self._family(),
            "statement": dict(self.statement),
            "state": None if self.state is None else {name: interval(value) for name, value in self.state.items()},
            "durations": [interval(value) for value in self.durations],
            "period": None,
            **values,
            "multipliers": [complex_interval(value) for value in self.multipliers],
            "spectral_radius": None if radius is None else interval(radius),
            "stable": self.stable,
            "claims": [_claim_record(claim) for claim in self.claims],
        }


def _bounds(value: arb | None) -> list[str] | None:
    """A measure as an interval; None where it is not defined, or may be infinite."""
    return interval(value) if value is not None and value.is_finite() else None


def _claim_record(claim: Claim) -> dict[str, Any]:
    margin = None if claim.margin is None else interval(claim.margin)[0]
    return {"claim": claim.name, "proved": claim.proved, "words": claim.words, "margin": margin}


def merged_claims(pieces: Sequence[Piece]) -> Iterator[Claim]:
    """The claims of all boxes: one that fails in a box fails, and of margins the smallest counts."""
    by_name: dict[str, list[Claim]] = {}
    for piece in pieces:
        for claim in piece.claims:
            by_name.setdefault(claim.name, []).append(claim)
    for name, claims in by_name.items():
        worst = min(claims, key=lambda claim: claim.proved)
        margins = [claim.margin for claim in claims if claim.margin is not None]
        words = worst.words if len(claims) == 1 or not worst.proved else f"in {len(claims)} boxes; first: {worst.words}"
        yield Claim(name, worst.proved, words, min(margins) if margins and worst.proved else None)


def _union(values: Sequence[Any]) -> Any:
    return None if None in values else reduce(arb.union, values)


def union_of_multipliers(parts: Iterable[Sequence[acb]]) -> tuple[acb, ...]:
    """Bounds of multipliers, largest modulus first, over the parts of a family."""
    return tuple(map(union, zip(*parts, strict=True)))


def union(values: Iterable[acb]) -> acb:
    """A box around complex boxes."""
    every = list(values)
    return acb(_union([value.real for value in every]), _union([value.imag for value in every]))
