"""Events within one integration step, on margins with known roots."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from gaitopt.model.transitions import kind, transitions
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.heel_toe import HeelToe
from gaitopt.model.walkers.kneed import KneedWalker
from gaitopt.simulation.events import (
    EDGE,
    INSTANT,
    LOOK_AHEAD,
    PRIORITY,
    Point,
    coincides,
    event_at_start,
    falls_at_start,
    first_event,
    is_armed,
    lift,
    priority,
    refine,
)

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


@settings(max_examples=40)
@given(root=st.floats(1e-3, 0.999), slope=st.floats(0.1, 1e3), bend=st.floats(-1.0, 1.0))
def test_a_root_is_found_wherever_it_lies_in_the_step(root: float, slope: float, bend: float) -> None:
    monotone = slope * (Polynomial([root, -1.0]) + bend / 3 * Polynomial([-root, 1.0]) ** 3)
    found = event([monotone])
    assert found is not None
    assert found[1] == pytest.approx(root, abs=1e-14)


def near(root: float) -> Polynomial:
    """A parabola that is negative near a root, between two that are close to each other."""
    return from_roots(root, 0.9 - root)


@pytest.mark.parametrize(
    ("margin", "armed", "root"),
    [
        (Polynomial([-0.5, 1.0]), False, None),  # it rises through zero
        (Polynomial([0.0, -1.0]), False, None),  # it stays negative
        (Polynomial([1e-16, -1.0]), False, None),
        (from_roots(0.2, 0.7, sign=-1), False, 0.7),  # it rises, and falls again within the step
        (Polynomial([-0.26, 1.0, -1.0]), False, None),  # its rise stays below zero
        (Polynomial([0.0, -1.0]), True, 0.0),  # it falls from its edge
        *((near(0.45 - half), True, 0.45 - half) for half in (0.2, 1e-2, 1e-4, 3e-6)),  # the first of two roots
        *((from_roots(0.45, 0.45) + above, True, None) for above in (1e-9, 0.0, -EDGE / 2)),  # it grazes zero
        (from_roots(0.45, 0.45) - 1e-9, True, 0.45 - np.sqrt(1e-9)),
    ],
)
def test_a_margin_that_is_armed_or_has_risen_fires_where_it_falls_through_zero(margin, armed, root):
    found = event([margin], armed=[armed])
    assert (found is None) is (root is None)
    assert root is None or found[1] == pytest.approx(root, abs=4e-10)
    assert root is None or abs(margin(found[1])) < 1e-14


def test_the_earliest_event_counts() -> None:
    found = event([Polynomial([0.8, -1.0]), Polynomial([1.0]), Polynomial([0.9, -1.0]), Polynomial([0.3, -1.0])])
    assert found is not None
    assert (found[0], found[1]) == ("slip_velocity", pytest.approx(0.3))


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
    tables = [transitions(CompassBiped), transitions(KneedWalker), transitions(HeelToe)]
    names = {
        kind(name)
        for table in tables
        for mode in table.modes
        if len(mode.touching) < 3
        for name in table.margin_names(mode)
    }
    assert set(PRIORITY) == names - set(KneedWalker.stops) | {""}
    assert priority("touchdown") < priority("knee") < priority("slip_velocity")


# the start of an arc


@pytest.mark.parametrize(
    ("margin", "rate", "bend", "expected"),
    [
        (0.0, 1.0, 0.0, False),
        (0.0, -1.0, 0.0, True),
        (0.0, 0.0, 1.0, False),
        (0.0, 0.0, -1.0, True),
        (0.0, -1e-14, 1.0, False),
        (0.0, 1e-14, -1.0, True),
        (0.0, -1e-8, 1e-3, False),
        (0.0, -1e-7, 1e-3, True),
        (-1e-3, 5.0, 0.0, True),
        (-1e-11, 1.0, 0.0, False),
        (1e-11, -1.0, 0.0, False),
    ],
)
def test_a_margin_at_its_edge_falls_or_leaves_it_by_its_first_derivative_that_is_not_zero(margin, rate, bend, expected):
    assert falls_at_start("upright", margin, rate, bend) == expected
    several = falls_at_start("upright", *(np.full(2, value) for value in (margin, rate, bend)))
    assert several.tolist() == [expected] * 2
    assert not falls_at_start("touchdown", margin, rate, bend)
    assert falls_at_start("painleve", margin, rate, bend) == (margin <= EDGE)


def start_of(*margins: Polynomial) -> str | None:
    def rates(t: float) -> list[float]:
        return [m.deriv()(t) for m in margins]

    return event_at_start(NAMES[: len(margins)], [m(0.0) for m in margins], rates(0.0), lambda: rates(LOOK_AHEAD))


def test_of_the_margins_that_do_not_hold_at_the_start_the_first_by_priority_counts() -> None:
    assert start_of(Polynomial([-1.0]), Polynomial([1.0])) is None
    assert start_of(Polynomial([1.0]), Polynomial([-1e-3]), Polynomial([-1.0])) == "normal_force"
    assert start_of(Polynomial([1.0]), Polynomial([-1e-3]), Polynomial([1.0])) == "upright"
    # where the rate is zero, the bend is looked for
    assert start_of(Polynomial([1.0]), Polynomial([0.0, 0.0, -1.0])) == "upright"
    assert start_of(Polynomial([1.0]), Polynomial([0.0, 0.0, 1.0])) is None


def test_no_lifted_margin_starts_at_zero_and_only_one_that_is_armed_starts_above() -> None:
    for margin in (0.0, EDGE / 3, -EDGE / 3):
        for rate in (-1.0, 0.0, 1.0):
            assert margin + lift("touchdown", margin, rate) < 0
            assert margin + lift("upright", margin, rate) > 0
            assert not is_armed("touchdown", margin)
    assert 0 < lift("slip_velocity", 0.0, 1.0) < 1e-17
    dipping = Polynomial([0.0, -1e-5, 1e5])
    lowest = dipping(-dipping.coef[1] / (2 * dipping.coef[2]))
    assert not falls_at_start("slip_velocity", *dipping.coef[:2], 2 * dipping.coef[2])
    assert lowest + lift("slip_velocity", *dipping.coef[:2]) > 0


@pytest.mark.parametrize("depth", [1.0, 1e-3, 1.1 * EDGE])
def test_the_root_of_a_lifted_margin_leads_to_that_of_the_margin(depth: float) -> None:
    dip = from_roots(0.45, 0.45) - depth
    root, lifted = (max(0.0, 0.45 - np.sqrt(depth - lifted)) for lifted in (0.0, EDGE))
    at = _motion([dip + 0.0])
    time, state = refine(0, at(0.45 - np.sqrt(depth + 0.0) + EDGE), lambda point, duration: at(point.time + duration))
    assert lifted >= root
    assert time == pytest.approx(0.45 - np.sqrt(depth), abs=1e-10)
    assert state[0] == pytest.approx(time, abs=1e-15)


def test_margins_that_fall_within_an_instant_coincide() -> None:
    assert coincides(0.0, -1.0)
    assert coincides(5e-13, -1.0)
    assert not coincides(5e-13, 1.0)
    assert not coincides(INSTANT, -1.0)
