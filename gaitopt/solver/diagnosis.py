"""Why a motion is not a gait: the condition that is violated most, its phase, its time and its amount.

``rejection_reason`` checks a solution of the equations: its integration error, and every margin at the nodes. All along
the motion, the walker must be upright, no margin may be negative, no event may happen early, and the swing foot must
land from above. ``missing_event`` and ``largest_residual`` explain why a search has found no solution.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gaitopt.arrays import Array, overflow_allowed
from gaitopt.display import distinguished
from gaitopt.gait import curves
from gaitopt.gait.curves import lowest_after_rise
from gaitopt.gait.gait import Cause, Status
from gaitopt.model.buffered import buffered, buffered_map
from gaitopt.model.cycle import Cycle
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import PUSH, contact_of, kind, margin, named
from gaitopt.solver.newton import Solution
from gaitopt.solver.shooting import Label

RESIDUAL_TOLERANCE = 1e-9
"""Largest violation, in natural units, of any equality or margin in a solution that is called converged."""
SHORTEST_PHASE = 1e-7
"""A phase does not take place if its duration is a smaller fraction of the period."""
SAMPLES = 33
"""Number of points of an arc at which an early event is sought."""
AIRBORNE = 1e-9
"""A foot is in the air if its guard is farther from zero than this, in natural units; below, the guard is rounding."""
INTERPOLATION_SLACK = 1e-8
"""A margin between the nodes may be negative by this much, the error of its interpolation. Verification allows the
friction coefficient the same excess."""
NUMERICAL = ("search", "equations", "integration", "breakpoint", "reference", "motion", "event", "periodicity")
"""Causes that say where a search ended. All others say why a periodic motion is impossible."""
NORMAL_FORCES = {"cone_forward": "normal_force", "impulse_cone_forward": "impulse", "push_cone_forward": ""}
"""The margin that is the normal force of each friction cone; empty for a push, whose contact cannot be lost."""
DIVERGED_RESIDUAL = 1e3
"""A search has diverged if its violation is larger, in natural units: a thousand times the forces and rates of a
walk."""


@overflow_allowed()
def rejection_reason(refined: Solution) -> tuple[Cause, ...]:
    """Why a solution of the equations is not a gait; empty for a gait."""
    mesh, durations = refined.equations.mesh, refined.durations
    short = np.flatnonzero(durations < SHORTEST_PHASE * durations.sum())
    if short.size:
        return (vanishing_phase(mesh.cycle, int(short[0]), float(durations[short[0]])),)
    if not np.isfinite(refined.errors).all():
        reason = "the equations are singular there: the gait is not isolated, or its motion fails"
        return (Cause(what="equations", description=reason),)
    if not refined.size <= RESIDUAL_TOLERANCE:
        return (Cause(what="equations", description=f"the equations are only satisfied to {refined.size:.2g}"),)
    equations, n_z = refined.equations, refined.equations.system.n_z
    start, section = refined.w[:n_z], equations.system.section(mesh.cycle)
    p = equations.dynamics(refined.p, equations.unpack(refined.w).freed).p
    off = np.abs(section.lift(start[section.indices], p, start) - start) / refined.units.unknowns[:n_z]
    if not off.max() <= RESIDUAL_TOLERANCE:  # one Newton step led from the last state to the section, if it was near
        reason = "not periodic: the cycle returns to a state off its section, for instance with another energy"
        return (Cause(what="periodicity", description=reason, needed=0.0, available=float(off.max())),)
    separate = _separate_stops(refined)
    if separate is not None:
        return (separate,)
    if not refined.accurate:
        reason = f"the integration is only accurate to {refined.errors.max():.2g}, even with {mesh.intervals} intervals"
        return (Cause(what="integration", description=reason),)
    if not refined.in_order:
        reason = "a switch has passed a breakpoint of the control: solve the problem from a guess closer to its gait"
        return (Cause(what="breakpoint", description=reason),)
    violated = violations(refined)
    if violated:
        return tuple(violated)
    cause = _impossible_motion(refined) or _lands_from_below(refined) or _law_ends(refined) or _turning_phase(refined)
    return () if cause is None else (cause,)


def status_without_gait(causes: tuple[Cause, ...]) -> Status:
    """Status of a solve for which these causes exclude a gait: infeasible if they say that its motion is impossible."""
    impossible = causes and all(cause.what not in NUMERICAL for cause in causes)
    return Status.INFEASIBLE if impossible else Status.NOT_CONVERGED


def violations(at: Solution) -> list[Cause]:
    """The worst violated condition of every phase and of the impact, worst first.

    Phases of negative duration are reported alone. Violations up to ``RESIDUAL_TOLERANCE`` are ignored.
    """
    margins = at.equations.margin_values(at.w, at.p)
    if (margins >= 0).all() and (at.durations >= 0).all():
        return []
    causes = [cause for cause in _duration_violations(at) if cause.severity > RESIDUAL_TOLERANCE]
    causes = causes or [*_cone_violations(at, margins), *_margin_violations(at, margins)]
    worst: dict[tuple[int | None, int], Cause] = {}
    for cause in sorted(causes, key=lambda c: c.severity):
        if cause.severity > RESIDUAL_TOLERANCE:
            worst[cause.phase, cause.step] = cause
    return sorted(worst.values(), key=lambda c: -c.severity)


def vanishing_phase(cycle: Cycle, phase: int, duration: float) -> Cause:
    """The cause that a phase of the mode sequence has no duration."""
    reason = f"phase {phase + 1} ({cycle.phases[phase]}) vanishes: remove it from the mode sequence"
    return Cause(what="duration", description=reason, phase=phase, needed=0.0, available=duration)


def missing_event(system: HybridSystem, cycle: Cycle, phase: int, margins: Array | None = None) -> Cause:
    """Why a phase of the guess has no end; the cause may be a reference that is too short.

    Parameters
    ----------
    margins : margins of the phase just after its start. The phase does not begin if the margin that should end it is
        negative.
    """
    control = system.control
    ending = system.transitions.ending(cycle, phase).guard
    reason = f"{cycle.phase_words(phase)} has no end: from the guess, {margin(ending).absent}"
    names = system.transitions.margin_names(cycle.phases[phase])
    if margins is not None and ending in names and margins[names.index(ending)] < 0:
        reason = f"{cycle.phase_words(phase)}: from the guess, it would end before it begins, so it does not take place"
    what, end = ending, None
    if ending == "touchdown" and control.breakpoints and np.isinf(control.horizon):
        what, end = "reference", control.breakpoints[-1]
        reason = f"{reason}: the reference is too short, it ends {end:.4g} s after the impact"
    return Cause(what=what, description=reason, phase=phase, step=cycle.step_of(phase), time=end, available=end)


def largest_residual(at: Solution) -> Cause:
    """The equality that is violated most."""
    residual, cycle = at.residual, at.equations.mesh.cycle
    relative = np.abs(residual / at.units.equalities)
    row = int(np.argmax(relative))
    if not relative[row] < DIVERGED_RESIDUAL:
        return Cause(what="search", description="the search has diverged; start from a state closer to a gait")
    label, size = at.equations.equality_labels[row], abs(float(residual[row]))
    if label.name == "reset":
        reason = f"not periodic: {label.coordinate} after the impact is off by {size:.3g}"
        return Cause(what="periodicity", description=reason, needed=0.0, available=size)
    assert label.phase is not None
    phase = cycle.phase_words(label.phase)
    if label.name == "defect":
        what, reason = "motion", f"{phase}: the motion does not close, off by {size:.3g} in {label.coordinate}"
    else:
        what, reason = "event", f"{phase}: the event that should end it is missed by {size:.3g}"
    return Cause(what=what, description=reason, phase=label.phase, needed=0.0, available=size)


def _separate_stops(at: Solution) -> Cause | None:
    """The cause that a contact slips when it should come to rest together with another one; None if none does."""
    equations, cycle, table = at.equations, at.equations.mesh.cycle, at.equations.system.transitions
    nodes, durations, _ = equations.unpack(at.w)
    per_phase = cycle.per_phase(equations.acting(at.w, at.p).steps)
    for phase, node in enumerate(equations.mesh.last_nodes):
        mode, names = cycle.phases[phase], cycle.stop_together(phase)
        if not names:
            continue
        margins = table.margin_names(mode)
        time, dynamics = float(equations.mesh.node_times(durations)[node]), per_phase[phase]
        segment = next(arc.segment for arc in reversed(equations.mesh.arcs) if arc.phase == phase)
        values = dynamics.margins(mode, segment, np.array([time]), nodes[:, [node]].T)[0]
        for name in names[1:]:
            speed = float(values[margins.index(f"slip_velocity.{name}")])
            if abs(speed) > RESIDUAL_TOLERANCE * dynamics.scales.speed:
                reason = (
                    f"{cycle.phase_words(phase)}: where {names[0]} comes to rest, {name} has the velocity "
                    f"{speed:.4g} m/s in its direction: state the phase in between"
                )
                return Cause(what="slip_velocity", description=reason, phase=phase, step=cycle.step_of(phase),
                             time=time, needed=0.0, available=speed)  # fmt: skip
    return None


def _impossible_motion(at: Solution) -> Cause | None:
    """The first instant at which a margin is negative between the nodes, or an event is too early; None without one.

    The walker must be upright throughout. A margin that rises before it falls, such as that of a touchdown, may be
    negative until it rises for the first time: scuffing in mid-swing is ignored.
    """
    equations, cycle, table = at.equations, at.equations.mesh.cycle, at.equations.system.transitions
    per_phase = cycle.per_phase(equations.acting(at.w, at.p).steps)
    period = float(at.durations.sum())
    causes = list[Cause]()
    # phase, times and values on each arc of a swing, by the name of each margin that rises before it falls
    rising: list[dict[str, list[tuple[int, Array, Array]]]] = [{} for _ in range(cycle.swings[-1] + 1)]

    def cause(name: str, phase: int, time: float) -> Cause:
        reason = f"{margin(name).lost}, about {time:.4f} s after the impact"
        return Cause(what=name, description=reason, phase=phase, step=cycle.step_of(phase), time=time)

    for index, arc in enumerate(equations.mesh.arcs):
        times, states = equations.sample(at.w, at.p, index, SAMPLES)
        dynamics = per_phase[arc.phase]
        values = dynamics.margins(arc.mode, arc.segment, times, states) / dynamics.margin_units(arc.mode)
        for name, column in zip(table.margin_names(arc.mode), values.T, strict=True):
            if margin(name).rises:
                rising[cycle.swings[arc.phase]].setdefault(name, []).append((arc.phase, times, column))
            elif times[-1] - times[0] > curves.SHORT_ARC * period:
                lowest_at, excess = curves.maximum(-column)
                if excess > INTERPOLATION_SLACK:
                    below = curves.points(SAMPLES)[column < -INTERPOLATION_SLACK].min(initial=lowest_at)
                    roots = curves.roots(column) if column[0] > -INTERPOLATION_SLACK else np.array([-1.0])
                    since = max(roots[roots < below], default=-1.0)
                    causes.append(cause(name, arc.phase, float(times[0] + (since + 1) / 2 * (times[-1] - times[0]))))
    for margins in rising:
        for name, arcs in margins.items():
            along = [arc_times for _, arc_times, _ in arcs], [column for _, _, column in arcs]
            lowest, end = lowest_after_rise(*along, AIRBORNE)
            if lowest < -AIRBORNE:
                phase = next(phase for phase, arc_times, _ in arcs if end <= arc_times[-1])
                roots = np.concatenate(
                    [t[0] + (curves.roots(column) + 1) / 2 * (t[-1] - t[0]) for _, t, column in arcs]
                )
                causes.append(cause(name, phase, float(max(roots[roots < end], default=end))))
    return min(causes, key=lambda cause: (cause.step, cause.time), default=None)


def _lands_from_below(at: Solution) -> Cause | None:
    """The first phase that ends with a landing although its foot moves away from the ground; None without one.

    The guard of touchdown vanishes where two legs have opposite angles. The foot then comes down in a step forward, and
    comes up through the ground in a step backward.
    """
    equations, cycle, table = at.equations, at.equations.mesh.cycle, at.equations.system.transitions
    per_phase = cycle.per_phase(equations.acting(at.w, at.p).steps)
    last_arcs = {arc.phase: index for index, arc in enumerate(equations.mesh.arcs)}
    for phase, index in last_arcs.items():
        reset = table.ending(cycle, phase).reset
        if reset is None or not reset.swaps:
            continue
        times, states = equations.sample(at.w, at.p, index, SAMPLES)
        landing = buffered(equations.system.approach(cycle.phases[phase], reset.of))
        approach = landing(states[-1], per_phase[phase].p)[0].item()
        if not approach < 0:
            foot = equations.system.walker.called(reset.of)
            reason = (
                f"{foot} touches the ground from below, {times[-1]:.4f} s after the impact: its normal velocity is "
                f"{approach:.4g} m/s"
            )
            return Cause(
                what="landing", description=reason, phase=phase, step=cycle.step_of(phase), time=float(times[-1]),
                needed=0.0, available=approach,
            )  # fmt: skip
    return None


def _law_ends(at: Solution) -> Cause | None:
    """The cause that a step lasts longer than the time for which its control law is defined; None without one."""
    cycle, horizon = at.equations.mesh.cycle, at.equations.system.control.horizon
    for phase in range(len(cycle.phases)):
        step = cycle.step_of(phase)
        time = float(at.durations[cycle.first_phases[step] : phase + 1].sum())
        if time > horizon:
            reason = f"the control law ends {horizon:.4g} s after the impact, but the step takes at least {time:.4g} s"
            return Cause(
                what="control", description=reason, phase=phase, step=step, time=horizon, needed=time, available=horizon
            )
    return None


def _turning_phase(at: Solution) -> Cause | None:
    """The cause if the phase variable of the control law is not monotone along a step; else None."""
    equations, name = at.equations, at.equations.system.control.phase_variable
    if not name:
        return None
    cycle, rate = equations.mesh.cycle, buffered_map(equations.system.phase_rate(), SAMPLES)
    per_phase = cycle.per_phase(equations.acting(at.w, at.p).steps)
    forward: bool | None = None
    for index, arc in enumerate(equations.mesh.arcs):
        times, states = equations.sample(at.w, at.p, index, SAMPLES)
        rates = rate(states, per_phase[arc.phase].p)[0][:, 0].copy()
        forward = bool(rates[SAMPLES // 2] > 0) if forward is None else forward
        turns = curves.roots(rates)
        if turns.size or bool(rates[SAMPLES // 2] > 0) is not forward:
            time = float(times[0] + (turns[0] + 1) / 2 * (times[-1] - times[0])) if turns.size else float(times[0])
            reason = f"the phase variable {name} is not monotone: it turns back {time:.4f} s after the impact"
            return Cause(what="phase", description=reason, phase=arc.phase, step=cycle.step_of(arc.phase), time=time)
    return None


def _cone_violations(at: Solution, margins: Array) -> Iterator[Cause]:
    """Violated friction cones: of each contact, with required and available friction, and of groups of contacts."""
    equations = at.equations
    _, labels = equations.inequalities
    dynamics = equations.dynamics(at.p, equations.unpack(at.w).freed)
    of_step, units = dynamics.steps, equations.margin_units(dynamics.p)
    rows = {label: i for i, label in enumerate(labels)}
    for label, i in rows.items():
        if "+" in label.name and margins[i] < 0:
            demand = f"the contacts {contact_of(label.name).replace('+', ' and ')} need more friction together"
            yield _cause("friction", demand, at, label, severity=-margins[i] / units[i])
        if not kind(label.name).endswith("cone_forward") or "+" in label.name:
            continue
        friction = of_step[label.step % len(of_step)].contact_friction[contact_of(label.name)]
        partner = replace(label, name=label.name.replace("forward", "backward"))
        if partner not in rows:
            continue
        normal = replace(label, name=named(NORMAL_FORCES[kind(label.name)], label.name))
        forward, backward = margins[i], margins[rows[partner]]
        f_n = margins[rows[normal]] if normal in rows else (forward + backward) / (2 * friction or np.inf)
        if (
            min(forward, backward) < -RESIDUAL_TOLERANCE * units[i] and f_n > 0
        ):  # massless contacts land without impulses
            needed = float(abs(forward - backward) / (2 * f_n))
            who = f"{contact_of(label.name)} " if "." in label.name else ""
            demand = f"{who}needs friction {{}}, has {{}}".format(*distinguished(needed, friction))
            yield _cause("friction", demand, at, label, needed=needed, available=friction, severity=needed - friction)


def _margin_violations(at: Solution, margins: Array) -> Iterator[Cause]:
    """Every margin that is negative."""
    equations = at.equations
    units = equations.margin_units(equations.dynamics(at.p, equations.unpack(at.w).freed).p)
    for label, value, unit in zip(equations.inequalities[1], margins.tolist(), units.tolist(), strict=True):
        template = margin(label.name).violated
        if value < 0 and template:
            violation = template.format(value=value)
            yield _cause(label.name, violation, at, label, needed=0.0, available=value, severity=-value / unit)


def _duration_violations(at: Solution) -> Iterator[Cause]:
    """Every phase of negative duration."""
    cycle, durations = at.equations.mesh.cycle, at.durations
    for phase, value in enumerate(durations.tolist()):
        if value < 0:
            reason = f"{cycle.phase_words(phase)}: its duration is {value:.4g} s, so it does not take place"
            severity = float(-value / abs(durations.sum()))
            yield Cause(
                what="duration", description=reason, phase=phase, needed=0.0, available=value, severity=severity
            )


def _cause(what: str, violation: str, at: Solution, label: Label, **numbers: float) -> Cause:
    """The cause at a row of the inequalities: the violation, preceded by the phase and the time, or by the impact."""
    mesh = at.equations.mesh
    node = mesh.impact_nodes[label.step] if label.node is None else label.node
    time = float(mesh.node_times(at.durations)[node])
    if kind(label.name) in PUSH:
        when = "push-off"
    elif label.phase is None:
        when = "impact" if len(mesh.cycle.steps) == 1 else f"impact of step {label.step + 1}"
    else:
        when = f"{mesh.cycle.phase_words(label.phase)}, t = {time:.4f} s"
    return Cause(
        what=what, description=f"{when}: {violation}", phase=label.phase, step=label.step, time=time, **numbers
    )
