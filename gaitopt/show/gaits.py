"""Figures of gaits and walks: phase portrait, force ratio, foot slip, torques, section states, NLP against simulation.

    sigma = f_t / f_n,      |sigma| <= mu        the friction cone; a sticking impact needs |F_t| / F_n <= mu too

They include Figs 2, 3, 6, 7 and 8 of Gamus & Or (2013). Only stored quantities are drawn, so that a gait that was read
back from its folder has the same figure.
"""

from collections.abc import Mapping, Sequence
from itertools import cycle, pairwise
from math import degrees
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import CARETDOWNBASE
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait
from gaitopt.gait.measures import ContactObservation, angles_of, friction_ratio, observe, touching_contacts
from gaitopt.gait.trajectory import Step
from gaitopt.model.modes import OFF, Mode
from gaitopt.model.section import TOUCHDOWN, cycle_start
from gaitopt.model.transitions import Ending
from gaitopt.problem.scalars import state_unit
from gaitopt.show.motion import (
    Motion,
    differences,
    motor_label,
    points_of,
    position_label,
    positions_of,
    resampled,
    resampled_points,
    smooth,
    thinned,
    time_label,
    with_start_times,
)
from gaitopt.show.style import (
    COLOURS,
    CURVES,
    HEIGHT,
    JUMP,
    MODE_COLOURS,
    MODE_NAMES,
    NEUTRAL,
    SLIP_DASHES,
    Label,
    dashes,
    entry,
    label,
    legend_below,
    mode_legend,
    panels,
    parameter_of,
    symbol,
)
from gaitopt.verification.walk import Walk

OUTSIDE: dict[str, Any] = {"facecolor": "#b39b77", "alpha": 0.2, "edgecolor": "none"}
"""Look of the region beyond the friction cone, on any background."""
SLIP_WIDTH, EDGE_DASHES = 4.0, (0, (1.3, 0.6))
"""Width [points] and dashes, in widths, of the force ratio of a foot that slips, which lies on the edge of the cone."""
BAR_HEIGHT, NARROW_BAR = 0.8, 0.005
"""Height of the bar of a mode; and the width of the bar of a slip, relative to the time axis, below which the slip is
marked."""
MARKED_STATES = 6
"""Largest number of states after impacts that are marked in the portrait of a walk."""
CONE_ROOM = 1.35
"""Half height of the axes relative to the coefficient of friction."""
SMALLEST_JUMP = 1e-6
"""Smallest jump of a state [rad, m; per s] that is not due to rounding."""
GAIT_COLOUR, FAILURE_COLOUR = "#009e73", "#d55e00"
"""Colours of the gait with which a walk is compared, and of the end of a walk that failed."""
STRIP_ROW = 0.1
"""Height of each further row of the modes above torques [inch]."""
PANEL_HEIGHT, AXIS_HEIGHT = 1.35, 1.1
"""Height of one panel, and of axis and legend below all panels [inch]."""
LABEL_CHARACTERS = 16
"""Number of characters of a label that fit beside a panel."""
ROUNDING = 1e-17
"""Height at which a difference of zero is drawn on the log axis."""


def force_ratio(motions: Sequence[Motion], against: str = "time") -> Figure:
    """Force ratio versus time or a shape coordinate, with the impulse ratio of eq. (9) as a cross at its end.

    For walkers that leave the ground a second panel shows the normal force. Every contact has its curve.

    Parameters
    ----------
    against : ``time``, or the name of a shape coordinate.
    """
    loaded = against == "time" and any(motion.walker.leaves_ground() for motion in motions)
    figure, (axes, *normal) = panels(2, heights=[3, 2], height=5.4) if loaded else panels()
    colours = _contact_colours(motions)
    for motion in motions:
        _draw_ratio(axes, motion, against, colours)
        weight = float(motion.dynamics.system.weight(motion.dynamics.p))
        for panel in normal:
            for began, arc in smooth(motion.steps):
                for contact in touching_contacts(arc, observe(arc)):
                    style = {"color": colours[motion.name, contact.names], "linestyle": _line(contact)}
                    panel.plot(began + arc.times, contact.force[:, 1] / weight, **style)
            panel.set_ylabel("normal force / weight\n$f_n/(m g)$")
    handles: list[Line2D | Patch] = [*_contact_entries(motions, colours)]
    [axes, *normal][-1].set_xlabel(time_label(motions) if against == "time" else f"angle {symbol(against)} [rad]")
    axes.set_ylabel("force ratio σ = $f_t/f_n$")
    handles.extend(_cones(axes, motions))
    modes = [mode for motion in motions for mode in motion.modes]
    crosses = [line for line in axes.lines if line.get_marker() == "x"][:1]
    ratios = [entry("impulse ratio to stick", marker="x", linestyle="", markeredgewidth=1.8) for _ in crosses]
    legend_below(figure, [*handles, *mode_legend(modes, each=True), *ratios])
    return figure


