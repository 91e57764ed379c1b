"""The problem statement, which says completely and in SI units which gait is required, and the same as plain data.

``problem_data`` writes data in the layout of a file, from which the same problem is read again; ``override`` changes
them by dotted key, and their SHA-256 identifies the problem.
"""

import hashlib
import json
import math
import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any, cast

from gaitopt.display import Tabulated
from gaitopt.errors import ProblemError
from gaitopt.model.control import Control
from gaitopt.model.cycle import BREAKPOINT, UNTIL, Cycle
from gaitopt.model.friction import COULOMB, STATIC_KINETIC, ContactFriction, Friction, ImpactLaw, shared_friction
from gaitopt.model.modes import Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN, Section, has_stated_sections, section_of
from gaitopt.model.units import Free, parse_count
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import Fault, Key, OverridePlace, dotted, shown
from gaitopt.problem.schema import OPEN, SIMULATION_KEYS, Aggregate, FirstGuessSection, FrictionCoefficients


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """A constraint on a scalar, in SI units.

    A missing bound is -inf or inf; the bounds of an equality are equal.
    """

    minimum: float
    maximum: float

    @property
    def is_equality(self) -> bool:
        """Whether the scalar has one value."""
        return self.minimum == self.maximum


@dataclass(frozen=True, slots=True, kw_only=True)
class Over:
    """The range of a parameter over which a design is a stable gait and meets its constraints.

    Attributes
    ----------
    key : dotted key of the parameter; the problem's own value lies in the range.
    lower, upper : ends of the range, in SI.
    aggregate : what is minimised of the objective's values over the range.
    at : the value of the parameter at which the objective counts, if only one does; None for the problem's own value.
    """

    key: str
    lower: float
    upper: float
    aggregate: Aggregate = Aggregate.AT
    at: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenSequence:
    """A mode sequence that is to be found.

    Attributes
    ----------
    impact : mode just after the impact, if it is known.
    steps : largest number of steps of a cycle.
    stated : whether the problem states a gait; without one it can only be simulated.
    """

    impact: Mode | None = None
    steps: int = 1
    stated: bool = True

    def __str__(self) -> str:
        return f"to be found; {self.impact or 'to be found'}" if self.stated else "no gait, for simulations"


@dataclass(frozen=True, slots=True, kw_only=True)
class Until:
    """The end of a simulation: a time, or a number of steps or events, whichever comes first.

    Attributes
    ----------
    time : since the start [s].
    steps : number of steps.
    events : number of events: changes of the mode and impacts.

    Raises
    ------
    ProblemError
        If all are missing, or one is not positive, or the number of steps or events is not whole.
    """

    time: float | None = None
    steps: int | None = None
    events: int | None = None

    def __post_init__(self) -> None:
        if not self.data:
            raise ProblemError("until: is empty; give time=SECONDS, steps=N or events=N")
        for name, value in self.data.items():
            kind: Any = Real if name == "time" else Integral
            if not isinstance(value, kind) or isinstance(value, bool):
                raise ProblemError(
                    f"until.{name}: {shown(value)} is not a {'number' if name == 'time' else 'whole number'}"
                )
            if not 0 < value < math.inf:
                raise ProblemError(f"until.{name}: {value:g} is not positive and finite")

    @property
    def data(self) -> dict[str, Any]:
        """The data as in a problem file."""
        known = {"time": self.time, "steps": self.steps, "events": self.events}
        return {key: value for key, value in known.items() if value is not None}


