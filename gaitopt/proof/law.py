"""The control law of a theorem: its breakpoints and segment data in balls, from the decimals of its problem.

The simulation evaluates a law at doubles. Here the numbers that a law reads as segment data (durations, spans, widths,
tables, tracked motions) have the exact values that the problem's text gives. Rates are the derivatives of angles, and
splines and fits are computed from the rows of their table:

    spline    cubic, twice continuously differentiable, not-a-knot: the third derivative is continuous at the first and
              the last inner knot
    fit       Bernstein polynomials with the least sum of squared errors, B' B c = B' y
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import comb, isfinite, prod
from typing import TypeAlias

import numpy as np
from flint import arb, arb_mat

from gaitopt.model.control import Control
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.reference import (
    BeyondEnd,
    BezierCurve,
    GivenCurves,
    Piece,
    Reference,
    Table,
    TableCurves,
    TableReference,
    Target,
)
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.model.virtual_constraints import VirtualConstraints
from gaitopt.proof.arithmetic import NotProved, ball

Exact: TypeAlias = Callable[[str, float], str]
"""Dotted key and double -> the decimal that the double stands for; see ``gaitopt.problem.writing.ExactValues``."""
Rows: TypeAlias = list[list[arb]]
"""Chebyshev coefficients of one piece, by joint."""
GUARD = 1e-9
"""Largest difference between a ball and its double, relative to the largest number of a segment."""


@dataclass(frozen=True, slots=True)
class ExactLaw:
    """What a law reads besides time, state and parameters.

    Attributes
    ----------
    breakpoints : times at which one segment ends and the next begins [s].
    horizon : time at which the law ends [s]; None if it does not.
    data : segment data, by segment.
    """

    breakpoints: tuple[arb, ...]
    horizon: arb | None
    data: tuple[tuple[arb, ...], ...]

    @property
    def edges(self) -> tuple[arb | None, ...]:
        """The ends of the segments; the last one is the horizon."""
        return (*self.breakpoints, self.horizon)


def exact_law(control: Control, exact: Exact, duration: float | None = None) -> ExactLaw:
    """Breakpoints and segment data of a law; those of laws from other packages are doubles.

    Parameters
    ----------
    duration : of curves or torques, an exact double; None if the texts give it [s].

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
        law = _target(control.reference, exact, law, duration)
    elif isinstance(control, VirtualConstraints):
        numbers = [ball(exact(f"control.span.{k}", value)) for k, value in enumerate(control.span)]
        numbers += [] if control.clamp is None else [ball(exact("control.clamp", control.clamp))]
        table, (data,) = control.reference, law.data
        rest = _fitted_table(table) if isinstance(table, TableCurves) else data[len(numbers) :]
        law = ExactLaw((), None, ((*numbers, *rest),))
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
    """Require that balls and doubles say the same, up to rounding."""
    rows = [*law.data, law.breakpoints]
    doubles = [*(control.data(k) for k in range(len(law.data))), np.array(control.breakpoints, dtype=float)]
    for balls, numbers in zip(rows, doubles, strict=True):
        scale = GUARD * max(1.0, float(np.abs(numbers).max(initial=0)))
        pairs = zip(balls, numbers.tolist(), strict=True)
        if not all(abs(a - arb(b)) < scale for a, b in pairs):
            raise NotProved(f"the numbers of the {control.type} law are too ill-conditioned: a table or a piece of it")


def _target(target: Target, exact: Exact, law: ExactLaw, duration: float | None) -> ExactLaw:
    """Breakpoints and segment data of a reference."""
    if isinstance(target, Reference):
        return _pieces(target)
    if isinstance(target, TableReference) and target.degree is None:
        return _spline(target.table, BeyondEnd(target.beyond_end or BeyondEnd.HOLD))
    if isinstance(target, TableReference):
        start, end, *points = _fitted_table(target)
    elif isinstance(target, GivenCurves) and target.phase_variable:
        start, end, *points = (
            ball(exact(f"control.reference.span.{k}", value)) for k, value in enumerate(target.domain)
        )
    elif isinstance(target, GivenCurves):
        start, end, points = arb(0), ball(exact("control.reference.duration", target.domain[1])), []
    elif isinstance(target, BezierCurve):
        stated = arb(target.duration)
        end = stated if duration is not None else ball(exact("control.reference.curve.duration", target.duration))
        start, points = arb(0), []
    else:
        return law
    if target.phase_variable:
        return ExactLaw((), None, ((start, end, *points),))
    return ExactLaw((end,), None, ((arb(1), arb(0), end, *points), (arb(0), arb(1), end, *points)))


# pieces of a motion


def piece_rows(piece: Piece) -> Rows:
    """Chebyshev coefficients of the angles of a piece, which are exact doubles."""
    return [[arb(float(c)) for c in row] for row in piece.angles]


def derivative_row(row: Sequence[arb], length: arb) -> list[arb]:
    """Chebyshev coefficients of d/dt of a series over a piece of some length: c'_(k-1) = c'_(k+1) + 2 k c_k."""
    slopes = [arb(0)] * (len(row) + 1)
    for k in range(len(row) - 1, 0, -1):
        slopes[k - 1] = slopes[k + 1] + 2 * k * row[k]
    slopes[0] = slopes[0] / 2
    return [2 * slope / length for slope in slopes[: max(len(row) - 1, 1)]]


def end_value(row: Sequence[arb]) -> arb:
    """A series at the end of its piece, where every polynomial is 1."""
    return sum(row, arb(0))


