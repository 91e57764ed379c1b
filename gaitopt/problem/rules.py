"""Rules between the sections of a whole problem: what is impossible is a fault, what is only unusual a remark.

The range of a number is declared at its field, see ``Within``, and applied here with the walker's natural units. Rules
between the keys of one mapping are declared at its class: ``faults`` of a section, a control law or a reference.

A passive walker gains energy only downhill. The mean contact force of a steady gait balances the weight, so friction
must be at least tan(slope).
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from casadi import Function
from pydantic import BaseModel

from gaitopt.building import built_once
from gaitopt.display import distinguished
from gaitopt.errors import ProblemError
from gaitopt.model.buffered import buffered
from gaitopt.model.checks import FALLEN, Posture, forgotten_inertia, posture_at
from gaitopt.model.contract import KINKED, check_hooks, check_period, jumping_operations, law_section
from gaitopt.model.control import OWN_PACKAGE, ConstantTorque, Control, NoControl
from gaitopt.model.declaration import actuator_units, parameter_values
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.foreign import FOOT_COORDINATES
from gaitopt.model.friction import COULOMB, shared_friction
from gaitopt.model.modes import Mode
from gaitopt.model.reference import TableReference
from gaitopt.model.section import CLOCK, TOUCHDOWN
from gaitopt.model.system import HybridSystem
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.model.units import DURATION, MOTOR_WORDS, Scales, Within, symmetric, words_and_unit
from gaitopt.model.virtual_constraints import Law, VirtualConstraints
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import Fault, Key, near_miss, shown
from gaitopt.problem.scalars import SCALARS, SLIPLESS_STEP
from gaitopt.problem.schema import HeadSection, state_section
from gaitopt.problem.statement import ProblemStatement
from gaitopt.threads import Uncompared

LARGEST_TORQUE_JUMP = 1e-9
"""Relative difference of a continuous torque before and after a breakpoint: rounding, with a reserve."""
FEET_APART = 1e-6
"""Smallest distance of the feet at the start of a step, in leg lengths."""
LARGEST_LENGTH = 50.0
"""Length [m] above which a walker is probably given in millimetres."""
SMALLEST_MASS = 1e-6
"""A mass below this fraction of the total is probably a mistake."""
LARGEST_TABLE_ERROR = 0.1
"""If the first or last value of a table differs more from its joint, the table is probably not made for this gait [rad,
or leg lengths]."""
MANY_PHASES = 32
"""Number of phases in a step above which a solution can take more than ten seconds: its time grows with the square of
the number, and an inchworm with 11 phases takes half a second."""
TOO_SLIPPERY = "{} is less than tan(slope) = {}: no steady gait exists on this slope"
NO_ENERGY = "no source of energy: a passive walker on level or uphill ground cannot have a periodic gait"
STATE: Key = ("gait", "guess", "state")
Span = tuple[Key, float, float, Within]
"""The path of a number or of a range of numbers; the lower and upper end of the range; and the limits of both."""
SMALLEST_SINGULAR_RATIO = 1e-9
"""If the smallest singular value of a matrix, relative to the largest one, is below its rounding with a reserve, the
matrix has no inverse."""
SAME_SHAPE = 1e-9
"""Difference of a shape from itself after its legs are relabelled twice: rounding [rad, m]."""


def impossible(problem: ProblemStatement) -> Iterator[Fault]:
    """Faults of a problem whose numbers the walker cannot have."""
    scales = natural_units(problem.walker)
    if not all(math.isfinite(size) and size > 0 for size in (scales.length, scales.time, scales.energy)):
        yield Fault(
            ("walker",),
            "masses, lengths and gravity differ so much that their products overflow or vanish: give them in SI units",
        )
        return
    for path, lower, upper, within in _spans(problem):
        why = within.objection(lower, upper, scales)
        if why:
            yield Fault(path, why)
    yield from _control_faults(problem)
    if problem.start is None or not problem.has_gait:  # a simulation may start anywhere
        return
    here = _at_guess(problem)
    passing = problem.cycle_end != TOUCHDOWN or problem.walker.leaves_ground()  # the swing foot may be anywhere
    if not passing and math.hypot(*here.foot[0]) <= FEET_APART * scales.length:
        yield Fault(STATE, "both feet are at the same place: a step begins with the feet apart")
    if here.upright < FALLEN:
        yield Fault(STATE, "the walker has fallen: a step begins upright")


def reference_faults(law: Control, walker: Walker, reference: ProblemStatement) -> Iterator[Fault]:
    """Faults of the problem whose gait a control law tracks: other joints, or several steps."""
    theirs, (name, key) = reference.walker, law.source
    subject = f"the reference {shown(name)}"
    target = next(each for each in law.targets.values() if each.source[0])
    followed = target.followed(type(walker))
    angles = tuple(dict.fromkeys((*theirs.shape, *theirs.actuators, *theirs.phases)))
    needed = dict.fromkeys((*followed.values(), *filter(None, (law.phase_variable,))))
    unknown = ", ".join(angle for angle in needed if angle not in angles)
    if unknown:
        reason = f"is a {theirs.model}, which has no {unknown} to track"
        yield Fault(key, f"{subject} {reason}; its angles are {', '.join(angles)}")
    elif theirs.shape != walker.shape and getattr(target, "joints", None) is None:
        reason = f"is a {theirs.model}, whose shape is {', '.join(theirs.shape)}"
        remedy = f"joints: {{{', '.join(f'{mine}: {angle}' for mine, angle in followed.items())}}}"
        yield Fault(key, f"{subject} {reason}: say which of them each joint follows, {remedy}")
    if len(reference.cycle.steps) > 1:
        why = "the curves are those of one" if law.phase_variable else "its clock restarts at every impact"
        yield Fault(key, f"{subject} has several steps, but {why}: name a gait of one step")


def over_faults(problem: ProblemStatement, objection: Callable[[str, float], str | None]) -> Iterator[Fault]:
    """Faults of the range over which a design holds; for ``objection`` see ``Problem``."""
    over, known = problem.over, problem.parameters
    if over is None:
        return
    path = ("over", over.key)
    if over.key not in known:
        yield Fault(path, f"is not a parameter of this problem{near_miss(over.key, [*known])}")
    elif isinstance(known[over.key], int):
        yield Fault(path, "is a whole number, along which there is no family of gaits")
    elif not over.lower <= known[over.key] <= over.upper:
        own = f"{over.key} = {known[over.key]:g}, for which the phases and the guess are stated"
        yield Fault(path, f"[{over.lower:g}, {over.upper:g}] must contain the problem's own value, {own}")
    else:
        objections = {end: objection(over.key, end) for end in (over.lower, over.upper)}
        yield from (Fault(path, why) for why in objections.values() if why)


def _control_faults(problem: ProblemStatement) -> Iterator[Fault]:
    """The ``torque_faults`` of the problem's own control law, unless it tracks a gait that is not known yet."""
    law = problem.control
    if isinstance(law, NoControl | ConstantTorque) or law.source[0]:
        return
    yield from torque_faults(problem, law, lambda: _controlled_system(problem))


