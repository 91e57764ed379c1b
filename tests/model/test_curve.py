"""Curves: what holds past their end, breakpoints, and the numbers that compiled functions read."""

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from casadi import SX, Function, vertcat
from numpy.polynomial import chebyshev
from scipy.interpolate import BPoly

from gaitopt.model.curve import BeyondEnd, Curve, Piece, bezier_curve, continuation, continued, piece_data

END = 0.8
NAMES = ("a", "b")
POINTS = {"a": (-0.1, 0.2, 0.4, 0.3), "b": (0.5, -0.3)}


def sine_piece(start: float, end: float, degree: int = 12) -> Piece:
    """sin t and cos 2t on [start, end]."""
    s = chebyshev.chebpts2(degree + 1)
    t = start + (end - start) * (s + 1) / 2
    angles = chebyshev.chebfit(s, np.column_stack([np.sin(t), np.cos(2 * t)]), degree)
    return Piece(start=start, end=end, rows=tuple(map(tuple, angles.T.tolist())))


def exact(t: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.array([np.sin(t), np.cos(2 * t)]), np.array([np.cos(t), -2 * np.sin(2 * t)])


@pytest.fixture
def pieces() -> list[Piece]:
    return [sine_piece(0.0, 0.3), sine_piece(0.3, END)]


def test_curve_and_rates_are_those_that_were_put_in(pieces: list[Piece]) -> None:
    t = np.linspace(0, END, 17)[:-1]
    angles, rates = continued(NAMES, pieces, END, BeyondEnd.HOLD)(t)
    np.testing.assert_allclose(angles, exact(t)[0], atol=1e-13)
    np.testing.assert_allclose(rates, exact(t)[1], atol=1e-12)  # the derivative of the series


def test_only_off_ceases_to_act(pieces: list[Piece]) -> None:
    for beyond_end in (BeyondEnd.LINEAR, BeyondEnd.HOLD, BeyondEnd.OFF):
        active = [piece.active for piece in continued(NAMES, pieces, END, beyond_end).pieces]
        assert active == [True, True, beyond_end is not BeyondEnd.OFF]


def test_breakpoints_are_where_pieces_meet(pieces: list[Piece]) -> None:
    curve = continued(NAMES, pieces, END, BeyondEnd.HOLD)
    assert curve.breakpoints == (0.3, END)
    assert curve.horizon == np.inf
    assert curve.stated == tuple(pieces)


def test_a_curve_may_end_before_its_last_piece_does(pieces: list[Piece]) -> None:
    """A step that is cut short continues from where it was cut."""
    angles, _ = continued(NAMES, pieces, 0.5, BeyondEnd.HOLD)([0.49, 0.51])
    np.testing.assert_allclose(angles, np.column_stack([exact(0.49)[0], exact(0.5)[0]]), atol=1e-13)


@pytest.mark.parametrize("beyond_end", [BeyondEnd.LINEAR, BeyondEnd.HOLD, BeyondEnd.OFF])
@pytest.mark.parametrize("parametric", [False, True])
def test_segment_data_say_the_same_in_symbols_as_the_curve_in_numbers(pieces, beyond_end, parametric):
    if parametric:
        curve = bezier_curve(POINTS, (0.0, END), beyond_end=beyond_end)
    else:
        curve = continued(NAMES, pieces, END, beyond_end)
    data, t, p = SX.sym("data", curve.data(0).size), SX.sym("t"), {name: SX.sym(name, 4) for name in NAMES}
    points = SimpleNamespace(a=p["a"], b=p["b"][:2])
    sums = [curve.at(t, 1, data, points, weights) for weights in ((1, 0), (0, 1), (2, 3))]
    function = Function("curve", [data, t, *p.values()], [*(values for values, _ in sums), sums[0][1]])
    numbers = ([*POINTS["a"]], [*POINTS["b"], 0, 0])
    starts = (0.0, *curve.breakpoints)
    for segment, start in enumerate(starts):
        for time in (start, start + 0.29):
            active = curve.pieces[segment].active
            angles, rates, both, acts = (np.asarray(x) for x in function(curve.data(segment), time, *numbers))
            expected = curve([time])
            assert bool(acts.item()) is active
            if active:
                np.testing.assert_allclose(angles, expected[0], atol=1e-13)
                np.testing.assert_allclose(rates, expected[1], atol=1e-13)
                np.testing.assert_allclose(both, 2 * expected[0] + 3 * expected[1], atol=1e-12)


def test_segment_data_have_one_length_whatever_the_degrees() -> None:
    curve = Curve(names=NAMES, pieces=(sine_piece(0.0, 0.4, degree=3), sine_piece(0.4, 1.0, degree=9)))
    assert curve.data(0).size == curve.data(1).size == 3 + 4 * 10


@pytest.mark.parametrize("beyond_end", [BeyondEnd.LINEAR, BeyondEnd.HOLD])
def test_control_points_give_the_bezier_curves_of_scipy(beyond_end: BeyondEnd) -> None:
    curve = bezier_curve(POINTS, (0.0, END), beyond_end=beyond_end)
    t = np.array([0.0, 0.1, 0.5, 0.79, 1.0, 3.0])
    angles, rates = curve(t)
    for k, row in enumerate(POINTS.values()):
        expected = BPoly([[c] for c in row], [0, END])
        slope, kept = expected.derivative(), beyond_end is BeyondEnd.LINEAR
        late = np.maximum(t - END, 0)
        inside = np.minimum(t, END)
        np.testing.assert_allclose(angles[k], expected(inside) + kept * late * slope(END), atol=1e-14)
        np.testing.assert_allclose(rates[k], np.where(late > 0, kept * slope(END), slope(inside)), atol=1e-13)


def test_curves_over_a_phase_have_the_rate_of_the_phase() -> None:
    """Over theta from 0.2 to -0.3, at 0.1, with the rate -2."""
    curve = bezier_curve(POINTS, (0.2, -0.3), phase="theta")
    points = SimpleNamespace(**{name: vertcat(*row) for name, row in POINTS.items()})
    now = SimpleNamespace(s=SimpleNamespace(theta=SX(0.1)), ds=SimpleNamespace(theta=SX(-2)), r=SX(curve.data(0)))
    (angles, active), (rates, _) = (curve.weighted(now, points, weights) for weights in ((1, 0), (0, 1)))  # type: ignore[arg-type]
    s = 0.1 / 0.5
    for k, row in enumerate(POINTS.values()):
        expected = BPoly([[c] for c in row], [0, 1])
        assert float(angles[k]) == pytest.approx(float(expected(s)), abs=1e-14)
        assert float(rates[k]) == pytest.approx(float(expected.derivative()(s)) * -2 / -0.5, abs=1e-13)
    assert float(active) == 1
    assert curve.breakpoints == ()


def test_parameters_have_the_keys_of_a_problem_file() -> None:
    assert [*bezier_curve(POINTS, (0.0, END)).parameters] == ["a.0", "a.1", "a.2", "a.3", "b.0", "b.1"]
    assert bezier_curve({"a": (0.1,)}, (0.0, 1.0)).parameters == {"constant.a": 0.1}


def test_pieces_of_other_numbers_have_the_same_formulas() -> None:
    """(x - 1)^2 = (T_0 + T_2) / 2 from 0 to 2 in fractions: its end, its slope there, and the data of both pieces."""
    half = Fraction(1, 2)
    piece = Piece(start=Fraction(0), end=Fraction(2), rows=((half, Fraction(0), half),))
    assert piece.slopes == ((0, 2),)
    tail = continuation(piece, Fraction(2), BeyondEnd.LINEAR)
    assert tail == Piece(start=Fraction(2), end=Fraction(3), rows=((2, 1),))
    assert piece_data((piece, tail), 0) == [0, 2, 1, half, 0, half, 0, 2, 0]
    assert piece_data((piece, tail), 1) == [2, 3, 1, 2, 1, 0, 2, 0, 0]