def foot_slip(motions: Sequence[Motion]) -> Figure:
    """Position of the stance foot over one cycle, downhill positive [mm]."""
    figure, (axes,) = panels(height=3.4)
    colours = _contact_colours(motions)
    for motion in motions:
        for began, step in with_start_times(motion.steps):
            slipped = dict[str, float]()  # slip of the contacts on the ground since they landed
            for arc in step.arcs:
                slipped = {name: slipped.get(name, 0.0) for name in arc.mode.touching}
                times, s = resampled(arc).times, resampled_points(arc)
                for contact in touching_contacts(arc, observe(arc)):
                    x = slipped[contact.names[0]] + curves.evaluate(curves.primitive(contact.slip, arc.duration), s)
                    slipped |= dict.fromkeys(contact.names, float(x[-1]))
                    style = {"color": colours[motion.name, contact.names], "linestyle": _line(contact)}
                    axes.plot(began + times, 1000 * x, **style)
    axes.axhline(0, color="#808080", linewidth=0.8)
    axes.set_xlabel(time_label(motions))
    labelled = any(motion.walker.labels() for motion in motions)
    axes.set_ylabel("slip since touchdown [mm]" if labelled else "slip of the stance foot x [mm]")
    modes = [mode for motion in motions for mode in motion.modes]
    legend_below(figure, [*_contact_entries(motions, colours), *mode_legend(modes, each=True)])
    return figure


def contact_diagram(motions: Sequence[Motion]) -> Figure:
    """The gait diagram: the mode of every contact versus time, in a row each."""
    figure, (axes,) = panels(height=1.4 + 0.32 * len(contact_rows(motions)))
    handles = mode_strip(axes, motions)
    axes.tick_params(labelbottom=True)
    axes.set_xlim(0, max(motion.period for motion in motions))
    axes.set_xlabel(time_label(motions))
    legend_below(figure, handles)
    return figure


def _contact_colours(motions: Sequence[Motion]) -> dict[tuple[str, tuple[str, ...]], str]:
    """A colour for every contact, or group of contacts that share their forces, of every motion."""
    pairs = dict.fromkeys(
        (motion.name, contact.names)
        for motion in motions
        for step in motion.steps
        for arc in step.arcs
        for contact in touching_contacts(arc, observe(arc))
    )
    return dict(zip(pairs, cycle(CURVES), strict=False))


def _contact_entries(motions: Sequence[Motion], colours: Mapping[tuple[str, tuple[str, ...]], str]) -> list[Line2D]:
    """Entries of the legend: the motions, or their contacts."""
    walkers = {motion.name: motion.walker for motion in motions}

    def title(motion: str, contacts: tuple[str, ...]) -> str:
        own = " + ".join(filter(None, map(walkers[motion].label, contacts))).replace("_", " ")
        return motion if not own else f"{motion}: {own}" if len(motions) > 1 else own

    return [entry(title(*key), color=colour) for key, colour in colours.items()]


def _line(contact: ContactObservation) -> Any:
    """Line style of a contact: solid where it sticks, dashed where it slips."""
    return SLIP_DASHES if contact.direction else "-"


