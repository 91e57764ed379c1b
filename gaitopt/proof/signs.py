"""The sign of a function of time on a whole arc, from its enclosed Taylor series.

Every step is divided until each part is of one kind, written as a letter

    p  positive      n  negative      u  rising      d  falling      ?  none of it could be shown

so that a claim on an arc is a pattern: ``p+`` positive throughout, ``p*d+`` positive until it falls to the zero at its
end, ``n*u*p+d+`` a touchdown, the first fall to zero after having been positive. Where a function is known to start
with a zero of order k, its sign just after it is that of its series divided by t^k.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from flint import arb

from gaitopt.proof.graph import NotProved, Refuted
from gaitopt.proof.taylor import Series, evaluate

POSITIVE = "p+"
ENDS = "p*d+"
TOUCHDOWN = "n*u*p+d+"
FINEST = 14
"""How often a step is halved at most."""


@dataclass(frozen=True, slots=True)
class Part:
    """A part of an arc on which a function is of one kind.

    Attributes
    ----------
    start, end : time since the start of the arc [s].
    value : the function there; divided by t^order next to a zero.
    order : of the zero with which the part starts.
    within : whether all of it is before the end of the arc, which is only enclosed.
    """

    kind: str
    start: arb
    end: arb
    value: arb
    order: int
    within: bool


def parts(steps: Iterable[tuple[Series, arb]], order: int = 0, *, monotone: bool = True) -> Iterator[Part]:
    """Parts of an arc in order of time.

    Parameters
    ----------
    steps : the function on every step, and the step's length.
    order : of the zero with which it starts.
    monotone : whether it is enough to know that a part rises or falls.
    """
    began = arb(0)
    for k, (series, h) in enumerate(steps):
        pending = [(arb(0), arb(h.upper()), FINEST)]
        while pending:
            start, end, depth = pending.pop()
            t, zero = start.union(end), order if k == 0 and start.is_zero() else 0
            value = evaluate(series.value[zero:], t)
            kind = "p" if value > 0 else "n" if value < 0 else "?"
            if kind == "?" and monotone:
                rate = evaluate(series.rate, t)
                kind = "u" if rate > 0 else "d" if rate < 0 else "?"
            if kind == "?" and depth and value.is_finite():
                middle = ((start + end) / 2).mid()
                pending += [(middle, end, depth - 1), (start, middle, depth - 1)]
            else:
                yield Part(kind, began + start, began + end, value, zero, bool(end <= h.lower()))
        began += h.mid()


def check_pattern(name: str, along: Sequence[Part], pattern: str) -> str:
    """The kinds of all parts, repeated ones counted, if they match a pattern.

    Raises
    ------
    NotProved
        If they do not; the message says when, and which values the function may have there. ``Refuted`` if it is
        negative there.
    """
    kinds = "".join(part.kind for part in along)
    if not re.fullmatch(pattern, kinds):
        negative = [] if pattern == TOUCHDOWN else [part for part in along if part.kind == "n" and part.within]
        fitting = max(k for k in range(len(kinds) + 1) if re.fullmatch(pattern.replace("+", "*"), kinds[:k]))
        part = min(negative, key=lambda part: part.value.upper(), default=along[min(fitting, len(along) - 1)])
        when = f"between {float(part.start):.6g} and {float(part.end):.6g} s of the arc"
        words = f"{name} is {part.value.str(6)} {when}: {_SHAPES[pattern]} is"
        if negative:
            raise Refuted(f"{words} false", name)
        raise NotProved(f"{words} not shown")
    return " ".join(f"{kind}{len(list(group))}" for kind, group in groupby(kinds))


def smallest(along: Sequence[Part]) -> arb | None:
    """A lower bound of the function over the parts where it is positive and not divided by a power of time."""
    return min((part.value.lower() for part in along if part.kind == "p" and not part.order), default=None)


_SHAPES = {
    POSITIVE: "that it is positive throughout",
    ENDS: "that it is positive and falls to zero only at the end",
    TOUCHDOWN: "that it falls to zero for the first time after having been positive at the end",
}
