"""The figures of every kind of result by their names."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import singledispatch
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.gait.branch import Branch
from gaitopt.gait.gait import Gait, require_gait
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import SCALARS
from gaitopt.runs.atlas import Atlas
from gaitopt.runs.attractors import Attractors, read_attractors
from gaitopt.runs.basin import Basin
from gaitopt.runs.branch import stored_branch
from gaitopt.runs.front import Front, front_file, read_fronts
from gaitopt.runs.results import KINDS, kind_of
from gaitopt.runs.robustness import Robustness
from gaitopt.runs.sweep import Sweep
from gaitopt.show.atlases import atlas_figure, scalar_names, sheet_names
from gaitopt.show.attractors import bifurcation_diagram
from gaitopt.show.branches import multiplier_paths, multiplier_plane, over_parameter
from gaitopt.show.gaits import (
    contact_diagram,
    design_range,
    foot_slip,
    force_ratio,
    method_comparison,
    phase_portrait,
    phase_variable,
    section_states,
    torques,
)
from gaitopt.show.grids import basin, front_figure, sweep
from gaitopt.show.motion import Motion, motion_of, motion_of_walk, simulated
from gaitopt.show.movie import movie, postures
from gaitopt.show.pages import animation_page
from gaitopt.show.programs import jacobian_pattern
from gaitopt.show.robustness import ALL, strips
from gaitopt.show.style import Parameter, parameter_of
from gaitopt.solver.program import NonlinearProgram
from gaitopt.verification.walk import Walk

Record = Mapping[str, Any]

ANIMATION = "animation"
"""Name of the page of the moving walker, beside the names of figures."""
PAGE = "html"
"""Format of an animation with controls."""
DRAWN_AXES = 2
"""Largest number of keys of a sweep or basin that can be drawn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """The figures of a result.

    Attributes
    ----------
    draw : function that draws the figure with a name.
    names : names of all figures.
    usual : names of those figures that are not empty for this result; the first one represents it.
    stem : beginning of the names of the files, if it is not the name of the figure.
    animation : function that returns the moving walker as a file of a format, ``html``, ``gif`` or ``mp4``; None if
        nothing moves.
    """

    draw: Callable[[str], Figure]
    names: tuple[str, ...]
    usual: tuple[str, ...]
    stem: str = ""
    animation: Callable[[str], bytes] | None = None


MOTION_FIGURES: Mapping[str, Callable[[Sequence[Motion]], Figure]] = {
    "portrait": phase_portrait,
    "force": force_ratio,
    "slip": foot_slip,
    "torques": torques,
    "contacts": contact_diagram,
    "postures": postures,
}
"""Figures of gaits and walks."""
GAIT_FIGURES = (*MOTION_FIGURES, "multipliers", "methods")
"""Figures of one or several gaits; ``methods`` exists for a single one."""
RANGE = "range"
"""Name of the figure of a design over a range of a parameter."""
WALK_FIGURES = ("section", *MOTION_FIGURES)
"""Figures of a simulated walk."""
PHASE = "phase"
"""Name of the figure of gaits and walks whose control law has a phase variable."""
DRAWN = {**MOTION_FIGURES, PHASE: phase_variable}
FORCE_OVER = "force_over_"
"""Beginning of the name of the figure of the force ratio over a shape coordinate."""
USUAL_BRANCH_FIGURES = ("spectral_radius", "multipliers", "speed", "cost_of_transport")
CYCLE_FIGURES = ("step_length",)
"""Further figures of branches whose cycles have several steps."""


@singledispatch
def figures_of(result: Any) -> Figures:
    """The figures of a result, as ``gaitopt.plot`` lists them.

    Raises
    ------
    TypeError
        If a result of this type has no figures.
    ProblemError
        If a problem, or its name, is given instead of its gait, or if a branch or a robustness has no figures.
    ValueError
        If a gait or a walk has no motion, or a grid more than two axes.
    """
    require_gait(result, "plot")
    gaits = list(result) if isinstance(result, Sequence) else []
    if not gaits or not all(isinstance(gait, Gait) for gait in gaits):
        raise TypeError(f"a {type(result).__name__} has no figures")
    return _gait_figures([(gait.problem.name, gait) for gait in gaits])


@figures_of.register
def _(result: Gait) -> Figures:
    return _gait_figures([(result.problem.name, result)])


@figures_of.register
def _(result: Mapping) -> Figures:  # type: ignore[type-arg] # singledispatch takes classes only
    values = list(result.values())
    if values and all(isinstance(value, Gait) for value in values):
        return _gait_figures(list(result.items()))
    branches = {name: value.to_records() if isinstance(value, Branch) else value for name, value in result.items()}
    parameters = {_parameter_key(value) for value in values}
    if None in parameters or len(parameters) != 1:
        raise TypeError("several results in one figure must be gaits, or branches over one parameter, by name")
    (key,) = parameters
    first = values[0].points[0].gait.problem if isinstance(values[0], Branch) and values[0].points else None
    return _families_figures(branches, Parameter(key=str(key)) if first is None else parameter_of(first, str(key)))


