"""Every figure by its name."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from gaitopt.figures.branches import over_parameter
from gaitopt.figures.comparison import node_points, simulated, two_roads
from gaitopt.figures.force import foot_slip, force_ratio, torques
from gaitopt.figures.labels import parameter_of
from gaitopt.figures.motion import motion_of, motion_of_walk
from gaitopt.figures.portrait import phase_portrait
from gaitopt.figures.stability import multiplier_paths, multiplier_plane
from gaitopt.figures.walk import section_states
from gaitopt.gait import Gait
from gaitopt.problem import SCALARS, Problem
from gaitopt.study.simulate import Walk

Record = Mapping[str, Any]


def _roads(gaits: Sequence[Gait]) -> Figure:
    (gait,) = gaits
    return two_roads(motion_of(gait), simulated(gait), node_points(gait))


GAIT_FIGURES: Mapping[str, Callable[[Sequence[Gait]], Figure]] = {
    "portrait": lambda gaits: phase_portrait([motion_of(gait) for gait in gaits]),
    "force": lambda gaits: force_ratio([motion_of(gait) for gait in gaits]),
    "slip": lambda gaits: foot_slip([motion_of(gait) for gait in gaits]),
    "torques": lambda gaits: torques([motion_of(gait) for gait in gaits]),
    "multipliers": lambda gaits: multiplier_plane({gait.problem.name: gait.multipliers for gait in gaits}),
    "roads": _roads,
}
"""Figures of one or several gaits; ``roads`` is of one."""

WALK_FIGURES: Mapping[str, Callable[[Walk], Figure]] = {
    "section": section_states,
    "portrait": lambda walk: phase_portrait([motion_of_walk(walk)]),
    "force": lambda walk: force_ratio([motion_of_walk(walk)]),
    "slip": lambda walk: foot_slip([motion_of_walk(walk)]),
    "torques": lambda walk: torques([motion_of_walk(walk)]),
}
"""Figures of a simulated walk."""
USUAL_WALK_FIGURES = ("section", "portrait")

BRANCH_FIGURES = ("multipliers", *SCALARS, "friction")
"""Figures of a branch: its multipliers in the complex plane, or any scalar over the parameter."""
USUAL_BRANCH_FIGURES = ("multipliers", "spectral_radius", "speed", "cost_of_transport")
CYCLE_FIGURES = ("step_length",)
"""What is drawn besides where cycles have several steps."""


def informative(gaits: Sequence[Gait]) -> Iterator[str]:
    """Words of the figures of gaits that have something to show: no torques of passive walkers, one gait's roads."""
    for word in GAIT_FIGURES:
        if word == "torques" and not any(gait.measures["peak_torque"] for gait in gaits):
            continue
        if word == "slip" and not any(gait.measures["slip_distance"] for gait in gaits):
            continue
        if word != "roads" or len(gaits) == 1:
            yield word


def usual_branch_figures(records: Sequence[Record]) -> tuple[str, ...]:
    """Words of the figures of a branch that have something to show: no cost of passive walkers."""
    works = any(record.get("work") for record in records)
    usual = [word for word in USUAL_BRANCH_FIGURES if works or word != "cost_of_transport"]
    return (*usual, *(CYCLE_FIGURES if any("steps" in record for record in records) else ()))


def branch_figure(word: str, problem: Problem, parameter: str, records: Sequence[Record]) -> Figure:
    """The figure of a branch of a problem's gaits by its name, one of ``BRANCH_FIGURES``."""
    shown = parameter_of(problem, parameter)
    if word == "multipliers":
        return multiplier_paths(records, shown)
    return over_parameter({problem.name: records}, shown, word)
