"""Curves by Chebyshev values: integrals, roots and extrema against closed forms; margins that fall early."""

from itertools import pairwise

import numpy as np
import pytest

from gaitopt.gait import curves
from gaitopt.gait.curves import lowest_after_rise

N = 33


def test_coefficients_of_a_chebyshev_polynomial_are_one_one() -> None:
    s = curves.points(9)
    assert (s[0], s[-1]) == (-1.0, 1.0)
    assert np.all(np.diff(s) > 0)
    table = np.column_stack([np.cos(k * np.arccos(s)) for k in range(9)])
    np.testing.assert_allclose(curves.coefficients(table), np.eye(9), atol=1e-14)


@pytest.mark.parametrize(
    ("function", "duration", "integral", "absolute"),
    [
        (lambda t: np.sin(3 * t), 2.5, (1 - np.cos(7.5)) / 3, None),
        (lambda t: np.sin(np.pi * t), 2.0, 0.0, 4 / np.pi),  # two arches
        (lambda t: -np.exp(t), 0.7, 1 - np.exp(0.7), np.exp(0.7) - 1),
    ],
)
def test_integrals_are_exact_and_absolute_ones_count_both_signs(function, duration, integral, absolute) -> None:
    values = function(duration * (curves.points(N) + 1) / 2)
    assert curves.integral(values, duration) == pytest.approx(integral, abs=1e-14)
    assert absolute is None or curves.absolute_integral(values, duration) == pytest.approx(absolute, abs=1e-13)


@pytest.mark.parametrize(
    ("function", "roots"),
    [
        (lambda s: np.cos(4 * np.pi * s), np.array([-7, -5, -3, -1, 1, 3, 5, 7]) / 8),
        (lambda s: (s - 0.5) * (s - 0.53), [0.5, 0.53]),
        (lambda s: (s - 0.1) ** 2 + 1e-14, []),  # it touches zero
        (np.zeros_like, []),
    ],
)
def test_roots_are_all_changes_of_sign(function, roots) -> None:
    np.testing.assert_allclose(curves.roots(function(curves.points(N))), roots, atol=1e-13)


@pytest.mark.parametrize(
    ("function", "start", "at", "height"),
    [
        (lambda s: np.cos(2 * (s - 0.123)), -1.0, pytest.approx(0.123, abs=1e-12), 1.0),
        (lambda s: np.cos(4 * np.pi * s) * (2 - s), 0.1, pytest.approx(0.5, abs=0.01), None),  # not the one before
        (lambda s: -(s**2), 0.3171, 0.3171, -(0.3171**2)),
        (np.exp, -1.0, 1.0, np.e),
        (lambda s: np.exp(-s), -1.0, -1.0, np.e),
    ],
)
def test_maximum_lies_between_the_points_or_at_an_end(function, start, at, height) -> None:
    place, value = curves.maximum(function(curves.points(N)), start=start)
    assert place == at
    assert height is None or value == pytest.approx(height, abs=1e-13)


def test_curve_of_two_points_is_a_line() -> None:
    line = np.array([-1.0, 3.0])
    assert curves.integral(line, 2.0) == pytest.approx(2.0)
    assert curves.maximum(line) == (1.0, 3.0)
    np.testing.assert_allclose(curves.roots(line), [-0.5], atol=1e-15)
    for height in (0.1, 0.7, -0.3, 1.36501297):
        assert curves.maximum(np.full(2, height))[1] == pytest.approx(height, rel=1e-15)


def test_tail_tells_a_resolved_curve_from_a_coarse_one_by_its_worst_column() -> None:
    assert curves.tail(np.sin(3 * curves.points(33))) < curves.RESOLVED
    s = curves.points(17)
    worst = curves.tail(np.sin(30 * s))
    assert worst > 1e-2
    assert curves.tail(np.column_stack([s, np.sin(30 * s), s**2])) == pytest.approx(worst)


def arcs(function, *ends: float):
    """Times and values of ``function`` on arcs between ``ends``."""
    times = [a + (b - a) * (curves.points(33) + 1) / 2 for a, b in pairwise(ends)]
    return times, [function(t) for t in times]


@pytest.mark.parametrize("ends", [(0, 1), (0, 0.25, 1), (0, 0.1, 0.5, 1)])
def test_the_lowest_minimum_after_the_rise_does_not_depend_on_the_arcs(ends):
    lowest, at = lowest_after_rise(*arcs(lambda t: np.sin(4 * np.pi * t) + t, *ends))
    exact = (np.arccos(-1 / (4 * np.pi)) * -1 + 2 * np.pi) / (4 * np.pi)
    assert at == pytest.approx(exact, abs=1e-9)
    assert lowest == pytest.approx(np.sin(4 * np.pi * exact) + exact, abs=1e-12)


def test_a_margin_that_dips_before_it_rises_has_not_fallen():
    lowest, at = lowest_after_rise(*arcs(lambda t: t * (t - 0.3) * (1 - t), 0, 1))
    assert lowest == np.inf
    assert at == 1


def test_a_margin_that_only_falls_at_its_end_has_no_early_fall():
    assert lowest_after_rise(*arcs(lambda t: np.sin(np.pi * t), 0, 0.5, 1))[0] == np.inf


def test_arcs_without_duration_are_left_out():
    times, values = arcs(lambda t: np.cos(1e6 * np.pi * t), 0, 1e-6)
    later, rising = arcs(lambda t: np.sin(np.pi * t), 1e-6, 1)
    assert lowest_after_rise(times + later, values + rising)[0] == np.inf
