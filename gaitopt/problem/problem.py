"""A problem: how the statement of a gait is loaded, changed and identified.

A problem that tracks another gait holds that gait's own problem, which overrides never touch.

The other problem whose gait a control tracks or its curve starts from: its name in the file, and what it must be.

The mode sequences of a gait and its first guess: a state on the section just after the impact, and durations.

What the section determines is filled in (both feet on the ground, x = 0, and dx = 0 unless the impact slips); what a
file gives besides must agree with it.

A problem as data in the layout of its file, in SI: the inverse of reading it.

Changing a problem by dotted keys: friction, walker.slope, gait.guess.state.theta1, constraints.speed.min.

From the data of a file, or of a file with overrides, to the fields of a problem; all faults are collected.

Numbers that are unknowns, ``{free: [lo, hi], guess: x}``, are validated three times by the very model of their
section: guess, lower and upper bound in the place of the number.

The named problems: files shipped with the package, or in a checkout those of its folder ``problems``.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.model.checks import check_walker, section_posture
from gaitopt.model.control import BeyondEnd
from gaitopt.model.cycle import Cycle, ModeSequence
from gaitopt.model.declaration import calling, check_class
from gaitopt.model.modes import NEXT_STATE, Mode
from gaitopt.model.registry import refused_walkers, registered_walkers
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import (
    ChangedPlace,
    Fault,
    FilePlace,
    Key,
    OverridePlace,
    Place,
    dotted,
    fault_lines,
    near_miss,
    raise_faults,
    read_section,
    shown,
)
from gaitopt.problem.plausibility import impossible, remarks
from gaitopt.problem.schema import (
    SECTION_KEYS,
    ConstantTorqueSpec,
    ControlSpec,
    Curve,
    CurveReference,
    CycleSection,
    Free,
    FreeSection,
    FrictionCoefficients,
    GaitReference,
    GaitSection,
    Guess,
    GuessSection,
    HeadSection,
    NoControlSpec,
    OpenGaitSection,
    OpenSequence,
    PDSpec,
    ProblemStatement,
    Scope,
    StepSection,
    check_unknowns,
    read_constraints,
    read_objective,
    state_section,
    torques_section,
)
from gaitopt.problem.source import parse_source, read_text


def reference_name(control: ControlSpec | None) -> tuple[str, Key]:
    """Name or path of the other problem in a control, and the key that gives it; empty if there is none."""
    if not isinstance(control, PDSpec):
        return "", ()
    if isinstance(control.reference, CurveReference):
        return control.reference.curve.start, ("control", "reference", "curve", "start")
    return control.reference.gait, ("control", "reference", "gait")


def unsuitable(name: str, reference: ProblemStatement, walker: Walker) -> Iterator[str]:
    """Why a walker cannot track the gait of a problem, which its file calls ``name``."""
    words = f"the reference {shown(name)}"
    untracked = ", ".join(angle for angle in walker.tracked if angle not in reference.walker.shape)
    if untracked:
        yield f"{words} is a {reference.walker.model}, which has no {untracked} to track"
    if len(reference.cycle.steps) > 1:
        yield f"{words} has several steps, but its clock restarts at every impact: name a gait of one step"


OPEN = "auto"
UNEVEN = "{} is no number of steps after which the same leg stands again: where the legs differ, a cycle has 2, 4, ..."
SAME_STATE = 1e-5  # relative: a state written with six digits may be off by half of this


def read_gait(
    data: Mapping[str, Any], model: type[Walker] | None, walker: Walker | None, faults: list[Fault]
) -> tuple[Cycle | OpenSequence | None, Guess | None]:
    """The cycle and the guess, as far as they can be had without fault."""
    if "gait" not in data:
        return None, None
    if isinstance(data["gait"], Mapping) and data["gait"].get("phases") == OPEN:
        return _read_open(data["gait"], model, walker, faults)
    several = isinstance(data["gait"], Mapping) and "steps" in data["gait"]
    model_: type[CycleSection] | type[GaitSection] = CycleSection if several else GaitSection
    gait = read_section(model_, data["gait"], ("gait",), faults)
    if gait is None:
        return None, None
    steps = gait.steps if isinstance(gait, CycleSection) else (gait,)
    cycle = _read_cycle(steps, model, ("gait", "steps" if several else "phases"), faults)
    guess = read_section(GuessSection, gait.guess, ("gait", "guess"), faults)
    if guess is None:
        return cycle, None
    phases = [mode for step in steps for mode in step.phases]
    if guess.durations is not None and len(guess.durations) != len(phases):
        needed = f"one duration per phase ({', '.join(phases)})"
        message = f"{len(guess.durations)} given, but it takes {needed}; or leave durations out"
        faults.append(Fault(("gait", "guess", "durations"), message))
    state = None if model is None else _read_state(guess.state, model, walker, steps[-1].impact, faults)
    return cycle, None if state is None else Guess(state=state, durations=guess.durations)


def _read_open(
    data: Mapping[str, Any], model: type[Walker] | None, walker: Walker | None, faults: list[Fault]
) -> tuple[OpenSequence | None, Guess | None]:
    """A gait whose sequence is to be found; of a guess, the slip velocity is 0 if it is left out."""
    gait = read_section(OpenGaitSection, data, ("gait",), faults)
    if gait is None:
        return None, None
    sides = 1 if model is None else model.n_sides()
    sequence = OpenSequence(impact=gait.impact, steps=max(gait.steps, sides))
    if "steps" in gait.model_fields_set and gait.steps < sides:
        faults.append(Fault(("gait", "steps"), UNEVEN.format(gait.steps)))
    guess = None if gait.guess is None else read_section(GuessSection, gait.guess, ("gait", "guess"), faults)
    if guess is None or model is None:
        return sequence, None
    if guess.durations is not None:
        faults.append(Fault(("gait", "guess", "durations"), "belong to phases, which are open here: leave them out"))
    slip = guess.state.get("dx", 0.0)
    impact = Mode.slip(slip) if isinstance(slip, int | float) and slip else Mode.STICK
    state = _read_state(guess.state, model, walker, impact, faults)
    return sequence, None if state is None else Guess(state=state, durations=None)


def _read_cycle(
    steps: Sequence[StepSection], model: type[Walker] | None, path: Key, faults: list[Fault]
) -> Cycle | None:
    try:
        cycle = Cycle(tuple(ModeSequence(phases=step.phases, impact=step.impact) for step in steps))
        if model is not None:
            if len(steps) % model.n_sides():
                raise ValueError(UNEVEN.format(len(steps)))
            for step in steps:
                _check_contacts(step, model)
                _check_stops(step, model)
        return cycle
    except ValueError as error:
        faults.append(Fault(path, str(error)))
        return None


def _check_contacts(step: StepSection, model: type[Walker]) -> None:
    """Whether the foot can do what every phase says, and the step of a walker that flies ends out of flight.

    Raises
    ------
    ValueError
        If not; the message says what the walker can do.
    """
    allowed = model.contacts()
    for mode in (*step.phases, step.impact):
        if mode.contact not in allowed:
            raise ValueError(f"the {model.model} has no {mode.contact}: its foot can {', '.join(allowed)}")
    if step.impact.flies:
        raise ValueError("after an impact the foot is on the ground: stick, slip_forward or slip_backward")
    if model.flies and not step.phases[-1].flies:
        raise ValueError(f"the {model.model} lands out of flight: the last phase of a step must be flight")


def _check_stops(step: StepSection, model: type[Walker]) -> None:
    """Whether every phase states the stops and switches, which lock or are thrown one after the other.

    Those of a walker that stays on the ground are all locked when the foot comes down.

    Raises
    ------
    ValueError
        If not; the message says how to write it.
    """
    start = model.released(Mode.STICK).stops
    stops = tuple(start)
    for mode in step.phases:
        if tuple(mode.stops) != stops or any(mode.stops[k] not in (v, NEXT_STATE[v]) for k, v in start.items()):
            form = "{" + ", ".join([f"mode: {mode.contact}", *(f"{k}: {v}" for k, v in start.items())]) + "}"
            raise ValueError(f"{mode} must be written {form if stops else mode.contact}, as the walker has its stops")
    thrown = [{name for name in stops if mode.stops[name] != start[name]} for mode in step.phases]
    jumps = [len(later) - len(earlier) for earlier, later in pairwise(thrown) if earlier <= later]
    if len(jumps) < len(thrown) - 1 or max(jumps, default=0) > 1 or thrown[0]:
        raise ValueError("a step begins with all stops free and all switches off, and they change one at a time")
    if not model.flies and step.phases[-1].free:
        raise ValueError("all stops lock before the foot comes down")
    if step.impact.stops:
        raise ValueError(f"the impact is written {step.impact.contact}: that of the foot frees all stops")


def _read_state(
    data: Mapping[str, Any], model: type[Walker], walker: Walker | None, impact: Mode, faults: list[Fault]
) -> dict[str, float] | None:
    """The complete state, in the order of the walker's state names."""
    path: Key = ("gait", "guess", "state")
    section = read_section(state_section(model), data, path, faults)
    if section is None:
        return None
    given = section.model_dump(exclude_none=True)
    needed = model.section_names(slipping=impact.slips)
    missing = [name for name in needed if name not in given]
    faults += [
        Fault((*path, name), f"is missing; after this impact the section is {', '.join(needed)}") for name in missing
    ]
    faults += _slip_faults(given.get("dx", 0.0), impact, (*path, "dx")) if "dx" not in missing else []
    if missing or walker is None:
        return None
    state = (
        dict.fromkeys(walker.state_names(), 0.0)
        | _after_impact(given, walker)
        | {k: given[k] for k in needed if k in given}
    )
    undefined = [name for name, value in state.items() if not math.isfinite(value)]
    if undefined:
        words = ", ".join(f"{name} = {value:g}" for name, value in given.items())
        faults.append(Fault(path, f"with {words} the walker would start with {undefined[0]} = {state[undefined[0]]}"))
        return None
    for name, value in given.items():
        if name not in (*needed, "x", "dx") and not math.isclose(value, state[name], rel_tol=SAME_STATE):
            message = f"{value:g} contradicts the section, just after the impact it is {state[name]:.9g}: leave it out"
            faults.append(Fault((*path, name), message))
    state |= {name: given[name] for name in ("x", "dx") if name in given}
    return {name: float(state[name]) for name in walker.state_names()}