def torques(motions: Sequence[Motion]) -> Figure:
    """Torque [N m] or force [N] of every motor over one cycle; the strip on top shows the modes."""
    rows = len(contact_rows(motions))
    figure, (strip, axes) = panels(2, heights=[rows, 14], height=HEIGHT + STRIP_ROW * (rows - 1))
    colours = cycle(CURVES)
    handles: list[Line2D | Patch] = []
    for motion in motions:
        for k, name in enumerate(motion.walker.actuators):
            prefix = f"{motion.name}: " if len(motions) > 1 else ""
            colour = next(colours)
            handles.append(entry(f"{prefix}{name.replace('_', ' ')}", color=colour))
            for began, arc in smooth(motion.steps):
                axes.plot(began + arc.times, observe(arc).torque[:, k], color=colour)
    axes.set_xlabel(time_label(motions))
    axes.set_ylabel(motor_label(motions))
    legend_below(figure, [*handles, *mode_strip(strip, motions)])
    return figure


def phase_variable(motions: Sequence[Motion]) -> Figure:
    """The phase variable of the control law and its rate over one cycle."""
    figure, (above, below) = panels(2)
    colours, handles = cycle(CURVES), list[Line2D]()
    for motion in motions:
        name, colour = motion.dynamics.system.control.phase_variable, next(colours)
        index = motion.dynamics.system.angle_names.index(name)
        handles.append(entry(f"{motion.name}: {symbol(name)}" if len(motions) > 1 else symbol(name), color=colour))
        for began, arc in smooth(motion.steps):
            for axes, values in zip((above, below), angles_of(arc), strict=True):
                axes.plot(began + arc.times, values[:, index], color=colour, linestyle=dashes(arc.mode))
    above.set_ylabel("phase [rad]")
    below.set_ylabel("its rate [rad/s]")
    below.set_xlabel(time_label(motions))
    legend_below(figure, [*handles, *mode_legend([mode for motion in motions for mode in motion.modes])])
    return figure


def contact_rows(motions: Sequence[Motion]) -> list[tuple[Motion, str]]:
    """Every contact of every motion: the rows of a gait diagram."""
    return [(motion, name) for motion in motions for name in motion.walker.contact_names()]


def mode_strip(axes: Axes, motions: Sequence[Motion]) -> list[Patch | Line2D]:
    """Draw the mode of every contact versus time as coloured bars, in a row each; returns the legend's entries.

    A slip that is too short to be seen has a mark above its bar. The row of a contact off the ground is empty, except
    in flight.
    """
    rows, present, narrow = contact_rows(motions), set[Mode](), False
    whole = max(motion.period for motion in motions)
    for row, (motion, name) in enumerate(rows):
        for began, step in with_start_times(motion.steps):
            for arc in step.arcs:
                state = arc.mode.contacts[name] if arc.mode.touching else Mode.FLIGHT
                if state != OFF:
                    begin, colour = began + arc.start, MODE_COLOURS[Mode(state)]
                    axes.barh(row, arc.duration, left=begin, height=BAR_HEIGHT, color=colour, linewidth=0)
                    if arc.duration < NARROW_BAR * whole and Mode(state).slips:
                        style: dict[str, Any] = {
                            "color": colour,
                            "markeredgecolor": "black",
                            "markeredgewidth": 0.4,
                            "clip_on": False,
                        }
                        centre = begin + arc.duration / 2, row - BAR_HEIGHT / 2 - 0.02
                        axes.plot(*centre, marker=CARETDOWNBASE, markersize=5, linestyle="", zorder=3, **style)
                        narrow = True
                    present.add(Mode(state))
    labels = [motion.name if len(motions) > 1 else "" for motion, _ in rows]
    own = [motion.walker.label(name).replace("_", " ") for motion, name in rows]
    labels = [": ".join(filter(None, pair)) for pair in zip(labels, own, strict=True)]
    axes.set_yticks(range(len(rows)) if any(labels) else [], labels if any(labels) else [], fontsize="small")
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.tick_params(length=0, labelbottom=False)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    entries: list[Patch | Line2D] = [
        Patch(color=MODE_COLOURS[mode], label=MODE_NAMES[mode]) for mode in MODE_COLOURS if mode in present
    ]
    return entries + [entry("a slip too short to see", marker=CARETDOWNBASE, linestyle="")] * narrow