def torque_faults(problem: ProblemStatement, law: Control, build: Callable[[], HybridSystem]) -> Iterator[Fault]:
    """Faults of a control law whose torques are not numbers, or jump at a breakpoint or elsewhere.

    Parameters
    ----------
    law : the control law of the problem, with its reference.
    build : returns the system of the problem with this law. It is called after the methods of the law are checked.
    """
    walker = type(problem.walker)
    try:
        check_hooks(law, walker)
        system = build()
        mode, function = _torques(problem, system)
        if type(law).quantities is not Control.quantities:
            system.quantities(mode)  # calls the method of the law, which may raise
    except ProblemError as error:
        yield Fault(("control",), str(error))
        return
    lands_within = problem.cycle_end not in (TOUCHDOWN, CLOCK) and walker.step_ends()
    if lands_within and (law.breakpoints or function.jac_sparsity(0, 0).nnz()):
        reason = f"{type(law).__name__} depends on the time since the last landing, which lies within the cycle"
        yield Fault(("gait", "section"), f"{reason}: end the cycle with a landing or the clock")
        return
    z = np.zeros(system.n_z) if problem.start is None else np.array([*problem.start.state.values()])
    p, times, name = system.values(problem.parameters), law.breakpoints, type(law).__name__
    jumps = () if type(law).__module__.startswith(OWN_PACKAGE) else jumping_operations(function)
    if jumps:
        reason = f"{name}: torques uses {', '.join(jumps)} of time or state, which may jump where no mode ends"
        remedy = "jumps in time are breakpoints; write others smoothly, such as tanh(x / width) for sign(x)"
        yield Fault(("control",), f"{reason}: {remedy}")
        return
    where = "with all coordinates zero" if problem.start is None else "at the guess"
    if isinstance(law, VirtualConstraints) and law.law is Law.LINEARISING and problem.start is not None:
        known = system.quantities(mode)(t=0, z=z, p=p, r=law.data(0))
        sizes = np.linalg.svd(np.asarray(known["decoupling"]), compute_uv=False)
        if not sizes[-1] > SMALLEST_SINGULAR_RATIO * sizes[0]:
            outputs, motors = ", ".join(law.outputs), ", ".join(law.driven_by(walker))
            reason = f"the decoupling matrix of {outputs} is singular {where}: the motors {motors} cannot accelerate"
            remedy = "choose other outputs or motors, or law: pd"
            yield Fault(("control", "outputs"), f"{reason} these outputs independently; {remedy}")
            return
    at_start, at_end = (np.full(len(walker.actuators), np.nan) for _ in range(2))
    evaluate = buffered(function)
    for segment, time in enumerate((0.0, *times)):
        data = law.data(segment)
        at_start = evaluate(time, z, p, data)[0].copy()
        for k, (actuator, unit) in enumerate(actuator_units(walker).items()):
            u, effort = at_start[k], MOTOR_WORDS[unit]
            if not np.isfinite(u):
                yield Fault(("control",), f"{name}: the {effort} of {actuator} is {u:g} {where}, but must be a number")
            elif segment and not law.jumps and abs(u - at_end[k]) > LARGEST_TORQUE_JUMP * max(abs(u), abs(at_end[k])):
                jump = f"from {at_end[k]:.6g} to {u:.6g} {unit} at its breakpoint {time:g} s"
                remedy = "make it continuous there, or set jumps = True"
                yield Fault(("control",), f"{name}: the {effort} of {actuator} jumps {jump}: {remedy}")
        if segment < len(times):
            at_end = evaluate(times[segment], z, p, data)[0].copy()
    if not law.restarts or problem.cycle_end == CLOCK:
        try:
            check_period(law, walker.actuators, function, z, p)
        except ProblemError as error:
            yield Fault(("control",), str(error))


