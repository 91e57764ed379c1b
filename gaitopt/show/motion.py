"""One cycle of a walk with all that is needed to draw it, from a gait, a simulated walk or a stored record.

What the ground does: force ratio, foot slip and torques over one step, as in Figs 3, 7 and 10 of the paper.

sigma = f_t / f_n,      |sigma| <= mu        the friction cone; a sticking impact needs |F_t| / F_n <= mu too

Phase portraits: every shape coordinate against its rate over one cycle, as in Figs 2, 6 and 8 of the paper.

A walk step by step: the states just after each impact against those of the gait that it started from.

Floquet multipliers in the complex plane, with the unit circle inside which a gait is stable.

The two independent methods compared: points of the NLP's gait on the simulated step, and their difference.

Only what a run folder keeps is drawn, so that a gait that has been read back has the same figure.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, cycle, pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait
from gaitopt.gait.measures import Observation, friction_ratio, observe
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import Ending
from gaitopt.model.walker import Walker
from gaitopt.problem.scalars import state_unit
from gaitopt.show.style import (
    COLOURS,
    JUMP,
    MODE_COLOURS,
    MODE_WORDS,
    NEUTRAL,
    Label,
    Parameter,
    dashes,
    entry,
    label,
    legend_below,
    mode_legend,
    panels,
    symbol,
)
from gaitopt.simulation.simulator import Simulator
from gaitopt.store.gaits import POINTS, integrated_steps, multipliers_of
from gaitopt.verification.walk import Walk

SMOOTH = 120
"""Points of an arc that is drawn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Steps to be drawn, one after the other; of a gait the first begins where the last one ends.

    Attributes
    ----------
    name : what legends call it.
    dynamics : the hybrid system that moves, at its parameters.
    steps : each with arcs at Chebyshev points, and the impact at their end; the last one of a walk may have none.
    periodic : whether it repeats itself.
    """

    name: str
    dynamics: Dynamics
    steps: tuple[Step, ...]
    periodic: bool = True

    @property
    def walker(self) -> type[Walker]:
        """What moves."""
        return self.dynamics.system.walker

    @property
    def modes(self) -> list[Mode]:
        """Modes of all phases in order."""
        return [mode for step in self.steps for mode, _ in step.phases]

    @property
    def period(self) -> float:
        """Time of the whole cycle [s]."""
        return sum(step.period for step in self.steps)

    def state_index(self, name: str) -> int:
        """Column of a state in ``Arc.states``."""
        return self.dynamics.system.state_names.index(name)

    def observe(self, arc: Arc) -> Observation:
        """Forces, torques and swing foot along an arc of this motion."""
        return observe(self.dynamics, arc)


def motion_of(gait: Gait, name: str = "") -> Motion:
    """The steps of a converged gait."""
    return Motion(name=name or gait.problem.name, dynamics=gait.dynamics, steps=gait.motion)


def motion_of_walk(walk: Walk) -> Motion:
    """All steps of a simulated walk, the last of which may end without an impact.

    Raises
    ------
    ValueError
        If the walk ended before anything moved.
    """
    if not walk.trajectory.steps:
        raise ValueError(f"{walk.problem.name}: the walk ended before it began: {walk.trajectory.message}")
    steps = walk.trajectory.steps
    return Motion(name=walk.problem.name, dynamics=walk.dynamics, steps=steps, periodic=False)


def motion_from_record(dynamics: Dynamics, record: Mapping[str, Any], name: str = "", points: int = POINTS) -> Motion:
    """The steps that a JSON record describes by a state after impact, their modes and durations.

    The motion is integrated from the state, so that a record needs to hold no more than that.

    Parameters
    ----------
    dynamics : at the parameters for which the record holds.
    record : a gait or a point of a branch, with the keys ``state``, ``phases`` and ``impact``, or ``steps``.
    points : Chebyshev points of every phase.
    """
    steps = integrated_steps(dynamics, record, points)
    return Motion(name=name or str(record["problem"]), dynamics=dynamics, steps=steps)


def resampled(arc: Arc, count: int) -> Arc:
    """The same arc at ``count`` equidistant times."""
    if len(arc.times) == 2:  # too short to be anything but straight
        s = np.linspace(0, 1, count)[:, None]
        states = arc.states[0] + s * (arc.states[-1] - arc.states[0])
    else:
        states = np.asarray(chebyshev.chebval(np.linspace(-1, 1, count), curves.coefficients(arc.states)).T)
    return replace(arc, times=np.linspace(arc.start, arc.end, count), states=states)


def smooth(steps: Sequence[Step]) -> Iterator[tuple[float, Arc]]:
    """Time before its step [s] and every arc, at so many points that a line through them looks smooth."""
    for began, step in running(steps):
        yield from ((began, resampled(arc, SMOOTH)) for arc in step.arcs)


def running(steps: Sequence[Step]) -> Iterator[tuple[float, Step]]:
    """Time from the start of the first step to that of each step [s], and the step."""
    return zip(accumulate((step.period for step in steps[:-1]), initial=0.0), steps, strict=True)


def time_label(motions: Sequence[Motion]) -> str:
    """What the time axis counts from: the one impact, or the start of several steps."""
    single = all(len(motion.steps) == 1 for motion in motions)
    return str(label("time") if single else Label(words="time since the start", unit="s"))


def position_label(motions: Sequence[Motion]) -> str:
    """Label of an axis with shape coordinates: angles, and lengths where a walker has them."""
    lengths = any(motion.walker.lengths for motion in motions)
    return "angle [rad], length [m]" if lengths else "angle [rad]"


OUTSIDE = "#f1ece4"
"""Colour of what friction cannot provide."""
CONE_ROOM = 1.35
"""Height of the axes over the largest ratio that is drawn."""


def force_ratio(motions: Sequence[Motion], against: str = "time") -> Figure:
    """Force ratio over time or over a shape coordinate, the impulse ratio of eq. (9) as a cross at its end.

    Of walkers that fly the normal force is drawn below.

    Parameters
    ----------
    against : ``time``, or the name of a shape coordinate.
    """
    flying = against == "time" and any(motion.walker.flies for motion in motions)
    figure, (axes, *normal) = panels(2, heights=[3, 2], height=5.4) if flying else panels()
    handles: list[Line2D | Patch] = []
    for motion, colour in zip(motions, cycle(COLOURS), strict=False):
        handles.append(entry(motion.name, color=colour))
        _draw_ratio(axes, motion, against, colour)
        for below in normal:
            _draw_normal_force(below, motion, colour)
    figure.axes[-1].set_xlabel(time_label(motions) if against == "time" else f"angle {symbol(against)} [rad]")
    axes.set_ylabel("force ratio σ = $f_t/f_n$")
    handles.extend(_cones(axes, motions))
    modes = [mode for motion in motions for mode in motion.modes]
    crosses = [line for line in axes.lines if line.get_marker() == "x"][:1]
    words = [entry("impulse ratio to stick", marker="x", linestyle="", markeredgewidth=1.8) for _ in crosses]
    legend_below(figure, [*handles, *mode_legend(modes), *words])
    return figure


def foot_slip(motions: Sequence[Motion]) -> Figure:
    """Where the stance foot has slipped to, downhill positive, over one cycle [mm]."""
    figure, (axes,) = panels(height=3.4)
    handles = []
    for motion, colour in zip(motions, cycle(COLOURS), strict=False):
        handles.append(entry(motion.name, color=colour))
        x = motion.state_index("x")
        for began, arc in smooth(motion.steps):
            if not arc.mode.flies:
                axes.plot(began + arc.times, 1000 * arc.states[:, x], color=colour, linestyle=dashes(arc.mode))
    axes.axhline(0, color="#808080", linewidth=0.8)
    axes.set_xlabel(time_label(motions))
    axes.set_ylabel("slip of the stance foot x [mm]")
    modes = [mode for motion in motions for mode in motion.modes]
    legend_below(figure, [*handles, *mode_legend(modes)])
    return figure


def torques(motions: Sequence[Motion]) -> Figure:
    """Torque of every actuator over one cycle [N m]; the strip on top says what the foot does."""
    figure, (strip, axes) = panels(2, heights=[len(motions), 14])
    colours = cycle(COLOURS)
    handles: list[Line2D | Patch] = []
    for motion in motions:
        for k, name in enumerate(motion.walker.actuators):
            prefix = f"{motion.name}: " if len(motions) > 1 else ""
            colour = next(colours)
            handles.append(entry(f"{prefix}{name}", color=colour))
            for began, arc in smooth(motion.steps):
                axes.plot(began + arc.times, motion.observe(arc).torque[:, k], color=colour)
    axes.set_xlabel(time_label(motions))
    axes.set_ylabel("torque [N m]")
    legend_below(figure, [*handles, *mode_strip(strip, motions)])
    return figure


def mode_strip(axes: Axes, motions: Sequence[Motion]) -> list[Patch]:
    """Draw the modes over time as coloured bars, one row for each motion; returns the legend's entries."""
    for row, motion in enumerate(motions):
        for began, step in running(motion.steps):
            for arc in step.arcs:
                axes.barh(row, arc.duration, left=began + arc.start, height=0.8, color=MODE_COLOURS[arc.mode.contact])
    named = len(motions) > 1
    axes.set_yticks(range(len(motions)) if named else [], [motion.name for motion in motions] if named else [])
    axes.tick_params(length=0, labelbottom=False)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.invert_yaxis()
    present = {mode.contact for motion in motions for mode in motion.modes}
    return [Patch(color=MODE_COLOURS[mode], label=MODE_WORDS[mode]) for mode in MODE_COLOURS if mode in present]


