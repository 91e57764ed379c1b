"""A margin that has risen and falls again before its end."""

from itertools import pairwise

import numpy as np
import pytest

from gaitopt.gait import curves
from gaitopt.gait.curves import lowest_after_rise


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