def _torques(problem: ProblemStatement, system: HybridSystem) -> tuple[Mode, Function]:
    """A mode of the gait, and the function (t, z, p, r) of the torques in it."""
    mode = type(problem.walker).released(Mode.STICK) if problem.is_open else problem.cycle.phases[0]
    return mode, system.torques(mode)


def _kinks(problem: ProblemStatement) -> Iterator[Fault]:
    """Remarks on functions in the torques of another package's law whose derivatives jump where no mode ends."""
    law = problem.control
    if type(law).__module__.startswith(OWN_PACKAGE) or law.source[0]:
        return
    kinks = jumping_operations(_torques(problem, _controlled_system(problem))[1], KINKED)
    if kinks:
        reason = f"torques uses {', '.join(kinks)} of time or state, whose kink gaitopt does not locate"
        remedy = "it may keep a solve or a verification from its accuracy"
        smooth = "write it smoothly, such as sqrt(x**2 + width**2) for fabs(x)"
        yield Fault(("control",), f"{type(law).__name__}: {reason}: {remedy}; {smooth}")


def _loose_ends(problem: ProblemStatement, length: float) -> Iterator[Fault]:
    """Remarks on tables whose first or last value is far from its joint just after or just before an impact.

    The shape just after the impact is that of the guess, and the shape just before it is the same with the legs
    relabelled.
    """
    law, walker = problem.control, type(problem.walker)
    tables = {name: each for name, each in law.targets.items() if isinstance(each, TableReference)}
    known_law = isinstance(law, ProportionalDerivative | VirtualConstraints)
    if not (tables and known_law) or problem.start is None or problem.is_open or walker.leaves_ground():
        return
    ((key, table),) = tables.items()
    names = law.outputs if isinstance(law, VirtualConstraints) else table.names
    system, mode, n = _controlled_system(problem), problem.cycle.phases[0], len(walker.shape)
    p, after = system.values(problem.parameters), np.array([*problem.start.state.values()])
    relabelled = system.impact(walker.swapped(Mode.STICK), Mode.STICK)
    before = np.asarray(relabelled(after, p)[0]).ravel()
    again = np.asarray(relabelled(before, p)[0]).ravel()
    ends = [("first", "just after the impact", after, 0.0)]
    if np.allclose(again[:n], after[:n], atol=SAME_SHAPE):
        durations, last = problem.start.durations, max(law.breakpoints, default=0.0)
        ends.append(("last", "just before the impact", before, min(sum(durations or [last]), last)))
    for row, where, z, time in ends:
        known = system.quantities(mode)(t=time, z=z, p=p, r=law.data(bisect_left(law.breakpoints, time)))
        for name, error in zip(names, np.asarray(known["outputs"]).ravel().tolist(), strict=True):
            unit, size = ("m", length) if name in walker.lengths else ("rad", 1.0)
            if abs(error) > LARGEST_TABLE_ERROR * size:
                offset = f"the {row} value of {name} is {abs(error):.3g} {unit} from its joint {where}, at the guess"
                yield Fault(("control", key, "table"), f"{table.table.file}: {offset}; the torques jump at the impact")