def _draw_ratio(axes: Axes, motion: Motion, against: str, colour: str) -> None:
    ends = []
    for began, arc in smooth(motion.steps):
        force = motion.observe(arc).force
        where = began + arc.times if against == "time" else arc.states[:, motion.state_index(against)]
        if not arc.mode.flies:
            axes.plot(where, friction_ratio(force), color=colour, linestyle=dashes(arc.mode))
        ends.append(float(where[-1]))
    last_arcs = np.cumsum([len(step.arcs) for step in motion.steps]) - 1
    for step, last in zip(motion.steps, last_arcs, strict=True):
        if step.impact is None or step.impact.impulse_ratio is None:
            continue
        tangential, normal = step.impact.stick_impulse
        axes.plot(ends[last], tangential / normal, "x", color=colour, markeredgewidth=1.8, markersize=7, clip_on=False)


def _draw_normal_force(axes: Axes, motion: Motion, colour: str) -> None:
    """Normal force over time, in units of the weight."""
    weight = float(motion.dynamics.system.weight(motion.dynamics.p))
    for began, arc in smooth(motion.steps):
        force = motion.observe(arc).force[:, 1] / weight
        axes.plot(began + arc.times, force, color=colour, linestyle=dashes(arc.mode))
    axes.set_ylabel("normal force / weight\n$f_n/(m g)$")


