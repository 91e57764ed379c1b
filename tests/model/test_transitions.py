"""The table of transitions against the mechanics: what each event of a walker does, and what may follow it."""

import numpy as np
import pytest
from contact_problems import PointFeet
from foot_impacts import around

from gaitopt import Cycle, Mode
from gaitopt.model.control import NoControl
from gaitopt.model.friction import STATIC_KINETIC, shared_friction
from gaitopt.model.registry import registered_walkers
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import transitions
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.hopper import Hopper
from gaitopt.model.walkers.kneed import KneedWalker

REGISTERED = sorted(registered_walkers().values(), key=lambda walker: walker.model)
WALKERS = [walker for walker in REGISTERED if not walker.contacts]
TABLES = [transitions(walker) for walker in WALKERS]
IDS = [walker.model for walker in WALKERS]


@pytest.mark.parametrize("table", TABLES, ids=IDS)
def test_every_event_ends_the_motion_or_leads_to_modes_of_the_walker(table):
    for mode in table.modes:
        assert ("normal_force" in table.of(mode)) == bool(mode.touching)
        for transition in table.of(mode).values():
            assert (transition.ending is None) == bool(transition.candidates)
            assert set(transition.candidates) <= {*table.modes}
            assert mode not in transition.candidates or transition.at_rest or transition.ends_step
            for after in {*transition.candidates} - {mode} if not transition.ends_step else ():
                event = table.between(mode, after)
                assert after in event.candidates
                assert not event.ends_step
    assert all(mode.touching for mode in table.landed)


@pytest.mark.parametrize("table", TABLES, ids=IDS)
def test_every_mode_can_be_reached_from_the_modes_after_an_impact(table):
    reached = set[Mode]()
    frontier = {*table.landed}
    while frontier:
        reached |= frontier
        frontier = {after for mode in frontier for row in table.of(mode).values() for after in row.candidates} - reached
    assert reached == {*table.modes}


@pytest.mark.parametrize("walker", WALKERS, ids=IDS)
def test_the_compiled_margins_are_those_of_the_table(walker):
    system = HybridSystem(walker, NoControl(), friction=STATIC_KINETIC)
    table = system.transitions
    for mode in table.modes:
        assert system.margins(mode).numel_out(0) == len(table.of(mode))
    for impact in {mode.contact for mode in table.landed}:
        struck, before = around(system, impact)
        assert system.impact_margins(struck, before).numel_out(0) == len(table.of_impact(struck, before))


@pytest.mark.parametrize("walker", WALKERS, ids=IDS)
def test_a_cycle_that_no_event_goes_through_is_refused(walker):
    table = transitions(walker)
    lands = [mode for mode in table.modes if any(row.ends_step for row in table.of(mode).values())]
    for last in {*table.modes} - {*lands}:
        with pytest.raises(ValueError, match=r"stops|flight"):
            table.check(Cycle.of_one_step((last,), table.landed[0].contact))


def test_an_end_of_the_step_that_no_event_reaches_is_an_error():
    with pytest.raises(ValueError, match="no event of the kneed_walker leads"):
        transitions(KneedWalker).between(Mode("stick, knee free"), None)


def test_margins_that_an_event_makes_zero_are_zero_there():
    """The force of a massless leg's spring vanishes where it takes off, and with it both margins of the cone."""
    massless = next(table for table in TABLES if table.walker.massless_feet and table.walker.flies)
    stick = next(mode for mode in massless.modes if mode.sticks)
    takes_off = massless.between(stick, stick.with_contact(Mode.FLIGHT))
    assert takes_off.zeros == ("normal_force", "cone_forward", "cone_backward")
    system = HybridSystem(massless.walker, NoControl())
    rng = np.random.default_rng(0)
    z, p = rng.normal(size=system.n_z), rng.uniform(0.5, 1.5, len(system.parameters))
    cone = dict(zip(massless.of(stick), np.asarray(system.margins(stick)(0, z, p, [])).ravel(), strict=True))
    assert cone["cone_forward"] + cone["cone_backward"] == pytest.approx(2 * p[-1] * cone["normal_force"])


def test_a_foot_must_move_up_where_the_impact_of_a_stop_lifts_it_and_not_where_it_is_in_flight() -> None:
    table = transitions(Hopper)
    flight, stops = Mode("flight, leg locked, thrust on"), {"leg": "free", "thrust": "on"}
    assert [*table.of_impact(flight, Mode.of(Mode.STICK, stops))] == ["lift_velocity"]
    assert not table.of_impact(flight, Mode.of(Mode.FLIGHT, stops))


def test_feet_swap_places_and_back() -> None:
    assert CompassBiped.swapped(Mode.SLIP_FORWARD) == "foot: off, swing_foot: slip_forward"
    for walker in REGISTERED:
        for mode in walker.foot_modes():
            assert walker.swapped(walker.swapped(mode)) is mode


def test_static_friction_may_hold_a_slipping_impact_on_one_contact_whatever_its_name() -> None:
    laws = shared_friction(PointFeet.contacts, STATIC_KINETIC)
    slips, before = Mode("foot: off, other: slip_forward"), Mode("foot: stick, other: off")
    assert "impact_onset.other" in transitions(PointFeet, laws).of_impact(slips, before)
    slips, before = CompassBiped.swapped(Mode.SLIP_FORWARD), Mode.STICK
    assert "impact_onset" in transitions(CompassBiped, STATIC_KINETIC).of_impact(slips, before)