def _draw_ratio(axes: Axes, motion: Motion, against: str, colours: Mapping[tuple[str, tuple[str, ...]], str]) -> None:
    ends = []
    for began, arc in smooth(motion.steps):
        where = began + arc.times if against == "time" else arc.states[:, motion.state_index(against)]
        for contact in touching_contacts(arc, observe(arc)):
            style = {"color": colours[motion.name, contact.names], "linestyle": _line(contact)}
            if contact.direction:  # on the edge of the cone, whose line would hide it
                style |= {"linewidth": SLIP_WIDTH, "linestyle": EDGE_DASHES}
            axes.plot(where, friction_ratio(contact.force), **style)
        ends.append(float(where[-1]))
    last_arcs = np.cumsum([len(step.arcs) for step in motion.steps]) - 1
    own = {colour for (name, _), colour in colours.items() if name == motion.name}
    colour = own.pop() if len(own) == 1 else NEUTRAL
    for step, last in zip(motion.steps, last_arcs, strict=True):
        if step.impact is None or step.impact.impulse_ratio is None:
            continue
        tangential, normal = step.impact.stick_impulse
        axes.plot(ends[last], tangential / normal, "x", color=colour, markeredgewidth=1.8, markersize=7, clip_on=False)


def _cones(axes: Axes, motions: Sequence[Motion]) -> list[Line2D | Patch]:
    """Draw the edges of friction cones, with a shade beyond if there is just one; returns the legend's entries."""
    own = [
        round(float(static), 12)
        for motion in motions
        for static, *_ in motion.dynamics.system.contact_coefficients(motion.dynamics.p).values()
    ]
    frictions = sorted(set(own))
    reach = max(float(np.abs(axes.dataLim.intervaly).max()) * 1.1, min(frictions) * CONE_ROOM)
    entries: list[Line2D | Patch] = []
    for friction in frictions:
        if friction > reach * CONE_ROOM:
            continue  # the curve would be squeezed into a line
        reach = max(reach, 1.1 * friction)
        colours = [colour for colour, value in zip(cycle(COLOURS), own, strict=False) if value == friction]
        one_cone_each = len(frictions) > 1 and len(own) == len(motions)
        colour = colours[0] if one_cone_each else NEUTRAL
        for side in (-friction, friction):
            axes.axhline(side, color=colour, linewidth=0.9, zorder=1.5, linestyle="-.")
        entries.append(entry(f"cone ±μ = ±{friction:g}", color=colour, linewidth=0.9, linestyle="-."))
    axes.set_ylim(-reach, reach)
    if len(frictions) == 1 and entries:
        for low, high in ((-reach, -frictions[0]), (frictions[0], reach)):
            axes.axhspan(low, high, zorder=-1, **OUTSIDE)
        entries.append(Patch(label="beyond friction", **OUTSIDE))
    return entries


def phase_portrait(motions: Sequence[Motion]) -> Figure:
    """Angles [rad] against rates [rad/s] of all motions in one plane; a dot marks the state just after the impact."""
    figure, (axes,) = panels(height=4.6)
    colours = cycle(CURVES)
    handles: list[Line2D] = []
    for motion in motions:
        for name in positions_of(motion):
            prefix = f"{motion.name}: " if len(motions) > 1 else ""
            colour = next(colours)
            handles.append(entry(f"{prefix}{symbol(name)}", color=colour))
            _draw_orbit(axes, motion, name, colour)
    axes.set_xlabel(position_label(motions))
    axes.set_ylabel("rate [rad/s, m/s]" if "length" in position_label(motions) else "angular rate [rad/s]")
    modes = [mode for motion in motions for mode in motion.modes]
    landing = any(motion.dynamics.system.cycle_end == TOUCHDOWN for motion in motions)
    starts = dict.fromkeys(cycle_start(motion.dynamics.system) for motion in motions)
    after = entry(" or ".join(starts), marker="o", linestyle="", markersize=5)
    locks = any(_leaps(step) for motion in motions if motion.walker.stops for step in motion.steps)
    jumps = landing or any(_leaps(step) for motion in motions for step in motion.steps)
    jump = entry("impact, or a stop locks" if locks else "impact", **JUMP)
    legend_below(figure, [*handles, *mode_legend(modes), *([jump] if jumps else []), after])
    return figure