def _cones(axes: Axes, motions: Sequence[Motion]) -> list[Line2D | Patch]:
    """Edges of the friction cone, shaded beyond where there is just one; returns the legend's entries."""
    own = [round(motion.dynamics.static_friction, 12) for motion in motions]
    frictions = sorted(set(own))
    reach = max(float(np.abs(axes.dataLim.intervaly).max()) * 1.1, min(frictions) * CONE_ROOM)
    entries: list[Line2D | Patch] = []
    for friction in frictions:
        if friction > reach * CONE_ROOM:
            continue  # a cone so wide would squeeze the curve into a line
        reach = max(reach, 1.1 * friction)
        colours = [colour for colour, value in zip(cycle(COLOURS), own, strict=False) if value == friction]
        colour = colours[0] if len(frictions) > 1 else NEUTRAL
        for side in (-friction, friction):
            axes.axhline(side, color=colour, linewidth=0.9, zorder=1.5, linestyle="-.")
        entries.append(entry(f"cone ±μ = ±{friction:g}", color=colour, linewidth=0.9, linestyle="-."))
    axes.set_ylim(-reach, reach)
    if len(frictions) == 1 and entries:
        for low, high in ((-reach, -frictions[0]), (frictions[0], reach)):
            axes.axhspan(low, high, color=OUTSIDE, zorder=-1, linewidth=0)
        entries.append(Patch(color=OUTSIDE, label="beyond friction"))
    return entries


VISIBLE = 1e-6
"""Jump of a state [rad, m; per s] that is none of rounding."""