def _controlled_system(problem: ProblemStatement) -> HybridSystem:
    """The system of a problem whose law needs no other gait. Problems that differ in parameters alone share it."""
    law = problem.control.untimed
    structure = (problem.impact_law, problem.friction_law, problem.cycle_end, *law.structure)
    return _controlled((type(problem.walker), *structure), Uncompared(problem))


@built_once(maxsize=16)
def _controlled(key: tuple[object, ...], stated: Uncompared[ProblemStatement]) -> HybridSystem:
    """The system of a problem; ``key`` determines its functions."""
    problem = stated.value
    law = problem.friction_law
    return HybridSystem(type(problem.walker), problem.control, problem.impact_law, law, problem.cycle_end)


def remarks(problem: ProblemStatement) -> Iterator[Fault]:
    """Remarks on numbers that are possible, but probably a mistake."""
    scales, walker = natural_units(problem.walker), problem.walker
    for path, lower, upper, within in _spans(problem):
        why = within.remark(lower, upper, scales)
        if why:
            yield Fault(path, why)
    for name, info in type(walker).model_fields.items():
        unit, value = words_and_unit(info.description or "")[1], getattr(walker, name)
        if unit == "m" and abs(value) > LARGEST_LENGTH:
            yield Fault(
                ("walker", name), f"{value:g} m is unusual; did you mean {value:g} mm, which is {value / 1000:g}?"
            )
        if unit == "kg" and 0 < value < SMALLEST_MASS * scales.mass:
            yield Fault(("walker", name), f"{value:g} is unusual: {value / scales.mass:.1g} of the total mass")
    steps = () if problem.is_open else problem.cycle.steps
    for k, step in enumerate(steps):
        if len(step.phases) > MANY_PHASES:
            path = ("gait", "steps", k, "phases") if len(steps) > 1 else ("gait", "phases")
            yield Fault(path, f"{len(step.phases)} phases in one step are many: a solution may take minutes")
    for remark in forgotten_inertia(type(walker)):
        yield Fault(("walker",), remark)
    if lacks_energy(problem):
        yield Fault(("walker",), NO_ENERGY)
    yield from _loose_ends(problem, scales.length)
    yield from _kinks(problem)
    needed = least_friction(problem)
    if problem.static_friction < needed:
        yield Fault(("friction",), TOO_SLIPPERY.format(*distinguished(problem.static_friction, needed)))


