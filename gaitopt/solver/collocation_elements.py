"""Expressions of a direct collocation: of a point, of an impact, and of the scalars of a step.

Each is a function (y, c, p) -> (f, g) of few unknowns y, which ``solver.elements`` applies to many groups of unknowns:

    point     f = 0, g = (-h dz/dt, margins, path quantities, extrema, bounds of |power|, -weight h rates)
    impact    f = 0, g = (-z_plus, -step length, -work of the push, margins)
    scalars   f = objective, g = scalars with a formula
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from casadi import SX, Function, cse, dot, pi, sin, sqrt, sum1, vertcat

from gaitopt.building import built_once
from gaitopt.model.contacts import sharing_contacts
from gaitopt.model.modes import Mode
from gaitopt.model.open_loop import OpenLoop, Order
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.system import HybridSystem
from gaitopt.model.walker import Walker
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import ANGLE, CLEARANCE, SCALARS, Instant

SMOOTHING = 3e-5
"""|power| is smoothed over this width, relative to the walker's weight times 1 m/s."""
POWER = "absolute_power"
"""Name of the integral of |power| in the formulas of scalars."""
SLIP = "slip"
"""Name of the distance over which contacts slide, an integral in the formulas of scalars."""
IMPULSE, CLEARED = "impulse_ratio", "foot_clearance"
"""Scalars that are extrema, but not over all instants of a phase."""
OF_CONTACTS = ("required_friction", "min_normal_force")
"""Scalars that are extrema over the contacts on the ground."""


class GroundContact(NamedTuple):
    """A contact on the ground, or contacts that share their forces: expressions with a column per instant.

    ``direction`` is the sign of the slip, 0 if the contact sticks.
    """

    direction: int
    force_t: Any
    force_n: Any
    slip: Any


def ground_contacts(walker: type[Walker], mode: Mode, force: Any, slip: Any) -> Iterator[GroundContact]:
    """The contacts on the ground in a mode, from observed forces and slip velocities with a column per instant."""
    index = {name: k for k, name in enumerate(walker.contact_names())}
    for names in sharing_contacts(walker, mode):
        rows = [index[name] for name in names]
        force_t, force_n = (sum(force[2 * k + row, :] for k in rows) for row in (0, 1))
        yield GroundContact(mode.directions[names[0]], force_t, force_n, slip[rows[0], :])