def _draw_orbit(axes: Axes, motion: Motion, name: str, colour: str) -> None:
    """Draw a shape coordinate and its rate, with dotted jumps and a dot just after every impact."""
    angle, rate = motion.state_index(name), motion.state_index(f"d{name}")
    for _, arc in smooth(motion.steps):
        axes.plot(arc.states[:, angle], arc.states[:, rate], color=colour, linestyle=dashes(arc.mode))
    for before, after in (pair for step in motion.steps for pair in _leaps(step)):
        axes.plot([before[angle], after[angle]], [before[rate], after[rate]], color=colour, **JUMP)
    starts = np.array([step.arcs[0].states[0, [angle, rate]] for step in motion.steps])
    for step, following in zip(motion.steps, (*motion.steps[1:], *motion.steps[: motion.periodic]), strict=False):
        last, first = step.arcs[-1].states[-1], following.arcs[0].states[0]
        angles, rates = (last[angle], last[angle], first[angle]), (last[rate], first[rate], first[rate])
        axes.plot(angles, rates, color=colour, **JUMP)  # first the rate jumps, then the angle
    count = len(starts) if motion.periodic else min(len(starts), MARKED_STATES)
    few = np.linspace(0, len(starts) - 1, count).round().astype(int)
    axes.plot(*starts[few].T, "o", color=colour, markersize=6, markeredgecolor=axes.get_facecolor(), zorder=3)


def _leaps(step: Step) -> list[tuple[Array, Array]]:
    """States before and after every jump within a step, such as that of a stop that locks."""
    ends = [(before.states[-1], after.states[0]) for before, after in pairwise(step.arcs)]
    return [(before, after) for before, after in ends if np.abs(after - before).max() > SMALLEST_JUMP]


def section_states(walk: Walk) -> Figure:
    """Every coordinate of the section versus the number of the step; a broken line marks where the walk ended."""
    states, ending = walk.trajectory.section_states, walk.trajectory.ending
    failed = ending is not Ending.COMPLETED
    names = list(walk.system.walker.section_names(slipping=True))
    if len(names) > 1 and not np.any(states[:, -1]):
        names.pop()  # no foot slips just after an impact
    figure, axes = panels(len(names), height=PANEL_HEIGHT * len(names) + AXIS_HEIGHT)
    for name, panel in zip(names, axes, strict=True):
        column = walk.system.state_names.index(name)
        for state in walk.gait_states:
            panel.axhline(state[column], color=GAIT_COLOUR, linewidth=1.4)
        panel.plot(range(len(states)), states[:, column], ".-", color=COLOURS[0], linewidth=1.0, markersize=7)
        if failed:
            panel.axvline(len(states) - 0.5, color=FAILURE_COLOUR, linestyle="--")
        low, high = panel.get_ylim()
        if high - low < SMALLEST_JUMP:  # a walk on its gait
            room = max(SMALLEST_JUMP, abs(low) / 10)
            panel.set_ylim(low - room, high + room)
        panel.set_ylabel(fill(f"{symbol(name)} [{state_unit(name)}]", LABEL_CHARACTERS))
        panel.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes[-1].set_xlabel("steps since the start")
    figure.align_ylabels(axes)
    handles = [entry(cycle_start(walk.system).replace("the", "each"), color=COLOURS[0], marker=".", linewidth=1.0)]
    handles += [entry("the gait", color=GAIT_COLOUR, linewidth=1.4)] if len(walk.gait_states) else []
    title = f"the walk ends: {str(ending).replace('_', ' ')}"
    handles += [entry(title, color=FAILURE_COLOUR, linestyle="--")] if failed else []
    legend_below(figure, handles)
    return figure


