"""Mode sequences that may follow an event."""

import pytest

import gaitopt as go
from gaitopt import Cycle, Mode, ModeSequence
from gaitopt.branches.change import simulated_gait, successors
from gaitopt.branches.curve import Metric, first_point
from gaitopt.branches.monitors import MonitorKey, MonitorValue
from gaitopt.model.transitions import transitions
from gaitopt.model.walkers.compass_biped import CompassBiped

TABLE = transitions(CompassBiped)
T, F, B = Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD


def proposed(phases: tuple[Mode, ...], impact: Mode, kind: str, phase: int | None, where: float) -> list[Cycle]:
    return successors(TABLE, Cycle.of_one_step(phases, impact), [(MonitorKey(kind, phase), MonitorValue(0.0, where))])


@pytest.mark.parametrize(
    ("phases", "impact", "kind", "phase", "where", "first"),
    [
        ((T,), T, "cone_forward", 0, 0.0, ((F, T), T)),
        ((T,), T, "cone_forward", 0, 1.0, ((T, F), T)),
        ((T,), T, "cone_backward", 0, 0.5, ((T, B, T), T)),
        ((F, T), T, "cone_backward", 1, 1.0, ((F, T, B), T)),
        ((F, T, B), T, "duration", 2, 1.0, ((F, T), T)),
        ((T, F, T), T, "duration", 1, 1.0, ((T,), T)),
        ((F, T), F, "duration", 0, 1.0, ((T,), T)),
        ((F,), F, "slip_velocity", 0, 0.5, ((F, T, F), F)),
        ((T,), T, "impulse_cone_forward", None, 1.0, ((F, T), F)),
        ((F, T, B), T, "impulse_cone_forward", None, 1.0, ((F, T, B), F)),
        ((F, T), F, "impact_slip_velocity", None, 1.0, ((T,), T)),
    ],
)
def test_the_first_proposal_is_what_the_physics_suggests(phases, impact, kind, phase, where, first):
    assert proposed(phases, impact, kind, phase, where)[0] == Cycle.of_one_step(*first)


@pytest.mark.parametrize("kind", ["cone_forward", "slip_velocity", "duration"])
@pytest.mark.parametrize("phases", [(T,), (F, T), (F, T, B), (B, F, T, B)])
def test_proposals_differ_from_the_old_sequence_and_from_each_other_and_never_repeat_a_mode(phases, kind):
    for phase in (k for k, mode in enumerate(phases) if kind == "duration" or kind in TABLE.of(mode)):
        found = proposed(phases, T, kind, phase, 0.5)
        assert Cycle.of_one_step(phases, T) not in found
        assert len(set(found)) == len(found)
        assert all(a is not b for c in found for a, b in zip(c.phases, c.phases[1:], strict=False))


def test_a_slipping_impact_is_followed_by_its_slip() -> None:
    for kind in ("duration", "slip_velocity"):
        for cycle in proposed((F, T), F, kind, 0, 0.5):
            assert cycle.impact is T or cycle.phases[0] is cycle.impact


def test_an_impact_that_slips_changes_the_step_that_it_ends_and_the_one_that_follows() -> None:
    cycle = Cycle((ModeSequence((T,), T), ModeSequence((F, T), T)))
    first, *_ = successors(TABLE, cycle, [(MonitorKey("impulse_cone_backward", step=0), MonitorValue(0.0))])
    assert first == Cycle((ModeSequence((T,), B), ModeSequence((B, F, T), T)))
    last, *_ = successors(TABLE, cycle, [(MonitorKey("impulse_cone_forward", step=1), MonitorValue(0.0))])
    assert last == Cycle((ModeSequence((F, T), T), ModeSequence((F, T), F)))


def test_a_phase_is_edited_within_its_own_step() -> None:
    cycle = Cycle((ModeSequence((T, B), T), ModeSequence((F, T), T)))
    first, *_ = successors(TABLE, cycle, [(MonitorKey("duration", 2), MonitorValue(0.0))])
    assert first == Cycle((ModeSequence((T, B), T), ModeSequence((T,), T)))


@pytest.mark.parametrize("name", ["compass-passive-a", "heel-toe"])
def test_fixed_point_of_the_simulated_return_map_is_the_gait_and_keeps_its_direction(name):
    gait = go.solve(name)
    slope = "walker.slope"
    here = first_point(gait, slope, Metric.of(gait, 0.01), -1.0)
    found = simulated_gait(here, 0.0)
    assert found is not None
    assert found.gait.state == pytest.approx(gait.state, abs=1e-10)
    assert found.direction == pytest.approx(here.direction, abs=1e-6)
    ahead = simulated_gait(here, -1e-4)
    assert ahead is not None
    assert ahead.value == pytest.approx(gait.dynamics.parameter(slope) - 1e-4, abs=1e-15)
    assert ahead.gait.state == pytest.approx(go.solve(gait.problem.replace({slope: ahead.value})).state, abs=1e-10)