def bounded_contacts(walker: type[Walker], mode: Mode, *, sticking: bool) -> Iterator[tuple[str, ...]]:
    """The contacts on the ground over which an extremum is taken; those that slip only if ``sticking`` is False."""
    return (names for names in sharing_contacts(walker, mode) if not (sticking and mode.directions[names[0]]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Goals:
    """The quantities in objective and constraints of a problem, without the numbers of the bounds.

    Attributes
    ----------
    objective : names with weights.
    constrained : names of the scalars, states, freed parameters and path quantities that have a range.
    bounds_power : whether |power| is replaced by unknowns that bound it from above. That is possible if absolute work
        is minimised or has an upper limit only.
    arch : smallest height of the swing foot in the middle of the step [m].
    """

    objective: tuple[tuple[str, float], ...]
    constrained: tuple[str, ...]
    bounds_power: bool
    arch: float

    @classmethod
    def of(cls, problem: Problem) -> "Goals":
        """The goals of a problem."""
        ranges, name = problem.constraints, "absolute_cost_of_transport"
        named = name in ranges or name in problem.objective
        limited = name not in ranges or bool(np.isinf(ranges[name].minimum))
        return cls(
            objective=tuple(problem.objective.items()),
            constrained=tuple(ranges),
            bounds_power=named and problem.objective.get(name, 0.0) >= 0 and limited,
            arch=ranges[CLEARANCE].minimum if CLEARANCE in ranges else 0.0,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """All names, once each."""
        return tuple(dict.fromkeys((*dict(self.objective), *self.constrained)))

    @property
    def extrema(self) -> tuple[str, ...]:
        """Scalars that are extrema."""
        return tuple(name for name in self.names if name in SCALARS and SCALARS[name].extremum)

    def of_points(self, walker: type[Walker], mode: Mode) -> tuple[tuple[str, int], ...]:
        """The extrema over all points of a mode, each with the number of its values at a point."""
        counts = {"peak_torque": len(walker.actuators)}
        for name in OF_CONTACTS:
            counts[name] = len([*bounded_contacts(walker, mode, sticking=SCALARS[name].sticking)])
        extrema = (name for name in self.extrema if name not in (IMPULSE, CLEARED))
        return tuple((name, counts.get(name, 1)) for name in extrema if counts.get(name, 1))

    @property
    def formulas(self) -> tuple[str, ...]:
        """Scalars that have a formula."""
        return tuple(name for name in self.names if name in SCALARS and SCALARS[name].formula)

    @property
    def paths(self) -> tuple[str, ...]:
        """Quantities that have a range along the whole step."""
        return tuple(name for name in self.constrained if name == CLEARANCE or name.startswith(ANGLE))

    @property
    def rates(self) -> tuple[str, ...]:
        """Names of the rates whose integrals the formulas contain."""
        symbols = _Symbols(*(SX.sym(name) for name in ("d", "distance", "weight", "push", "incline")))
        for name in self.formulas:
            formula = SCALARS[name].formula
            assert formula is not None
            formula(symbols)
        return tuple(symbols.integrals)


class _Symbols:
    """The quantities of formulas as symbols; every integral that a formula uses is recorded."""

    def __init__(self, durations: SX, distance: SX, weight: SX, push: SX, incline: SX) -> None:
        self.duration, self.distance, self.incline = sum1(durations), distance, incline
        self.weight, self.transport, self.push_work = weight, weight * distance, push
        self.integrals: dict[str, SX] = {}

    @property
    def slip(self) -> SX:
        """The symbol of the path of the sliding contacts."""
        return self.integral(SLIP)

    def integral(self, rate: str) -> SX:
        """The symbol of an integral."""
        return self.integrals.setdefault(rate, SX.sym(rate))


@dataclass(frozen=True, slots=True)
class PointKey:
    """All that determines the function of a point.

    ``leg`` is the index of its step's parameters in ``HybridSystem.step_parameters``.
    """

    system: HybridSystem
    mode: Mode
    leg: int
    n_phases: int
    n_steps: int
    free: tuple[str, ...]
    goals: Goals
    dynamic: bool
    timed: bool


@built_once(maxsize=64)
def point_function(key: PointKey) -> Function:
    """(y, c, p) -> (0, g) of a point, with y = (z, torque values, bounds of |power|, durations, T, freed, extrema).

    c = (time, h and end of the step, each affine in the durations and T; interval of the law; weight; clearance; data)
    and g = (-h dz/dt if dynamic, margins, path quantities, extrema, |power| below its bounds, -weight h rates).
    """
    system, mode = key.system, key.mode
    goals, bounds_power = key.goals, key.dynamic and key.goals.bounds_power
    law, n, m = system.control, system.n_z, key.n_phases
    open_loop = isinstance(law, OpenLoop)
    motors = [*law.values] if isinstance(law, OpenLoop) else []
    ends = 2 if isinstance(law, OpenLoop) and law.order is Order.LINEAR else 1
    z, values = SX.sym("z", n), SX.sym("values", len(motors) * ends)
    d, v, e = SX.sym("d", m), SX.sym("v", len(key.free)), SX.sym("e", len(goals.extrema))
    duration, bound = SX.sym("T", int(key.timed)), SX.sym("P", len(system.walker.actuators) if bounds_power else 0)
    y, T = vertcat(z, values, bound, d, duration, v, e), duration if key.timed else sum1(d) / key.n_steps
    data = SX.sym("r", 0 if open_loop else system.n_r)
    time, length, end = SX.sym("time", m + 2), SX.sym("h", m + 2), SX.sym("end", m + 2)
    segment, weight, arch = SX.sym("segment"), SX.sym("weight"), SX.sym("arch")
    c = vertcat(time, length, end, segment, weight, arch, data)
    p = SX.sym("p", len(system.parameters))
    at = vertcat(1, d, T)
    t, h = dot(time, at), dot(length, at)
    known = dict(zip(key.free, [v[k] for k in range(len(key.free))], strict=True))
    since, r = t, data
    if isinstance(law, OpenLoop):  # every interval is computed as the first one of a law with unit intervals
        known |= {f"control.{name}.{k}": SX(0) for name in motors for k in range(law.count)}
        known |= {f"control.{name}.{k}": values[ends * j + k] for j, name in enumerate(motors) for k in range(ends)}
        since, r = law.intervals * t / T - segment, SX(law.model_copy(update={"duration": None}).data(0))
    full = vertcat(*(known.get(name, p[k]) for k, name in enumerate(system.parameters)))
    full = system.step_parameters(full)[key.leg]
    dz, margins = system.flow(mode)(since, z, full, r), system.margins(mode)(since, z, full, r)
    force, torque, power, foot, _, _, _, slip = system.observation(mode)(since, z, full, r)
    contacts = [*ground_contacts(system.walker, mode, force, slip)]
    rows = [-h * dz] if key.dynamic else []
    rows.append(margins)
    for name in goals.paths:
        angle = None if name == CLEARANCE else system.angle_names.index(name.removeprefix(ANGLE))
        rows.append(foot[1] - arch * sin(pi * t / dot(end, at)) if angle is None else system.angles(z, full)[0][angle])
    for name, _ in goals.of_points(system.walker, mode):
        scalar, level = SCALARS[name], e[goals.extrema.index(name)]
        forces = [each for each in contacts if not (scalar.sticking and each.direction)]
        instants = [Instant(each.force_t, each.force_n, None, None) for each in forces]
        for here in instants if name in OF_CONTACTS else [Instant(None, None, torque, foot[1])]:
            rows += scalar.bounded(level, here)
    width = SMOOTHING * system.weight(full)
    if bounds_power:
        rows += [bound - power, bound + power]
    if key.dynamic:
        by_rate = {
            "power": sum1(power),
            POWER: sum1(bound) if bounds_power else sum1(sqrt(power**2 + width**2)),
            "squared_torque": sum1(torque**2),
            SLIP: sum((contact.direction * contact.slip for contact in contacts), SX(0)),
        }
        rows += [-weight * h * by_rate[rate] for rate in goals.rates]
    return Function("point", [y, c, p], cse([SX(0), vertcat(*rows)]))


@built_once(maxsize=32)
def impact_function(
    system: HybridSystem, modes: tuple[Mode, Mode], ends_step: bool, leg: int, free: tuple[str, ...], ratio: bool
) -> Function:
    """(y, c, p) -> (0, (-z_plus, -step length, -work of the push, margins)) of y = (z, freed, impulse ratio).

    Parameters
    ----------
    modes : mode of the impact, and mode before it; see ``HybridSystem.reset``.
    leg : see ``PointKey``.
    """
    z, v, e = SX.sym("z", system.n_z), SX.sym("v", len(free)), SX.sym("e", int(ratio))
    p = SX.sym("p", len(system.parameters))
    full = vertcat(*(v[free.index(name)] if name in free else p[k] for k, name in enumerate(system.parameters)))
    full, (mode, before), distance, push = system.step_parameters(full)[leg], modes, z[system.n_shape], SX(0)
    landing = [name for name in mode.touching if name not in before.touching]
    lands = bool(landing) and system.cycle_end == TOUCHDOWN
    if lands:
        distance = system.impact(mode, before, ends_step=ends_step)(z=z, p=full)["z_plus"][system.n_shape]
    if landing and system.walker.pushes:
        push = system.push(before)(z=z, p=full)["work"]
    moved = system.reset(mode, before, ends_step=ends_step)(z=z, p=full)["z_plus"]
    margins = system.impact_margins(mode, before)(z, full) if landing or not ends_step else SX(0, 1)
    rows = [-moved, -distance if ends_step else SX(0), -push, margins]
    if ratio:
        sticks = mode.with_states(dict.fromkeys(mode.touching, Mode.STICK))
        impulse = system.impact(sticks, before, ends_step=ends_step)(z=z, p=full)["impulse"]
        landing_indices = [*map(system.walker.struck_contacts(sticks).index, landing)]
        F_t, F_n = (sum((impulse[2 * k + row] for k in landing_indices), SX(0)) for row in (0, 1))
        rows += SCALARS[IMPULSE].bounded(e, Instant(F_t, F_n, None, None))
    return Function("impact", [vertcat(z, v, e), SX(0, 1), p], cse([SX(0), vertcat(*rows)]))


@built_once(maxsize=32)
def scalars_function(
    system: HybridSystem, n_phases: int, free: tuple[str, ...], goals: Goals, states: tuple[str, ...]
) -> Function:
    """(y, c, p) -> (objective, scalars) of y = (durations, freed, integrals, lengths, extrema, states)."""
    d, v = SX.sym("d", n_phases), SX.sym("v", len(free))
    lengths, e, direct = SX.sym("lengths", 2), SX.sym("e", len(goals.extrema)), SX.sym("direct", len(states))
    integrals, p = SX.sym("integrals", len(goals.rates)), SX.sym("p", len(system.parameters))
    full = vertcat(*(v[free.index(name)] if name in free else p[k] for k, name in enumerate(system.parameters)))
    symbols = _Symbols(d, lengths[0], SX(system.weight(full)), lengths[1], SX(system.incline(full)))
    symbols.integrals = {rate: integrals[k] for k, rate in enumerate(goals.rates)}
    values = {name: SCALARS[name].formula(symbols) for name in goals.formulas}  # type: ignore[misc]  # they have one
    values |= {name: e[k] for k, name in enumerate(goals.extrema)}
    values |= {name: v[k] for k, name in enumerate(free)} | {name: direct[k] for k, name in enumerate(states)}
    total = sum((weight * values[name] for name, weight in goals.objective), SX(0))
    return Function(
        "scalars",
        [vertcat(d, v, integrals, lengths, e, direct), SX(0, 1), p],
        [total, vertcat(SX(0, 1), *(values[name] for name in goals.formulas))],
    )