def _after_impact(given: Mapping[str, float], walker: Walker) -> dict[str, float]:
    """Shape coordinates and rates that follow from those of the section."""
    model = type(walker)
    p = np.array([float(getattr(walker, name)) for name in model.model_fields])
    shape, rates = section_posture(model, given, p)
    names = (*walker.shape, *(f"d{name}" for name in walker.shape))
    return dict(zip(names, map(float, (*shape, *rates)), strict=True))


def _slip_faults(dx: float, impact: Mode, path: Key) -> list[Fault]:
    """Whether the slip velocity has the sign that the impact says."""
    if math.copysign(1.0, dx) * (dx != 0) == impact.direction:
        return []
    sign = {0: "= 0 (leave it out)", 1: "> 0", -1: "< 0"}[impact.direction]
    return [Fault(path, f"{shown(dx)} contradicts the impact: after {impact} it is {sign}")]


def problem_data(problem: ProblemStatement) -> dict[str, Any]:
    """JSON-able data that would be read as the same problem; a reference stands there by its name.

    Of the guessed state only the section coordinates are given, so that what follows from them does when they change.
    """
    data: dict[str, Any] = {
        "name": problem.name,
        "about": problem.about,
        "walker": {"model": problem.walker.model, **problem.walker.model_dump(mode="json")},
        "friction": problem.friction_data,
        "impact_law": str(problem.impact_law),
        "control": problem.control.model_dump(mode="json", exclude_none=True),
        "gait": _gait_data(problem),
    }
    if isinstance(problem.control, ConstantTorqueSpec):
        data["control"] = {"type": problem.control.type, **problem.control.torques}
    for key, free in problem.free.items():
        group, _, name = key.rpartition(".")
        (data[group] if group else data)[name] = {"free": [free.lower, free.upper], "guess": free.guess}
    if problem.objective:
        data["objective"] = dict(problem.objective)
    if problem.constraints:
        ends = {name: {"min": span.minimum, "max": span.maximum} for name, span in problem.constraints.items()}
        data["constraints"] = {n: {k: v for k, v in own.items() if math.isfinite(v)} for n, own in ends.items()}
    return data


