"""Mode sequences that may follow an event, and how far from it they are tried."""

from itertools import pairwise
from types import SimpleNamespace
from typing import cast

import pytest

import gaitopt as go
from gaitopt import Cycle, Mode, ModeSequence
from gaitopt.branches.change import _ahead, simulated_gait, size_of, successors
from gaitopt.branches.curve import CurvePoint, Metric, first_point
from gaitopt.branches.monitors import MonitorValue
from gaitopt.gait.trace import MonitorKey
from gaitopt.model.transitions import transitions
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.heel_toe import HeelToe

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
@pytest.mark.parametrize(
    ("phases", "impact"), [((T,), T), ((F, T), T), ((F, T, B), T), ((B, F, T, B), T), ((F, T), F)], ids=str
)
def test_proposals_differ_never_repeat_a_mode_and_begin_with_the_slip_of_their_impact(phases, impact, kind):
    for phase in (k for k, mode in enumerate(phases) if kind == "duration" or kind in TABLE.of(mode)):
        found = proposed(phases, impact, kind, phase, 0.5)
        assert Cycle.of_one_step(phases, impact) not in found
        assert len(set(found)) == len(found)
        for cycle in found:
            assert all(a is not b for a, b in pairwise(cycle.phases))
            assert cycle.impact is T or cycle.phases[0] is cycle.impact


def test_an_impact_that_slips_changes_the_step_that_follows_too_and_a_phase_is_edited_within_its_own_step() -> None:
    def first(key: MonitorKey, *steps: tuple[Mode, ...]) -> Cycle:
        cycle = Cycle(tuple(ModeSequence(phases, T) for phases in steps))
        return successors(TABLE, cycle, [(key, MonitorValue(0.0))])[0]

    slips = first(MonitorKey("impulse_cone_backward", step=0), (T,), (F, T))
    assert slips == Cycle((ModeSequence((T,), B), ModeSequence((B, F, T), T)))
    last = first(MonitorKey("impulse_cone_forward", step=1), (T,), (F, T))
    assert last == Cycle((ModeSequence((F, T), T), ModeSequence((F, T), F)))
    assert first(MonitorKey("duration", 2), (T, B), (F, T)) == Cycle((ModeSequence((T, B), T), ModeSequence((T,), T)))


def test_a_landing_that_slips_changes_the_phase_that_follows_it() -> None:
    cycle = go.load_problem("heel-toe-slip").cycle
    key = MonitorKey("impulse_cone_forward.toe", 5)  # in the second of two steps of four phases
    unchanged, slips = successors(transitions(HeelToe), Cycle(cycle.steps * 2), [(key, MonitorValue(0.0))])[0].steps
    assert (unchanged,) == cycle.steps
    expected = "heel slip_forward, heel stick, toe slip_forward, toe stick, toe slip_backward; heel stick"
    assert str(Cycle((slips,))) == expected


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
    assert _ahead(here, -1e-4) == pytest.approx(here.at_parameter(ahead.value).at.w, abs=1e-4)


def test_the_simulated_return_map_shows_that_a_foot_slips_if_friction_falls_below_the_one_that_it_needs():
    gait = go.solve("compass-passive-stick")
    needed = gait.scalar("required_friction")
    gait = go.solve(gait.problem.replace({"friction": needed + 1e-5}))
    found = simulated_gait(first_point(gait, "friction", Metric.of(gait, 0.01), -1.0), -2e-5)
    assert found is not None
    assert found.value == pytest.approx(needed - 1e-5, abs=1e-15)
    assert found.gait.cycle == Cycle.of_one_step((F, T), T)


@pytest.mark.parametrize(("key", "unit"), [("control.hip", 10 * 9.8 * 1.6), ("friction", 1.0), ("walker.slope", 1.0)])
def test_next_to_zero_the_size_of_a_parameter_is_a_part_of_its_natural_unit(key: str, unit: float) -> None:
    problem = go.load_problem("compass-torque-stick")  # two legs of 4 kg and 1.6 m with a hip of 2 kg
    sizes = [
        size_of(cast(CurvePoint, SimpleNamespace(value=value, problem=problem, curve=SimpleNamespace(parameter=key))))
        for value in (0.0, -1e-9, 2 * unit)
    ]
    assert sizes == pytest.approx([0.01 * unit, 0.01 * unit, 2 * unit])
