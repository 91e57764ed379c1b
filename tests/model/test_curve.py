"""Curves: the numbers that compiled functions and proofs read; ``test_given_references`` follows them."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.interpolate import BPoly

from gaitopt.model.curve import BeyondEnd, Curve, Piece, bezier_curve, continuation, piece_data


def test_segment_data_have_one_length_whatever_the_degrees() -> None:
    pieces = [Piece(start=0.0, end=0.4, rows=((0.0,) * 4,) * 2), Piece(start=0.4, end=1.0, rows=((0.0,) * 10,) * 2)]
    curve = Curve(names=("a", "b"), pieces=tuple(pieces))
    assert curve.data(0).size == curve.data(1).size == 3 + 4 * 10


@pytest.mark.parametrize("beyond_end", [BeyondEnd.LINEAR, BeyondEnd.HOLD])
def test_control_points_give_the_bezier_curves_of_scipy(beyond_end: BeyondEnd) -> None:
    points, end = {"a": (-0.1, 0.2, 0.4, 0.3), "b": (0.5, -0.3)}, 0.8
    t = np.array([0.0, 0.1, 0.5, 0.79, 1.0, 3.0])
    late, inside = np.maximum(t - end, 0), np.minimum(t, end)
    angles, rates = bezier_curve(points, (0.0, end), beyond_end=beyond_end)(t)
    for k, row in enumerate(points.values()):
        expected = BPoly([[c] for c in row], [0, end])
        slope, kept = expected.derivative(), beyond_end is BeyondEnd.LINEAR
        np.testing.assert_allclose(angles[k], expected(inside) + kept * late * slope(end), atol=1e-14)
        np.testing.assert_allclose(rates[k], np.where(late > 0, kept * slope(end), slope(inside)), atol=1e-13)


def test_pieces_of_other_numbers_have_the_same_formulas() -> None:
    """(x - 1)^2 = (T_0 + T_2) / 2 from 0 to 2 in fractions: its end, its slope there, and the data of both pieces."""
    half = Fraction(1, 2)
    piece = Piece(start=Fraction(0), end=Fraction(2), rows=((half, Fraction(0), half),))
    assert piece.slopes == ((0, 2),)
    tail = continuation(piece, Fraction(2), BeyondEnd.LINEAR)
    assert tail == Piece(start=Fraction(2), end=Fraction(3), rows=((2, 1),))
    assert piece_data((piece, tail), 0) == [0, 2, 1, half, 0, half, 0, 2, 0]
    assert piece_data((piece, tail), 1) == [2, 3, 1, 2, 1, 0, 2, 0, 0]
