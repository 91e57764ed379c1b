"""Balls: their precision, as decimal strings rounded outward, which enclose what is proved, and in pickles."""

import copyreg
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from typing import Any

from flint import acb, arb, ctx

EXTRA_DIGITS = 2
"""Digits printed beyond the first one in which the bounds differ."""
MOST_DIGITS = 30
BITS = 128
"""Of the bounds, before they become decimals."""
RADIUS_BITS = 64
"""More than the 30 bits of a radius."""
_COMPUTING = threading.RLock()
"""Held while balls are computed: FLINT's precision and length of series hold for the whole process."""


@contextmanager
def precision(bits: int) -> Iterator[None]:
    """Compute with balls of this precision within the block; other threads that do so wait for its end."""
    with _COMPUTING, ctx.workprec(bits):
        length = ctx.cap
        try:
            yield
        finally:
            ctx.cap = length


def interval(ball: arb) -> list[str]:
    """[lo, hi] as decimals."""
    with precision(BITS):
        lower, upper = _fraction(ball.lower()), _fraction(ball.upper())
    places = _places(upper - lower)
    scale = 10**places
    return [_decimal((lower * scale).__floor__(), places), _decimal((upper * scale).__ceil__(), places)]


def complex_interval(ball: acb) -> dict[str, list[str]]:
    """Real and imaginary part as intervals."""
    return {"re": interval(ball.real), "im": interval(ball.imag)}


def _fraction(exact: arb) -> Fraction:
    mantissa, exponent = exact.man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def _places(width: Fraction) -> int:
    """Decimal places that resolve a width."""
    places = 0
    while width and places < MOST_DIGITS and width * 10**places < 1:
        places += 1
    return MOST_DIGITS if width == 0 else min(places + EXTRA_DIGITS, MOST_DIGITS)


def _decimal(units: int, places: int) -> str:
    """units / 10^places."""
    sign, digits = "-" if units < 0 else "", str(abs(units)).rjust(places + 1, "0")
    return f"{sign}{digits[:-places]}.{digits[-places:]}" if places else f"{sign}{digits}"


def _pickled(ball: arb) -> tuple[Any, ...]:
    """What a pickle holds of a ball: mantissa and exponent of its middle and its radius."""
    if not ball.is_finite():
        return arb, (str(ball),)
    return _ball, tuple((int(m), int(e)) for m, e in (ball.mid().man_exp(), ball.rad().man_exp()))


def _ball(middle: tuple[int, int], radius: tuple[int, int]) -> arb:
    """The same ball: FLINT rounds a radius up to the next one that it can hold, even if it can hold this one."""
    mantissa, exponent = radius
    if mantissa == 0:
        return arb(middle)
    ball = arb(middle, arb((mantissa * 2**RADIUS_BITS - 1, exponent - RADIUS_BITS)))
    return ball if ball.rad() >= arb(radius) else arb(middle, arb(radius))


copyreg.pickle(arb, _pickled)
copyreg.pickle(acb, lambda ball: (acb, (ball.real, ball.imag)))
