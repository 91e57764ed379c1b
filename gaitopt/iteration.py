"""The loop of every Newton and chord method here, with its one stopping rule.

    x_k+1 = following(x_k)      until x_k is solved,      given up where size(x_k+1) >= contraction size(x_k)

``size`` is what has to become small: the residual, or the next step. Iterates that are given up are not kept.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Generic, TypeVar

Iterate = TypeVar("Iterate")

NO_CONTRACTION = inf
"""For methods that decide by themselves whether a step may increase the residual."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Iterated(Generic[Iterate]):
    """Where an iteration ended: the last iterate that was kept, whether it is solved, and how many were tried."""

    at: Iterate
    solved: bool
    count: int


def iterate(
    start: Iterate,
    following: Callable[[Iterate], Iterate | None],
    *,
    size: Callable[[Iterate], float],
    solved: Callable[[Iterate], bool],
    most: int,
    contraction: float = 1.0,
) -> Iterated[Iterate]:
    """Iterate from ``start`` until ``solved``, as long as the size falls, ``most`` times at most.

    Parameters
    ----------
    following : the next iterate, or None where there is none.
    contraction : largest ratio of a size to the one before.
    """
    at = start
    for count in range(most):
        if solved(at):
            return Iterated(at=at, solved=True, count=count)
        candidate = following(at)
        if candidate is None or not size(candidate) < contraction * size(at):
            return Iterated(at=at, solved=False, count=count + 1)
        at = candidate
    return Iterated(at=at, solved=solved(at), count=most)