def start_value(row: Sequence[arb]) -> arb:
    """A series at the start of its piece."""
    return sum((-c if k % 2 else c for k, c in enumerate(row)), arb(0))


def _pieces(motion: Reference) -> ExactLaw:
    """The pieces of a tracked motion."""
    pieces = [(arb(piece.start), arb(piece.end), piece_rows(piece), piece.active) for piece in motion.pieces]
    if not isfinite(motion.horizon):  # the last one continues those before it, in doubles
        tail = motion.pieces[-1]
        pieces[-1] = _continuation(pieces[:-1], held=not np.any(tail.angles[:, 1:]), active=tail.active)
    return _law_of_pieces(pieces, arb(motion.horizon) if isfinite(motion.horizon) else None)


def _continuation(
    pieces: Sequence[tuple[arb, arb, Rows, bool]], *, held: bool, active: bool
) -> tuple[arb, arb, Rows, bool]:
    """The piece of one second that holds the last angle, or continues the last rate; see ``reference.continued``."""
    start, end, rows, _ = pieces[-1]
    rates = [arb(0) if held else end_value(derivative_row(row, end - start)) for row in rows]
    series = [[end_value(row) + rate / 2, rate / 2] for row, rate in zip(rows, rates, strict=True)]
    return end, end + 1, series, active


def _law_of_pieces(pieces: Sequence[tuple[arb, arb, Rows, bool]], horizon: arb | None) -> ExactLaw:
    """Breakpoints and segment data of pieces, in the layout of ``Reference.data``."""
    width, data = max(len(row) for _, _, rows, _ in pieces for row in rows), []
    for start, end, rows, active in pieces:
        series = [*rows, *(derivative_row(row, end - start) for row in rows)]
        padded = [c for row in series for c in (*row, *[arb(0)] * (width - len(row)))]
        data.append((start, end, arb(int(active)), *padded))
    return ExactLaw(tuple(start for start, *_ in pieces[1:]), horizon, tuple(data))


# tables


def table_columns(table: Table) -> dict[str, list[arb]]:
    """The columns of a table by name, in rad and SI units."""
    return {name: [ball(text) for text in column] for name, column in table.decimals.items()}


def _spline(table: Table, beyond_end: BeyondEnd) -> ExactLaw:
    """The splines through the rows of a table, and their continuation."""
    times, *columns = table_columns(table).values()
    slopes = [_spline_slopes(times, column) for column in columns]
    pieces = []
    for k, (start, end) in enumerate(pairwise(times)):
        rows = [_hermite(y[k], y[k + 1], s[k], s[k + 1], end - start) for y, s in zip(columns, slopes, strict=True)]
        pieces.append((start, end, rows, True))
    held, active = beyond_end is not BeyondEnd.LINEAR, beyond_end is not BeyondEnd.OFF
    return _law_of_pieces([*pieces, _continuation(pieces, held=held, active=active)], None)


def _spline_slopes(t: Sequence[arb], y: Sequence[arb]) -> list[arb]:
    """Slopes of the not-a-knot spline at its knots; of a parabola through three, of a line through two."""
    n, h = len(t), [b - a for a, b in pairwise(t)]
    m = [(b - a) / step for (a, b), step in zip(pairwise(y), h, strict=True)]
    if n == 2:
        return [m[0], m[0]]
    A, b = arb_mat(n, n), arb_mat(n, 1)
    for i in range(1, n - 1):
        A[i, i - 1], A[i, i], A[i, i + 1] = h[i], 2 * (h[i - 1] + h[i]), h[i - 1]
        b[i, 0] = 3 * (h[i] * m[i - 1] + h[i - 1] * m[i])
    for row, i in (
        (0, 0),
        (n - 1, n - 3),
    ):  # (s_i + s_(i+1) - 2 m_i) / h_i^2 is the same on both pieces; of three, zero
        for sign, k in ((1, i), (-1, i + 1)):
            if n > 3 or k == row // 2:
                A[row, k] += sign / h[k] ** 2
                A[row, k + 1] += sign / h[k] ** 2
                b[row, 0] += 2 * sign * m[k] / h[k] ** 2
    return [arb(value) for value in A.solve(b).entries()]


def _hermite(y0: arb, y1: arb, s0: arb, s1: arb, h: arb) -> list[arb]:
    """Chebyshev coefficients of the cubic with these values and slopes at both ends of a piece of length h."""
    rise = y1 - y0
    a = [y0, h * s0, 3 * rise - h * (2 * s0 + s1), h * (s0 + s1) - 2 * rise]  # in powers of (1 + s) / 2
    return [
        a[0] + a[1] / 2 + 3 * a[2] / 8 + 5 * a[3] / 16,
        a[1] / 2 + a[2] / 2 + 15 * a[3] / 32,
        a[2] / 8 + 3 * a[3] / 16,
        a[3] / 32,
    ]


def _fitted_table(table: TableCurves) -> list[arb]:
    """Both ends of the domain, and the control points of the fitted curves, one after the other."""
    phase, *columns = table_columns(table.table).values()
    if table.degree is None:
        return [phase[0], phase[-1]]
    n, start, end = table.degree, phase[0], phase[-1]
    s = [(value - start) / (end - start) for value in phase]
    B = arb_mat([[comb(n, k) * prod([x] * k + [1 - x] * (n - k), start=arb(1)) for k in range(n + 1)] for x in s])
    y = arb_mat([list(row) for row in zip(*columns, strict=True)])
    points = (B.transpose() * B).solve(B.transpose() * y)
    return [start, end, *points.transpose().entries()]
