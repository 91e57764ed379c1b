"""Curves by Chebyshev values: integrals, roots and extrema against closed forms."""

import numpy as np
import pytest

from gaitopt.gait import curves

N = 33


def on_interval(duration: float, count: int = N) -> np.ndarray:
    """Times of the Chebyshev points of an interval that starts at zero."""
    return duration * (curves.points(count) + 1) / 2


def test_points_ascend_from_end_to_end() -> None:
    s = curves.points(N)
    assert (s[0], s[-1]) == (-1.0, 1.0)
    assert np.all(np.diff(s) > 0)


def test_coefficients_of_a_chebyshev_polynomial_are_one_one() -> None:
    s = curves.points(9)
    table = np.column_stack([np.cos(k * np.arccos(s)) for k in range(9)])
    np.testing.assert_allclose(curves.coefficients(table), np.eye(9), atol=1e-14)


def test_integral_of_a_sine_is_exact() -> None:
    t = on_interval(2.5)
    assert curves.integral(np.sin(3 * t), 2.5) == pytest.approx((1 - np.cos(7.5)) / 3, abs=1e-14)


def test_absolute_integral_counts_both_signs() -> None:
    t = on_interval(2.0)  # sin(pi t) over a full period: two arches of area 2 / pi
    assert curves.integral(np.sin(np.pi * t), 2.0) == pytest.approx(0, abs=1e-14)
    assert curves.absolute_integral(np.sin(np.pi * t), 2.0) == pytest.approx(4 / np.pi, abs=1e-13)


def test_absolute_integral_without_change_of_sign_is_the_integral() -> None:
    t = on_interval(0.7)
    assert curves.absolute_integral(-np.exp(t), 0.7) == pytest.approx(np.exp(0.7) - 1, abs=1e-14)


def test_roots_of_a_cosine_are_all_found() -> None:
    s = curves.points(N)
    expected = np.array([-7, -5, -3, -1, 1, 3, 5, 7]) / 8
    np.testing.assert_allclose(curves.roots(np.cos(4 * np.pi * s)), expected, atol=1e-14)


def test_two_close_roots_are_told_apart() -> None:
    s = curves.points(N)
    np.testing.assert_allclose(curves.roots((s - 0.5) * (s - 0.53)), [0.5, 0.53], atol=1e-13)


def test_curve_that_touches_zero_has_no_change_of_sign() -> None:
    assert curves.roots((curves.points(N) - 0.1) ** 2 + 1e-14).size == 0
    assert curves.roots(np.zeros(N)).size == 0


def test_maximum_lies_between_the_points() -> None:
    s = curves.points(N)
    at, height = curves.maximum(np.cos(2 * (s - 0.123)))
    assert at == pytest.approx(0.123, abs=1e-12)
    assert height == pytest.approx(1, abs=1e-14)


def test_largest_of_several_maxima_is_taken() -> None:
    s = curves.points(65)
    at, height = curves.maximum(np.cos(3 * np.pi * s) + 0.1 * s)
    assert at == pytest.approx(2 / 3, abs=2e-3)
    assert height > np.max(np.cos(3 * np.pi * s) + 0.1 * s)


@pytest.mark.parametrize(("sign", "end"), [(1, 1.0), (-1, -1.0)])
def test_maximum_of_a_monotonic_curve_is_at_its_end(sign: int, end: float) -> None:
    at, height = curves.maximum(np.exp(sign * curves.points(N)))
    assert at == end
    assert height == pytest.approx(np.e, abs=1e-13)


def test_maximum_after_a_start_may_be_at_the_start_itself() -> None:
    s = curves.points(N)
    at, height = curves.maximum(-(s**2), start=0.3171)
    assert at == 0.3171
    assert height == pytest.approx(-(0.3171**2), abs=1e-15)


def test_maximum_before_the_start_does_not_count() -> None:
    s = curves.points(N)
    at, _ = curves.maximum(np.cos(4 * np.pi * s) * (2 - s), start=0.1)
    assert at == pytest.approx(0.5, abs=0.01)


def test_curve_of_two_points_is_a_line() -> None:
    line = np.array([-1.0, 3.0])
    assert curves.integral(line, 2.0) == pytest.approx(2.0)
    assert curves.maximum(line) == (1.0, 3.0)
    np.testing.assert_allclose(curves.roots(line), [-0.5], atol=1e-15)


@pytest.mark.parametrize("height", [0.1, 0.7, -0.3, 1.36501297])
def test_maximum_of_a_constant_between_two_points_is_the_constant(height: float) -> None:
    assert curves.maximum(np.full(2, height))[1] == pytest.approx(height, rel=1e-15)


def test_tail_tells_a_resolved_curve_from_a_coarse_one() -> None:
    assert curves.tail(np.sin(3 * curves.points(33))) < curves.RESOLVED
    assert curves.tail(np.sin(30 * curves.points(17))) > 1e-2


def test_tail_is_that_of_the_worst_column() -> None:
    s = curves.points(17)
    worst = curves.tail(np.sin(30 * s))
    assert curves.tail(np.column_stack([s, np.sin(30 * s), s**2])) == pytest.approx(worst)
