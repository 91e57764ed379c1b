"""Plausibility of the numbers of a problem for its walker: impossible numbers are faults, unusual ones only remarks.

A passive walker gains energy only downhill. The mean contact force of a steady gait balances the weight, so friction
must be at least tan(slope).
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from casadi import SX, Function
from pydantic import BaseModel

from gaitopt.model.buffered import buffered
from gaitopt.model.checks import FALLEN
from gaitopt.model.control import NoControl
from gaitopt.model.declaration import state_mechanism
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.lagrangian import parameter_namespace
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.model.units import Scales, Within, symmetric
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import Fault, Key
from gaitopt.problem.scalars import SCALARS, SLIPLESS_STEP
from gaitopt.problem.schema import (
    DURATION,
    ConstantTorqueSpec,
    CurveReference,
    HeadSection,
    NoControlSpec,
    PDSpec,
    state_section,
    torques_section,
)
from gaitopt.problem.statement import ProblemStatement

FEET_APART = 1e-6
"""Least distance of the feet at the start of a step, in leg lengths."""
LIGHT = 1e-6
"""A mass below this part of the total is probably a mistake."""
MANY_PHASES = 10
"""Phases of a step for which a solution takes many seconds; the time grows with the square of their number."""
NO_ENERGY = "no source of energy: a passive walker on level or uphill ground cannot have a periodic gait"
STATE: Key = ("gait", "guess", "state")
Span = tuple[Key, float, float, Within]
"""Path of a number or of a range of numbers, its lower and upper end, and its limits."""


def impossible(problem: ProblemStatement) -> Iterator[Fault]:
    """Faults: numbers that the walker cannot have."""
    scales = natural_units(problem.walker)
    if not all(math.isfinite(size) and size > 0 for size in (scales.length, scales.time, scales.energy)):
        yield Fault(("walker",), "masses, lengths and gravity differ so much that their products overflow or vanish")
        return
    for path, lower, upper, within in _spans(problem):
        why = within.objection(lower, upper, scales)
        if why:
            yield Fault(path, why)
    if problem.start is None:
        return
    foot, upright, _ = _geometry_at_guess(problem)
    if not (problem.walker.flies or math.hypot(*foot) > FEET_APART * scales.length):
        yield Fault(STATE, "both feet are at the same place: a step begins with the feet apart")
    if upright < FALLEN:
        yield Fault(STATE, "the walker has fallen: a step begins upright")


def remarks(problem: ProblemStatement) -> Iterator[Fault]:
    """Remarks: numbers that are possible, but probably a mistake."""
    scales, walker = natural_units(problem.walker), problem.walker
    for path, lower, upper, within in _spans(problem):
        why = within.remark(lower, upper, scales)
        if why:
            yield Fault(path, why)
    for name, field in type(walker).model_fields.items():
        part = getattr(walker, name) / scales.mass if (field.description or "").endswith("[kg]") else 1.0
        if 0 < part < LIGHT:
            yield Fault(("walker", name), f"is unusual: {part:.1g} of the whole mass")
    steps = () if problem.is_open else problem.cycle.steps
    for k, step in enumerate(steps):
        if len(step.phases) > MANY_PHASES:
            place: Key = ("gait", "steps", k, "phases") if len(steps) > 1 else ("gait", "phases")
            yield Fault(place, f"{len(step.phases)} phases in one step are many: a solution may take minutes")
    gravity = _geometry_at_guess(problem)[2]
    if lacks_energy(problem):
        yield Fault(("walker",), NO_ENERGY)
    needed = abs(gravity[0] / gravity[1])
    if problem.static_friction < needed and not problem.free:
        less = f"{problem.static_friction:g} is less than tan(slope) = {needed:.4g}"
        yield Fault(("friction",), f"{less}: no steady gait exists on this slope")


def lacks_energy(problem: ProblemStatement) -> bool:
    """Whether nothing replaces the energy lost in impacts and friction: no motors, no push-off, no downhill slope."""
    downhill = _geometry_at_guess(problem)[2][0]
    slides_back = problem.is_open or Mode.SLIP_BACKWARD in (*problem.cycle.phases, *problem.cycle.impacts)
    walker, system = problem.walker, _system(type(problem.walker))
    push, _ = system.push(np.zeros(system.n_z), [*_values(walker), 0.0])
    driven = walker.flies or (walker.pushes and np.asarray(push).any())
    passive = isinstance(problem.control, NoControlSpec) and not problem.free and not driven
    return bool(passive and (downhill == 0 or (downhill < 0 and not slides_back)))


def natural_units(walker: Walker) -> Scales:
    """Natural units of a walker with its parameters."""
    return Dynamics(_system(type(walker)), np.array([*_values(walker), 0.0])).scales


def _spans(problem: ProblemStatement) -> Iterator[Span]:
    """All numbers with a range in natural units, or one that depends on the walker."""
    walker, control, laws = problem.walker, problem.control, dict[str, Any]()
    yield from _friction(problem)
    yield from _of(walker, ("walker",))
    fields = state_section(type(walker)).model_fields
    parameters = {name: field.metadata for name, field in type(walker).model_fields.items()}
    for name, value in () if problem.start is None else problem.start.state.items():
        yield from _annotated((*STATE, name), value, fields[name].metadata)
    for k, duration in enumerate((problem.start and problem.start.durations) or ()):
        yield ("gait", "guess", "durations", k), duration, duration, DURATION
    if isinstance(control, ConstantTorqueSpec):
        laws = {name: field.metadata for name, field in torques_section(type(walker)).model_fields.items()}
        for name, value in control.torques.items():
            yield from _annotated(("control", name), value, laws[name])
    if isinstance(control, PDSpec):
        laws = {name: field.metadata for name, field in PDSpec.model_fields.items()}
        yield from _of(control, ("control",))
        if isinstance(control.reference, CurveReference):
            yield from _of(control.reference.curve, ("control", "reference", "curve"))
    for key, unknown in problem.free.items():
        group, _, name = key.rpartition(".")
        metadata = {"control": laws, "walker": parameters}.get(group, {}).get(name, [])
        for k, bound in enumerate((unknown.lower, unknown.upper)):
            yield from _annotated((group, name, "free", k), bound, metadata)
    for name, span in problem.constraints.items():
        yield from ((("constraints", name), span.minimum, span.maximum, part) for part in _scalar_range(name, problem))


def _friction(problem: ProblemStatement) -> Iterator[Span]:
    if isinstance(problem.friction, float):
        return _annotated(("friction",), problem.friction, HeadSection.model_fields["friction"].metadata)
    return _of(problem.friction, ("friction",))


def _of(model: BaseModel, path: Key) -> Iterator[Span]:
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if isinstance(value, int | float):
            yield from _annotated((*path, name), value, field.metadata)


def _annotated(path: Key, value: float, metadata: list[Any]) -> Iterator[Span]:
    yield from ((path, value, value, part) for part in metadata if isinstance(part, Within))


def _scalar_range(name: str, problem: ProblemStatement) -> list[Within]:
    """Range of a constrained scalar; a freed parameter has its own bounds."""
    modes = set() if problem.is_open else {*problem.cycle.phases, *problem.cycle.impacts}
    if name == "step_length" and modes == {Mode.STICK}:
        return [SLIPLESS_STEP]
    if name in SCALARS:
        return [SCALARS[name].within]
    group, _, coordinate = name.partition(".")
    if group != "state":
        return []
    if coordinate in problem.walker.shape:
        if coordinate in problem.walker.lengths:
            return [Within(possible=(-1, 1), unit="length")]
        return [Within(possible=symmetric(problem.walker.largest_angle))]
    return [part for part in state_section(type(problem.walker)).model_fields[coordinate].metadata
            if isinstance(part, Within)]  # fmt: skip


def _geometry_at_guess(problem: ProblemStatement) -> tuple[Any, float, Any]:
    """Swing foot from the stance foot [m], margin of being upright, and gravity along x and y [m/s^2].

    Without a guess all angles are zero.
    """
    shape = [0.0 if problem.start is None else problem.start.state[name] for name in problem.walker.shape]
    foot, upright, gravity = buffered(_geometry(type(problem.walker)))(shape, _values(problem.walker))
    return foot.copy(), float(upright[0]), gravity.copy()


def _values(walker: Walker) -> list[float]:
    return [float(getattr(walker, name)) for name in type(walker).model_fields]


@lru_cache(maxsize=32)
def _system(walker: type[Walker]) -> HybridSystem:
    return HybridSystem(walker, NoControl())


@lru_cache(maxsize=32)
def _geometry(walker: type[Walker]) -> Function:
    """(shape, p) -> swing foot from the stance foot, upright, gravity."""
    shape, p = SX.sym("shape", len(walker.shape)), SX.sym("p", len(walker.model_fields))
    names = {name: shape[k] for k, name in enumerate(walker.shape)}
    m = state_mechanism(walker, SimpleNamespace(**names, x=SX(0), y=SX(0)), parameter_namespace(walker, p))
    return Function("geometry", [shape, p], [m.swing_foot, m.upright, m.gravity])
