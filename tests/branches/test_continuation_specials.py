"""Every special point of the families in the paper, against the simulator, which knows nothing of continuation."""

from dataclasses import dataclass, field
from functools import cache
from math import radians, tan

import numpy as np
import pytest
from _pytest.mark import ParameterSet
from named import solved
from oracles import wheel_friction
from simulated_family import SimulatedFamily

import gaitopt as go
from gaitopt import Branch, Cycle, Mode, continuation
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.gait.branch import BranchPoint, SpecialPoint, collected

pytestmark = pytest.mark.portable

AGREEMENT = 1e-9
ASIDE = 1e-5
"""Distance from a special point at which the simulator begins, in units of the parameter."""
FAR, NEARER = 1e-3, 0.3
"""The same where it comes from one side only, and the part of the way that it goes next."""


@dataclass(frozen=True)
class Family:
    """One command: a gait, a parameter and where to go."""

    name: str
    parameter: str
    to: float
    overrides: tuple[tuple[str, float], ...] = ()
    options: tuple[tuple[str, float], ...] = field(default=())


@cache
def branch(family: Family) -> Branch:
    gait = solved(go.load_problem(family.name).replace(dict(family.overrides)))
    return continuation(gait, family.parameter, family.to, **dict(family.options))


def only(family: Family, kind: str, near: float) -> SpecialPoint:
    found = [special for special in branch(family).special(kind) if abs(special.value - near) < 2e-4]
    assert len(found) == 1, branch(family).specials
    return found[0]


def simulated(at: SpecialPoint | BranchPoint, parameter: str, section: Mode) -> SimulatedFamily:
    """Simulated gaits from eight digits of a gait."""
    gait = at.gait
    return SimulatedFamily(gait, parameter, section, np.round(gait.state[gait.system.section(section).indices], 8))


def approached(family: Family, special: SpecialPoint, cycle: Cycle) -> tuple[SimulatedFamily, tuple[float, float]]:
    """Simulated gaits of one sequence, and two values on the way to a special point."""
    points = [point for point in branch(family) if point.gait.problem.cycle == cycle]
    start = min(points, key=lambda point: abs(abs(point.value - special.value) - FAR))
    walk = simulated(start, family.parameter, cycle.impact)
    return walk, (start.value, start.value + NEARER * (special.value - start.value))


def leaves_circle(multipliers: np.ndarray) -> float:
    """A complex pair on the unit circle."""
    assert abs(multipliers[0].imag) > 1e-3
    return abs(multipliers[0]) - 1


def doubles(multipliers: np.ndarray) -> float:
    """A multiplier at -1; others may lie beyond it."""
    return float(np.prod(multipliers + 1).real)


def family(name: str, parameter: str, start: float | None, to: float, **overrides: float) -> Family:
    """The family from ``start`` to ``to``; None starts at the value of the named problem."""
    values = overrides if start is None else {**overrides, parameter: start}
    return Family(name, parameter, to, tuple(values.items()))


def slow(*values: object) -> ParameterSet:
    return pytest.param(*values, marks=pytest.mark.slow)


HIP = Family("compass-torque-stick", "control.hip", 0.3, options=(("max_points", 60),))
CHANGES_OF_MODES = [
    (family("rimless-wheel-stick", "friction", 0.92, 0.91), wheel_friction(radians(13))),
    slow(family("rimless-wheel-slip", "friction", 0.27, 0.22), 0.267571006115),
    (family("compass-passive-stick", "friction", 0.18, 0.172), 0.174918491336),
    (family("compass-passive-stick", "friction", 0.18, 0.172), 0.173080797240),
    slow(family("compass-pd-impact-slip", "friction", 0.11, 0.105), 0.107646200895),
    slow(family("compass-torque-slip", "control.ankle", None, 0.5), 0.534789264505),
]
IMPACT_CHANGES = [
    (family("rimless-wheel-slip", "friction", 0.27, 0.22), 0.245052155579),
    slow(family("compass-passive-b", "friction", 0.3, 0.31), 0.304416755066),
    slow(family("compass-torque-impact-slip", "friction", 0.23, 0.235), 0.232244917992),
    slow(family("compass-pd-impact-slip", "friction", 0.37, 0.38), 0.37694520138),
    slow(family("compass-torque-slip", "control.hip", None, 0.49), 0.501870492312),
    slow(HIP, 0.442508614033),
]
STEEP = family("compass-passive-stick", "walker.slope", None, 0.095, friction=1.0)
STABILITY = [
    (family("compass-passive-a", "friction", 0.112, 0.108), "neimark_sacker", 0.110349580792),
    (family("compass-passive-b", "friction", 0.146, 0.142), "period_doubling", 0.144302180459),
    slow(STEEP, "period_doubling", 0.093312534155),
    slow(family("compass-torque-slip", "friction", 0.106, 0.102), "neimark_sacker", 0.103496337245),
    slow(family("compass-passive-b", "friction", None, 0.045), "period_doubling", 0.048697775116),
    slow(family("compass-pd-impact-slip", "friction", 0.187, 0.182), "period_doubling", 0.184204614123),
    slow(family("compass-torque-slip", "friction", 0.07, 0.062), "period_doubling", 0.067884440242),
]
CRITICAL = {"neimark_sacker": leaves_circle, "period_doubling": doubles}