def phase_portrait(motions: Sequence[Motion]) -> Figure:
    """Angles [rad] against rates [rad/s] of all motions in one plane; a dot marks the state just after the impact."""
    figure, (axes,) = panels(height=4.6)
    colours = cycle(COLOURS)
    handles: list[Line2D] = []
    for motion in motions:
        for name in motion.walker.shape:
            prefix = f"{motion.name}: " if len(motions) > 1 else ""
            colour = next(colours)
            handles.append(entry(f"{prefix}{symbol(name)}", color=colour))
            _draw(axes, motion, name, colour)
    lengths = any(motion.walker.lengths for motion in motions)
    axes.set_xlabel(position_label(motions))
    axes.set_ylabel("rate [rad/s, m/s]" if lengths else "angular rate [rad/s]")
    modes = [mode for motion in motions for mode in motion.modes]
    after = entry("just after the impact", marker="o", linestyle="", markersize=5)
    locks = any(_leaps(step) for motion in motions for step in motion.steps)
    jump = entry("impact, or a stop locks" if locks else "impact", **JUMP)
    legend_below(figure, [*handles, *mode_legend(modes), jump, after])
    return figure


def _draw(axes: Axes, motion: Motion, name: str, colour: str) -> None:
    angle, rate = motion.state_index(name), motion.state_index(f"d{name}")
    for _, arc in smooth(motion.steps):
        axes.plot(arc.states[:, angle], arc.states[:, rate], color=colour, linestyle=dashes(arc.mode))
    for before, after in (pair for step in motion.steps for pair in _leaps(step)):
        axes.plot([before[angle], after[angle]], [before[rate], after[rate]], color=colour, **JUMP)
    axes.plot(*motion.steps[0].arcs[0].states[0, [angle, rate]], "o", color=colour, markersize=5)
    for step, following in zip(motion.steps, (*motion.steps[1:], *motion.steps[: motion.periodic]), strict=False):
        last, first = step.arcs[-1].states[-1], following.arcs[0].states[0]
        angles, rates = (last[angle], last[angle], first[angle]), (last[rate], first[rate], first[rate])
        axes.plot(angles, rates, color=colour, **JUMP)  # first the rate jumps, then the angle
        axes.plot(first[angle], first[rate], "o", color=colour, markersize=5)


def _leaps(step: Step) -> list[tuple[Array, Array]]:
    """States before and after every jump within a step, as where a stop locks."""
    ends = [(before.states[-1], after.states[0]) for before, after in pairwise(step.arcs)]
    return [(before, after) for before, after in ends if np.abs(after - before).max() > VISIBLE]


GAIT, FAILED = "#009e73", "#d55e00"
PANEL_HEIGHT, FOOT = 1.35, 1.1
"""Height of one panel, and of axis and legend below [inch]."""


def section_states(walk: Walk) -> Figure:
    """Every coordinate of the section over the number of the step; a broken line marks where the walk ended."""
    names = _names(walk)
    states = walk.trajectory.section_states
    figure, axes = panels(len(names), height=PANEL_HEIGHT * len(names) + FOOT)
    for name, panel in zip(names, axes, strict=True):
        column = walk.system.state_names.index(name)
        for state in walk.gait_states:
            panel.axhline(state[column], color=GAIT, linewidth=1.4)
        panel.plot(range(len(states)), states[:, column], ".-", color=COLOURS[0], linewidth=1.0, markersize=7)
        if walk.trajectory.ending is not Ending.COMPLETED:
            panel.axvline(len(states) - 0.5, color=FAILED, linestyle="--")
        panel.set_ylabel(f"{symbol(name)} [{state_unit(name)}]")
        panel.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes[-1].set_xlabel("steps since the start")
    figure.align_ylabels(axes)
    legend_below(figure, _legend(walk))
    return figure


def _names(walk: Walk) -> list[str]:
    """The section's coordinates; the slip velocity only where a foot ever slips after an impact."""
    names = list(walk.system.walker.section_names(slipping=True))
    slipping = bool(np.any(walk.trajectory.section_states[:, -1]))
    return names if slipping or len(names) == 1 else names[:-1]


def _legend(walk: Walk) -> list[Line2D]:
    handles = [entry("just after each impact", color=COLOURS[0], marker=".", linewidth=1.0)]
    if len(walk.gait_states):
        handles.append(entry("the gait", color=GAIT, linewidth=1.4))
    if walk.trajectory.ending is not Ending.COMPLETED:
        words = str(walk.trajectory.ending).replace("_", " ")
        handles.append(entry(f"the walk ends: {words}", color=FAILED, linestyle="--"))
    return handles