@dataclass(frozen=True, slots=True, kw_only=True)
class Guess:
    """First guess of a gait.

    Attributes
    ----------
    state : the whole state just after the impact by name [rad, m, rad/s, m/s].
    durations : durations of the phases [s]; None if the solver has to estimate them.
    first : the guess without a state in the file from which the state follows, if there is one; the guessed motion is
        then straight between the postures.
    whole : whether the state is where a simulation starts, so that it need not be on the section.
    """

    state: Mapping[str, float]
    durations: tuple[float, ...] | None
    first: FirstGuessSection | None = None
    whole: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ProblemStatement(Tabulated):
    """The requirements on one gait. ``Problem`` adds the source, loading and changes.

    Attributes
    ----------
    name, about : name of the problem, and a description in a sentence.
    walker : the walker with its parameters. In walker, friction and control, a free parameter has the value of its
        guess.
    friction : coefficient of friction mu, or static and kinetic coefficient and drag; or either for every contact by
        name.
    impact_law : tangential law of a slipping impact.
    control : control law of the motors.
    modes : phases and impacts of the steps after which the gait repeats itself, or an open sequence.
    start : first guess of the gait with a complete state; None only if the sequence is open.
    free : the unknown parameters by dotted key.
    objective : weights of the scalars whose sum is minimised; empty if there is none.
    constraints : ranges of scalars by name.
    over : the range of a parameter over which a design holds; None if it is for the problem's own values only.
    cycle_end : what ends a cycle: ``touchdown``, ``clock`` or the name of a margin.
    until : the end of a simulation, if the problem states it; only without a gait.
    """

    name: str
    about: str = ""
    walker: Walker
    friction: float | FrictionCoefficients | Mapping[str, float | FrictionCoefficients]
    impact_law: ImpactLaw = ImpactLaw.COULOMB
    control: Control
    modes: Cycle | OpenSequence
    start: Guess | None
    free: Mapping[str, Free[float]] = field(default_factory=dict)
    objective: Mapping[str, float] = field(default_factory=dict)
    constraints: Mapping[str, Range] = field(default_factory=dict)
    over: Over | None = None
    cycle_end: str = TOUCHDOWN
    until: Until | None = None

    def __repr__(self) -> str:
        return f"<Problem {self.name}: {self.walker.model}, {self.modes}>"

    @property
    def is_open(self) -> bool:
        """Whether the mode sequence is open."""
        return isinstance(self.modes, OpenSequence)

    @property
    def has_gait(self) -> bool:
        """Whether the problem states a gait; without one it can only be simulated."""
        return not isinstance(self.modes, OpenSequence) or self.modes.stated

    @property
    def is_design(self) -> bool:
        """Whether numbers of the problem, or control points of its reference, are unknowns."""
        return bool(self.free) or bool(self.control.unknowns(type(self.walker)))

    @property
    def cycle(self) -> Cycle:
        """The mode sequences of the steps after which the gait repeats itself.

        Raises
        ------
        ProblemError
            If they are open.
        """
        if isinstance(self.modes, OpenSequence):
            raise self._open_error()
        return self.modes

    @property
    def guess(self) -> Guess:
        """The first guess.

        Raises
        ------
        ProblemError
            If the sequence is open and there is none.
        """
        if self.start is None:
            raise self._open_error()
        return self.start

    @property
    def parameters(self) -> dict[str, float]:
        """Every scalar parameter by dotted key, in a fixed order: walker, friction, control."""
        walker = {f"walker.{key}": value for key, value in self.walker if type(value) in (int, float)}
        of_law = self.control.parameters | self.control.feedback_parameters
        control = {f"control.{key}": value for key, value in of_law.items()}
        return {**walker, **_flat("friction", self.friction_data), **control}

    @property
    def static_friction(self) -> float:
        """The largest coefficient that bounds the force of a sticking foot."""
        laws = self.friction.values() if isinstance(self.friction, Mapping) else (self.friction,)
        return max(law if isinstance(law, float) else law.static for law in laws)

    @property
    def friction_law(self) -> Friction | ContactFriction:
        """The friction law of all contacts, or that of every named contact, with the keys of its coefficients."""
        if not isinstance(self.friction, Mapping):
            return shared_friction(
                self.walker.labels(), COULOMB if isinstance(self.friction, float) else STATIC_KINETIC
            )
        contacts = self.walker.contact_names()
        keys = {name: f"friction.{name}" for name in contacts}
        laws = (
            Friction(keys[name], keys[name])
            if isinstance(self.friction[name], float)
            else Friction(*(f"{keys[name]}.{kind}" for kind in FrictionCoefficients.model_fields))
            for name in contacts
        )
        return ContactFriction(tuple(zip(contacts, laws, strict=True)))

    @property
    def friction_data(self) -> float | dict[str, Any]:
        """The coefficient or the coefficients of friction, as in a file."""
        if isinstance(self.friction, Mapping):
            laws = self.friction.items()
            return {name: law if isinstance(law, float) else law.model_dump() for name, law in laws}
        return self.friction if isinstance(self.friction, float) else self.friction.model_dump()

    @property
    def section(self) -> Section | None:
        """The section of the gait; with open modes that of a sticking impact, or None if it follows from the modes."""
        if self.is_open and not has_stated_sections(type(self.walker), self.cycle_end):
            return None
        before, after = (Mode.STICK, Mode.STICK) if self.is_open else (self.cycle.phases[-1], self.cycle.impact)
        return section_of(type(self.walker), before, after, self.cycle_end)

    @property
    def map_section(self) -> Section:
        """The section from which any step starts. It has the slip velocity as a coordinate if the class states one.

        Raises
        ------
        ProblemError
            If the section follows from modes that are open.
        """
        if self.section is None:
            raise self._open_error()
        return self.section.every_step

    @property
    def section_names(self) -> tuple[str, ...]:
        """Names of the section coordinates of the gait; empty if they follow from modes that are open."""
        return () if self.section is None else self.section.names

    def check_gait(self) -> None:
        """Check that the problem states a gait.

        Raises
        ------
        ProblemError
            If it does not.
        """
        if not self.has_gait:
            remedy = "give its phases, or phases: auto"
            raise ProblemError(f"{self.name}: gait: is missing; only simulate works without one; {remedy}")

    def _open_error(self) -> ProblemError:
        self.check_gait()
        return ProblemError(
            f"{self.name}: its mode sequence is open (gait.phases: auto): `gaitopt find` lists the gaits; "
            "give the phases and the impact of one of them"
        )


