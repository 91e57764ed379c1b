"""What a mode sequence assumes along a gait, as numbers that are positive while it holds.

A margin that an event makes zero at an end of its phase is divided by that zero, so that what is left says whether
the event is still crossed: with s in [-1, 1] over the phase and g the margin,

    monitor = min over s of g(s) / ((1 + s)^a (1 - s)^b)

a = 1 where a slip starts at rest with an acceleration, a = 2 at the onset of slip (a double zero), b = 1 where an
event ends the phase; g is in natural units. A monitor that changes sign along a branch marks the end of the sequence.

One or two coefficients of friction: a gait restated so that the one that is varied is a parameter of its system.

Where static and kinetic friction are equal, a gait of the one law is a gait of the other.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array
from gaitopt.errors import ProblemError
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait
from gaitopt.gait.trajectory import SHORT, Arc, lowest_after_rise
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.friction import CoulombFriction, Friction, StaticKineticFriction
from gaitopt.model.margins import ending_margin, margin, margin_names, margin_scales, margin_unit
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.problem.schema import FrictionCoefficients

OPEN = 1.0
"""Value of a monitor that is far from anything."""


@dataclass(frozen=True, slots=True)
class MonitorKey:
    """What is watched.

    Attributes
    ----------
    kind : ``duration``, or one of ``mechanics.margins``, where ``touchdown`` is a second one within the step.
    phase : index of the phase, None for an impact.
    step : index of the step that an impact ends.
    """

    kind: str
    phase: int | None = None
    step: int = 0


@dataclass(frozen=True, slots=True)
class MonitorValue:
    """Value of a monitor, and where in its phase, from 0 (start) to 1 (end), it is taken."""

    value: float
    where: float = 1.0


def monitor_values(gait: Gait) -> dict[MonitorKey, MonitorValue]:
    """All monitors of a solution, whether or not they hold."""
    arcs = _arcs_by_phase(gait)
    return {**dict(_phase_values(gait, arcs)), **dict(_impact_values(gait, arcs))}


def _phase_values(gait: Gait, arcs: list[list[Arc]]) -> Iterator[tuple[MonitorKey, MonitorValue]]:
    modes = gait.problem.cycle.phases
    along = {id(arc): _margins(gait, arc) for whole in arcs for arc in whole}
    period = abs(gait.period)
    for phase, whole in enumerate(arcs):
        duration = sum(arc.duration for arc in whole)
        yield MonitorKey("duration", phase), MonitorValue(duration / period)
        if duration < SHORT * period:
            continue
        group = [arc for arc in whole if arc.duration > SHORT * period]
        margins = [along[id(arc)] for arc in group]
        for row, kind in enumerate(margin_names(modes[phase])):
            if kind != "upright" and not margin(kind).rises:
                values = [own[row] for own in margins]
                yield MonitorKey(kind, phase), _lowest(values, _zeros(gait, phase, kind), group, whole)
        if gait.problem.cycle.starts_from_rest(phase) and gait.dynamics.friction_drops:
            yield MonitorKey("onset", phase), MonitorValue(_beyond_cone(gait, whole[0]), 0.0)
    for first, step in zip(gait.problem.cycle.first_phases, gait.steps, strict=True):
        for name in dict.fromkeys(name for arc in step.arcs for name in margin_names(arc.mode) if margin(name).rises):
            within = [name in margin_names(arc.mode) for arc in step.arcs]
            last = max(phase for phase, has in zip(step.arc_phases, within, strict=True) if has)
            own = [arc for arc, has in zip(step.arcs, within, strict=True) if has]
            clearances = [along[id(arc)][margin_names(arc.mode).index(name)] for arc in own]
            yield MonitorKey(name, first + last), MonitorValue(_early_fall(own, clearances))


def _arcs_by_phase(gait: Gait) -> list[list[Arc]]:
    """Arcs of each phase; breakpoints of the control cut a phase into several."""
    groups: list[list[Arc]] = []
    for step in gait.steps:
        first = len(groups)
        for arc, phase in zip(step.arcs, step.arc_phases, strict=True):
            if first + phase == len(groups):
                groups.append([])
            groups[first + phase].append(arc)
    return groups


def _zeros(gait: Gait, phase: int, kind: str) -> tuple[int, int]:
    """Orders of the zeros that events give a margin at the start and at the end of its phase."""
    cycle, jump = gait.problem.cycle, gait.dynamics.friction_drops
    start = cycle.onset_order(phase, jump=jump) if kind == "slip_velocity" else 0
    after = cycle.after(phase)
    return start, int(after is not None and kind == ending_margin(cycle.phases[phase], after))


def _lowest(values: list[Array], zeros: tuple[int, int], group: list[Arc], whole: list[Arc]) -> MonitorValue:
    """The lowest value of a margin without its zeros, on some of the arcs of a phase, and where in the phase it is."""
    minima = []
    for arc, own in zip(group, values, strict=True):
        start, end = zeros[0] * (arc is whole[0]), zeros[1] * (arc is whole[-1])
        at, height = curves.maximum(-(_deflation(own.size, start, end) @ own if start or end else own))
        time = arc.start + arc.duration * (at + 1) / 2
        minima.append((-height, (time - whole[0].start) / (whole[-1].end - whole[0].start)))
    return MonitorValue(*min(minima))


@lru_cache(maxsize=64)
def _deflation(count: int, start: int, end: int) -> Array:
    """Matrix from values of g to values of g / ((1 + s)^start (1 - s)^end), both at ``points(count)``."""
    factor = chebyshev.chebfromroots([-1.0] * start + [1.0] * end) * (-1) ** end
    n = count - start - end
    product = np.zeros((count, n))
    for k in range(n):
        product[: k + factor.size, k] = chebyshev.chebmul(np.eye(n)[k][: k + 1], factor)
    quotient = np.linalg.pinv(product) @ np.linalg.inv(chebyshev.chebvander(curves.points(count), count - 1))
    return np.asarray(chebyshev.chebvander(curves.points(count), n - 1) @ quotient, dtype=float)


def _early_fall(arcs: Sequence[Arc], margins: Sequence[Array]) -> float:
    return min(OPEN, lowest_after_rise([arc.times for arc in arcs], margins)[0])


def _beyond_cone(gait: Gait, arc: Arc) -> float:
    """By how much the force that would hold the foot at the start of a slip exceeds static friction [N]."""
    stick = arc.mode.with_contact(Mode.STICK)
    margins = gait.dynamics.standing(arc.side).margins(stick, arc.segment, arc.times[:1], arc.states[:1])[0]
    return -float(margins[margin_names(stick).index(ending_margin(stick, arc.mode))])


def _margins(gait: Gait, arc: Arc) -> Array:
    values = gait.dynamics.standing(arc.side).margins(arc.mode, arc.segment, arc.times, arc.states)
    return np.asarray(values / margin_scales(arc.mode, gait.dynamics.scales)).T


def _impact_values(gait: Gait, arcs: list[list[Arc]]) -> Iterator[tuple[MonitorKey, MonitorValue]]:
    """Margins of every impact in natural units."""
    cycle, scales = gait.problem.cycle, gait.dynamics.scales
    for phase, mode in cycle.resets:
        at, last = {"phase": phase} if mode.locked else {"step": cycle.step_of(phase)}, arcs[phase][-1]
        for kind, value in gait.dynamics.standing(last.side).impact_margins(mode, last.states[-1]).items():
            if kind == "touchdown_rate" or (kind == "impact_onset" and not gait.dynamics.friction_drops):
                continue  # a grazing touchdown is a second one, too; equal coefficients leave no doubt about an onset
            yield MonitorKey(kind, **at), MonitorValue(float(value) / margin_unit(kind, scales))


def with_friction(gait: Gait, parameter: str) -> Gait:
    """The same gait under the friction law that has ``parameter``; unchanged for all other parameters.

    Raises
    ------
    ProblemError
        If both coefficients are to be moved but differ, or there is viscous drag besides.
    """
    if parameter in gait.system.parameters or parameter.partition(".")[0] != "friction":
        return gait
    friction = gait.problem.friction
    if isinstance(friction, float):
        value = gait.dynamics.static_friction
        if parameter not in StaticKineticFriction().parameters:
            return gait
        return _restated(gait, FrictionCoefficients(static=value, kinetic=value), StaticKineticFriction())
    if friction.static != friction.kinetic or friction.viscous:
        numbers = ", ".join(f"{name} = {value:g}" for name, value in friction)
        raise ProblemError(
            f"friction has several coefficients, {numbers}: vary friction.static, friction.kinetic or friction.viscous"
        )
    return _restated(gait, friction.static, CoulombFriction())


def coefficient_bounds(gait: Gait, parameter: str) -> tuple[float, float]:
    """Range of a parameter that the other coefficient of friction leaves, static being at least kinetic."""
    known = gait.dynamics.parameters
    if parameter == "friction.static":
        return known["friction.kinetic"], np.inf
    return -np.inf, known["friction.static"] if parameter == "friction.kinetic" else np.inf


def _restated(gait: Gait, coefficients: float | FrictionCoefficients, law: Friction) -> Gait:
    problem = replace(gait.problem, friction=coefficients)
    system = HybridSystem(gait.system.walker, gait.system.control, gait.system.law, law)
    p = system.values({**problem.parameters, **gait.dynamics.parameters})
    return replace(gait, problem=problem, dynamics=Dynamics(system, p))
