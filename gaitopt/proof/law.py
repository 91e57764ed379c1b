"""The control law of a theorem: its breakpoints and segment data in balls, from the decimals of its problem.

The simulation evaluates a law at doubles. Here the numbers that a law reads as segment data (durations, spans, widths,
tables, tracked motions) have the exact values that the problem's text gives. Rates are the derivatives of angles, and
splines and fits are computed from the rows of their table:

    spline    cubic, twice continuously differentiable, not-a-knot: the third derivative is continuous at the first and
              the last inner knot
    fit       Chebyshev series of least squares, T' T c = T' y
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from math import isfinite
from typing import TypeAlias

import numpy as np
from flint import arb, arb_mat, fmpq

from gaitopt.model.control import OWN_PACKAGE, Control
from gaitopt.model.curve import Curve, Piece, bezier_pieces, continuation, piece_data
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.reference import Reference, TableReference
from gaitopt.model.table import Table
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.model.virtual_constraints import VirtualConstraints
from gaitopt.proof.arithmetic import NotProved, ball

Exact: TypeAlias = Callable[[str, float], str]
"""Dotted key and double -> the decimal that the double stands for; see ``gaitopt.problem.writing.ExactValues``."""
LARGEST_DENOMINATOR = 1000
"""A breakpoint of a clock is a fraction of its period with at most this denominator."""
LARGEST_DISAGREEMENT = 1e-9
"""Largest difference between the ball of a number and its double, relative to the largest number of its segment."""


@dataclass(frozen=True, slots=True)
class ExactLaw:
    """The numbers that a law reads besides time, state and parameters.

    Attributes
    ----------
    breakpoints : times at which one segment ends and the next begins [s].
    horizon : time at which the law ends [s]; None if it does not end.
    data : the numbers of each segment.
    period : period of a clock of its own [s]; None if it has none.
    """

    breakpoints: tuple[arb, ...]
    horizon: arb | None
    data: tuple[tuple[arb, ...], ...]
    period: arb | None = None

    @property
    def edges(self) -> tuple[arb | None, ...]:
        """The ends of the segments; the last one is the horizon."""
        return (*self.breakpoints, self.horizon)


def exact_law(control: Control, exact: Exact, duration: float | None = None) -> ExactLaw:
    """Breakpoints and segment data of a law; those of laws from other packages are doubles.

    Parameters
    ----------
    duration : duration of curves or torques [s], an exact double; None if the problem's text states it.

    Raises
    ------
    NotProved
        If balls and doubles do not agree: a table or a piece is too ill-conditioned.
    """
    law = _in_doubles(control)
    if isinstance(control, OpenLoop) and control.duration is not None:
        stated, n = control.duration, control.intervals
        whole = arb(stated) if duration is not None else ball(exact("control.duration", stated))
        starts = [whole * k / n for k in range(n)]
        intervals = [(start, whole / n, *law.data[k][2:]) for k, start in enumerate(starts)]
        law = ExactLaw(tuple(starts[1:]), None, tuple(intervals))
    elif isinstance(control, ProportionalDerivative):
        curve, known = control.reference.motion(), None if duration is None else arb(duration)
        law = _law_of_pieces(exact_pieces(control.reference, curve, exact, "control.reference.span", known), curve)
    elif isinstance(control, VirtualConstraints):
        pieces = exact_pieces(control.reference, control.curve, exact, "control.span")
        law = _law_of_pieces(pieces, control.curve)
        if control.clamp is not None:
            keys = ("control.span.0", "control.span.1", "control.clamp")
            numbers = zip(keys, (*(control.span or ()), control.clamp), strict=True)
            clamp = [ball(exact(key, value)) for key, value in numbers]
            law = ExactLaw((), None, ((*clamp, *law.data[0]),))
    elif control.period is not None and type(control).__module__.startswith(OWN_PACKAGE):
        period = ball(exact("control.cycle", control.period))
        ratios = (Fraction(time / control.period) for time in control.breakpoints)
        fractions = (ratio.limit_denominator(LARGEST_DENOMINATOR) for ratio in ratios)
        times = tuple(period * fmpq(fraction.numerator, fraction.denominator) for fraction in fractions)
        law = ExactLaw(times, None if law.horizon is None else period, law.data, period)
    elif control.period is not None:
        law = replace(law, period=arb(control.period))
    _compare(law, control)
    return law


def _in_doubles(control: Control) -> ExactLaw:
    """The law with its doubles taken as exact."""
    segments = range(len(control.breakpoints) + 1)
    return ExactLaw(
        tuple(arb(float(time)) for time in control.breakpoints),
        arb(control.horizon) if isfinite(control.horizon) else None,
        tuple(tuple(arb(float(value)) for value in control.data(k)) for k in segments),
    )


def _compare(law: ExactLaw, control: Control) -> None:
    """Require that the balls agree with the doubles of the simulation up to rounding."""
    rows = [*law.data, law.breakpoints]
    doubles = [*(control.data(k) for k in range(len(law.data))), np.array(control.breakpoints, dtype=float)]
    for balls, numbers in zip(rows, doubles, strict=True):
        scale = LARGEST_DISAGREEMENT * max(1.0, float(np.abs(numbers).max(initial=0)))
        pairs = zip(balls, numbers.tolist(), strict=True)
        if not all(abs(a - arb(b)) < scale for a, b in pairs):
            raise NotProved(f"the numbers of the {control.type} law are too ill-conditioned: a table or a piece of it")


def exact_pieces(
    reference: Reference, curve: Curve, exact: Exact, span: str, duration: arb | None = None
) -> tuple[Piece, ...]:
    """The pieces of a curve in balls.

    Parameters
    ----------
    span : dotted key of the span of curves over a phase.
    duration : duration of a curve with control points [s]; None if the problem's text states it.
    """
    first, tail = curve.pieces[0], curve.beyond_end if curve.continues else None
    if curve.points and tail is not None:
        above = "control.reference.curve" if "curve" in type(reference).model_fields else "control.reference"
        end = ball(exact(f"{above}.duration", first.end)) if duration is None else duration
        return bezier_pieces((arb(0), end), tail)
    if curve.points:
        return bezier_pieces((ball(exact(f"{span}.0", first.start)), ball(exact(f"{span}.1", first.end))), None)
    if isinstance(reference, TableReference):
        pieces = _spline(reference.table) if reference.degree is None else _fit(reference.table, reference.degree)
    else:
        pieces = [exact_piece(piece) for piece in curve.stated]
    return (*pieces, *(() if tail is None else (continuation(pieces[-1], pieces[-1].end, tail),)))


def exact_piece(piece: Piece) -> Piece:
    """A piece of a tracked motion, whose doubles are exact."""
    rows = tuple(tuple(arb(c) for c in row) for row in piece.rows)
    return Piece(start=arb(piece.start), end=arb(piece.end), rows=rows, active=piece.active)


def _law_of_pieces(pieces: Sequence[Piece], curve: Curve) -> ExactLaw:
    """Breakpoints and segment data of pieces."""
    data = tuple(tuple(map(arb, piece_data(pieces, k))) for k in range(len(pieces)))
    horizon = arb(curve.horizon) if isfinite(curve.horizon) else None
    return ExactLaw(tuple(piece.start for piece in pieces[1:]), horizon, data)


# tables


def table_columns(table: Table) -> dict[str, list[arb]]:
    """The columns of a table by name, in rad and SI units."""
    return {name: [ball(text) for text in column] for name, column in table.decimals.items()}


def _spline(table: Table) -> list[Piece]:
    """The splines through the rows of a table."""
    times, *columns = table_columns(table).values()
    slopes = [_spline_slopes(times, column) for column in columns]
    return [
        Piece(
            start=start,
            end=end,
            rows=tuple(
                _hermite(y[k], y[k + 1], s[k], s[k + 1], end - start) for y, s in zip(columns, slopes, strict=True)
            ),
        )
        for k, (start, end) in enumerate(pairwise(times))
    ]


def _spline_slopes(t: Sequence[arb], y: Sequence[arb]) -> list[arb]:
    """Slopes of the not-a-knot spline at its knots. Three knots give a parabola, two a straight line."""
    n, h = len(t), [b - a for a, b in pairwise(t)]
    m = [(b - a) / step for (a, b), step in zip(pairwise(y), h, strict=True)]
    if n == 2:
        return [m[0], m[0]]
    A, b = arb_mat(n, n), arb_mat(n, 1)
    for i in range(1, n - 1):
        A[i, i - 1], A[i, i], A[i, i + 1] = h[i], 2 * (h[i - 1] + h[i]), h[i - 1]
        b[i, 0] = 3 * (h[i] * m[i - 1] + h[i - 1] * m[i])
    # not-a-knot: (s_i + s_(i+1) - 2 m_i) / h_i^2 is the same on both pieces; with three knots it is zero on each
    for row, i in ((0, 0), (n - 1, n - 3)):
        for sign, k in ((1, i), (-1, i + 1)):
            if n > 3 or k == row // 2:
                A[row, k] += sign / h[k] ** 2
                A[row, k + 1] += sign / h[k] ** 2
                b[row, 0] += 2 * sign * m[k] / h[k] ** 2
    return [arb(value) for value in A.solve(b).entries()]


def _hermite(y0: arb, y1: arb, s0: arb, s1: arb, h: arb) -> tuple[arb, ...]:
    """Chebyshev coefficients of the cubic with these values and slopes at both ends of a piece of length h."""
    rise = y1 - y0
    a = [y0, h * s0, 3 * rise - h * (2 * s0 + s1), h * (s0 + s1) - 2 * rise]  # in powers of (1 + s) / 2
    return (
        a[0] + a[1] / 2 + 3 * a[2] / 8 + 5 * a[3] / 16,
        a[1] / 2 + a[2] / 2 + 15 * a[3] / 32,
        a[2] / 8 + 3 * a[3] / 16,
        a[3] / 32,
    )


def _fit(table: Table, n: int) -> list[Piece]:
    """The polynomials of degree n that are closest to the rows of a table."""
    argument, *columns = table_columns(table).values()
    piece = Piece(start=argument[0], end=argument[-1])
    T = arb_mat([[(2 * piece.fraction(x) - 1).chebyshev_t(k) for k in range(n + 1)] for x in argument])
    y = arb_mat([list(row) for row in zip(*columns, strict=True)])
    c = (T.transpose() * T).solve(T.transpose() * y)
    rows = tuple(tuple(c[k, j] for k in range(n + 1)) for j in range(len(columns)))
    return [replace(piece, rows=rows)]