CROSSINGS = ("fold", "period_doubling", "neimark_sacker", "branch_point")
"""Special points at which a multiplier lies on the unit circle."""
CROSSING, ON_CIRCLE = "#d55e00", 1e-3
"""Colour of the rings; and how near the circle a multiplier of such a point lies at most."""
MARKERS = "osD^v"
SMALLEST_REACH, LARGEST_REACH = 1.15, 2.0
"""Half width of the picture: the unit circle and a margin; and at most so much that the circle is still seen."""
SAME_PLACE = 0.1
"""Crossings this close share their text."""


def multiplier_plane(named: Mapping[str, NDArray[np.complex128]]) -> Figure:
    """Multipliers of one or several gaits by name."""
    figure, handles, reach = _plane()
    axes = figure.axes[0]
    for k, (name, values) in enumerate(named.items()):
        colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
        stable = bool(np.abs(values).max(initial=0.0) < 1)
        places = _inside(values)
        axes.plot(places.real, places.imag, marker, color=colour, markersize=7, fillstyle="full" if stable else "none")
        for place, value in zip(places[places != values], values[places != values], strict=True):
            side = "right" if place.real > 0 else "left"
            axes.annotate(
                f"{abs(value):.3g}", (place.real, place.imag), xytext=(0, 8), textcoords="offset points", ha=side
            )
        words = f"{name} ({'stable' if stable else 'unstable'})"
        handles.append(entry(words, color=colour, marker=marker, linestyle="", fillstyle="full" if stable else "none"))
        reach = max(reach, _reach(values))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    legend_below(figure, handles)
    return figure


def multiplier_paths(records: Sequence[Mapping[str, Any]], parameter: Parameter) -> Figure:
    """Multipliers of every point of a branch, coloured by the parameter; where they cross the circle it stands by."""
    records = parameter.shown(records)
    points = [record for record in records if record["record"] == "point"]
    specials = [record for record in records if record["record"] == "special" and record["type"] in CROSSINGS]
    figure, handles, reach = _plane()
    axes = figure.axes[0]
    z = np.concatenate([multipliers_of(point) for point in points])
    values = np.array([point["value"] for point in points for _ in point["multipliers"]])
    reach = max(reach, _reach(z))
    handles += _crossings(axes, specials)
    places = _inside(z)
    scatter = axes.scatter(places.real, places.imag, c=values, cmap="cividis", s=12, linewidths=0)
    figure.colorbar(scatter, ax=axes, label=str(parameter.label), shrink=0.85)
    if (places != z).any():
        largest = np.abs(z).max()
        handles.append(entry(f"at the edge: beyond it, |λ| up to {largest:.3g}", marker=".", linestyle=""))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    legend_below(figure, handles)
    return figure


def _crossings(axes: Axes, specials: Sequence[Mapping[str, Any]]) -> list[Line2D]:
    """Rings around the multipliers on the circle at special points, each with the value of the parameter."""
    texts = dict[complex, list[str]]()
    for special in specials:
        values = [complex(m["re"], m["im"]) for m in (special.get("gait") or {}).get("multipliers", ())]
        on_circle = [z for z in values if abs(abs(z) - 1) < ON_CIRCLE]
        axes.plot([z.real for z in on_circle], [z.imag for z in on_circle], "o", color=CROSSING, fillstyle="none")
        for z in on_circle[:1]:
            place = next((known for known in texts if abs(known - z) < SAME_PLACE), z)
            texts.setdefault(place, []).append(f"{special['value']:.4g}")
    for z, words in texts.items():
        axes.annotate("\n".join(words), (z.real, z.imag), xytext=(6, 6), textcoords="offset points")
    return [entry("stability changes", marker="o", linestyle="", color=CROSSING, fillstyle="none")] if specials else []


def _reach(values: NDArray[np.complex128]) -> float:
    """Half width of a picture of multipliers."""
    return min(LARGEST_REACH, 1.1 * float(np.abs(values).max(initial=0.0)))