def method_comparison(motion: Motion, walked: Sequence[Step]) -> Figure:
    """Positions of a gait from the NLP over those of the simulated steps, and the differences of all states below.

    Parameters
    ----------
    motion : the gait.
    walked : the simulated steps.
    """
    figure, (upper, lower) = panels(2, heights=[3, 2], height=5.4)
    times, states = thinned(*points_of(motion.steps))
    handles: list[Line2D] = []
    for name, colour in zip(positions_of(motion), COLOURS, strict=False):
        column = motion.state_index(name)
        for began, step in with_start_times(walked):
            for arc in step.arcs:
                upper.plot(began + arc.times, arc.states[:, column], color=colour, linestyle=dashes(arc.mode))
        upper.plot(times, states[:, column], "o", color=colour, markersize=4, fillstyle="none")
        handles.append(entry(f"{symbol(name)}, simulation", color=colour))
    handles.append(entry("NLP", marker="o", linestyle="", fillstyle="none"))
    upper.set_ylabel(position_label([motion]))
    rate = motion.state_index(f"d{motion.walker.shape[0]}")
    for kind, columns, line in (("positions", slice(0, rate), "-"), ("velocities", slice(rate, None), ":")):
        for at, gap in differences(motion.steps, walked):
            size = np.maximum(np.abs(gap[:, columns]).max(axis=1), ROUNDING)
            lower.semilogy(at, size, color=NEUTRAL, linestyle=line, linewidth=1.1)
        handles.append(entry(f"difference, {kind}", linestyle=line, linewidth=1.1))
    lower.set_xlabel(time_label([motion]))
    lower.set_ylabel("|NLP − simulation|\n[rad, m; per s]")
    legend_below(figure, [*handles, *mode_legend([mode for step in walked for mode, _ in step.phases])])
    return figure


def design_range(gait: Gait) -> Figure:
    """Objective and spectral radius of a design over the range of its parameter, with its changes of mode sequence.

    The dashed lines are the objective of the design for one value alone, and the bound of the radius.
    """
    over = gait.over
    assert over is not None
    weights, bound = gait.problem.objective, gait.problem.constraints.get("spectral_radius")
    shown = parameter_of(gait.problem, over.key)
    scale = degrees(1.0) if shown.in_degrees else 1.0
    values = [scale * point.value for point in over.points]
    rows: list[tuple[Label, list[float], float | None]]
    rows = [
        (label("spectral_radius"), [point.spectral_radius for point in over.points], bound.maximum if bound else None)
    ]
    if weights:
        minimised = label(next(iter(weights)), gait.problem) if len(weights) == 1 else Label(name="objective")
        sign = np.sign(next(iter(weights.values()))) if len(weights) == 1 else 1.0
        rows.insert(0, (minimised, [sign * point.objective for point in over.points], sign * (over.single or 0.0)))
    figure, axes = panels(len(rows), height=1.9 * len(rows) + 0.8)
    changes = [
        (one + other) / 2
        for (one, first), (other, second) in pairwise(zip(values, (p.sequence for p in over.points), strict=True))
        if first != second
    ]
    for panel, (quantity, heights, line) in zip(axes, rows, strict=True):
        panel.plot(values, heights, color=COLOURS[0])
        if line is not None:
            panel.axhline(line, color=COLOURS[1], linestyle="--", linewidth=1)
        for change in changes:
            panel.axvline(change, color=NEUTRAL, linestyle=":", linewidth=0.8)
        panel.set_ylabel(str(quantity))
    axes[-1].set_xlabel(str(shown.label))
    dashed = " and ".join([*["design for one value"] * bool(weights), *["bound of the radius"] * (bound is not None)])
    handles = [entry(dashed, color=COLOURS[1], linestyle="--", linewidth=1)] if dashed else []
    legend_below(figure, [*handles, entry("change of the mode sequence", color=NEUTRAL, linestyle=":", linewidth=0.8)])
    return figure
