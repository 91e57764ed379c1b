"""A problem statement: what is required of a gait, complete and in SI, and the same as data in the layout of a file.

Data that ``problem_data`` writes are read as the same problem, and their SHA-256 identifies it.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gaitopt.display import Tabulated
from gaitopt.errors import ProblemError
from gaitopt.model.cycle import Cycle
from gaitopt.model.modes import ImpactLaw, Mode
from gaitopt.model.walker import Walker
from gaitopt.problem.schema import (
    OPEN,
    ConstantTorqueSpec,
    ControlSpec,
    CurveReference,
    FrictionCoefficients,
    PDSpec,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Free:
    """A parameter that is an unknown, in SI: its bounds and its first guess."""

    lower: float
    upper: float
    guess: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """A constraint on a scalar, in SI: -inf or inf where it is open, both equal for an equality."""

    minimum: float
    maximum: float


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenSequence:
    """An open mode sequence: its impact if that is known, and the largest number of steps of a cycle."""

    impact: Mode | None = None
    steps: int = 1

    def __str__(self) -> str:
        return f"to be found; {self.impact or 'to be found'}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Guess:
    """First guess of a gait.

    Attributes
    ----------
    state : the whole state just after the impact by name [rad, m, rad/s, m/s].
    durations : of the phases [s]; None where the solver estimates them.
    """

    state: Mapping[str, float]
    durations: tuple[float, ...] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ProblemStatement(Tabulated):
    """The statement of one gait.

    Attributes
    ----------
    name, about : from the file.
    walker : the walker with its parameters; a freed parameter has its guess, here and below.
    friction : coefficient of friction mu, or static and kinetic coefficient and drag.
    impact_law : tangential law of a slipping impact.
    control : what the motors do.
    modes : phases and impacts of the steps after which the gait repeats itself; or an open sequence.
    start : first guess of the gait, its state complete; None only where the sequence is open.
    free : the unknown parameters by dotted key.
    objective : weights of the scalars whose sum is minimised; empty if there is none.
    constraints : ranges of scalars by name.
    """

    name: str
    about: str = ""
    walker: Walker
    friction: float | FrictionCoefficients
    impact_law: ImpactLaw = ImpactLaw.COULOMB
    control: ControlSpec
    modes: Cycle | OpenSequence
    start: Guess | None
    free: Mapping[str, Free] = field(default_factory=dict)
    objective: Mapping[str, float] = field(default_factory=dict)
    constraints: Mapping[str, Range] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Problem {self.name}: {self.walker.model}, {self.modes}>"

    @property
    def is_open(self) -> bool:
        """Whether the mode sequence is open."""
        return isinstance(self.modes, OpenSequence)

    @property
    def is_design(self) -> bool:
        """Whether some of its numbers, or the control points of a reference, are unknowns."""
        reference = self.control.reference if isinstance(self.control, PDSpec) else None
        return bool(self.free) or isinstance(reference, CurveReference)

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
        scalars = self.control.model_dump(exclude={"type", "reference"})
        control = {f"control.{key}": value for key, value in scalars.get("torques", scalars).items()}
        numbers = self.friction_data
        friction = (
            {f"friction.{k}": v for k, v in numbers.items()} if isinstance(numbers, dict) else {"friction": numbers}
        )
        return {**walker, **friction, **control}

    @property
    def static_friction(self) -> float:
        """The coefficient that bounds the force of a sticking foot."""
        return self.friction if isinstance(self.friction, float) else self.friction.static

    @property
    def friction_data(self) -> float | dict[str, float]:
        """The coefficient of friction, or the coefficients by name, as in a file."""
        return self.friction if isinstance(self.friction, float) else self.friction.model_dump()

    def _open_error(self) -> ProblemError:
        return ProblemError(
            f"{self.name}: its mode sequence is open (gait.phases: auto): `gaitopt find` lists the gaits; "
            "give the phases and the impact of one of them"
        )


def problem_data(problem: ProblemStatement) -> dict[str, Any]:
    """JSON data that are read as the same problem; a reference is given by its name.

    The guessed state has only its section coordinates, so that the others follow when these change.
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


def digest_of(resolved: Mapping[str, Any]) -> str:
    """SHA-256 of resolved data, without the texts ``about``."""
    canonical = json.dumps(_without_about(resolved), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def _without_about(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {key: _without_about(value) for key, value in data.items() if key != "about"}
    return data