def _inside(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Multipliers beyond the largest picture moved to its edge, towards the origin."""
    size = np.maximum(np.abs(values.real), np.abs(values.imag)) / LARGEST_REACH
    return np.asarray(values / np.maximum(size, 1.0))


def _plane() -> tuple[Figure, list[Line2D], float]:
    figure, (axes,) = panels(height=5.2)
    turn = np.linspace(0, 2 * np.pi, 361)
    axes.plot(np.cos(turn), np.sin(turn), color=NEUTRAL, linewidth=1.0)
    axes.axhline(0, color="#b0b0b0", linewidth=0.7)
    axes.axvline(0, color="#b0b0b0", linewidth=0.7)
    axes.set_box_aspect(1)
    axes.set_xlabel("real part of λ")
    axes.set_ylabel("imaginary part of λ")
    return figure, [entry("unit circle", linewidth=1.0)], SMALLEST_REACH


POINTS_SHOWN = 20
"""Markers of the gait's points; more would hide the curve."""
ROUNDING = 1e-17
"""A difference of exactly zero is drawn here, at the foot of the log axis."""


def simulated(gait: Gait) -> tuple[Step, ...]:
    """The steps that the forward simulator walks from the gait's state, choosing its modes by itself."""
    return Simulator(gait.dynamics).run(gait.state, steps=len(gait.steps), dense=True).steps


def method_comparison(motion: Motion, walked: Sequence[Step]) -> Figure:
    """Angles of a gait found by the NLP over those of the simulated steps, and all states' differences below.

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
        for began, step in running(walked):
            for arc in step.arcs:
                upper.plot(began + arc.times, arc.states[:, column], color=colour, linestyle=dashes(arc.mode))
        upper.plot(times, states[:, column], "o", color=colour, markersize=4, fillstyle="none")
        handles.append(entry(f"{symbol(name)}, simulation", color=colour))
    handles.append(entry("NLP", marker="o", linestyle="", fillstyle="none"))
    upper.set_ylabel(position_label([motion]))
    handles += _differences(lower, motion, walked)
    legend_below(figure, [*handles, *mode_legend([mode for step in walked for mode, _ in step.phases])])
    return figure


def positions_of(motion: Motion) -> tuple[str, ...]:
    """The shape coordinates, and the height of a foot that flies."""
    return tuple(name for name in motion.dynamics.system.state_names if name in (*motion.walker.shape, "y"))


def differences(ours: Sequence[Step], theirs: Sequence[Step]) -> Iterator[tuple[Array, Array]]:
    """Times since the start and differences of the states on each arc, compared at equal fractions of it."""
    pairs = zip(running(ours), theirs, strict=False)
    arcs = ((began, *pair) for (began, step), other in pairs for pair in zip(step.arcs, other.arcs, strict=False))
    for began, mine, other in arcs:
        if mine.mode is not other.mode or mine.duration <= 0:
            return
        fractions = 2 * (mine.times - mine.start) / mine.duration - 1
        states = chebyshev.chebval(fractions, curves.coefficients(other.states)).T
        yield began + mine.times, mine.states - np.asarray(states, dtype=np.float64)


def _differences(axes: Axes, motion: Motion, walked: Sequence[Step]) -> list[Line2D]:
    """Angles' and rates' differences along arcs that both methods have."""
    rate = motion.state_index(f"d{motion.walker.shape[0]}")
    kinds = {"positions": (slice(0, rate), "-"), "velocities": (slice(rate, None), ":")}
    entries = []
    for words, (columns, line) in kinds.items():
        for times, gap in differences(motion.steps, walked):
            size = np.maximum(np.abs(gap[:, columns]).max(axis=1), ROUNDING)
            axes.semilogy(times, size, color=NEUTRAL, linestyle=line, linewidth=1.1)
        entries.append(entry(f"difference, {words}", linestyle=line, linewidth=1.1))
    axes.set_xlabel(time_label([motion]))
    axes.set_ylabel("|NLP − simulation|\n[rad, m; per s]")
    return entries


def points_of(steps: Sequence[Step]) -> tuple[Array, Array]:
    """Times since the start of the first step (n,) and states (n, n_z) at all points of some steps."""
    arcs = [(began, arc) for began, step in running(steps) for arc in step.arcs]
    return np.concatenate([began + arc.times for began, arc in arcs]), np.vstack([arc.states for _, arc in arcs])


def thinned(times: Array, states: Array) -> tuple[Array, Array]:
    """At most twenty of many points, evenly among them, the first and the last with them."""
    shown = np.unique(np.linspace(0, len(times) - 1, min(len(times), POINTS_SHOWN)).round().astype(int))
    return times[shown], states[shown]
