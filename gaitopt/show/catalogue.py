"""Every figure by its name."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

from gaitopt.gait.gait import Gait
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import SCALARS
from gaitopt.runs.basin import Basin
from gaitopt.runs.front import Front, front_file
from gaitopt.runs.sweep import Sweep
from gaitopt.show.families import basin, front_figure, over_parameter, sweep
from gaitopt.show.film import animation_page
from gaitopt.show.gaits import foot_slip, force_ratio, method_comparison, phase_portrait, section_states, torques
from gaitopt.show.labels import parameter_of
from gaitopt.show.motion import motion_of, motion_of_walk, simulated
from gaitopt.show.multipliers import multiplier_paths, multiplier_plane
from gaitopt.verification.walk import Walk

Record = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """The figures of a result.

    Attributes
    ----------
    draw : draws the one with a name.
    names : of all.
    usual : of those that show something of this result; the first is the one that stands for it.
    stem : of their files, where that is not the name of the figure.
    animation : gives the page of the moving walker, where one moves.
    """

    draw: Callable[[str], Figure]
    names: tuple[str, ...]
    usual: tuple[str, ...]
    stem: str = ""
    animation: Callable[[], str] | None = None


GAIT_FIGURES: Mapping[str, Callable[[Sequence[Gait]], Figure]] = {
    "portrait": lambda gaits: phase_portrait([motion_of(gait) for gait in gaits]),
    "force": lambda gaits: force_ratio([motion_of(gait) for gait in gaits]),
    "slip": lambda gaits: foot_slip([motion_of(gait) for gait in gaits]),
    "torques": lambda gaits: torques([motion_of(gait) for gait in gaits]),
    "multipliers": lambda gaits: multiplier_plane({gait.problem.name: gait.multipliers for gait in gaits}),
    "roads": lambda gaits: method_comparison(motion_of(gaits[0]), simulated(gaits[0])),
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
BRANCH_FIGURES = ("multipliers", *SCALARS, "friction")
"""Figures of a branch: its multipliers in the complex plane, or any scalar over the parameter."""
USUAL_BRANCH_FIGURES = ("spectral_radius", "multipliers", "speed", "cost_of_transport")
CYCLE_FIGURES = ("step_length",)
"""What is drawn besides where cycles have several steps."""


def informative(gaits: Sequence[Gait]) -> Iterator[str]:
    """Names of the figures of gaits that show something: torques only of walkers with motors, ``roads`` of one gait."""
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


def gait_figures(gaits: Sequence[Gait]) -> Figures:
    """Of one or several gaits in one picture."""
    first = gaits[0]
    return Figures(
        draw=lambda name: GAIT_FIGURES[name](gaits),
        names=tuple(GAIT_FIGURES),
        usual=tuple(informative(gaits)),
        animation=(lambda: animation_page(motion_of(first), first.problem.about)) if len(gaits) == 1 else None,
    )


def walk_figures(walk: Walk) -> Figures:
    """Of a simulated walk."""
    return Figures(
        draw=lambda name: WALK_FIGURES[name](walk),
        names=tuple(WALK_FIGURES),
        usual=("section", "portrait"),
        animation=lambda: animation_page(motion_of_walk(walk), walk.trajectory.message),
    )


def branch_figures(problem: Problem, parameter: str, records: Sequence[Record]) -> Figures:
    """Of the records of a branch of a problem's gaits."""
    usual = usual_branch_figures(records)
    return Figures(
        draw=lambda name: branch_figure(name, problem, parameter, records), names=BRANCH_FIGURES, usual=usual
    )


def sweep_figures(result: Sweep) -> Figures:
    """Of a sweep over one or two parameters: any scalar."""
    return Figures(draw=lambda scalar: sweep(result, scalar), names=tuple(SCALARS), usual=("spectral_radius",))


def basin_figures(result: Basin) -> Figures:
    """Of a basin over one or two coordinates."""
    return Figures(draw=lambda _: basin(result), names=("basin",), usual=("basin",))


def front_figures(front: Front) -> Figures:
    """Of a front."""
    return Figures(
        draw=lambda _: front_figure(front.problem, front.key, front.to_records()),
        names=("front",),
        usual=("front",),
        stem=front_file(front.key).removesuffix(".json"),
    )
