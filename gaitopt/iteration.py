"""One loop for Newton and chord methods, and a bracketing root finder.

    x_{k+1} = following(x_k)      until x_k is solved;      fails if size(x_{k+1}) >= contraction size(x_k)

``size`` is the quantity that must become small, the residual or the next step. A rejected iterate is discarded.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

Iterate = TypeVar("Iterate")


@dataclass(frozen=True, slots=True, kw_only=True)
class Iterated(Generic[Iterate]):
    """The last accepted iterate, whether it is solved, and the number of iterates tried."""

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
    """Iterate from ``start`` until ``solved`` while the size falls, at most ``most`` times.

    Parameters
    ----------
    following : the next iterate, or None if there is none.
    contraction : largest ratio of a size to the previous one.
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


def overflow_allowed() -> np.errstate:
    """Decorator or context for computations with trial points, which may diverge: they overflow without a warning.

    The caller rejects values that are not finite. Whether numpy warns of them depends on the vector unit of the
    processor.
    """
    return np.errstate(over="ignore", invalid="ignore")


def bracketed_root(function: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """A root between two arguments at which ``function`` has opposite signs, by inverse quadratics or bisection.

    T. R. Chandrupatla (1997), Advances in Engineering Software 28, 145-149. Importing scipy.optimize for it would take
    a quarter of a second.

    Parameters
    ----------
    tolerance : largest error of the root, apart from rounding.

    Raises
    ------
    ValueError
        If the signs are equal.
    """
    a, b, f_a, f_b = low, high, function(low), function(high)
    if f_a * f_b > 0:
        raise ValueError(f"no change of sign between {low:g} and {high:g}: {f_a:g} and {f_b:g}")
    part = 0.5
    while True:
        best, least = (a, f_a) if abs(f_a) < abs(f_b) else (b, f_b)
        narrow = (tolerance / 2 + sys.float_info.epsilon * abs(best)) / (abs(b - a) or 1.0)
        if least == 0 or not narrow < 0.5:
            return best
        x = a + min(max(part, narrow), 1 - narrow) * (b - a)
        f_x = function(x)
        if (f_x > 0) == (f_a > 0):
            c, f_c = a, f_a
        else:
            b, f_b, c, f_c = a, f_a, b, f_b
        a, f_a = x, f_x
        place, height = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b)
        part = 0.5
        if height**2 < place and (1 - height) ** 2 < 1 - place:
            part = f_a / (f_b - f_a) * f_c / (f_b - f_c) + (c - a) / (b - a) * f_a / (f_c - f_a) * f_b / (f_c - f_b)
