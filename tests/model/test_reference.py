"""Reference motions: what holds past their end, breakpoints, and the numbers that compiled functions read."""

import numpy as np
import pytest
from casadi import SX, Function
from numpy.polynomial import chebyshev

from gaitopt.model.reference import BeyondEnd, Piece, Reference, continued, evaluate

END = 0.8


def sine_piece(start: float, end: float, degree: int = 12) -> Piece:
    """sin t and cos 2t on [start, end]."""
    s = chebyshev.chebpts2(degree + 1)
    t = start + (end - start) * (s + 1) / 2
    angles = chebyshev.chebfit(s, np.column_stack([np.sin(t), np.cos(2 * t)]), degree)
    return Piece(start=start, end=end, angles=angles.T)


def exact(t: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.array([np.sin(t), np.cos(2 * t)]), np.array([np.cos(t), -2 * np.sin(2 * t)])


@pytest.fixture
def pieces() -> list[Piece]:
    return [sine_piece(0.0, 0.3), sine_piece(0.3, END)]


def test_curve_and_rates_are_those_that_were_put_in(pieces: list[Piece]) -> None:
    t = np.linspace(0, END, 17)[:-1]
    angles, rates = continued(pieces, END, BeyondEnd.HOLD)(t)
    np.testing.assert_allclose(angles, exact(t)[0], atol=1e-13)
    np.testing.assert_allclose(rates, exact(t)[1], atol=1e-12)  # the derivative of the series


def test_hold_keeps_the_last_angle_with_zero_rate(pieces: list[Piece]) -> None:
    angles, rates = continued(pieces, END, BeyondEnd.HOLD)([END + 0.1, END + 2])
    np.testing.assert_allclose(angles, np.column_stack([exact(END)[0]] * 2), atol=1e-13)
    np.testing.assert_array_equal(rates, 0)


def test_linear_keeps_the_last_rate(pieces: list[Piece]) -> None:
    angles, rates = continued(pieces, END, BeyondEnd.LINEAR)([END + 0.1, END + 2])
    last_angle, last_rate = exact(END)
    np.testing.assert_allclose(rates, np.column_stack([last_rate] * 2), atol=1e-12)
    np.testing.assert_allclose(angles, np.column_stack([last_angle + dt * last_rate for dt in (0.1, 2)]), atol=1e-12)


def test_only_off_ceases_to_act(pieces: list[Piece]) -> None:
    for beyond_end in (BeyondEnd.LINEAR, BeyondEnd.HOLD, BeyondEnd.OFF):
        active = [piece.active for piece in continued(pieces, END, beyond_end).pieces]
        assert active == [True, True, beyond_end is not BeyondEnd.OFF]


def test_breakpoints_are_where_pieces_meet(pieces: list[Piece]) -> None:
    reference = continued(pieces, END, BeyondEnd.HOLD)
    assert reference.breakpoints == (0.3, END)
    assert reference.horizon == np.inf


def test_reference_may_end_before_its_last_piece_does(pieces: list[Piece]) -> None:
    """A step that is cut short continues from where it was cut."""
    angles, _ = continued(pieces, 0.5, BeyondEnd.HOLD)([0.49, 0.51])
    np.testing.assert_allclose(angles, np.column_stack([exact(0.49)[0], exact(0.5)[0]]), atol=1e-13)


def test_segment_data_say_the_same_in_symbols_as_the_curve_in_numbers(pieces: list[Piece]) -> None:
    for beyond_end in (BeyondEnd.LINEAR, BeyondEnd.HOLD, BeyondEnd.OFF):
        reference = continued(pieces, END, beyond_end)
        data, t = SX.sym("data", reference.data(0).size), SX.sym("t")
        sums = [evaluate(data, t, 2, reference.degree, weights) for weights in ((1, 0), (0, 1), (2, 3))]
        function = Function("reference", [data, t], [*(values for values, _ in sums), sums[0][1]])
        for segment, times in enumerate(([0.0, 0.29], [0.3, 0.6], [END, 1.3])):
            for time in times:
                angles, rates, both, active = (np.asarray(x) for x in function(reference.data(segment), time))
                expected_pair = reference([time])
                np.testing.assert_allclose(angles, expected_pair[0], atol=1e-13)
                np.testing.assert_allclose(rates, expected_pair[1], atol=1e-13)
                np.testing.assert_allclose(both, 2 * expected_pair[0] + 3 * expected_pair[1], atol=1e-12)
                assert bool(active.item()) is reference.pieces[segment].active


def test_segment_data_have_one_length_whatever_the_degrees() -> None:
    coarse, fine = sine_piece(0.0, 0.4, degree=3), sine_piece(0.4, 1.0, degree=9)
    reference = Reference(pieces=(coarse, fine))
    assert reference.degree == 9
    assert reference.data(0).size == reference.data(1).size == 3 + 4 * 10