@pytest.mark.parametrize(("family", "near"), CHANGES_OF_MODES)
def test_modes_change_where_those_of_the_simulated_gait_do(family: Family, near: float) -> None:
    special = only(family, "mode_change", near)
    assert special.status == "converged"
    walk = simulated(special, family.parameter, special.before.impact)
    low, high = special.value - ASIDE, special.value + ASIDE
    assert {walk.modes_at(low), walk.modes_at(high)} == {special.before.phases, special.after.phases}
    assert special.value == pytest.approx(walk.change_of_modes(low, high), rel=0, abs=AGREEMENT)
    assert special.value == pytest.approx(near, rel=0, abs=AGREEMENT)


@pytest.mark.parametrize(("family", "near"), IMPACT_CHANGES)
def test_impact_changes_where_the_impulse_of_the_simulated_gait_reaches_its_cone(family: Family, near: float) -> None:
    special = only(family, "impact_change", near)
    assert special.status == "converged"
    sticks = special.before if special.before.impact is Mode.STICK else special.after
    walk, near_by = approached(family, special, sticks)
    root = walk.approach(walk.impact_margin, *near_by)
    assert special.value == pytest.approx(root, rel=0, abs=AGREEMENT)
    assert special.value == pytest.approx(near, rel=0, abs=AGREEMENT)


@pytest.mark.slow
def test_first_slip_vanishes_where_the_simulated_gait_begins_to_stick_at_once() -> None:
    """It is as short as the simulator's rounding long before that: the sticking side tells where."""
    torque = family("compass-torque-slip", "control.ankle", None, 0.5)
    special = only(torque, "mode_change", 1.2112929)
    walk, near_by = approached(torque, special, special.after)
    root = walk.approach(walk.start_margin, *near_by)
    assert special.value == pytest.approx(root, rel=0, abs=AGREEMENT)


@pytest.mark.parametrize(("family", "kind", "near"), STABILITY)
def test_stability_is_lost_where_the_simulated_multipliers_say(family: Family, kind: str, near: float) -> None:
    special = only(family, kind, near)
    assert special.status == "converged"
    walk = simulated(special, family.parameter, special.gait.problem.cycle.impact)
    root = walk.crossing(CRITICAL[kind], special.value - ASIDE, special.value + ASIDE)
    assert special.value == pytest.approx(root, rel=0, abs=AGREEMENT)
    assert special.value == pytest.approx(near, rel=0, abs=AGREEMENT)


@pytest.mark.slow
def test_fold_is_where_a_simulated_multiplier_is_one() -> None:
    special = only(HIP, "fold", 0.42656)
    walk = simulated(special, "control.hip", special.gait.problem.cycle.impact)
    assert special.value == pytest.approx(walk.fold(special.value, reach=1e-4), rel=0, abs=AGREEMENT)
    assert special.value == pytest.approx(0.426564546887, rel=0, abs=AGREEMENT)


def test_wheel_has_no_gait_where_friction_is_below_the_slope() -> None:
    walked = branch(family("rimless-wheel-slip", "friction", 0.27, 0.22))
    assert walked.specials[-1].type == "end"
    assert "no other mode sequence continues the family" in walked.specials[-1].reason
    assert walked.specials[-1].value == pytest.approx(tan(radians(13)), rel=0, abs=AGREEMENT)


def test_running_is_stable_between_the_fold_and_the_period_doubling_of_its_family():
    """The force of a spring leg is zero at landing and at take-off, where the cone is no limit."""
    gait = go.solve("slip-run")
    request = Request(parameter="walker.attack", to=(radians(67), radians(68.6)), verify_every=0, largest_length=0.1)
    runs = collected("walker.attack", [*follow_family(gait, request)])
    (fold,), (doubling,) = runs.special("fold"), runs.special("period_doubling")
    assert [runs.special("end")[k].reason.split()[0] for k in range(2)] == ["reached", "reached"]
    for special, multiplier in ((fold, 1), (doubling, -1)):
        rates = special.gait.to_record()["state"]["dtheta"] + 1e-5 * np.array([[-1.0], [1.0]])
        mapped = go.return_map(special.gait, np.hstack([rates, np.zeros((2, 1))]))
        assert np.diff(mapped.states[:, 0]) / np.diff(rates[:, 0]) == pytest.approx(multiplier, abs=1e-4)
