"""What a problem says of a gait: walker, friction, control, modes, guess and unknowns, complete and in SI."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from gaitopt.display import Tabulated
from gaitopt.errors import ProblemError
from gaitopt.mechanics.cycle import Cycle
from gaitopt.mechanics.modes import ImpactLaw
from gaitopt.mechanics.walker import Walker
from gaitopt.problem.control_sections import ControlSpec, CurveReference, PDSpec
from gaitopt.problem.parts import Free, Guess, OpenSequence, Range
from gaitopt.problem.sections import FrictionCoefficients


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
    modes : those of the step, or of the steps, after which the gait repeats itself, and their impacts; or what is
        known of a sequence that is open.
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
        """Whether the mode sequence is to be found."""
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
        """Coefficient that bounds the force of a sticking foot."""
        return self.friction if isinstance(self.friction, float) else self.friction.static

    @property
    def friction_data(self) -> float | dict[str, float]:
        """The coefficient of friction, or the coefficients by name, as in a file."""
        return self.friction if isinstance(self.friction, float) else self.friction.model_dump()

    def _open_error(self) -> ProblemError:
        return ProblemError(
            f"{self.name}: its mode sequence is open (gait.phases: auto), and this needs one: `gaitopt find` lists the "
            "gaits that there are; give the phases and the impact of one of them"
        )