def problem_data(problem: ProblemStatement) -> dict[str, Any]:
    """JSON data from which the same problem is read; they name a reference.

    The guess contains section coordinates only, so that the other coordinates follow when these change.
    """
    modes, start = problem.modes, problem.start
    if isinstance(modes, OpenSequence):
        gait: dict[str, Any] = {"phases": OPEN}
        gait |= {} if modes.impact is None else {"impact": modes.impact.words}
        gait |= {} if modes.steps == 1 else {"steps": modes.steps}
    else:
        gait = cycle_data(modes)
    if problem.cycle_end != TOUCHDOWN:
        gait["section"] = CLOCK if problem.cycle_end == CLOCK else {"margin": problem.cycle_end}
    if start is not None and problem.has_gait:
        names = guessed_names(type(problem.walker), modes, problem.cycle_end, start.state["dx"])
        gait["guess"] = {"state": {name: start.state[name] for name in dict.fromkeys((*names, "x"))}}
        gait["guess"] |= {} if start.durations is None else {"durations": list(start.durations)}
        if start.first is not None:
            gait["guess"] = start.first.model_dump(mode="json", exclude_none=True)
    data: dict[str, Any] = {
        "name": problem.name,
        "about": problem.about,
        "walker": {**problem.walker.statement(), **problem.walker.model_dump(mode="json")},
        "friction": problem.friction_data,
        "impact_law": str(problem.impact_law),
        "control": problem.control.record,
        **({"gait": gait} if problem.has_gait else _simulation_data(problem)),
    }
    for key, free in problem.free.items():
        *above, name = key.split(".")
        section = data
        for group in above:
            section = section[group]
        section[name] = free.record
    over, objective = problem.over, dict(problem.objective)
    if objective:
        aggregate = Aggregate.AT if over is None else over.aggregate
        data["objective"] = objective if aggregate is Aggregate.AT else {aggregate.value: objective}
    if over is not None:
        data["over"] = {over.key: [over.lower, over.upper]}
        data |= {} if over.at is None else {"at": {over.key: over.at}}
    if problem.constraints:
        data["constraints"] = {
            name: {key: value for key, value in (("min", span.minimum), ("max", span.maximum)) if math.isfinite(value)}
            for name, span in problem.constraints.items()
        }
    return data


def _simulation_data(problem: ProblemStatement) -> dict[str, Any]:
    """Start and end of a simulation, as in a file."""
    data: dict[str, Any] = {}
    if problem.start is not None:
        state = problem.start.state
        names = guessed_names(type(problem.walker), problem.modes, problem.cycle_end, state["dx"])
        data["state"] = {name: state[name] for name in (state if problem.start.whole else names)}
    return data | ({} if problem.until is None else {"until": problem.until.data})


def guessed_names(
    walker: type[Walker], modes: Cycle | OpenSequence, cycle_end: str, dx: float = 0.0
) -> tuple[str, ...]:
    """Names of the coordinates of a guess, from which the others follow; ``dx`` is its slip velocity [m/s]."""
    if isinstance(modes, Cycle):
        return section_of(walker, modes.phases[-1], modes.impact, cycle_end).defining_names
    stated = has_stated_sections(walker, cycle_end)
    return walker.section_names(slipping=dx != 0) if stated else walker.state_names()


def cycle_data(cycle: Cycle) -> dict[str, Any]:
    """Phases and impact of one step, or those of several steps under ``steps``.

    Timed phases are marked; they occur in results only.
    """
    steps = [
        {
            "phases": [
                {**mode.record, UNTIL: BREAKPOINT} if k in step.timed else mode.begun_by(landings.get(k))
                for k, mode in enumerate(step.phases)
            ],
            "impact": step.impact.words,
        }
        for step, landings in ((step, dict(step.landings)) for step in cycle.steps)
    ]
    return steps[0] if len(steps) == 1 else {"steps": steps}