def least_friction(problem: ProblemStatement) -> float:
    """The friction tan(slope) that every steady gait needs.

    Over a period the contact forces balance the weight, and friction bounds the tangential force everywhere. The bound
    is zero if drag or motors act along the ground too, and if the problem has free numbers.
    """
    gravity = _at_guess(problem).gravity
    drag = any(value for key, value in problem.parameters.items() if key.endswith(".viscous"))
    return 0.0 if problem.free or drag or problem.walker.external else abs(float(gravity[0] / gravity[1]))


def lacks_energy(problem: ProblemStatement) -> bool:
    """Whether no motor, push-off or downhill slope replaces the energy that impacts and friction dissipate.

    Gravity does work if the walker moves downhill over a cycle: it may walk forward, or in the direction in which its
    centre of mass moves at the guess, and slip in those of its modes.
    """
    walker = problem.walker
    if (
        walker.may_keep_energy()
        or problem.cycle_end != TOUCHDOWN
        or problem.free
        or not isinstance(problem.control, NoControl)
    ):
        return False
    here = _at_guess(problem)
    along, momentum = here.gravity[0], here.bodies[:, 0] @ here.bodies[:, 4]
    modes = () if problem.is_open else (*problem.cycle.phases, *problem.cycle.impacts)
    directions = (1.0, momentum, *(direction for mode in modes for direction in mode.directions.values()))
    if along and (problem.is_open or any(direction * along > 0 for direction in directions)):
        return False
    system, on_ground = _system(type(walker)), walker.foot_modes()[0]
    push = system.push(on_ground)(np.zeros(system.n_z), [*parameter_values(walker), 0.0])
    return not (walker.pushes and np.asarray(push[0]).any())


def natural_units(walker: Walker) -> Scales:
    """Natural units of a walker with its parameters."""
    return Dynamics(_system(type(walker)), np.array([*parameter_values(walker), 0.0])).scales


def natural_unit(problem: ProblemStatement, key: str) -> float:
    """The natural unit of a number of a problem by its dotted key, in SI; 1 if it is a pure number or has no range."""
    scales = natural_units(problem.walker)
    sizes = (within.size(scales) for path, _, _, within in _spans(problem) if ".".join(map(str, path)) == key)
    return next(sizes, 1.0)


def _spans(problem: ProblemStatement) -> Iterator[Span]:
    """All numbers of a problem that have a range in natural units, or a range that depends on the walker."""
    walker, state = problem.walker, state_section(type(problem.walker))
    control = law_section(type(problem.control), type(walker))
    yield from _section_spans((), HeadSection, {"friction": problem.friction})
    for name, law in problem.friction.items() if isinstance(problem.friction, Mapping) else ():
        if isinstance(law, BaseModel):
            yield from _section_spans(("friction", name), type(law), vars(law))
    yield from _section_spans(("walker",), type(walker), vars(walker))
    if problem.start is not None:
        yield from _section_spans(STATE if problem.has_gait else ("state",), state, problem.start.state)
        for k, duration in enumerate(problem.start.durations or ()):
            yield ("gait", "guess", "durations", k), duration, duration, DURATION
    for path, lower, upper, within in _section_spans(("control",), control, dict(problem.control)):
        yield path, lower, upper, _of_motor(walker, path, within)
    sections = {"walker": type(walker), "control": control}
    for key, unknown in problem.free.items():
        group, *names = key.split(".")
        ranges = _ranges(sections[group]).get(names[0], ()) if group in sections else ()
        for k, bound in enumerate((unknown.lower, unknown.upper)):
            path = (group, *names, "free", k)
            yield from ((path, bound, bound, _of_motor(walker, (group, *names), within)) for within in ranges)
    for name, span in problem.constraints.items():
        for within in _scalar_range(name, problem):
            yield ("constraints", name), span.minimum, span.maximum, within


