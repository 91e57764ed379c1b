"""Monitors hold on good gaits, and see a gait that has been spoilt."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt import Gait, Mode
from gaitopt.branches.monitors import MonitorKey, monitor_values

NAMES = ("rimless-wheel-stick", "rimless-wheel-slip", "compass-passive-stick", "compass-passive-a", "compass-passive-b")


@cache
def solved(name: str) -> Gait:
    return named(name)


def with_parameter(gait: Gait, name: str, value: float) -> Gait:
    """The same motion, judged with another parameter."""
    return replace(gait, dynamics=gait.dynamics.at({name: value}))


def with_slip_velocity(gait: Gait, index: int, factor: float, offset: float = 0.0) -> Gait:
    """The slip velocity of one arc spoilt."""
    arcs = list(gait.arcs)
    states = arcs[index].states.copy()
    states[:, -1] = factor * states[:, -1] + offset
    arcs[index] = replace(arcs[index], states=states)
    return replace(gait, steps=(replace(gait.steps[0], arcs=tuple(arcs)),))


def lost(gait: Gait) -> set[MonitorKey]:
    return {name for name, monitor in monitor_values(gait).items() if monitor.value <= 0}


@pytest.mark.parametrize("name", NAMES)
def test_everything_holds_on_a_gait(name: str) -> None:
    assert lost(solved(name)) == set()


@pytest.mark.parametrize("name", NAMES)
def test_places_lie_within_their_phases(name: str) -> None:
    assert all(0 <= monitor.where <= 1 for monitor in monitor_values(solved(name)).values())


def test_durations_are_parts_of_the_period() -> None:
    found = monitor_values(solved("compass-passive-a"))
    assert sum(found[MonitorKey("duration", phase)].value for phase in range(3)) == pytest.approx(1, abs=1e-12)


def test_less_friction_than_sticking_needs_is_seen_at_the_start_of_the_step() -> None:
    gait = solved("compass-passive-stick")
    needed = gait.measures["required_friction"]
    assert lost(with_parameter(gait, "friction", needed + 1e-9)) == set()
    spoilt = with_parameter(gait, "friction", needed - 1e-9)
    assert lost(spoilt) == {MonitorKey("cone_forward", 0)}
    assert monitor_values(spoilt)[MonitorKey("cone_forward", 0)].where == 0


def test_less_friction_than_the_impact_needs_is_seen() -> None:
    gait = solved("compass-passive-stick")
    ratio = abs(gait.measures["impulse_ratio"])
    assert monitor_values(with_parameter(gait, "friction", ratio))[
        MonitorKey("impulse_cone_forward")
    ].value == pytest.approx(0, abs=1e-12)
    assert MonitorKey("impulse_cone_forward") in lost(with_parameter(gait, "friction", ratio - 1e-9))
    assert MonitorKey("impulse_cone_forward") not in lost(with_parameter(gait, "friction", ratio + 1e-9))


@pytest.mark.parametrize(
    ("phase", "name"), [(0, "compass-passive-a"), (2, "compass-passive-a"), (1, "rimless-wheel-slip")]
)
def test_a_slip_against_its_mode_is_seen(name: str, phase: int) -> None:
    gait = solved(name)
    assert MonitorKey("slip_velocity", phase) in lost(with_slip_velocity(gait, phase, -1.0))


def test_a_slip_that_dips_below_zero_within_its_phase_is_seen() -> None:
    gait = solved("compass-passive-b")
    assert gait.arcs[0].mode is Mode.SLIP_FORWARD
    assert MonitorKey("slip_velocity", 0) in lost(with_slip_velocity(gait, 0, 1.0, -0.01 * gait.state[-1]))


def test_a_walker_that_is_pulled_up_has_no_normal_force() -> None:
    gait = solved("compass-passive-stick")
    assert MonitorKey("normal_force", 0) in lost(with_parameter(gait, "walker.gravity", -1.0))


def test_a_slip_after_the_impact_that_fades_is_seen_before_it_is_gone() -> None:
    values = []
    for friction in (0.28, 0.30, 0.304):
        gait = go.solve(go.load_problem("compass-passive-b").replace({"friction": friction}))
        found = monitor_values(gait)
        values.append((found[MonitorKey("impact_slip_velocity")].value, found[MonitorKey("duration", 0)].value))
    assert np.all(np.diff(values, axis=0) < 0)
    assert np.all(np.array(values) > 0)
    assert values[-1][0] < 0.05 * values[0][0]


def test_a_foot_that_lands_between_is_seen() -> None:
    """The swing leg is bent in mid-step until the foot touches the ground, and lifted again."""
    gait = solved("compass-passive-stick")
    (arc,) = gait.arcs
    where = (arc.times - arc.start) / arc.duration
    apart = arc.states[:, 1] - arc.states[:, 0]
    states = arc.states.copy()
    states[:, 1] -= 1.5 * apart * np.exp(-(((where - 0.7) / 0.1) ** 2))
    step = replace(gait.steps[0], arcs=(replace(arc, states=states),))
    assert lost(replace(gait, steps=(step,))) >= {MonitorKey("touchdown", 0)}