def _flat(key: str, data: Any) -> dict[str, float]:
    """Numbers of nested mappings by dotted key."""
    if not isinstance(data, Mapping):
        return {key: data}
    return {path: number for name, value in data.items() for path, number in _flat(f"{key}.{name}", value).items()}


def reference_keys(data: Mapping[str, Any]) -> list[tuple[Any, str]]:
    """Sections and keys under which the data of a problem, valid or not, name another problem or contain its data."""
    control = data.get("control")
    reference = control.get("reference") if isinstance(control, Mapping) else None
    curve = reference.get("curve") if isinstance(reference, Mapping) else None
    places = ((reference, "gait"), (curve, "start"))
    return [(section, key) for section, key in places if isinstance(section, Mapping) and key in section]


def file_entries(data: Mapping[str, Any]) -> list[tuple[Key, Any]]:
    """Paths and entries of the data of a problem, valid or not, that name a robot's file or a table, or contain it."""
    walker, control = data.get("walker"), data.get("control")
    sections: list[tuple[Key, Any]] = [(("walker", "urdf"), walker)]
    if isinstance(control, dict):
        sections += [(("control", key, "table"), entry) for key, entry in control.items()]
    return [
        (path, section[path[-1]]) for path, section in sections if isinstance(section, Mapping) and path[-1] in section
    ]


