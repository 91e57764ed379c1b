"""Pages as single HTML files: the moving walker; reports of gaits, branches, atlases, walks and robustness.

A page has templates, scripts, style sheets and data in one file and needs no network. The report of a branch has a
diagram over the continued parameter, in which each gait can be selected. The report of a walk lists its states step by
step.
"""

import gzip
import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from itertools import cycle
from types import MappingProxyType
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from gaitopt.arrays import Array
from gaitopt.design.derivatives import derivatives
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.branch import cascades, ends_by_request
from gaitopt.gait.gait import Gait
from gaitopt.gait.regions import NO_GAIT, UNKNOWN
from gaitopt.model.section import cycle_start
from gaitopt.model.transitions import Ending
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import SCALARS, relevant_scalars, scalar_values, state_unit
from gaitopt.runs.atlas import Atlas
from gaitopt.runs.robustness import Robustness
from gaitopt.show.atlases import LINES, axis_label, point_name, sequences, shown_in
from gaitopt.show.branches import OF_EACH_STEP
from gaitopt.show.film import film, pack, short
from gaitopt.show.gaits import ROUNDING, section_states
from gaitopt.show.motion import (
    Motion,
    differences,
    motion_from_record,
    motion_of,
    motion_of_walk,
    points_of,
    positions_of,
    simulated,
    smooth,
    thinned,
)
from gaitopt.show.replays import replayed_motion
from gaitopt.show.robustness import ALL, strips
from gaitopt.show.style import FLIGHT_DOTS, MODE_NAMES, SLIP_DASHES, dashes, encoded, label, parameter_of, symbol
from gaitopt.show.tables import printed, robustness_rows
from gaitopt.store.run import Manifest
from gaitopt.systems import problem_dynamics
from gaitopt.verification.walk import Walk

Record = Mapping[str, Any]

FRAMES = 30
"""Number of frames of a step at one point of a branch; a page with 200 points is then well below a megabyte."""
STROKES = {"-": "stick", SLIP_DASHES: "slip", FLIGHT_DOTS: "flight"}
"""The names that ``curves.js`` uses for line styles."""
COLOURS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh")
"""The names that ``theme.css`` uses for colours."""
MOST_GAITS = 300
"""Approximate largest number of gaits on the page of an atlas, with which it has about two megabytes."""
POINTS = 17
"""Number of Chebyshev points of a phase of a branch: seven digits are accurate, more than a page can show."""