def _families_figures(branches: Mapping[str, Sequence[Record]], parameter: Parameter) -> Figures:
    """The figures of several branches over one parameter, by their names in the legend."""
    names = _known_figures([record for records in branches.values() for record in records])
    return Figures(draw=lambda name: over_parameter(branches, parameter, name), names=names, usual=("spectral_radius",))


def _known_figures(records: Sequence[Record]) -> tuple[str, ...]:
    """Names of those scalars that any gait of the branches has."""
    return tuple(name for name in (*SCALARS, "friction") if any(record.get(name) is not None for record in records))


def _parameter_key(branch: Any) -> str | None:
    """The continued parameter of a branch or of its records; None of anything else."""
    if isinstance(branch, Branch):
        return branch.parameter
    head = branch[0] if isinstance(branch, Sequence) and branch else None
    return head.get("parameter") if isinstance(head, Mapping) else None


@figures_of.register
def _(result: Branch) -> Figures:
    if not result.points:
        raise ProblemError("a branch without points has no figures")
    return branch_figures(result.points[0].gait.problem, result.parameter, result.to_records())


@figures_of.register
def _(result: Robustness) -> Figures:
    kinds = tuple(result.strips)
    if not kinds:
        raise ProblemError("only patches and pushes have figures: compute them with --what patch,push")
    return Figures(draw=lambda name: strips(result, name), names=(ALL, *kinds), usual=(ALL,))


@figures_of.register
def _(result: Walk) -> Figures:
    return Figures(
        draw=lambda name: section_states(result) if name == "section" else DRAWN[name]([motion_of_walk(result)]),
        names=(*WALK_FIGURES, *_phase_figures([result])),
        usual=("section", "portrait", "postures"),
        animation=lambda extension: _animation(motion_of_walk(result), result.trajectory.message, extension),
    )


@figures_of.register
def _(result: Sweep) -> Figures:
    return Figures(draw=lambda scalar: sweep(result, scalar), names=tuple(SCALARS), usual=("spectral_radius",))


@figures_of.register
def _(result: Atlas) -> Figures:
    sheets = sheet_names(result)
    return Figures(
        draw=lambda name: atlas_figure(result, name), names=(*sheets, *scalar_names(result)), usual=tuple(sheets)
    )


@figures_of.register
def _(result: Attractors) -> Figures:
    return attractor_figures(result, {})


def attractor_figures(result: Attractors, branches: Mapping[str, Sequence[Record]]) -> Figures:
    """The figures of attractors: every section coordinate, and the exponents.

    Parameters
    ----------
    branches : records of branches that are drawn too, by their names in the legend.
    """
    names = (*result.names, "lyapunov")
    return Figures(
        draw=lambda name: bifurcation_diagram(result, name, branches), names=names, usual=(result.names[0], "lyapunov")
    )


@figures_of.register
def _(result: Basin) -> Figures:
    return Figures(draw=lambda _: basin(result), names=("basin",), usual=("basin",))


@figures_of.register
def _(result: NonlinearProgram) -> Figures:
    return Figures(draw=lambda _: jacobian_pattern(result), names=("jacobian",), usual=("jacobian",))


@figures_of.register
def _(result: Front) -> Figures:
    return Figures(
        draw=lambda _: front_figure(result.problem, result.key, result.to_records()),
        names=("front",),
        usual=("front",),
        stem=front_file(result.key).removesuffix(".json"),
    )


def _gait_figures(named: Sequence[tuple[str, Gait]]) -> Figures:
    """The figures of one or several gaits with their names in the legend."""
    gaits = [gait for _, gait in named]
    for gait in gaits:
        if not gait.steps:
            raise ValueError(f"{gait.problem.name} is {gait.status}: there is no gait to draw")
    first, alone = gaits[0], len(gaits) == 1

    def draw(name: str) -> Figure:
        if name == "multipliers":
            return multiplier_plane({title: gait.multipliers for title, gait in named})
        motions = [motion_of(gait, title) for title, gait in named]
        if name == RANGE:
            return design_range(first)
        if name == "methods":
            return method_comparison(motions[0], simulated(first))
        if name.startswith(FORCE_OVER):
            return force_ratio(motions, name.removeprefix(FORCE_OVER))
        return DRAWN[name](motions)

    empty = set() if alone else {"methods"}
    empty |= {"torques"} if not any(gait.measures["peak_torque"] for gait in gaits) else set()
    empty |= {"contacts"} if not any(gait.system.walker.labels() for gait in gaits) else set()
    empty |= {"slip"} if not any(gait.measures["slip_distance"] for gait in gaits) else set()
    shapes = [gait.system.walker.shape for gait in gaits]
    common = [name for name in shapes[0] if all(name in shape for shape in shapes)]
    more = (*_phase_figures(gaits), *((RANGE,) if alone and first.over is not None else ()))
    return Figures(
        draw=draw,
        names=(*GAIT_FIGURES, *more, *(f"{FORCE_OVER}{name}" for name in common)),
        usual=(*(name for name in GAIT_FIGURES if name not in empty), *more),
        animation=(lambda extension: _animation(motion_of(first), first.problem.about, extension)) if alone else None,
    )


