"""The ends of a walk along a family: at its bounds, from either side, and when it has taken all it may."""

import pytest

from gaitopt.branches.request import Request

REQUEST = Request(parameter="friction", to=(0.8,), lower=0.2, upper=0.8, max_points=10, max_seconds=5.0)


@pytest.mark.parametrize(
    ("before", "after", "bound"),
    [(0.7, 0.9, 0.8), (0.7, 0.8, 0.8), (0.3, 0.1, 0.2), (0.3, 0.7, None), (0.8, 0.7, None), (0.8, 0.9, None)],
)
def test_a_bound_is_crossed_from_inside_only(before, after, bound):
    assert REQUEST.crossed(before, after) == bound


def test_a_walk_that_was_cut_short_at_a_bound_has_reached_it():
    assert REQUEST.reached(0.8) == "reached friction = 0.8"
    assert REQUEST.reached(0.2) == "reached friction = 0.2"
    assert REQUEST.reached(0.5) is None


def test_points_and_time_are_bounded_each():
    assert REQUEST.exhausted(9, 4.9) is None
    assert REQUEST.exhausted(10, 0.0) == "paused at the limit of 10 points"
    assert REQUEST.exhausted(0, 5.1) == "paused at the limit of 5 s"