def changed_values(before: Mapping[str, Any], after: Mapping[str, Any], above: str = "") -> list[str]:
    """Dotted keys of what differs between the data of two problems; their names and texts ``about`` do not count."""
    changed = []
    for key in dict.fromkeys([*before, *after]):
        one, other = before.get(key), after.get(key)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            changed += changed_values(one, other, f"{above}{key}.")
        elif one != other and (above or key not in ("name", "about")):
            changed.append(f"{above}{key}")
    return changed


def digest_of(resolved: Mapping[str, Any]) -> str:
    """SHA-256 of resolved data without the texts ``about``."""
    canonical = json.dumps(_without_about(resolved), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def _without_about(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {key: _without_about(value) for key, value in data.items() if key != "about"}
    return data


def _gait_data(problem: ProblemStatement) -> dict[str, Any]:
    if isinstance(problem.modes, OpenSequence):
        data: dict[str, Any] = {"phases": OPEN}
        data |= {} if problem.modes.impact is None else {"impact": str(problem.modes.impact)}
        data |= {} if problem.modes.steps == 1 else {"steps": problem.modes.steps}
        slipping = problem.start is not None and problem.start.state["dx"] != 0
    else:
        data, slipping = cycle_data(problem.modes), problem.modes.impact.slips
    if problem.start is not None:
        names = (*problem.walker.section_names(slipping=slipping), "x")
        data["guess"] = {"state": {name: problem.start.state[name] for name in names}}
        if problem.start.durations is not None:
            data["guess"]["durations"] = list(problem.start.durations)
    return data


def cycle_data(cycle: Cycle) -> dict[str, Any]:
    """Phases and impact of one step, or those of several under ``steps``."""
    steps = [{"phases": [mode.data for mode in step.phases], "impact": str(step.impact)} for step in cycle.steps]
    return steps[0] if len(steps) == 1 else {"steps": steps}


DURATIONS = ("gait", "guess", "durations")
SLIP_VELOCITY = ("gait", "guess", "state", "dx")


def apply_overrides(
    data: Mapping[str, Any], overrides: Mapping[str, object], faults: list[Fault], label: str = ""
) -> tuple[dict[str, Any], OverridePlace]:
    """A copy of ``data`` with ``overrides``, and the place by which faults name them.

    An override of the sequence removes the parts of the first guess that no longer apply, unless they are overridden
    too: durations when the number of phases changes, the slip velocity when the impact sticks, and impact and
    durations when the sequence is opened.
    """
    changed = deepcopy(dict(data))
    place = OverridePlace({key: _path(key) for key in overrides}, label)
    for key, value in overrides.items():
        _set(changed, place.keys[key], value, faults)
    if not faults:
        _drop_stale(data, changed, tuple(place.keys.values()))
    return changed, place


def _path(key: str) -> Key:
    """Keys of mappings; a name after ``constraints`` or ``objective`` may itself hold dots (state.dx, walker.slope)."""
    first, *rest = key.split(".")
    if first not in ("constraints", "objective") or not rest:
        return (first, *rest)
    end = rest[-1:] if first == "constraints" and rest[-1] in ("min", "max") and len(rest) > 1 else []
    return (first, ".".join(rest[: len(rest) - len(end)]), *end)


def _set(data: dict[str, Any], path: Key, value: object, faults: list[Fault]) -> None:
    section: Any = data
    if path[0] == "friction":
        value = _match_friction(data, path, value, faults)
    for depth, key in enumerate(path[:-1], start=1):
        created: dict[str, Any] = {}
        section = section.setdefault(key, created)
        if not isinstance(section, dict):
            faults.append(Fault(path, f"{dotted(path[:depth])} is {shown(section)} and has no keys: set it as a whole"))
            return
    section[path[-1]] = deepcopy(value)


def _match_friction(data: dict[str, Any], path: Key, value: object, faults: list[Fault]) -> object:
    """One coefficient where there are two moves both, if they are equal; one of two splits a single one."""
    friction = data["friction"]
    if len(path) > 1 and isinstance(friction, int | float):
        data["friction"] = {"static": friction, "kinetic": friction}
    elif (
        len(path) == 1
        and isinstance(value, int | float)
        and "static" in (friction if isinstance(friction, dict) else ())
    ):
        if friction["static"] == friction["kinetic"]:
            return {**friction, "static": value, "kinetic": value}
        faults.append(
            Fault(path, f"there are two coefficients, {shown(friction)}: set friction.static or friction.kinetic")
        )
    return value


_REPLACED = (("steps", ("phases", "impact")), ("phases", ("steps",)))
_OPENED = (("phases", ("impact", "steps")),)
"""Keys of a gait that go where another one is set: one step or several, and a sequence that is opened."""


def _drop_stale(before: Mapping[str, Any], after: Mapping[str, Any], overridden: tuple[Key, ...]) -> None:
    def is_set(path: Key) -> bool:
        return any(path[: len(key)] == key for key in overridden)

    gait = after["gait"]
    if not isinstance(gait, dict) or not isinstance(gait.get("guess"), dict):
        return
    guess, opened = gait["guess"], gait.get("phases") == OPEN
    if opened and before["gait"].get("phases") != OPEN:
        guess.pop("durations", None)
    stale = _OPENED if opened and before["gait"].get("phases") != OPEN else () if opened else _REPLACED
    for key, others in stale:
        if is_set(("gait", key)):
            for other in others:
                if not is_set(("gait", other)):
                    gait.pop(other, None)
    if _phase_counts(gait) not in (None, _phase_counts(before["gait"])) and not is_set(DURATIONS):
        guess.pop("durations", None)
    last = next(iter(_steps(gait)[-1:]), None)
    sticks = isinstance(last, Mapping) and last.get("impact") == Mode.STICK
    if sticks and not is_set(SLIP_VELOCITY) and isinstance(guess.get("state"), dict):
        guess["state"].pop("dx", None)


def _steps(gait: Mapping[str, Any]) -> list[Any]:
    """The steps of a gait's data, valid or not."""
    steps = gait.get("steps", [gait])
    return list(steps) if isinstance(steps, list | tuple) else []


def _phase_counts(gait: Mapping[str, Any]) -> list[int] | None:
    """Number of phases of every step; None where the data are no steps."""
    phases = [step.get("phases") if isinstance(step, Mapping) else None for step in _steps(gait)]
    counts = [len(p) for p in phases if isinstance(p, list | tuple)]
    return counts if len(counts) == len(phases) else None


Model = TypeVar("Model", bound=BaseModel)

CONTROLS = ("none", "constant_torque", "pd")
UNREAD = Free(lower=math.nan, upper=math.nan, guess=math.nan)
"""Stands for an unknown that has faults of its own, so that its name stays known."""


def assemble(data: Mapping[str, Any], walkers: Mapping[str, type[Walker]], faults: list[Fault]) -> dict[str, Any]:
    """The fields of a problem that its own data determine; they are meaningful only if no fault was added."""
    return _Reader(data, walkers, faults).fields()


class _Reader:
    """Reads the sections of one problem, and collects its unknowns ``free`` and all faults on the way."""

    def __init__(self, data: Mapping[str, Any], walkers: Mapping[str, type[Walker]], faults: list[Fault]) -> None:
        self._data, self._walkers, self._faults = data, walkers, faults
        self._free: dict[str, Free] = {}
        friction = data.get("friction")
        self._coefficients = friction if isinstance(friction, Mapping) and not _is_free(friction) else None

    def fields(self) -> dict[str, Any]:
        """The fields of the problem."""
        data, faults = self._data, self._faults
        model = self._model()
        walker = None if model is None else self._walker(model)
        head = self._head()
        several = self._coefficients
        friction = None if several is None else self._parameters(FrictionCoefficients, several, ("friction",))
        control = self._control(model)
        modes, guess = read_gait(data, model, walker, faults)
        fields: dict[str, Any] = {"walker": walker, "control": control, "modes": modes, "start": guess}
        if head:
            fields |= {key: getattr(head, key) for key in HeadSection.model_fields}
        if friction:
            fields["friction"] = friction
        if model:
            cycle = modes if isinstance(modes, Cycle) else None
            scope = Scope(walker=model, control=control, cycle=cycle, free=self._free)
            objective = read_objective(data.get("objective"), scope, faults)
            constraints = read_constraints(data.get("constraints"), scope, faults)
            if not faults:
                check_unknowns(scope, objective, constraints, faults)
            fields |= {"objective": objective, "constraints": constraints}
        return fields | {"free": self._free}

    def _fault(self, path: Key, message: str) -> None:
        self._faults.append(Fault(path, message))

    def _head(self) -> HeadSection | None:
        known = (*HeadSection.model_fields, *SECTION_KEYS)
        for key in self._data:
            if key not in known:
                self._fault((key,), f"unknown key{near_miss(key, known)}")
        self._faults += [Fault((key,), "is missing") for key in ("walker", "gait") if key not in self._data]
        own = {key: value for key, value in self._data.items() if key in HeadSection.model_fields}
        if self._coefficients is not None:
            own["friction"] = 0.0  # read by itself
        return self._parameters(HeadSection, own, ())

    def _model(self) -> type[Walker] | None:
        if "walker" not in self._data:
            return None
        section = self._data["walker"]
        if not isinstance(section, Mapping):
            words = "stands where a mapping belongs: model, and the model's parameters"
            self._fault(("walker",), f"{shown(section)} {words}")
            return None
        name = section.get("model")
        if isinstance(name, str) and name in self._walkers:
            return self._walkers[name]
        if isinstance(name, str) and name in refused_walkers():
            self._fault(("walker", "model"), refused_walkers()[name])
            return None
        wrong = f"no walker is called {shown(name)}" if "model" in section else "is missing"
        self._fault(("walker", "model"), f"{wrong}{near_miss(name, tuple(self._walkers))}")
        return None

    def _walker(self, model: type[Walker]) -> Walker | None:
        parameters = {key: value for key, value in self._data["walker"].items() if key != "model"}
        try:
            with calling(model, "reading its parameters"):
                walker = self._parameters(model, parameters, ("walker",))
            if walker is None:
                return None
            check_walker(walker)
        except ProblemError as error:
            self._fault(("walker",), str(error))
            return None
        return walker

    def _control(self, walker: type[Walker] | None) -> ControlSpec | None:
        data, path = self._data.get("control", {"type": "none"}), ("control", "type")
        if not isinstance(data, Mapping) or "type" not in data:
            self._fault(path, f"is missing; allowed: {', '.join(CONTROLS)}")
            return None
        kind = data["type"]
        if kind not in CONTROLS:
            self._fault(path, f"no control law is called {shown(kind)}{near_miss(kind, CONTROLS)}")
            return None
        if kind == "none":
            return read_section(NoControlSpec, data, ("control",), self._faults)
        if walker is not None and not walker.actuators:
            words = f"so that {kind} has nothing to act on; allowed: none"
            self._fault(path, f"{walker.model} has no actuators, {words}")
            return None
        if kind == "pd":
            law = self._parameters(PDSpec, self._with_reference(data), ("control",))
            if walker is not None and law is not None and isinstance(law.reference, CurveReference):
                self._faults += _point_faults(law.reference.curve, walker)
            return law
        if walker is None:
            return None
        torques = self._parameters(torques_section(walker), data, ("control",))
        return None if torques is None else ConstantTorqueSpec(torques=torques.model_dump(exclude={"type"}))

    def _with_reference(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """The data of a PD law with its reference read; where that failed another one stands in, to check the rest."""
        if "reference" not in data:
            return dict(data)
        reference, path = data["reference"], ("control", "reference")
        read: GaitReference | CurveReference | None
        if isinstance(reference, Mapping) and "curve" in reference:
            curve = read_section(Curve, reference["curve"], (*path, "curve"), self._faults)
            stand_in = curve or Curve.model_construct(degree=1, start="")
            read = read_section(CurveReference, {**reference, "curve": stand_in}, path, self._faults)
        else:
            read = read_section(GaitReference, reference, path, self._faults)
        return {**data, "reference": read or GaitReference.model_construct(gait="", beyond_end=BeyondEnd.HOLD)}

    def _parameters(self, model: type[Model], data: Mapping[str, Any], path: Key) -> Model | None:
        """A section in which numbers may be free; a freed number has its guess."""
        freed = {key: data[key] for key in model.model_fields if _is_free(data.get(key))}
        self._free |= {_dotted_key(path, key): UNREAD for key in freed}
        parts = {key: read_section(FreeSection, value, (*path, key), self._faults) for key, value in freed.items()}
        unknowns = {key: part for key, part in parts.items() if part is not None}
        own: list[Fault] = []
        plain = {**data, **{key: part.guess for key, part in unknowns.items()}}
        section = read_section(model, plain, path, own)
        for fault in own:
            key = fault.path[len(path)] if len(fault.path) > len(path) else None
            if key in unknowns:
                self._fault((*fault.path, "guess"), fault.message)
            elif key not in freed:  # what is wrong with the mapping of an unknown has been said
                self._faults.append(fault)
        if section is None:
            return None
        for name, part in unknowns.items():
            span = self._bounds(section, plain, part, (*path, name))
            if span is not None:
                self._free[_dotted_key(path, name)] = span
        return section

    def _bounds(self, section: BaseModel, plain: Mapping[str, Any], part: FreeSection, path: Key) -> Free | None:
        key, guess = str(path[-1]), getattr(section, str(path[-1]))
        if not isinstance(guess, float):
            self._fault(path, "cannot be free: only a real number can be an unknown; give a value")
            return None
        bounds = []
        for index, bound in enumerate(part.free):
            own: list[Fault] = []
            other = read_section(type(section), {**plain, key: bound}, (), own)
            self._faults += [Fault((*path, "free", index), fault.message) for fault in own]
            bounds += [] if other is None else [getattr(other, key)]
        if len(bounds) < 2:
            return None
        lower, upper = bounds
        if lower >= upper:
            words = f"[{lower:g}, {upper:g}] needs lo < hi; for a fixed value, give a number"
            self._fault((*path, "free"), f"is empty: {words}")
        elif not lower <= guess <= upper:
            self._fault((*path, "guess"), f"{guess:g} is outside of its bounds [{lower:g}, {upper:g}]")
        return Free(lower=lower, upper=upper, guess=guess)


def _point_faults(curve: Curve, walker: type[Walker]) -> Iterator[Fault]:
    """Whether the control points are those of the walker's tracked joints, as many as the degree takes, in bounds."""
    if curve.points is None:
        return
    path: Key = ("control", "reference", "curve", "points")
    if set(curve.points) != set(walker.tracked):
        tracked = ", ".join(walker.tracked)
        yield Fault(path, f"are given for {', '.join(curve.points) or 'no joint'}; the tracked joints are {tracked}")
        return
    for name, points in curve.points.items():
        if len(points) != curve.degree + 1:
            message = f"{len(points)} control points, but a curve of degree {curve.degree} has {curve.degree + 1}"
            yield Fault((*path, name), message)
        yield from (
            Fault((*path, name, k), f"{point:g} is outside of within = {curve.within:g}")
            for k, point in enumerate(points)
            if abs(point) > curve.within
        )


def _is_free(value: object) -> bool:
    return isinstance(value, Mapping) and "free" in value


def _dotted_key(path: Key, key: str) -> str:
    return ".".join(map(str, (*path, key)))


SUFFIXES = (".yaml", ".yml")


def problem_names() -> tuple[str, ...]:
    """Every name that ``load_problem`` knows, in alphabetical order."""
    return tuple(sorted(path.stem for path in _folder().glob("*.yaml")))


def find_problem(name_or_path: str | Path, folder: Path | None = None) -> Path:
    """The file of a named problem, or the path itself, taken relative to ``folder``.

    A path is recognised by its suffix or by a separator.

    Raises
    ------
    UnknownNameError
        If it is neither a name nor looks like a path.
    """
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or text.endswith(SUFFIXES) or "/" in text or "\\" in text:
        return (folder or Path()) / name_or_path
    names = problem_names()
    if text not in names:
        raise UnknownNameError(
            f"no problem is called {text!r}{near_miss(text, names)} (or give the path of a .yaml file)"
        )
    return _folder() / f"{text}.yaml"


def _folder() -> Path:
    shipped = Path(str(files("gaitopt.problem"))) / "catalogue"
    return shipped if shipped.is_dir() else Path(__file__).resolve().parents[2] / "problems"


FOLLOWED_FROM = "followed_from"
"""Key of a resolved problem: the file's values of the parameters that were changed."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Problem(ProblemStatement):
    """The statement of one gait, validated, with where it comes from.

    Attributes
    ----------
    reference : the problem whose gait the control tracks or its curve starts from.
    path, text : where it came from, verbatim; overrides are not in the text.
    origin : the problem with an open sequence that this one answers, under whose name and digest it is kept.
    file : the problem that the file states, before ``replace`` changed it; None for that problem itself.
    place : where each of its values was given: a line of the file, or an override.
    """

    reference: "Problem | None" = None
    path: Path | None = None
    text: str = ""
    place: Place = field(compare=False, repr=False)
    origin: "Problem | None" = None
    file: "Problem | None" = None

    def __hash__(self) -> int:
        return hash(self.digest)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is unusual about its numbers, one line each with its place; empty for most problems."""
        return tuple(fault_lines(remarks(self), self.place))

    def reference_problem(self) -> "Problem | None":
        """The problem whose gait the control tracks or its curve starts from; never touched by ``replace``."""
        return self.reference

    @property
    def followed_from(self) -> "Problem | None":
        """The file's problem, where only values of continuous parameters differ from it; otherwise None.

        The gait of this problem is then the file's own gait, followed from the file's values to these.
        """
        if self.file is None or self.is_open or self.is_design or self.origin is not None:
            return None
        if self.reference != self.file.reference or type(self.walker) is not type(self.file.walker):
            return None
        values, changed = self.parameters, changed_values(problem_data(self.file), problem_data(self))
        continuous = [key for key in changed if type(values.get(key)) is float]
        return self.file if changed and len(continuous) == len(changed) else None

    def from_guess(self) -> "Problem":
        """The same problem, to be solved from its guess: ``solve`` then does not follow the gait of the file."""
        return replace(self, file=None)

    def replace(self, overrides: Mapping[str, object], *, label: str = "") -> "Problem":
        """The problem with some values changed, validated as a whole.

        Where only values of continuous parameters change, ``solve`` follows the gait of the unchanged problem to the
        new values. With another guess, mode sequence or structure it starts from the guess.

        Parameters
        ----------
        overrides : values as in the file by dotted key, for instance ``{"friction": 0.16, "walker.slope": "2 deg"}``.
        label : stands before the keys in messages: the option that sets them, for instance.

        Raises
        ------
        ProblemError
            If the result is wrong; each line names the override.
        """
        faults: list[Fault] = []
        data, place = apply_overrides(problem_data(self), overrides, faults, label)
        raise_faults(faults, place)
        known = {} if self.reference is None else {reference_name(self.control)[0]: self.reference}
        origin = _Origin(walkers=(type(self.walker),), path=self.path)
        changed = _build(data, place, faults, origin, text=self.text, known=known)
        file = self if self.file is None else self.file
        same = problem_data(changed) == problem_data(file) and changed.reference == file.reference
        return replace(changed, place=ChangedPlace(self.place, place), file=None if same else file)

    def with_guess(self, gait: Mapping[str, Any], parameters: Mapping[str, float] | None = None) -> "Problem":
        """The problem with a known gait as its first guess; the modes stay those of the problem.

        Durations are taken where the phases are the same, and the slip velocity where the impact is.

        Parameters
        ----------
        gait : record of a gait of the same walker model, see ``Gait.to_record``.
        parameters : of that gait by dotted key, control points of a curve as ``control.reference.JOINT.K``; they are
            the guesses of free numbers and curves. Those of the record if left out.

        Raises
        ------
        ProblemError
            As ``replace``.
        """
        values = gait.get("parameters", {}) if parameters is None else parameters
        same_impact = gait["impact"] == self.cycle.impact
        names = self.walker.section_names(slipping=self.cycle.impact.slips)
        state = {name: gait["state"][name] for name in names if same_impact or name != "dx"}
        same_phases = [Mode.from_record(phase) for phase in gait["phases"]] == list(self.cycle.phases)
        changes: dict[str, object] = {f"gait.guess.state.{name}": value for name, value in state.items()}
        if same_phases:
            changes["gait.guess.durations"] = [phase["duration"] for phase in gait["phases"]]
        points = self._curve_guess(values)
        changes |= {"control.reference.curve.points": points} if points else {}
        return self.replace(changes | self.free_guesses(values))

    def with_gait(self, gait: Mapping[str, Any]) -> "Problem":
        """The problem with the modes of a known gait and its motion as the guess; raises as ``replace``.

        Parameters
        ----------
        gait : record of a gait, or of a candidate: its steps or phases and impact, ``state`` and ``parameters``.
        """
        cycle = Cycle.from_record(gait)
        phases = [phase for step in gait.get("steps", (gait,)) for phase in step["phases"]]
        durations = [phase["duration"] for phase in phases]
        return self.with_modes(cycle, gait["state"], durations, gait.get("parameters", {}))

    def with_modes(
        self,
        cycle: Cycle,
        state: Mapping[str, float],
        durations: Sequence[float] | None = None,
        parameters: Mapping[str, float] | None = None,
    ) -> "Problem":
        """The problem with another mode sequence; raises as ``replace``.

        Parameters
        ----------
        state : guess of the state just after the last impact by name; only section coordinates are used.
        durations : guess of the phases [s]; those of the problem if left out, where the numbers of phases are the same.
        parameters : guesses of free numbers by dotted key.
        """
        if durations is None and not self.is_open and _phase_numbers(cycle) == _phase_numbers(self.cycle):
            durations = self.guess.durations
        names = self.walker.section_names(slipping=cycle.impact.slips)
        guess: dict[str, Any] = {"state": {name: float(state[name]) for name in names}}
        guess |= {} if durations is None else {"durations": list(durations)}
        return self.replace({"gait": {**cycle_data(cycle), "guess": guess}, **self.free_guesses(parameters or {})})

    def free_guesses(self, values: Mapping[str, float]) -> dict[str, object]:
        """Overrides that make known values the guesses of the free numbers, clipped to their bounds."""
        return {
            key: {"free": [free.lower, free.upper], "guess": float(np.clip(values[key], free.lower, free.upper))}
            for key, free in self.free.items()
            if key in values
        }

    def with_fixed(self, values: Mapping[str, float]) -> "Problem":
        """The problem with its free numbers fixed at values by dotted key, without objective and constraints."""
        plain = replace(self, free={}, objective={}, constraints={})
        return plain.replace({key: values[key] for key in self.free})

    def _curve_guess(self, values: Mapping[str, float]) -> dict[str, list[float]]:
        """Control points of a free curve, clipped to its bound; empty where the values have not all of them."""
        if not isinstance(self.control, PDSpec) or not isinstance(self.control.reference, CurveReference):
            return {}
        curve = self.control.reference.curve
        keys = {
            name: [f"control.reference.{name}.{k}" for k in range(curve.degree + 1)] for name in self.walker.tracked
        }
        if not all(key in values for row in keys.values() for key in row):
            return {}
        return {
            name: [float(np.clip(values[key], -curve.within, curve.within)) for key in row]
            for name, row in keys.items()
        }

    def objection(self, key: str, value: float) -> str | None:
        """Why a parameter cannot have a value, independently of all others; None if it can."""
        faults: list[Fault] = []
        data, place = apply_overrides(problem_data(self), {key: value}, faults)
        assemble(data, {self.walker.model: type(self.walker)}, faults)
        return next((fault.message for fault in faults if fault.path == place.keys[key]), None)

    def resolved(self) -> dict[str, Any]:
        """The whole problem in SI as JSON-able data; in a reference the other problem stands in place of its name.

        Where the gait of the file is followed, ``followed_from`` has the file's values of the changed parameters.
        """
        if self.origin is not None:
            return self.origin.resolved()
        data = problem_data(self)
        if self.start is not None:
            data["gait"]["guess"]["state"] = dict(self.start.state)
        if self.reference is not None:
            reference = data["control"]["reference"]
            holder, key = (reference["curve"], "start") if "curve" in reference else (reference, "gait")
            holder[key] = self.reference.resolved()
        if self.followed_from is not None:
            before = self.followed_from.parameters
            changed = {key: before[key] for key, value in self.parameters.items() if value != before[key]}
            data[FOLLOWED_FROM] = changed
        return data

    @property
    def digest(self) -> str:
        """SHA-256 of everything that determines the gait, and of the name; the texts ``about`` do not count.

        That is the resolved problem: all values, modes and guess, the reference with its own, and the file's values of
        the parameters that were changed, where the gait is followed from there.
        """
        return digest_of(self.resolved())

    @property
    def hash8(self) -> str:
        """The first eight digits of the digest."""
        return self.digest[:8]


def _phase_numbers(cycle: Cycle) -> list[int]:
    return [len(step.phases) for step in cycle.steps]


def load_problem(name_or_path: str | Path, *, walkers: Sequence[type[Walker]] = ()) -> Problem:
    """The problem of a name in the catalogue, or of a file.

    Parameters
    ----------
    name_or_path : a name out of ``problem_names()``, or the path of a .yaml file.
    walkers : walkers that the file may name besides those that are registered.

    Raises
    ------
    UnknownNameError
        If no problem has this name.
    ProblemError
        If the file or what it says is wrong: one line ``file:line:column key: ...`` per fault.
    """
    return _load(name_or_path, _Origin(walkers=_listed(walkers)))


def parse_problem(text: str, path: Path | None = None, *, walkers: Sequence[type[Walker]] = ()) -> Problem:
    """The problem stated by a YAML text; ``path`` names it in messages, and references are relative to it.

    Raises
    ------
    ProblemError
        As ``load_problem``.
    """
    return _parse(text, _Origin(walkers=_listed(walkers), path=path))


def restore_problem(record: Mapping[str, Any], *, walkers: Sequence[type[Walker]] = ()) -> Problem:
    """The problem that ``Problem.resolved`` has written, references included.

    Raises
    ------
    ProblemError
        If the record is wrong.
    """
    data = deepcopy(dict(record))
    before = data.pop(FOLLOWED_FROM, None)
    place = FilePlace(f"record of {shown(data.get('name'))}", {(): (1, 1)})
    known: dict[str, Problem] = {}
    control = data.get("control")
    reference = control.get("reference") if isinstance(control, Mapping) else None
    curve = reference.get("curve") if isinstance(reference, Mapping) else None
    for holder, key in ((reference, "gait"), (curve, "start")):
        if isinstance(holder, dict) and isinstance(holder.get(key), Mapping):
            nested = restore_problem(holder[key], walkers=walkers)
            known, holder[key] = {nested.name: nested}, nested.name
    problem = _build(data, place, [], _Origin(walkers=_listed(walkers)), known=known)
    return problem if before is None else replace(problem, file=problem.replace(before).from_guess())


@dataclass(frozen=True, slots=True, kw_only=True)
class _Origin:
    """Where a problem is read from: its file, those that refer to it one after the other, and further walkers."""

    walkers: tuple[type[Walker], ...]
    path: Path | None = None
    chain: tuple[Path, ...] = ()


def _listed(walkers: Sequence[type[Walker]]) -> tuple[type[Walker], ...]:
    """Classes that a caller passes.

    Raises
    ------
    ProblemError
        If they are not in a list or tuple.
    """
    if not isinstance(walkers, list | tuple):
        raise ProblemError(f"walkers is {shown(walkers)}, but must be a list of classes: walkers=[MyWalker]")
    return tuple(walkers)


def _by_model(walkers: Sequence[type[Walker]]) -> dict[str, type[Walker]]:
    """Classes that a caller passes, by the names of their models.

    Raises
    ------
    ProblemError
        If one of them is no well-formed class of a walker, or two have one name.
    """
    named: dict[str, type[Walker]] = {}
    for walker in walkers:
        try:
            check_class(walker)
        except ProblemError as error:
            raise ProblemError(f"walkers: {error}") from error
        if named.setdefault(walker.model, walker) is not walker:
            both = f"{named[walker.model].__name__} and {walker.__name__}"
            raise ProblemError(f"walkers: {both} are both called {walker.model!r}: give each model a name of its own")
    return named


def _load(name_or_path: str | Path, origin: _Origin) -> Problem:
    path = find_problem(name_or_path, None if origin.path is None else origin.path.parent)
    text = read_text(path)
    chain = origin.chain if origin.path is None else (*origin.chain, origin.path.resolve())
    if path.resolve() in chain:
        raise ProblemError(f"references run in a circle: {' -> '.join(file.stem for file in (*chain, path))}")
    return _parse(text, _Origin(walkers=origin.walkers, path=path, chain=chain))


def _parse(text: str, origin: _Origin) -> Problem:
    name = "problem" if origin.path is None else str(origin.path)
    source = parse_source(text, name)
    place = FilePlace(name, source.marks)
    faults = list(source.faults)
    if not isinstance(source.data, Mapping):
        faults.append(Fault((), "the file holds no mapping of keys; `gaitopt schema` describes a problem file"))
        raise_faults(faults, place)
    return _build(source.data, place, faults, origin, text=text)


def _build(
    data: Mapping[str, Any],
    place: Place,
    faults: list[Fault],
    origin: _Origin,
    *,
    text: str = "",
    known: Mapping[str, Problem] | None = None,
) -> Problem:
    """A problem from data, or all that is wrong with them; ``known`` are references that need no loading, by name."""
    walkers = {**registered_walkers(), **_by_model(origin.walkers)}
    fields = assemble(data, walkers, faults)
    name, key = reference_name(fields["control"])
    reference = None
    if name:
        try:
            reference = (known or {}).get(name) or _load(name, origin)
        except (UnknownNameError, ProblemError) as error:
            faults.append(Fault(key, f"the reference {shown(name)} cannot be used: {error}"))
    if reference and fields["walker"]:
        faults += [Fault(key, why) for why in unsuitable(name, reference, fields["walker"])]
    raise_faults(faults, place)
    problem = Problem(**fields, reference=reference, path=origin.path, text=text, place=place)
    raise_faults(impossible(problem), place)
    return problem