def check_gait_figures(problem: Problem, names: Sequence[str], *, alone: bool) -> None:
    """Refuse names that no figure of a gait of a problem has, before the gait is solved.

    Parameters
    ----------
    alone : whether the gait is drawn alone, and not with others.
    """
    more = ((PHASE, problem.control.phase_variable), (RANGE, alone and problem.over is not None))
    figures = *GAIT_FIGURES, *(name for name, exists in more if exists)
    over = (f"{FORCE_OVER}{name}" for name in type(problem.walker).shape)
    check_names(names, (*figures, *over, *((ANIMATION,) if alone else ())))


def check_names(names: Sequence[str], known: Sequence[str]) -> None:
    """Refuse names that are not those of figures."""
    unknown = [name for name in names if name not in known]
    if unknown:
        raise UnknownNameError(f"{unknown[0]}: choose from {', '.join(known)}").concerning("what")


def _phase_figures(motions: Sequence[Gait | Walk]) -> tuple[str, ...]:
    """The name of the figure of the phase variable, if the control law of every motion has one."""
    return (PHASE,) if all(motion.system.control.phase_variable for motion in motions) else ()


def _animation(motion: Motion, about: str, extension: str) -> bytes:
    return animation_page(motion, about).encode() if extension == PAGE else movie(motion, extension)


def branch_figures(problem: Problem, parameter: str, records: Sequence[Record]) -> Figures:
    """The figures of the records of a branch of a problem's gaits."""
    shown = parameter_of(problem, parameter)

    def draw(name: str) -> Figure:
        if name == "multipliers":
            return multiplier_paths(records, shown)
        return over_parameter({problem.name: records}, shown, name)

    works = any(record.get("work") for record in records)  # passive walkers have no cost
    usual = [name for name in USUAL_BRANCH_FIGURES if works or name != "cost_of_transport"]
    usual += CYCLE_FIGURES if any("steps" in record for record in records) else ()
    return Figures(draw=draw, names=("multipliers", *_known_figures(records)), usual=tuple(usual))


def folder_figures(*folders: Path, over: Sequence[Path] = ()) -> list[Figures]:
    """The figures of the result in a folder, or of the branches in several folders.

    There are none for folders with gaits. A folder with fronts has figures for each of them. Branches are drawn from
    their records, without restoring the gaits of their points.

    Parameters
    ----------
    over : folders with branches over which attractors are drawn.

    Raises
    ------
    StorageError
        If a folder is broken or unfinished.
    UnknownNameError
        If a sweep or basin is over more than two keys, or branches are over several parameters.
    """
    folder, *others = folders
    if others:
        if any(kind_of(path) != "branch" for path in folders):
            return []
        branches = {str(path): stored_branch(path) for path in folders}
        keys = list(dict.fromkeys(parameter for _, parameter, _ in branches.values()))
        if len(keys) > 1:
            raise UnknownNameError(f"branches over {' and '.join(keys)} have no common axis; draw them one by one")
        problem, key, _ = branches[str(folder)]
        records = {name: branch for name, (_, _, branch) in branches.items()}
        return [_families_figures(records, parameter_of(problem, key))]
    kind = kind_of(folder)
    if kind == "attractors":
        if foreign := [path for path in over if kind_of(path) != "branch"]:
            raise UnknownNameError(f"--over {foreign[0]}: is not a folder with branches, as `gaitopt continue` writes")
        settled, branches = read_attractors(folder), {str(path): stored_branch(path) for path in over}
        for path, (_, key, _) in branches.items():
            if key != settled.axis.key:
                raise UnknownNameError(f"{path} is a branch over {key}, but the attractors are over {settled.axis.key}")
        return [attractor_figures(settled, {path: records for path, (_, _, records) in branches.items()})]
    if over:
        raise UnknownNameError(f"--over draws attractors over branches, but {folder} contains no attractors")
    if kind == "branch":
        return [branch_figures(*stored_branch(folder))]
    if kind == "front":
        return [figures_of(front) for front in read_fronts(folder)]
    if kind not in ("basin", "sweep", "walk", "robustness", "atlas"):
        return []
    result = KINDS[kind][1](folder)
    if isinstance(result, Basin | Sweep) and len(result.grid.axes) > DRAWN_AXES:
        raise UnknownNameError(f"{folder} is over {len(result.grid.axes)} keys; pictures are drawn over one or two")
    return [figures_of(result)]
