"""Traced curves of every type, cut: at a value of the second parameter, a branch in the first has the special point.

A branch finds it by itself, with one parameter, from a gait beside the curve.
"""

from dataclasses import dataclass
from functools import cache
from math import radians

import pytest
from named import named

from gaitopt import Branch, continuation, trace
from gaitopt.branches.monitors import MonitorKey, monitor_values
from gaitopt.gait.trace import TracePoint

AGREEMENT = 1e-9
"""Largest difference between a curve and a branch, relative to the first parameter, at least 1."""
ASIDE = 2e-4
"""Distance from the curve at which a branch begins, relative to the first parameter, at least 1."""
SLOPE, DEG = "walker.slope", radians(1)


@dataclass(frozen=True)
class Case:
    """A special point of the branch of a named gait, and the parameter in which it is traced.

    Attributes
    ----------
    name, first, to : the branch.
    kind, index : the special point.
    second, targets : the trace.
    margin : kind of the monitor that vanishes; empty for a bifurcation.
    where : where in its phase it does, from 0 to 1.
    cuts : number of cuts of the curve.
    """

    name: str
    first: str
    to: float
    kind: str
    second: str
    targets: tuple[float, float]
    index: int = 0
    margin: str = ""
    where: float = 1.0
    cuts: int = 20

    def __str__(self) -> str:
        return f"{self.name}-{self.kind}-{self.index}-over-{self.second}"


COMPASS = [
    Case("compass-passive-a", "friction", 0.1, "neimark_sacker", SLOPE, (0.4 * DEG, 2.2 * DEG)),
    Case("compass-passive-a", "friction", 0.07, "period_doubling", SLOPE, (0.75 * DEG, 1.4 * DEG)),
    Case("compass-passive-a", "friction", 0.06, "impact_change", SLOPE, (0.75 * DEG, 1.4 * DEG),
         margin="impulse_cone_backward"),
    Case("compass-passive-a", "friction", 0.18, "mode_change", SLOPE, (0.5 * DEG, 2 * DEG), margin="cone_backward"),
    Case("compass-passive-a", "friction", 0.18, "mode_change", SLOPE, (0.5 * DEG, 2 * DEG), index=1,
         margin="cone_forward", where=0.0),
    Case("compass-passive-b", "friction", 0.16, "period_doubling", SLOPE, (0.4 * DEG, 2.5 * DEG)),
    Case("compass-passive-b", "friction", 0.32, "impact_change", SLOPE, (0.5 * DEG, 2 * DEG),
         margin="impulse_cone_forward"),
]  # fmt: skip
OTHERS = [
    Case("rimless-wheel-stick", "friction", 0.91, "mode_change", SLOPE, (0.224, 0.229), margin="cone_forward"),
    Case("rimless-wheel-slip", SLOPE, 0.6, "lift_off", "friction", (0.35, 0.5), margin="normal_force", where=0.48),
    Case("slip-walk-stable", "walker.energy", 839.0, "end", "walker.stiffness", (13900.0, 14100.0),
         margin="cone_forward.front", where=0.5, cuts=4),
    Case("heel-toe", "friction", 0.27, "mode_change", "walker.toe", (0.025, 0.055), margin="cone_forward.heel",
         where=0.0, cuts=4),
    Case("heel-toe", "friction", 0.26, "mode_change", "walker.toe", (0.032, 0.055), index=1,
         margin="cone_backward.toe", cuts=4),
    Case("crawler", "friction.rear", 0.57, "mode_change", "friction.front", (0.395, 0.41), margin="cone_backward.rear",
         where=0.0, cuts=4),
    Case("inchworm", "friction.front", 0.39, "mode_change", "friction.rear", (0.495, 0.505), cuts=2,
         margin="cone_forward.front"),
]  # fmt: skip


@cache
def branch(name: str, parameter: str, to: float) -> Branch:
    return continuation(named(name), parameter, to, verify_every=0, progress=False)


def cut(point: TracePoint, first: str, kind: str) -> float | None:
    """The value of the first parameter at which a branch in it has the special point; None if it has none."""
    value, found = point.values[first], list[float]()
    aside = ASIDE * max(1.0, abs(value))
    for side in (aside, -aside):
        away = continuation(point.gait, first, value + side, max_points=40, verify_every=0, progress=False)
        if not found and len(away) > 1:
            back = continuation(
                away.points[-1].gait, first, value - side, max_points=60, verify_every=0, progress=False
            )
            found = [each.value for each in back.special(kind)]
    return min(found, key=lambda other: abs(other - value), default=None)


@pytest.mark.slow
@pytest.mark.parametrize("case", [*COMPASS, *OTHERS], ids=str)
def test_a_curve_has_the_special_points_of_branches_wherever_it_is_cut(case: Case) -> None:
    start = branch(case.name, case.first, case.to).special(case.kind)[case.index]
    curve = trace(start, case.second, case.targets, progress=False)
    assert {end.reason for end in curve.special("end")} == {f"reached {case.second} = {to:.12g}" for to in case.targets}
    checks = [point.gait.verification for point in curve if point.gait.verification is not None]
    assert all(check["passed"] for check in checks)
    if case.margin:
        key = MonitorKey(**curve.points[0].condition["margin"])
        assert key.kind == case.margin
        for point in curve:
            monitor = monitor_values(point.gait)[key]
            assert monitor.value == pytest.approx(0, abs=1e-10)
            assert monitor.where == pytest.approx(case.where, abs=0.05)
    points = [point for point in curve if point.index]
    for point in points[:: max(1, len(points) // case.cuts)]:
        value, found = point.values[case.first], cut(point, case.first, case.kind)
        assert found is not None, point
        assert found == pytest.approx(value, rel=0, abs=AGREEMENT * max(1.0, abs(value)))
