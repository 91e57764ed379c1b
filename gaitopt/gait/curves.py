"""Smooth curves on an interval, represented by their values at Chebyshev points of the second kind.

Integrals, extrema and roots of any quantity along a smooth arc then have the same accuracy as the states of the arc.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array

FINE_FACTOR = 6
"""The grid on which extrema and roots are bracketed has this many points per Chebyshev point."""
NEWTON_STEPS = 4
"""Number of Newton steps: from a grid of this density three reach machine precision, and the fourth is a reserve."""
COUNTS = (33, 65, 129, 257)
"""Numbers of points that are tried in turn until an arc is resolved; 33 resolve a phase of walking."""
RESOLVED = 1e-12
"""An arc is resolved if its last Chebyshev coefficients (see ``tail``) are below this, the rounding of its states."""
SHORT_ARC = 1e-4
"""Arcs shorter than this fraction of the step are skipped, because their curves consist of rounding errors."""
RISEN = 1e-3
"""A margin has risen once it exceeds this fraction of its largest value. The threshold is not zero because a margin
beside a phase of almost no duration does not start exactly at zero."""


@lru_cache(maxsize=32)
def points(count: int) -> Array:
    """Chebyshev points of the second kind on [-1, 1], ascending, ends included; shape (count,)."""
    return np.asarray(chebyshev.chebpts2(count), dtype=float)


@lru_cache(maxsize=32)
def _analysis(count: int) -> Array:
    return np.asarray(np.linalg.inv(chebyshev.chebvander(points(count), count - 1)), dtype=float)


@lru_cache(maxsize=32)
def _fine(count: int) -> tuple[Array, Array, Array]:
    """A fine grid, and the matrices from values at the points to values and derivatives on it."""
    s = np.cos(np.linspace(np.pi, 0, FINE_FACTOR * count))
    by_slope = chebyshev.chebvander(s, count - 2) @ _differentiation(count) @ _analysis(count)
    return s, chebyshev.chebvander(s, count - 1) @ _analysis(count), by_slope


@lru_cache(maxsize=32)
def _slope(count: int) -> Array:
    """The matrix from values at the points to derivatives there."""
    return np.asarray(chebyshev.chebvander(points(count), count - 2) @ _differentiation(count) @ _analysis(count))


@lru_cache(maxsize=32)
def weights(count: int) -> Array:
    """Clenshaw-Curtis weights of ``points(count)``, shape (count,).

    They follow from the integral of T_k over [-1, 1], which is 2 / (1 - k^2) for even k, 0 for odd k.
    """
    k = np.arange(count)
    moments = np.divide(2.0, 1.0 - k**2, out=np.zeros(count), where=k % 2 == 0)
    return np.asarray(moments @ _analysis(count))


@lru_cache(maxsize=32)
def _differentiation(count: int) -> Array:
    return np.asarray(chebyshev.chebder(np.eye(count)))


@lru_cache(maxsize=32)
def _primitive(count: int) -> Array:
    """The matrix from values at the points to Chebyshev coefficients of the integral; shape (count + 1, count)."""
    return np.asarray(chebyshev.chebint(_analysis(count)), dtype=float)


def coefficients(values: Array) -> Array:
    """Chebyshev coefficients of the curve through ``values`` (n, ...) at ``points(n)``; same shape."""
    return _analysis(values.shape[0]) @ values


def tail(values: Array) -> float:
    """Size of the last three coefficients relative to the largest value of their column, which counts at least as one.

    It shows how well the points resolve the curve. The values must be in natural units, so that one is a meaningful
    size.
    """
    c = np.abs(coefficients(values))
    scale = np.maximum(np.abs(values).max(axis=0), 1.0)
    return float((c[-3:].max(axis=0) / scale).max())


def evaluate(c: Array, s: Array) -> Array:
    """Chebyshev series sum_k c_k cos(k arccos s) at points s in [-1, 1]; shape of s, times the columns of c."""
    return np.asarray(np.cos(np.multiply.outer(np.arccos(s), np.arange(c.shape[0]))) @ c)


def integral(values: Array, duration: float) -> float:
    """Integral of the curve over an interval of the given duration."""
    return float(weights(values.shape[0]) @ values) * duration / 2


def primitive(values: Array, duration: float) -> Array:
    """Chebyshev coefficients of the integral from the start of an interval; shape (n + 1,)."""
    c = _primitive(values.shape[0]) @ values * duration / 2
    c[0] -= evaluate(c, np.array(-1.0))
    return np.asarray(c)


def signed_weights(values: Array) -> tuple[Array, Array]:
    """Weights (m,) that integrate a curve times the sign of the curve through ``values`` (m,) over [-1, 1].

    The second result contains the points where this sign changes; the integrals are exact across them.
    """
    changes = roots(values)
    pieces = np.diff(evaluate(_primitive(values.size), np.concatenate([[-1.0], changes, [1.0]])), axis=0)
    return np.sign(pieces @ values) @ pieces, changes


def absolute_integral(values: Array, duration: float) -> float:
    """Integral of the absolute value of a curve, exact across its changes of sign."""
    return float(signed_weights(values)[0] @ values) * duration / 2


def integrals(columns: Array, duration: float) -> Array:
    """Integrals of many curves, shape (m, n), over an interval of the given duration; shape (n,)."""
    return np.asarray(weights(columns.shape[0]) @ columns) * duration / 2


def roots(values: Array) -> Array:
    """Roots in (-1, 1) at which the curve changes sign, ascending. A root at an end may be included or not."""
    s, to_fine, _ = _fine(values.shape[0])
    c, fine = coefficients(values), to_fine @ values
    negative = fine < 0  # a zero on the grid counts as positive, so no change is missed or counted twice
    before = np.flatnonzero(negative[:-1] != negative[1:])
    double = _double_changes(values, c, fine)
    single = _newton(c, s[before], s[before + 1]) if before.size else np.zeros(0)
    both = np.sort(np.concatenate([single, double]))
    return both[np.abs(both) < 1]


def _double_changes(values: Array, c: Array, fine: Array) -> Array:
    """Pairs of roots between two neighbours on the fine grid, between which the curve crosses zero and returns."""
    s, _, to_slopes = _fine(values.shape[0])
    toward = fine * (to_slopes @ values) < 0
    cells = np.flatnonzero(toward[:-1] & ~toward[1:] & ((fine[:-1] < 0) == (fine[1:] < 0)))
    if cells.size == 0:
        return np.zeros(0)
    slope = derivative(c)
    bottom = _newton(slope, s[cells], s[cells + 1])
    depth, bend = evaluate(c, bottom), evaluate(derivative(slope), bottom)
    through = (depth < 0) != (fine[cells] < 0)
    cells, bottom, half = cells[through], bottom[through], np.sqrt(2 * np.abs(depth / bend)[through])
    left = _newton(c, s[cells], bottom, bottom - half)
    right = _newton(c, bottom, s[cells + 1], bottom + half)
    return np.concatenate([left, right])


def slopes(values: Array, s: Array) -> Array:
    """Derivatives of the curve in s, at points s in [-1, 1]; shape of s."""
    return evaluate(derivative(coefficients(values)), s)


def critical(values: Array) -> Array:
    """Points in (-1, 1) where the curve has extrema, ascending."""
    return roots(_slope(values.shape[0]) @ values)


def minima(values: Array) -> Array:
    """Points in (-1, 1) where the curve has minima, ascending."""
    at = critical(values)
    return at[evaluate(derivative(derivative(coefficients(values))), at) > 0] if at.size else at


def maximum(values: Array, start: float = -1.0) -> tuple[float, float]:
    """The point in [start, 1] where the curve is largest, and its value there."""
    s, to_fine, _ = _fine(values.shape[0])
    heights = to_fine @ values
    if start > -1:
        inside = s > start
        s = np.concatenate([[start], s[inside]])
        heights = np.concatenate([evaluate(coefficients(values), s[:1]), heights[inside]])
    best = int(np.argmax(heights))
    if 0 < best < s.size - 1:
        c = coefficients(values)
        at = _newton(derivative(c), s[best - 1 : best], s[best + 1 : best + 2])
        height = evaluate(c, at)
        if height[0] > heights[best]:
            return float(at[0]), float(height[0])
    return float(s[best]), float(heights[best])


def derivative(c: Array) -> Array:
    """Chebyshev coefficients of the derivative, one fewer than those ``c`` of the curve."""
    return np.asarray(_differentiation(c.shape[0]) @ c)


def minima_after_rise(
    times: Sequence[Array], values: Sequence[Array], level: float | None = None
) -> Iterator[tuple[int, float]]:
    """The interior minima of a margin after it has risen: index of the arc, and point in [-1, 1].

    Parameters
    ----------
    times : times of each arc of a step, at its Chebyshev points [s].
    values : values of the margin at these points, in natural units.
    level : value above which the margin has risen; None for the fraction ``RISEN`` of its largest value. If a level is
        given, a margin that starts at zero and rises at once counts as risen, however short the rise.
    """
    risen, rises_at_once = False, level is not None
    level = RISEN * max(float(margin.max()) for margin in values) if level is None else level
    for k, (arc, margin) in enumerate(zip(times, values, strict=True)):
        if arc[-1] - arc[0] < SHORT_ARC * abs(times[-1][-1]):
            continue
        risen = risen or (rises_at_once and bool(margin[0] > -level and _slope(margin.size)[0] @ margin > level))
        for s in minima(margin).tolist():
            if risen or (margin[points(margin.size) < s] > level).any():
                yield k, s
        risen = risen or bool((margin[:-1] > level).any())


def lowest_after_rise(
    times: Sequence[Array], values: Sequence[Array], level: float | None = None
) -> tuple[float, float]:
    """Value and time of the lowest interior minimum of a margin after it has risen; see ``minima_after_rise``.

    If the value is negative, the margin falls to zero too early.

    Returns
    -------
    lowest, time : infinity and the end of the step if there is no such minimum.
    """
    lowest, at = np.inf, float(times[-1][-1])
    for k, s in minima_after_rise(times, values, level):
        value = float(evaluate(coefficients(values[k]), np.array(s)))
        if value < lowest:
            lowest, at = value, float(times[k][0] + (s + 1) / 2 * (times[k][-1] - times[k][0]))
    return lowest, at


def _newton(c: Array, lower: Array, upper: Array, start: Array | None = None) -> Array:
    """Roots of the series ``c``, one in each bracket; an iterate that leaves its bracket is moved back to its end."""
    both = np.column_stack([c, np.append(derivative(c), 0.0)[: c.size]])  # a constant keeps one coefficient
    s = (lower + upper) / 2 if start is None else start
    for _ in range(NEWTON_STEPS):
        s = np.minimum(np.maximum(s, lower), upper)
        value, rate = evaluate(both, s).T
        s = s - np.divide(value, rate, out=np.zeros_like(s), where=rate != 0)
    return np.minimum(np.maximum(s, lower), upper)
