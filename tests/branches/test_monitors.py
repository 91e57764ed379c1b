"""Monitors hold on good gaits and see a spoilt one; test functions of special points on multipliers that are known."""

from dataclasses import replace

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt import Gait
from gaitopt.branches import monitors
from gaitopt.branches.monitors import monitor_values
from gaitopt.gait.trace import MonitorKey

NAMES = ("rimless-wheel-stick", "rimless-wheel-slip", "compass-passive-stick", "compass-passive-a", "compass-passive-b")


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
def test_everything_holds_on_a_gait_and_durations_are_parts_of_its_period(name: str) -> None:
    found = monitor_values(named(name))
    assert lost(named(name)) == set()
    assert all(0 <= monitor.where <= 1 for monitor in found.values())
    durations = [monitor.value for key, monitor in found.items() if key.kind == "duration"]
    assert not durations or sum(durations) == pytest.approx(1, abs=1e-12)


def test_less_friction_than_sticking_or_the_impact_needs_or_a_pull_upwards_is_seen() -> None:
    gait, start, impact = (
        named("compass-passive-stick"),
        MonitorKey("cone_forward", 0),
        MonitorKey("impulse_cone_forward"),
    )
    needed, ratio = gait.measures["required_friction"], abs(gait.measures["impulse_ratio"])
    assert lost(with_parameter(gait, "friction", needed + 1e-9)) == set()
    spoilt = with_parameter(gait, "friction", needed - 1e-9)
    assert lost(spoilt) == {start}
    assert monitor_values(spoilt)[start].where == 0
    assert monitor_values(with_parameter(gait, "friction", ratio))[impact].value == pytest.approx(0, abs=1e-12)
    for change, seen in ((-1e-9, True), (1e-9, False)):
        assert (impact in lost(with_parameter(gait, "friction", ratio + change))) is seen
    assert MonitorKey("normal_force", 0) in lost(with_parameter(gait, "walker.gravity", -1.0))


@pytest.mark.parametrize(
    ("phase", "name"), [(0, "compass-passive-a"), (2, "compass-passive-a"), (1, "rimless-wheel-slip")]
)
def test_a_slip_against_its_mode_is_seen(name: str, phase: int) -> None:
    assert MonitorKey("slip_velocity", phase) in lost(with_slip_velocity(named(name), phase, -1.0))
    fading = named("compass-passive-b")  # it dips below zero within its phase
    assert MonitorKey("slip_velocity", 0) in lost(with_slip_velocity(fading, 0, 1.0, -0.01 * fading.state[-1]))


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
    gait = named("compass-passive-stick")
    (arc,) = gait.arcs
    where = (arc.times - arc.start) / arc.duration
    apart = arc.states[:, 1] - arc.states[:, 0]
    states = arc.states.copy()
    states[:, 1] -= 1.5 * apart * np.exp(-(((where - 0.7) / 0.1) ** 2))
    step = replace(gait.steps[0], arcs=(replace(arc, states=states),))
    assert lost(replace(gait, steps=(step,))) >= {MonitorKey("touchdown", 0)}


def critical(*multipliers: complex) -> dict[str, float]:
    return monitors.test_functions(np.array(multipliers, dtype=complex), 0.3)


def test_a_multiplier_that_passes_minus_one_doubles_the_period_and_a_pair_that_leaves_the_circle_is_a_torus() -> None:
    before, after = critical(-0.99, 0.4, 0.1), critical(-1.01, 0.4, 0.1)
    assert list(monitors.bifurcations_between(before, after)) == ["period_doubling"]
    pair = np.exp(1.1j)
    before, after = (critical(r * pair, r * pair.conjugate(), 0.2) for r in (0.99, 1.01))
    assert list(monitors.bifurcations_between(before, after)) == ["neimark_sacker"]
    assert monitors.is_bifurcation("neimark_sacker", np.array([pair, pair.conjugate(), 0.2]))
    assert critical(0.7)["neimark_sacker"] == 1.0  # a single multiplier has no pair
    for rest in ([0.2], [0.3 + 0.1j, 0.3 - 0.1j]):  # nor is a neutral saddle a torus
        assert not monitors.is_bifurcation("neimark_sacker", np.array([2.0, 0.5, *rest], dtype=complex))


MAPS = {
    "fold": (lambda x: 2 * x, lambda x: 1 - 2 * x),
    "transcritical": (lambda x: 1.0, lambda x: 1 - x),
    "pitchfork, handle": (lambda x: 1.0, lambda x: 1 + x),
    "pitchfork, prongs": (lambda x: 2 * x, lambda x: 1 - 2 * x**2),
}
"""Derivative of the parameter m and multiplier, along fixed points of x + m - x^2 (over x, m = x^2), of x + m x - x^2
(x = m, over m) and of x + m x - x^3 (x = 0 over m, and m = x^2 over x)."""


@pytest.mark.parametrize("name", MAPS)
def test_folds_and_branch_points_of_normal_forms_are_told_apart(name: str) -> None:
    slope, multiplier = MAPS[name]
    before, after = (monitors.test_functions(np.array([multiplier(x), 0.3 + 0j]), slope(x)) for x in (-0.1, 0.1))
    kind = "fold" if name == "fold" else "branch_point"
    test = "unit" if slope(-0.1) * slope(0.1) > 0 else "slope"
    assert monitors.bifurcations_between(before, after) == {kind: test}


@pytest.mark.parametrize(("kind", "critical"), [("period_doubling", -1.0), ("fold", 1.0), ("branch_point", 1.0)])
def test_a_multiplier_that_passes_through_infinity_is_no_bifurcation(kind, critical):
    assert monitors.is_bifurcation(kind, np.array([critical * (1 + 1e-9), 0.2]))
    assert not monitors.is_bifurcation(kind, np.array([-3e12, 0.2]))
