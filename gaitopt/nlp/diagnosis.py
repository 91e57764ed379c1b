"""Why a search failed, in physical terms: the condition that is violated most, its phase, its time and its amount."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.curves import lowest_after_rise
from gaitopt.gait.gait import Cause
from gaitopt.model.cycle import Cycle
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import PUSH, margin
from gaitopt.nlp.layout import COINCIDENT
from gaitopt.nlp.shooting import Label, MultipleShooting

SAMPLES = 33
"""Points of an arc at which an early event is sought."""
AIRBORNE = 1e-9
"""A guard closer to zero than this is zero up to rounding: the foot is on the ground."""
NORMAL = {"cone_forward": "normal_force", "impulse_cone_forward": "impulse", "push_cone_forward": ""}
"""The margin that is the normal force of a friction cone; a push has none, because its contact cannot be lost."""
RUNAWAY = 1e3
"""Violation in natural units that shows a diverged search: a thousand times the forces and rates of a walk."""


def violations(equations: MultipleShooting, w: Array, p: Array, margins: Array, tolerance: float) -> list[Cause]:
    """The worst violated condition of every phase and of the impact, worst first.

    Phases of negative duration are reported alone.

    Parameters
    ----------
    margins : values of the inequalities at ``w``.
    tolerance : severity up to which a violation is ignored, in natural units.
    """
    if (margins >= 0).all() and (equations.unpack(w).durations >= 0).all():
        return []
    present = [c for c in _duration_violations(equations, w, p) if c.severity > tolerance]
    present = present or [*_cone_violations(equations, w, p, margins), *_margin_violations(equations, w, p, margins)]
    worst: dict[tuple[int | None, int], Cause] = {}
    for violation in sorted(present, key=lambda c: c.severity):
        if violation.severity > tolerance:
            worst[violation.phase, violation.step] = violation
    return sorted(worst.values(), key=lambda c: -c.severity)


def early_event(equations: MultipleShooting, w: Array, p: Array) -> Cause | None:
    """An event that happens too early: the swing foot lands or a stop locks; None if there is none.

    Scuffing in mid-swing is ignored.
    """
    for step in range(len(equations.layout.cycle.steps)):
        for name, arcs in _rising_margins(equations, w, p, step).items():
            phases, times, values = zip(*arcs, strict=True)
            lowest, at = lowest_after_rise(times, values)
            if lowest < -AIRBORNE:
                phase = next(phase for phase, arc_times in zip(phases, times, strict=True) if at <= arc_times[-1])
                roots = np.concatenate([_roots(*arc) for arc in zip(times, values, strict=True)])
                time = float(max(roots[roots < at], default=at))
                words = f"{margin(name).lost}, about {time:.4f} s after the impact"
                return Cause(what=name, words=words, phase=phase, step=step, time=time)
    return None


def _roots(times: Array, values: Array) -> Array:
    """Times at which a curve changes its sign, given at the Chebyshev points of an arc."""
    return np.asarray(times[0] + (curves.roots(values) + 1) / 2 * (times[-1] - times[0]))


def _rising_margins(
    equations: MultipleShooting, w: Array, p: Array, step: int
) -> dict[str, list[tuple[int, Array, Array]]]:
    """Phase, times and values along the arcs of a step by the name of each margin that rises before it falls."""
    rising, cycle = dict[str, list[tuple[int, Array, Array]]](), equations.layout.cycle
    per_phase = cycle.per_phase(equations.dynamics(p, equations.unpack(w).freed).steps)
    for index, arc in enumerate(equations.layout.arcs):
        if cycle.step_of(arc.phase) != step:
            continue
        times, states = equations.sample(w, p, index, SAMPLES)
        dynamics = per_phase[arc.phase]
        values = dynamics.margins(arc.mode, arc.segment, times, states) / dynamics.margin_units(arc.mode)
        for name, column in zip(dynamics.system.transitions.margin_names(arc.mode), values.T, strict=True):
            if margin(name).rises:
                rising.setdefault(name, []).append((arc.phase, times, column))
    return rising


def missing_event(system: HybridSystem, cycle: Cycle, phase: int) -> Cause:
    """Why a phase of the guess has no end; the cause may be a reference that is too short."""
    control = system.control
    ending = system.transitions.between(cycle.phases[phase], cycle.after(phase)).guard
    words = f"{cycle.phase_words(phase)} has no end: from the guess, {margin(ending).absent}"
    what, end = ending, None
    if ending == "touchdown" and control.breakpoints and np.isinf(control.horizon):
        what, end = "reference", control.breakpoints[-1]
        words = f"{words}: the reference is too short, it ends {end:.4g} s after the impact"
    return Cause(what=what, words=words, phase=phase, step=cycle.step_of(phase), time=end, available=end)


def largest_residual(equations: MultipleShooting, w: Array, p: Array, residual: Array) -> Cause:
    """The equality that is violated most."""
    relative = np.abs(residual / equations.units(p).equalities)
    row = int(np.argmax(relative))
    n_z, cycle = equations.system.n_z, equations.layout.cycle
    n_defects = n_z * equations.layout.intervals
    size = abs(float(residual[row]))
    if not relative[row] < RUNAWAY:
        return Cause(what="search", words="the search has diverged; start from a state closer to a gait")
    if row < n_defects:
        arcs = equations.layout.arcs
        phase = arcs[int(np.searchsorted(np.cumsum([arc.intervals for arc in arcs]), row // n_z, side="right"))].phase
        place, name = cycle.phase_words(phase), equations.system.state_names[row % n_z]
        words = f"{place}: the motion does not close, off by {size:.3g} in {name}"
        return Cause(what="motion", words=words, phase=phase, needed=0.0, available=size)
    row -= n_defects
    if row < len(cycle.phases):
        words = f"{cycle.phase_words(row)}: the event that should end it is missed by {size:.3g}"
        return Cause(what="event", words=words, phase=row, needed=0.0, available=size)
    name = equations.system.state_names[(row - len(cycle.phases)) % n_z]
    words = f"not periodic: {name} after the impact is off by {size:.3g}"
    return Cause(what="periodicity", words=words, needed=0.0, available=size)


def _cone_violations(equations: MultipleShooting, w: Array, p: Array, margins: Array) -> Iterator[Cause]:
    """Required against available friction, where the foot should stick."""
    _, labels = equations.inequalities
    friction = equations.dynamics(p, equations.unpack(w).freed).static_friction
    rows = {label: i for i, label in enumerate(labels)}
    for label, i in rows.items():
        if not label.name.endswith("cone_forward"):
            continue
        partner = replace(label, name=label.name.replace("forward", "backward"))
        if partner not in rows:
            continue
        normal = replace(label, name=NORMAL[label.name])
        forward, backward = margins[i], margins[rows[partner]]
        f_n = margins[rows[normal]] if normal in rows else (forward + backward) / (2 * friction or np.inf)
        if min(forward, backward) < 0 < f_n:
            needed = abs(forward - backward) / (2 * f_n)
            words = f"{_place(equations, w, label)}: needs friction {needed:.4g}, has {friction:.4g}"
            numbers = {"needed": float(needed), "available": friction, "severity": float(needed - friction)}
            yield _cause("friction", words, equations, w, label, **numbers)


def _margin_violations(equations: MultipleShooting, w: Array, p: Array, margins: Array) -> Iterator[Cause]:
    _, labels = equations.inequalities
    units = equations.margin_units(equations.dynamics(p, equations.unpack(w).freed).p)
    for label, value, unit in zip(labels, margins, units, strict=True):
        if value < 0 and margin(label.name).violated:
            text = f"{_place(equations, w, label)}: {margin(label.name).violated.format(value=value)}"
            numbers = {"needed": 0.0, "available": float(value), "severity": float(-value / unit)}
            yield _cause(label.name, text, equations, w, label, **numbers)


def _duration_violations(equations: MultipleShooting, w: Array, p: Array) -> Iterator[Cause]:
    _, durations, freed = equations.unpack(w)
    period = float(durations.sum())
    for phase, duration in enumerate(durations):
        if duration < 0:
            place = equations.layout.cycle.phase_words(phase)
            backward = f"{duration:.4g}" if duration < -COINCIDENT * equations.dynamics(p, freed).scales.time else "0"
            words = f"{place}: its duration is {backward} s, so it does not take place"
            severity = float(-duration / abs(period))
            yield Cause(
                what="duration", words=words, phase=phase, needed=0.0, available=float(duration), severity=severity
            )


def _cause(what: str, words: str, equations: MultipleShooting, w: Array, label: Label, **numbers: float) -> Cause:
    """The cause with the place of a row of the inequalities."""
    node = equations.layout.impact_nodes[label.step] if label.node is None else label.node
    time = float(equations.node_times(w)[node])
    return Cause(what=what, words=words, phase=label.phase, step=label.step, time=time, **numbers)


def _place(equations: MultipleShooting, w: Array, label: Label) -> str:
    if label.name in PUSH:
        return "push-off"
    if label.phase is None or label.node is None:
        return "impact" if len(equations.layout.cycle.steps) == 1 else f"impact of step {label.step + 1}"
    return f"{equations.layout.cycle.phase_words(label.phase)}, t = {equations.node_times(w)[label.node]:.4f} s"