def render(template: str, **content: Any) -> str:
    """The page of a template; texts are escaped. Only a page about gaits has ``checks``, their verifications."""
    templates = Environment(
        loader=PackageLoader("gaitopt.show", "web"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    templates.filters |= {"figure": figure, "packed": packed}
    templates.policies["json.dumps_kwargs"] = {"sort_keys": False, "separators": (",", ":")}
    return templates.get_template(template).render({"checks": [], **content})


def packed(data: Mapping[str, Any]) -> str:
    """Data as gzipped JSON in base64, for ``frame.html``."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def figure(value: float | str | None, digits: int = 6) -> str:
    """A number as the page shows it; a text is not changed."""
    if isinstance(value, str):
        return value
    return "–" if value is None else f"{value:.{digits}g}".replace("-", "−")


def labels(films: Sequence[Record], records: Sequence[Record], problem: Problem) -> dict[str, Any]:
    """Labels of the scalars of some records and of the walker's states, for the scripts; motors determine units."""
    names = {name for film in films for name in film["shape"]}
    states = [key for name in (*sorted(names), "y", "x") for key in (name, f"d{name}")]
    freed = {key for record in records for key in record.get("parameters", ())}
    return {
        "scalars": {key: asdict(label(key, problem)) for key in relevant_scalars(records)},
        "symbols": {name: symbol(name) for name in states},
        "units": {name: state_unit(name) for name in states},
        "parameters": {key: asdict(label(key, problem)) for key in sorted(freed)},
        "slipping": SCALARS["required_friction"].meaning,  # label of ``required_friction`` if a foot slips
    }


def numbers(record: Record) -> dict[str, Any]:
    """Scalars, multipliers, state and verification of a gait, with the digits that the page shows."""
    return {
        "scalars": {
            key: value if value is None else float(f"{value:.9g}") for key, value in scalar_values(record).items()
        },
        "multipliers": [[float(f"{m['re']:.7g}"), float(f"{m['im']:.7g}")] for m in record["multipliers"]],
        "state": {name: float(f"{value:.9g}") for name, value in record["state"].items()},
        "parameters": record["parameters"],
        "passed": None if record["verification"] is None else record["verification"]["passed"],
    }


def provenance(problem: Problem, solver: Mapping[str, float | str] = MappingProxyType({})) -> dict[str, Any]:
    """The text of the problem, its hash and the versions of all packages, for the foot of a page."""
    known = Manifest.of(problem)
    return {
        "name": problem.name,
        "text": problem.text,
        "hash": known.hash,
        "versions": known.versions,
        "platform": known.platform,
        "solver": dict(solver),
    }


def animation_page(motion: Motion, about: str = "") -> str:
    """HTML of the moving walker; ``about`` is written under the title."""
    return render("animation.html", film=film(motion), about=about)


def comparison_report(gaits: Sequence[Gait], replays: Sequence[Record] = ()) -> str:
    """HTML of gaits side by side: numbers, figures, moving walkers, NLP against simulation, verification, provenance.

    Parameters
    ----------
    replays : records of replays of the first gait in other engines.

    Raises
    ------
    ValueError
        If one of the gaits is a failed solve.
    """
    if not all(gait.converged for gait in gaits):
        raise ValueError("only converged gaits have a report; look at their status first")
    records = [gait.to_record() for gait in gaits]
    names = [gait.problem.name for gait in gaits]
    names = [n if names.count(n) == 1 else f"{n} ({g.problem.hash8})" for n, g in zip(names, gaits, strict=True)]
    motions = [motion_of(gait, name) for gait, name in zip(gaits, names, strict=True)]
    shown = [
        {"film": film(motion), "comparison": _comparison(motion, gait), **numbers(record)}
        for motion, gait, record in zip(motions, gaits, records, strict=True)
    ]
    return render(
        "gaits.html",
        title=" and ".join(dict.fromkeys(gait["film"]["name"] for gait in shown)),
        about=gaits[0].problem.about if len(gaits) == 1 else "Side by side",
        replayed=svg(replayed_motion(motions[0], replays)) if any(replay["motion"] for replay in replays) else "",
        data={"gaits": shown, **labels([gait["film"] for gait in shown], records, gaits[0].problem)},
        derivatives=[(name, _differentiated(gait)) for name, gait in zip(names, gaits, strict=True)],
        checks=[(gait["film"]["name"], record["verification"]) for gait, record in zip(shown, records, strict=True)],
        origins=[provenance(gait.problem, gait.solver) for gait in gaits],
    )


def _differentiated(gait: Gait) -> str:
    """The table of derivatives as HTML, or the reason why there is none."""
    try:
        return printed(derivatives(gait))
    except SolveError as reason:
        return f"<p>{escape(str(reason))}</p>"


def _comparison(motion: Motion, gait: Gait) -> dict[str, Any]:
    """Positions along the simulated steps, points of the NLP's gait, and the differences of the states."""
    walked = simulated(gait)
    times, states = thinned(*points_of(motion.steps))
    names = positions_of(motion)
    columns = [motion.state_index(name) for name in names]
    nodes = {"t": times} | {name: states[:, k] for name, k in zip(names, columns, strict=True)}
    arcs = [
        (arc.mode, {"t": began + arc.times} | {n: arc.states[:, k] for n, k in zip(names, columns, strict=True)})
        for began, arc in smooth(walked)
    ]
    gaps = [
        {"t": times, "difference": np.log10(np.maximum(np.abs(gap).max(axis=1), ROUNDING))}
        for times, gap in differences(motion.steps, walked)
    ]
    return {
        "nodes": pack(nodes),
        "lines": [{"mode": STROKES[dashes(mode)], **pack(line)} for mode, line in arcs],
        "gaps": [pack(gap) for gap in gaps],
    }


def branch_report(problem: Problem, parameter: str, records: Sequence[Record]) -> str:
    """HTML of a branch.

    Parameters
    ----------
    problem : the problem that was continued.
    parameter : dotted key of the parameter that was continued.
    records : points and special points, as the continuation wrote them.
    """
    points = [record for record in records if record["record"] == "point" and record["state"] is not None]
    if not points:
        raise ProblemError(f"the branch of {problem.name} has no points yet")
    dynamics, shown = problem_dynamics(problem), parameter_of(problem, parameter)
    moved = [dynamics.at({**point["parameters"], parameter: point["value"]}) for point in points]
    motions = (motion_from_record(*pair, name=problem.name, points=POINTS) for pair in zip(moved, points, strict=True))
    films: list[Record] = [film(motion, FRAMES) for motion in motions]
    common, own = _common(films)
    gaits = [
        {
            "film": moving,
            "branch": point["branch"],
            "value": point["value"],
            **_of_each_step(point),
            **numbers(_without([parameter], point)),
        }
        for point, moving in zip(shown.shown(points), own, strict=True)
    ]
    specials = [_special(record) for record in shown.shown(records) if record["record"] == "special"]
    return render(
        "branch.html",
        title=f"{problem.name} over {shown.label.name}",
        about=problem.about,
        data={
            "common": common,
            "gaits": gaits,
            "specials": specials,
            "cascades": [str(cascade) for cascade in cascades(shown.shown(records))],
            "parameter": asdict(shown.label),
            **labels(films, [_without([parameter], point) for point in points], problem),
        },
        origins=[provenance(problem)],
    )


def atlas_report(atlas: Atlas) -> str:
    """HTML of an atlas: a map, and the gait nearest to the point that the reader selects.

    Raises
    ------
    ProblemError
        If no branch of the atlas has a gait.
    """
    keys, ranges, found = [axis.key for axis in atlas.axes], atlas.axes, atlas.arrangement
    segments = [(number, index) for number, region in enumerate(found.regions) for index in region.segments]
    if not segments:
        raise ProblemError(f"the atlas of {atlas.problem.name} has no gaits")
    each = max(1, MOST_GAITS // len(segments))
    chosen: list[tuple[int, tuple[float, ...], Record]] = [
        (number, tuple(known["at"].values()), known["gait"])
        for number, known in enumerate(atlas.gaits)
        if known.get("gait") is not None
    ]
    for number, (j, i) in segments:
        points = atlas.slices[j].segments[i].points
        thinned_points = points[:: -(-len(points) // each)]
        chosen += [(number, (point["value"], atlas.slices[j].value), point) for point in thinned_points]
    dynamics = problem_dynamics(atlas.problem.replace(dict(zip(keys, chosen[0][1], strict=True))))
    films: list[Record] = []
    for _, values, record in chosen:
        moved = dynamics.at(dict(zip(keys, values, strict=True)))
        films.append(film(motion_from_record(moved, record, name=atlas.problem.name, points=POINTS), FRAMES))
    (common, own), colours = _common(films), dict(zip(sequences(atlas), cycle(COLOURS), strict=False))
    gaits = [
        {
            "film": moving,
            "region": number,
            "sheet": found.regions[number].sheet,
            "values": _short_points(shown_in(np.array([values]), ranges))[0],
            **_of_each_step(record),
            **numbers(_without(keys, record)),
        }
        for (number, values, record), moving in zip(chosen, own, strict=True)
    ]
    axes = [axis_label(axis, atlas) for axis in ranges]
    ends = shown_in(np.array([[axis.lower for axis in ranges], [axis.upper for axis in ranges]]), ranges).T.tolist()
    return render(
        "atlas.html",
        title=f"{atlas.problem.name} over {' and '.join(axis.name for axis in axes)}",
        about=atlas.problem.about,
        data={
            "common": common,
            "gaits": gaits,
            "axes": [{**asdict(axis), "range": span} for axis, span in zip(axes, ends, strict=True)],
            "regions": [
                {
                    "modes": region.modes.replace("_", " "),
                    "unstable": region.unstable,
                    "sheet": region.sheet,
                    "colour": colours.get(region.modes, "empty" if region.modes == NO_GAIT else UNKNOWN),
                    "fraction": region.area / atlas.area,
                    "outlines": [_short_points(shown_in(piece, ranges)) for piece in region.pieces if len(piece) > 2],
                }
                for region in found.regions
            ],
            "curves": [
                {
                    "type": curve.type,
                    "label": LINES[curve.type][0] if curve.type in LINES else curve.type,
                    "sheet": curve.sheet,
                    "points": _short_points(shown_in(curve.points, ranges)),
                }
                for curve in found.curves
            ],
            "points": [
                {
                    "name": point_name(junction),
                    "sheet": junction.sheet,
                    "within": junction.within,
                    "values": shown_in(np.array([junction.values]), ranges)[0].tolist(),
                }
                for junction in found.junctions
            ],
            **labels(films, [_without(keys, record) for _, _, record in chosen], atlas.problem),
        },
        origins=[provenance(atlas.problem)],
    )


def _short_points(points: Array) -> list[list[float]]:
    """Points with as many digits as a page can show."""
    return [[float(f"{value:.6g}") for value in point] for point in points.tolist()]


def _common(films: Sequence[Record]) -> tuple[Record, list[Record]]:
    """The entries that are the same in all films, and the other entries of each film."""
    common = {key: value for key, value in films[0].items() if all(other[key] == value for other in films)}
    return common, [{key: value for key, value in film.items() if key not in common} for film in films]


def walks_page(gait: Gait, walks: Mapping[str, Walk], about: str, over: tuple[str, str] | None = None) -> str:
    """HTML of walks that start beside a gait. The reader chooses the walk that is played.

    Parameters
    ----------
    gait : the gait beside which the walks start.
    walks : walks by the text of their button; those that end before anything moves are left out.
    over : two states of the section; if they are given, the reader chooses a start in their plane instead of a button.
    """
    moving = {title: walk for title, walk in walks.items() if walk.trajectory.steps}
    films: list[Record] = [film(motion_of_walk(walk)) for walk in moving.values()]
    (common, own), columns = _common(films), [gait.system.state_names.index(name) for name in over or ()]
    shown = [
        {
            "film": moved,
            "title": title,
            "ending": walk.trajectory.ending,
            "message": walk.trajectory.message or f"walks on, {len(walk.complete_steps)} steps are shown",
            "start": [short(walk.trajectory.start[column]) for column in columns],
        }
        for moved, (title, walk) in zip(own, moving.items(), strict=True)
    ]
    plane = None
    if over:
        starts = np.array([one["start"] for one in shown])
        plane = {
            "title": "Click a start to see its walk",
            **{
                axis: f"{symbol(name)} {cycle_start(gait.system)} [{state_unit(name, gait.system)}]"
                for axis, name in zip("xy", over, strict=True)
            },
            "size": [short(np.diff(np.unique(column)).min()) for column in starts.T],
            "gait": [short(gait.state[column]) for column in columns],
        }
    goes_on = (k for k, one in enumerate(shown) if one["ending"] == Ending.COMPLETED)
    return render(
        "walks.html",
        title=gait.problem.name,
        about=about,
        data={"walks": shown, "common": common, "plane": plane, "first": next(goes_on, 0)},
        origins=[provenance(gait.problem)],
    )


def _without(moved: Sequence[str], point: Record) -> Record:
    """A point without the continued parameters among its freed ones."""
    return {**point, "parameters": {key: value for key, value in point["parameters"].items() if key not in moved}}


def _special(record: Record) -> dict[str, Any]:
    gait = record.get("gait") or {}
    known = {key: record.get(key) for key in ("branch", "type", "value", "status", "next")}
    reason = record.get("reason", "")
    for mode, name in MODE_NAMES.items():
        reason = reason.replace(mode, name)
    known |= {"reason": reason, "bound": ends_by_request(record)}
    return {**known, **_of_each_step(gait), "scalars": numbers(gait)["scalars"] if gait else {}}


def _of_each_step(record: Mapping[str, Any]) -> dict[str, Any]:
    """The scalars ``OF_EACH_STEP`` of a cycle of several steps."""
    if "steps" not in record:
        return {}
    return {"steps": {key: [float(f"{step[key]:.9g}") for step in record["steps"]] for key in OF_EACH_STEP}}


def svg(drawn: Figure) -> str:
    """A figure as the source of an image within a page."""
    return f"data:image/svg+xml;base64,{b64encode(encoded(drawn, 'svg')).decode()}"


def walk_report(walk: Walk) -> str:
    """HTML of a walk."""
    names = [name for name in walk.system.state_names if name != "x"]
    columns = [walk.system.state_names.index(name) for name in names]
    states = walk.trajectory.section_states[:, columns]
    impacts = ["start", *(step.impact.mode.brief for step in walk.complete_steps if step.impact is not None)]
    rows = zip(walk.section_times.tolist(), impacts, states.tolist(), strict=True)
    return render(
        "walk.html",
        title=walk.problem.name,
        about=walk.problem.about,
        walk=walk,
        start=cycle_start(walk.system),
        columns=[f"{symbol(name)} [{state_unit(name)}]" for name in names],
        rows=[(t, impact.replace("_", " "), state) for t, impact, state in rows],
        picture=svg(section_states(walk)),
        data={"film": film(motion_of_walk(walk))},
        origins=[provenance(walk.problem)],
    )


def robustness_report(result: Robustness) -> str:
    """HTML of the robustness of a gait: its figures and how each was found, and a picture of what a walk survives."""
    return render(
        "robustness.html",
        title=f"{result.problem.name}: robustness",
        about=result.problem.about,
        start=cycle_start(problem_dynamics(result.problem).system),
        picture=svg(strips(result, ALL)) if result.strips else "",
        rows=robustness_rows(result),
        data={},
        origins=[provenance(result.problem)],
    )