def _section_spans(path: Key, section: type[BaseModel], values: Mapping[str, Any]) -> Iterator[Span]:
    ranges = _ranges(section)
    for name, value in values.items():
        if name in ranges:
            for key, number in _numbers(value):
                yield from (((*path, name, *key), number, number, within) for within in ranges[name])
        if isinstance(value, BaseModel):
            yield from _section_spans((*path, name), type(value), dict(value))


def _of_motor(walker: Walker, path: Key, within: Within) -> Within:
    """The range of a number of a control law, in natural units of forces if its motor exerts a force.

    A number that belongs to no motor has units of forces if all motors exert forces.
    """
    units = actuator_units(type(walker))
    named = {units[str(name)] for name in path if name in units}
    if path[0] != "control" or (named or {*units.values()}) != {"N"}:
        return within
    of_force = {"torque": "force" if named else "stiffness", "damping": "drag"}
    return replace(within, unit=of_force.get(within.unit, within.unit))


def _numbers(value: object) -> list[tuple[Key, float]]:
    """A number without a key, or the numbers of a mapping or tuple with their keys."""
    if isinstance(value, tuple):
        return [((k,), entry) for k, entry in enumerate(value) if isinstance(entry, int | float)]
    if not isinstance(value, Mapping):
        return [((), value)] if isinstance(value, int | float) else []
    return [((str(key),), entry) for key, entry in value.items() if isinstance(entry, int | float)]


@lru_cache(maxsize=64)
def _ranges(section: type[BaseModel]) -> Mapping[str, tuple[Within, ...]]:
    """The ranges of those fields of a section that have any."""
    ranges = {
        name: tuple(entry for entry in info.metadata if isinstance(entry, Within))
        for name, info in section.model_fields.items()
    }
    return {name: within for name, within in ranges.items() if within}


def _scalar_range(name: str, problem: ProblemStatement) -> tuple[Within, ...]:
    """The range of a constrained scalar. A freed parameter has its own bounds, and so no range here."""
    walker, modes = problem.walker, set() if problem.is_open else {*problem.cycle.phases, *problem.cycle.impacts}
    if name == "step_length" and modes == {Mode.STICK}:
        return (SLIPLESS_STEP,)
    if name in SCALARS:
        within, forces = SCALARS[name].within, {*actuator_units(type(walker)).values()} == {"N"}
        return (replace(within, unit="force") if name == "peak_torque" and forces else within,)
    group, _, coordinate = name.partition(".")
    if group != "state":
        return ()
    if coordinate in walker.lengths:
        return (Within(possible=(-1, 1), unit="length"),)
    if coordinate in walker.shape:
        return (Within(possible=symmetric(walker.largest_angle)),)
    return _ranges(state_section(type(walker))).get(coordinate, ())


def _at_guess(problem: ProblemStatement) -> Posture:
    """The walker at the guess, with its stance foot at the origin; without a guess all angles and rates are zero."""
    walker = type(problem.walker)
    state = {} if problem.start is None else problem.start.state
    names = (*walker.shape, *FOOT_COORDINATES)
    q = (*(0.0 if name == "x" else state.get(name, 0.0) for name in names),)
    dq = (*(state.get(f"d{name}", 0.0) for name in names),)
    return _posture(walker, q, dq, (*parameter_values(problem.walker).tolist(),))


@lru_cache(maxsize=16)
def _posture(walker: type[Walker], q: tuple[float, ...], dq: tuple[float, ...], p: tuple[float, ...]) -> Posture:
    """The walker at some coordinates, which the rules, the remarks and the solver ask for in turn."""
    return posture_at(walker, np.array(q), np.array(dq), np.array(p))


@built_once(maxsize=32)
def _system(walker: type[Walker]) -> HybridSystem:
    return HybridSystem(walker, NoControl(), friction=shared_friction(walker.labels(), COULOMB))
