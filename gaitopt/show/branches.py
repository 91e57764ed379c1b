"""Figures of branches: a scalar over the continued parameter, and Floquet multipliers in the complex plane.

A gait is stable if all its multipliers lie inside the unit circle, as in Figs 4, 9, 11 and 12 of Gamus & Or (2013).
Branches are drawn from the records that a continuation writes: ``point`` records with ``branch``, ``index`` and
``value``, and ``special`` records with ``type`` and ``value``.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import cycle, groupby, pairwise, product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait.branch import TERMINAL, ends_by_request
from gaitopt.model.cycle import Cycle, mode_words
from gaitopt.show.style import COLOURS, CURVES, NEUTRAL, Parameter, entry, label, legend_below, panels
from gaitopt.store.gaits import multipliers_of

Record = Mapping[str, Any]
Multipliers = NDArray[np.complex128]

UNSTABLE: Any = (0, (1.2, 1.4))
"""Line style of unstable gaits."""
STABLE_LINE: dict[str, Any] = {"linewidth": 2.2}
UNSTABLE_LINE: dict[str, Any] = {"linewidth": 1.3, "linestyle": UNSTABLE}
LARGEST_LINEAR = 10.0
"""Modulus of a multiplier above which the axis is logarithmic, so that those near one can still be distinguished."""
SPECIAL_LOOKS = {
    "fold": ("fold", "o"),
    "branch_point": ("branches cross", "p"),
    "period_doubling": ("period doubling", "s"),
    "neimark_sacker": ("Neimark–Sacker", "D"),
    "mode_change": ("other phases begin", "^"),
    "impact_change": ("other impact begins", "v"),
    "lift_off": ("foot lifts off", "P"),
    "painleve": ("Painlevé paradox", "X"),
    "vanishing": ("gait vanishes", "x"),
    "end": ("branch ends", "|"),
}
"""Legend entry and marker of every type of special point."""
USER_MARKER = "*"
"""Marker of a special point that the user defined (``events``)."""
OF_EACH_STEP = ("period", "step_length")
"""Scalars that are drawn for every step of a cycle, so that the curve splits at a period doubling."""
CROSSINGS = ("fold", "period_doubling", "neimark_sacker", "branch_point")
"""Special points at which a multiplier lies on the unit circle."""
CROSSING, ON_CIRCLE = "#d55e00", 1e-3
"""Colour of the ring around a multiplier on the unit circle, and largest distance from the circle of such a
multiplier."""
MARKERS = "osD^v"
SMALLEST_REACH, LARGEST_REACH = 1.15, 2.0
"""Smallest half width of the picture, for the unit circle with a margin; and largest one, with which the circle can
still be seen."""
VALUE_SIZE = np.array([0.12, 0.06])
"""Size of the value beside a special point, relative to the axes; a value that would cover another is left out."""
MARKER_SIZE = np.array([0.015, 0.02])
"""Half size of the marker of a special point, and distance of its value, relative to the axes."""
DISTANCES = (1.0, 2.0, 3.5)
"""Distances at which a value is tried, as multiples of ``MARKER_SIZE``; the closest one that is free is taken."""
PER_POINT, PER_CROSSING = 1.5, 20.0
"""Further distance at which a text is preferred to one that covers a point of a curve, and to one whose line crosses
another mark or text."""
LEADER_POINTS = 30
"""Number of points of a line at which crossings are looked for."""
VERTICAL_MARGIN = 0.11
"""Margin above and below the curves for the values of special points at their edge, relative to their height."""
VALUE_REGION = np.array([[0.0, 0.0], [1.03, 1.08]])
"""Corners of the region for these values, relative to the axes."""
SHARED_TEXT = 0.1
"""Distance of two crossings below which they share a text."""


def over_parameter(
    curves: Mapping[str, Sequence[Record]], parameter: Parameter, quantity: str = "spectral_radius"
) -> Figure:
    """A scalar versus the continued parameter: stable gaits as thick lines, unstable ones as thin dots.

    For cycles of several steps, the period and the length of every step are drawn.

    Parameters
    ----------
    curves : records of one or several branches by their names in the legend.
    parameter : the parameter that was continued.
    quantity : key of a scalar in the records.
    """
    figure, (axes,) = panels()
    handles, drawn, many_curves = dict[str, Line2D](), list[Record](), len(curves) > 1
    marks = list[tuple[str, float, float]]()
    for (name, stored), colour in zip(curves.items(), cycle(COLOURS), strict=False):
        records = parameter.shown(stored)
        points = [record for record in records if record["record"] == "point" and record.get(quantity) is not None]
        points.sort(key=lambda point: (point["branch"], point["index"]))
        specials = [record for record in records if record["record"] == "special" and not ends_by_request(record)]
        if (
            quantity == "spectral_radius"
        ):  # it may grow without bound towards an end: the last point is drawn as the end
            specials = [{**record, "gait": {}} if record["type"] in TERMINAL else record for record in specials]
        sequences = {} if many_curves else {point["branch"]: _sequence_title(point) for point in points}
        sequence_colours = dict(
            zip(dict.fromkeys(sequences.values()), cycle(CURVES), strict=False)
        )  # equal sequences share a colour
        for number, branch in groupby(points, key=lambda point: point["branch"]):
            title = sequences.get(number, name)
            branch_colour = sequence_colours.get(title, colour)
            line = joined(list(branch), specials, quantity)
            heights, ink = [_heights(point, quantity) for point in line], {"color": branch_colour}
            draw_branch(axes, line, heights, STABLE_LINE | ink, UNSTABLE_LINE | ink)
            if many_curves or len(sequences) > 1:
                handles[title] = entry(title, color=branch_colour)
        marks += _mark(axes, specials, points, quantity, colour if many_curves else NEUTRAL)
        drawn += points
    if quantity == "spectral_radius":
        axes.axhline(1, color=NEUTRAL, linewidth=0.8, linestyle="-.")
        if any(point[quantity] > LARGEST_LINEAR for point in drawn):
            axes.set_yscale("log")
    axes.margins(y=VERTICAL_MARGIN)
    axes.autoscale_view()
    write_beside(axes, [("" if kind in TERMINAL else f"{value:.4g}", value, height) for kind, value, height in marks])
    axes.set_xlabel(str(parameter.label))
    written = label(quantity, parameter.problem)
    split = any(len(_heights(point, quantity)) > 1 for point in drawn)
    axes.set_ylabel(str(replace(written, name=f"{written.name} of each step") if split else written))
    stability = [entry("stable", **STABLE_LINE), entry("unstable", **UNSTABLE_LINE)]
    looks = [SPECIAL_LOOKS.get(kind, (kind, USER_MARKER)) for kind in sorted({kind for kind, *_ in marks})]
    markers = [entry(title, marker=marker, linestyle="", markerfacecolor="white") for title, marker in looks]
    legend_below(figure, [*handles.values(), *stability, *markers])
    return figure


def joined(branch: Sequence[Record], specials: Sequence[Record], quantity: str) -> list[Record]:
    """The points of a branch with the gaits of its special points between them, so that lines reach the markers.

    A special point is as stable as the point before it, because stability is lost at the marker.
    """
    line, number = list(branch), branch[0]["branch"]
    for special in specials:
        gait = special.get("gait") or {}
        if gait.get(quantity) is None or not (special["branch"] == number or number in special.get("next", ())):
            continue
        index = 0 if special["branch"] != number else _insertion(line, special["value"])
        before = line[max(index - 1, 0)]
        line.insert(index, {**gait, "value": special["value"], "branch": number, "stable": is_stable(before)})
    return line


def _insertion(line: Sequence[Record], value: float) -> int:
    """Index at which a value fits between the points of a line with the smallest detour; the end if it lies beyond."""
    values = [point["value"] for point in line]
    detours = [abs(value - a) + abs(b - value) - abs(b - a) for a, b in pairwise(values)]
    beyond = 2 * abs(value - values[-1])
    return len(line) if not detours or beyond <= min(detours) else int(np.argmin(detours)) + 1


def _sequence_title(point: Record) -> str:
    """The mode sequence of a point for the legend."""
    steps = Cycle.from_record(point).steps
    titles = [f"{mode_words(step.phases, step.timed)}; impact {step.impact.brief}".replace("_", " ") for step in steps]
    return f"{len(titles)} times {titles[0]}" if len(titles) > 1 and len(set(titles)) == 1 else " | ".join(titles)


def is_stable(point: Record) -> bool:
    """Whether the gait of a record attracts its neighbours."""
    radius = point.get("spectral_radius")
    return bool(point.get("stable", radius is not None and radius < 1))


def _heights(point: Record, quantity: str) -> list[float]:
    """The scalar of a gait, or of every step of a cycle for the scalars ``OF_EACH_STEP``."""
    if quantity in OF_EACH_STEP and "steps" in point:
        return [step[quantity] for step in point["steps"]]
    return [point[quantity]]


def draw_branch(
    axes: Axes,
    branch: Sequence[Record],
    heights: Sequence[list[float]],
    stable_look: Mapping[str, Any],
    unstable_look: Mapping[str, Any],
) -> None:
    """Draw runs of equal stability; neighbouring runs share a point, so that no gap opens between them.

    Parameters
    ----------
    heights : for every point of the branch, a height of the gait or of each of its steps.
    stable_look, unstable_look : properties of the lines.
    """
    values = np.array([point["value"] for point in branch])
    n_steps = max(map(len, heights))  # a doubled family begins with the cycle of its origin, which counts twice
    columns = np.array([entries * (n_steps // len(entries)) for entries in heights])
    stable = np.array([is_stable(point) for point in branch])
    for first, last in pairwise([0, *(np.flatnonzero(np.diff(stable)) + 1), len(branch)]):
        run = slice(max(first - 1, 0), last)
        axes.plot(values[run], columns[run], **(stable_look if stable[first] else unstable_look))


def _mark(
    axes: Axes, specials: Sequence[Record], points: Sequence[Record], quantity: str, colour: str
) -> Iterator[tuple[str, float, float]]:
    """Mark special points, each at the height of its own record or of the nearest gait of its branch.

    Yields
    ------
    kind, value, height : type, parameter and first height of every special point.
    """
    for special in specials:
        near = [point for point in points if point["branch"] == special["branch"]]
        if special.get("value") is None or not near:
            continue
        closest = min(near, key=lambda point: abs(point["value"] - special["value"]))
        gait = special.get("gait") or {}
        heights = _heights(closest if gait.get(quantity) is None else gait, quantity)
        marker = SPECIAL_LOOKS.get(special["type"], ("", USER_MARKER))[1]
        values = [special["value"]] * len(heights)
        size = 7 if len(heights) == 1 else 4
        axes.plot(values, heights, marker, color=colour, markersize=size, markeredgewidth=1.4, markerfacecolor="white")
        yield special["type"], special["value"], heights[0]


def write_beside(
    axes: Axes,
    marks: Sequence[tuple[str, float, float]],
    away: Sequence[float] = DISTANCES,
    letter: tuple[float, float] | None = None,
) -> None:
    """Write texts beside marks where they cover no mark, text or curve.

    A text without such a position is left out; if the size of letters is given, it is written where it covers the
    fewest points of curves and the line to its mark crosses the fewest marks and texts.

    Parameters
    ----------
    marks : text, possibly empty, and position (x, y) of every mark.
    away : distances at which a text is tried, as multiples of ``MARKER_SIZE``; a line joins a distant text to its mark.
    letter : size of a letter with its space, relative to the axes; by default every text has the size of a value.
    """
    to_axes, back = axes.transData + axes.transAxes.inverted(), axes.transAxes.inverted()
    lines = [(line.get_transform() + back).transform(line.get_xydata()) for line in axes.lines]
    curves = np.concatenate([np.empty((0, 2)), *(_along(line) for line in lines)])
    taken = [(at - MARKER_SIZE, at + MARKER_SIZE) for at in (to_axes.transform(position) for _, *position in marks)]
    for text, value, height in marks:
        at, options = to_axes.transform((value, height)), list[Any]()
        size = VALUE_SIZE if letter is None else np.array([letter[0] * len(text), letter[1]])
        sides = product(away, (1, -1), (1, -1) if letter is None else (1, -1, 0)) if text else ()
        for distance, side in ((distance, np.array(side)) for distance, *side in sides):
            centre = at + side * (distance * MARKER_SIZE + size / 2)
            low, high = centre - size / 2, centre + size / 2
            if any(np.all((low < top) & (bottom < high)) for bottom, top in taken):
                continue
            leader = np.linspace(at, centre, LEADER_POINTS)
            others = (box for box in taken if not np.all((box[0] < at) & (at < box[1])))
            crossed = sum(
                bool(np.all((bottom - MARKER_SIZE / 2 < leader) & (leader < top + MARKER_SIZE / 2), axis=1).any())
                for bottom, top in others
            )
            if np.all(low >= VALUE_REGION[0]) and np.all(high <= VALUE_REGION[1]):
                covered = int(np.all((low < curves) & (curves < high), axis=1).sum())
                if not covered or letter is not None:
                    cost = PER_POINT * covered + PER_CROSSING * crossed + distance
                    options.append((cost, distance, side, low, high))
        if options:
            _, distance, (right, up), low, high = min(options, key=lambda option: option[0])
            taken.append((low, high))
            ink, near = (NEUTRAL, DISTANCES[-1]) if letter is None else ("black", DISTANCES[1])
            arrow = {"arrowstyle": "-", "color": ink, "linewidth": 0.7} if distance > near else None
            by_size = at + distance * MARKER_SIZE * (right, up), "axes fraction"
            where, units = ((7 * distance * right, 5 * distance * up), "offset points") if letter is None else by_size
            axes.annotate(
                text, (value, height), xytext=where, textcoords=units,
                ha="left" if right > 0 else "right", va=("center", "bottom", "top")[up], fontsize="small",
                color=ink, arrowprops=arrow,
                path_effects=[] if letter is None else [withStroke(linewidth=2, foreground="white")],
            )  # fmt: skip


def _along(corners: Array) -> Array:
    """Points along the line through some corners, closer together than the text of a value is high; shape (n, 2)."""
    lengths = np.append(0.0, np.cumsum(np.hypot(*np.diff(corners, axis=0).T)))
    evenly = np.linspace(0, lengths[-1], 2 + int(4 * lengths[-1] / VALUE_SIZE.min()))
    return np.column_stack([np.interp(evenly, lengths, column) for column in corners.T])


def multiplier_plane(named: Mapping[str, Multipliers]) -> Figure:
    """The multipliers of gaits in the complex plane, by the names of the gaits."""
    figure, axes, handles = _plane()
    reach = SMALLEST_REACH
    for k, (name, values) in enumerate(named.items()):
        colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
        stable = bool(np.abs(values).max(initial=0.0) < 1)
        drawn = _inside(values)
        moved = drawn != values
        filled: Any = {"fillstyle": "full" if stable else "none", "clip_on": False}
        axes.plot(drawn.real, drawn.imag, marker, color=colour, markersize=7, **filled)
        texts = dict[complex, list[str]]()  # the multipliers beyond the picture, by their positions at its edge
        for z, value in zip(drawn[moved].tolist(), values[moved].tolist(), strict=True):
            near = next((known for known in texts if abs(known - z) < SHARED_TEXT), z)
            texts.setdefault(near, []).append(f"{abs(value):.3g}")
        for z, sizes in texts.items():
            side, shift = ("right", -5) if z.real > 0 else ("left", 5)
            axes.annotate(
                ", ".join(sizes), (z.real, z.imag), xytext=(shift, 8 + 12 * k), textcoords="offset points",
                ha=side, color=colour,
            )  # fmt: skip
        title = f"{name} ({'stable' if stable else 'unstable'})"
        handles.append(entry(title, color=colour, marker=marker, linestyle="", fillstyle="full" if stable else "none"))
        reach = max(reach, _reach(values))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    legend_below(figure, handles)
    return figure


def multiplier_paths(records: Sequence[Record], parameter: Parameter) -> Figure:
    """The multipliers of every point of a branch in the complex plane, coloured by the parameter.

    Rings with the value of the parameter mark the multipliers on the unit circle at special points.
    """
    records = parameter.shown(records)
    points = [record for record in records if record["record"] == "point"]
    specials = [record for record in records if record["record"] == "special" and record["type"] in CROSSINGS]
    figure, axes, handles = _plane()
    reach = SMALLEST_REACH
    texts = dict[complex, list[str]]()
    for special in specials:
        multipliers = multipliers_of(special["gait"]) if special.get("gait") else np.empty(0, complex)
        on_circle = multipliers[np.abs(np.abs(multipliers) - 1) < ON_CIRCLE]
        axes.plot(on_circle.real, on_circle.imag, "o", color=CROSSING, fillstyle="none")
        for z in on_circle[:1]:
            near = next((known for known in texts if abs(known - z) < SHARED_TEXT), complex(z))
            texts.setdefault(near, []).append(f"{special['value']:.4g}")
    for z, labels in texts.items():
        right, up = 9 * z.real / abs(z), 9 * z.imag / abs(z)
        axes.annotate(
            "\n".join(labels), (z.real, z.imag), xytext=(right, up), textcoords="offset points",
            ha="left" if right > 0 else "right", va="bottom" if up > 0 else "top",
        )  # fmt: skip
    if specials:
        handles.append(entry("stability changes", marker="o", linestyle="", color=CROSSING, fillstyle="none"))
    z = np.concatenate([multipliers_of(point) for point in points])
    values = np.array([point["value"] for point in points for _ in point["multipliers"]])
    reach, drawn = max(reach, _reach(z)), _inside(z)
    scatter = axes.scatter(drawn.real, drawn.imag, c=values, cmap="cividis", s=12, linewidths=0)
    figure.colorbar(scatter, ax=axes, label=str(parameter.label), shrink=0.85)
    if (drawn != z).any():
        largest = np.abs(z).max()
        handles.append(entry(f"at the edge: beyond it, |λ| up to {largest:.3g}", marker=".", linestyle=""))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    legend_below(figure, handles)
    return figure


def _plane() -> tuple[Figure, Axes, list[Line2D]]:
    """A figure with the unit circle, its axes and its legend entry."""
    figure, (axes,) = panels(height=5.2)
    turn = np.linspace(0, 2 * np.pi, 361)
    axes.plot(np.cos(turn), np.sin(turn), color=NEUTRAL, linewidth=1.0)
    axes.axhline(0, color="#b0b0b0", linewidth=0.7)
    axes.axvline(0, color="#b0b0b0", linewidth=0.7)
    axes.set_box_aspect(1)
    axes.set_xlabel("real part of λ")
    axes.set_ylabel("imaginary part of λ")
    return figure, axes, [entry("unit circle", linewidth=1.0)]


def _reach(values: Multipliers) -> float:
    """Half width of a picture of multipliers."""
    return min(LARGEST_REACH, 1.1 * float(np.abs(values).max(initial=0.0)))


def _inside(values: Multipliers) -> Multipliers:
    """The multipliers; those beyond the largest picture are moved towards the origin to its edge."""
    size = np.maximum(np.abs(values.real), np.abs(values.imag)) / LARGEST_REACH
    return np.asarray(values / np.maximum(size, 1.0))