def digest_of(resolved: Mapping[str, Any]) -> str:
    """The SHA-256 of resolved data without their texts ``about``."""
    canonical = json.dumps(_without_about(resolved), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def _without_about(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {key: _without_about(value) for key, value in data.items() if key != "about"}
    return data


def override(
    data: dict[str, Any], overrides: Mapping[str, object], faults: list[Fault], label: str = ""
) -> OverridePlace:
    """Set values in the data of a problem by dotted key, and return the keys by which faults name them.

    Dotted keys are friction, walker.slope, gait.guess.state.theta1, constraints.speed.min, and so on. A change of the
    mode sequence removes what no longer applies in the gait and its first guess, unless it is set too: durations if the
    number of phases changes, the slip velocity if the impact sticks, impact and durations if the sequence opens.

    Parameters
    ----------
    data : the result of ``problem_data``; changed in place.
    overrides : values by dotted key.
    faults : faults of overrides that cannot be set are added to this list.
    label : text before the keys in messages.
    """
    before = data.get("gait", {})
    was_open, phase_counts = before.get("phases") == OPEN, _phase_counts(before)
    overridden = OverridePlace({key: _path(key, data) for key in overrides}, label)
    for key, value in overrides.items():
        _set(data, overridden.keys[key], value, faults)
    gait = data.get("gait")
    for key in SIMULATION_KEYS if gait is not None and not before else ():  # the problem gets a gait
        data.pop(key, None)
    if faults or not isinstance(gait, dict) or not isinstance(gait.get("guess"), dict):
        return overridden

    def is_set(path: Key) -> bool:
        return any(path[: len(key)] == key for key in overridden.keys.values())

    guess, is_open = gait["guess"], gait.get("phases") == OPEN
    if any(key[:3] == ("gait", "guess", "state") for key in overridden.keys.values()):
        for key in FirstGuessSection.model_fields:
            if not is_set(("gait", "guess", key)):
                guess.pop(key, None)
    replaced = {"steps": ("phases", "impact"), "phases": ("steps",)}  # one step and several exclude each other
    if is_open:
        replaced = {} if was_open else {"phases": ("impact", "steps")}
    for key, others in replaced.items():
        for other in others:
            if is_set(("gait", key)) and not is_set(("gait", other)):
                gait.pop(other, None)
    if is_open and not was_open:
        guess.pop("durations", None)
    if _phase_counts(gait) not in (None, phase_counts) and not is_set(("gait", "guess", "durations")):
        guess.pop("durations", None)
    last = next(iter(_steps(gait)[-1:]), None)
    sticks = isinstance(last, Mapping) and last.get("impact") == Mode.STICK
    if sticks and not is_set(("gait", "guess", "state", "dx")) and isinstance(guess.get("state"), dict):
        guess["state"].pop("dx", None)
    return overridden


def parameter_key(key: str) -> str:
    """The key of the parameter that is a control point, control.reference.JOINT.K, in place of its key in a file."""
    return re.sub(r"^(control\.[^.]+\.)bezier\.", r"\1", key)


def point_key(key: str) -> str:
    """The key of a control point in a file, control.reference.bezier.JOINT.K, in place of that of its parameter."""
    return re.sub(r"^(control\.[^.]+\.)", r"\1bezier.", key)


def _path(key: str, data: Mapping[str, Any]) -> Key:
    """The path that a dotted key means in some data.

    A name after ``constraints``, ``objective``, ``over`` or ``at`` may contain dots, such as state.dx. A control point
    has two keys, that of its parameter, control.reference.JOINT.K, and control.reference.bezier.JOINT.K.
    """
    first, *rest = key.split(".")
    if first not in ("constraints", "objective", "over", "at") or not rest:
        path, section = list[str | int](), cast(Any, data)
        for name in (first, *rest):
            if path[:-1] == ["control"] and isinstance(section, dict) and name not in section:
                points = section.get("bezier")
                if isinstance(points, dict) and name in points:
                    path, section = [*path, "bezier"], points
            index = parse_count(name)
            if isinstance(section, list) and index is not None and index < len(section):
                path.append(index)
                section = section[index]
            else:
                path.append(name)
                section = section.get(name) if isinstance(section, dict) else None
        return tuple(path)
    if first == "objective" and rest[0] in (Aggregate.WORST, Aggregate.MEAN) and len(rest) > 1:
        return (first, rest[0], ".".join(rest[1:]))
    end = rest[-1:] if first == "constraints" and rest[-1] in ("min", "max") and len(rest) > 1 else []
    return (first, ".".join(rest[: len(rest) - len(end)]), *end)


def _set(data: dict[str, Any], path: Key, value: object, faults: list[Fault]) -> None:
    """Set one value.

    If friction has a static and a kinetic coefficient that are equal, a single number sets both. If it is a single
    number, setting one of the two coefficients keeps the number as the other one.
    """
    friction = data["friction"] if path[0] == "friction" else None
    if isinstance(friction, int | float) and len(path) > 1 and path[1] not in FrictionCoefficients.model_fields:
        faults.append(Fault(path, "all contacts have one friction: set friction as a whole, {CONTACT: number, ...}"))
        return
    if isinstance(friction, int | float) and len(path) > 1:
        data["friction"] = {"static": friction, "kinetic": friction}
    elif isinstance(friction, dict) and "static" in friction and len(path) == 1 and isinstance(value, int | float):
        if friction["static"] == friction["kinetic"]:
            value = {**friction, "static": value, "kinetic": value}
        else:
            message = f"there are two coefficients, {shown(friction)}: set friction.static or friction.kinetic"
            faults.append(Fault(path, message))
    section: Any = data
    for depth, key in enumerate(path[:-1], start=1):
        section = section[key] if isinstance(key, int) else section.setdefault(key, {})
        if not isinstance(section, dict | list) or isinstance(section, list) is not isinstance(path[depth], int):
            one = f"name one of 0 to {len(section) - 1}, or " if isinstance(section, list) else ""
            has = f"{shown(section)} and has no {'such entry' if one else 'keys'}"
            faults.append(Fault(path, f"{dotted(path[:depth])} is {has}: {one}set it as a whole"))
            return
    section[path[-1]] = deepcopy(value)


def _steps(gait: Mapping[str, Any]) -> list[Any]:
    """The steps in the data of a gait, valid or not."""
    steps = gait.get("steps", [gait])
    return list(steps) if isinstance(steps, list | tuple) else []


def _phase_counts(gait: Mapping[str, Any]) -> list[int] | None:
    """Number of phases of every step; None where the data are not steps."""
    phases = [step.get("phases") if isinstance(step, Mapping) else None for step in _steps(gait)]
    counts = [len(p) for p in phases if isinstance(p, list | tuple)]
    return counts if len(counts) == len(phases) else None


def changed_values(before: Mapping[str, Any], after: Mapping[str, Any], above: str = "") -> list[str]:
    """Dotted keys whose values differ in the data of two problems; ``name`` and ``about`` do not count."""
    changed = []
    for key in dict.fromkeys([*before, *after]):
        one, other = before.get(key), after.get(key)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            changed += changed_values(one, other, f"{above}{key}.")
        elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
            ours, theirs = ({str(k): entry for k, entry in enumerate(values)} for values in (one, other))
            changed += changed_values(ours, theirs, parameter_key(f"{above}{key}."))
        elif one != other and (above or key not in ("name", "about")):
            changed.append(f"{above}{key}")
    return changed
