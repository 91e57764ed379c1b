"""Events within one integration step, on margins with known roots."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from gaitopt.mechanics import Mode, margin_names
from gaitopt.simulation.events import EDGE, PRIORITY, Point, first_event, violated

NAMES = ("touchdown", "upright", "normal_force", "slip_velocity", "painleve")


def event(
    margins: Sequence[Polynomial], names: Sequence[str] = NAMES, armed: Sequence[bool] | None = None, end: float = 1.0
) -> tuple[str, float, np.ndarray] | None:
    """First event of polynomial margins in a step from 0 to ``end``; the state is time itself."""
    names = names[: len(margins)]
    at = _motion(margins)
    return first_event(names, at(0.0), at(end), armed or [True] * len(names), at)


def _motion(margins: Sequence[Polynomial]) -> Callable[[float], Point]:
    def at(t: float) -> Point:
        return Point(t, np.array([t]), np.ones(1), [m(t) for m in margins], [m.deriv()(t) for m in margins])

    return at


def from_roots(*roots: float, sign: float = 1.0) -> Polynomial:
    return sign * Polynomial.fromroots(roots)


def test_a_simple_root_is_located_to_rounding() -> None:
    curved = Polynomial([np.cos(0.7), -1.0, 0.3, -0.2])
    root = min(r.real for r in curved.roots() if abs(r.imag) < 1e-12 and 0 < r.real < 1)
    found = event([curved])
    assert found is not None
    assert found[0] == "touchdown"
    assert found[1] == pytest.approx(root, rel=1e-14)
    assert found[2][0] == pytest.approx(root, rel=1e-14)


@given(root=st.floats(1e-3, 0.999), slope=st.floats(0.1, 1e3), bend=st.floats(-1.0, 1.0))
def test_a_root_is_found_wherever_it_lies_in_the_step(root: float, slope: float, bend: float) -> None:
    monotone = slope * (Polynomial([root, -1.0]) + bend / 3 * Polynomial([-root, 1.0]) ** 3)
    found = event([monotone])
    assert found is not None
    assert found[1] == pytest.approx(root, abs=1e-14)


def test_a_margin_that_rises_through_zero_is_no_event() -> None:
    assert event([Polynomial([-0.5, 1.0])], armed=[False]) is None


def test_a_margin_that_is_not_armed_does_not_fire_while_it_stays_negative() -> None:
    assert event([Polynomial([0.0, -1.0])], armed=[False]) is None
    assert event([Polynomial([1e-16, -1.0])], armed=[False]) is None


def test_a_margin_that_is_not_armed_fires_after_a_rise_within_the_step() -> None:
    found = event([from_roots(0.2, 0.7, sign=-1)], armed=[False])
    assert found is not None
    assert found[1] == pytest.approx(0.7, rel=1e-14)


def test_a_rise_that_stays_below_zero_arms_nothing() -> None:
    assert event([Polynomial([-0.26, 1.0, -1.0])], armed=[False]) is None


def test_two_roots_within_one_step_give_the_first() -> None:
    for half_width in (0.2, 1e-2, 1e-4, 3e-6):
        found = event([from_roots(0.45 - half_width, 0.45 + half_width)])
        assert found is not None
        assert found[1] == pytest.approx(0.45 - half_width, abs=1e-13 / half_width * 1e-2 + 1e-14)


def test_grazing_without_crossing_is_no_event() -> None:
    touching = from_roots(0.45, 0.45)
    assert event([touching + 1e-9]) is None
    assert event([touching]) is None
    assert event([touching - EDGE / 2]) is None
    assert event([touching - 1e-9]) is not None


def test_the_earliest_event_counts() -> None:
    found = event([Polynomial([0.8, -1.0]), Polynomial([1.0]), Polynomial([0.9, -1.0]), Polynomial([0.3, -1.0])])
    assert found is not None
    assert found[0] == "slip_velocity"
    assert found[1] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("names", "winner"),
    [
        (("touchdown", "slip_velocity"), "touchdown"),
        (("touchdown", "cone_forward"), "touchdown"),
        (("touchdown", "normal_force"), "normal_force"),
        (("touchdown", "upright"), "upright"),
        (("cone_forward", "cone_backward", "normal_force"), "normal_force"),
        (("slip_velocity", "painleve"), "painleve"),
    ],
)
def test_simultaneous_events_are_ranked(names: tuple[str, ...], winner: str) -> None:
    margins = [Polynomial([0.5, -1.0]) * (k + 1) for k in range(len(names))]
    for order in (1, -1):
        found = event(margins, names=names[::order])
        assert found is not None
        assert found[0] == winner


def test_every_margin_has_a_rank() -> None:
    assert set(PRIORITY) == {name for mode in Mode for name in margin_names(mode)}


def test_a_margin_that_falls_from_its_edge_fires_at_the_start() -> None:
    found = event([Polynomial([0.0, -1.0])])
    assert found is not None
    assert found[1] == 0.0


def test_a_margin_below_its_edge_is_violated_at_once() -> None:
    point = _motion([Polynomial([1.0]), Polynomial([-1e-3]), Polynomial([-1.0])])(0.0)
    assert violated(NAMES[:3], point, [True, True, True]) == "normal_force"
    assert violated(NAMES[:3], point, [True, True, False]) == "upright"
    assert violated(NAMES[:3], point, [True, False, False]) is None
