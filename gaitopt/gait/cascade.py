"""Cascades of period doublings in the records of a family, and the ratios of the distances between them.

    ratio_k = (p_k - p_{k-1}) / (p_{k+1} - p_k)  ->  4.669...

References
----------
M. J. Feigenbaum (1978), Quantitative universality for a class of nonlinear transformations.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

Record = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cascade:
    """Period doublings of which each lies on the family that begins at the one before.

    Attributes
    ----------
    n_steps : steps of the cycles whose period doubles.
    values : the parameter at each.
    """

    n_steps: tuple[int, ...]
    values: tuple[float, ...]

    @property
    def ratios(self) -> tuple[float, ...]:
        """Distance of neighbours over the next distance, one for every three doublings in turn."""
        distances = [later - earlier for earlier, later in pairwise(self.values)]
        return tuple(first / second for first, second in pairwise(distances))

    def __str__(self) -> str:
        places = [f"{n} -> {2 * n} steps at {value:.10g}" for n, value in zip(self.n_steps, self.values, strict=True)]
        ratios = [f"{ratio:.5g}" for ratio in self.ratios]
        return ", ".join(places) + (f"; ratios of the distances {', '.join(ratios)}" if ratios else "")


def cascades(records: Sequence[Record]) -> list[Cascade]:
    """All chains of two or more doublings, each followed along the first doubling of every family."""
    doublings = [record for record in records if record.get("type") == "period_doubling"]
    begun = {branch for doubling in doublings for branch in _family(records, doubling["next"])}
    chains = [list(_chain(records, doubling)) for doubling in doublings if doubling["branch"] not in begun]
    steps = {record["branch"]: record["n_steps"] for record in records if record["record"] == "point"}
    return [
        Cascade(n_steps=tuple(steps[r["branch"]] for r in chain), values=tuple(r["value"] for r in chain))
        for chain in chains
        if len(chain) > 1
    ]


def _chain(records: Sequence[Record], doubling: Record) -> Iterator[Record]:
    """A doubling, and the first one on the family that begins there, and so on."""
    following: Record | None = doubling
    while following is not None:
        yield following
        family = _family(records, following["next"])
        following = next((r for r in records if r.get("type") == "period_doubling" and r["branch"] in family), None)


def _family(records: Sequence[Record], branches: Sequence[int]) -> list[int]:
    """The branches that follow from some through changes of the mode sequence, these included."""
    family = list(branches)
    for branch in family:  # which grows on the way
        changes = (
            r for r in records if r.get("branch") == branch and r.get("type") in ("mode_change", "impact_change")
        )
        family += [number for change in changes for number in change["next"] if number not in family]
    return family
