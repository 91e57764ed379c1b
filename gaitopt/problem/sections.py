"""The sections of a problem file, one model per mapping: keys, units, ranges and meaning.

The same models validate a file and describe it to an editor. Sections that depend on the walker (its state, its
torques) are made from the walker's own names.
"""

from functools import lru_cache
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from gaitopt.mechanics.modes import ImpactLaw, Mode
from gaitopt.mechanics.ranges import Within, symmetric
from gaitopt.mechanics.units import Angle, Finite, NonNegative, Number
from gaitopt.mechanics.walker import Walker
from gaitopt.problem.section import DURATION, Duration, Section, section_model

MAX_STEPS = 64
"""Of a cycle; beyond that a walk is taken for irregular."""
MAX_PHASES = 64
"""Of one step: known gaits have up to five, and the equations grow with them."""
FRICTION = Within(usual=(0, 3))
DRAG = Within(unit="drag", possible=(0, 1e4), usual=(0, 100))
RATE = Within(unit="rate", possible=symmetric(100), usual=symmetric(5))
SLIP = Within(unit="speed", possible=symmetric(100), usual=symmetric(5))
POSITION = Within(unit="length", possible=symmetric(1000))
LENGTH = Within(unit="length", possible=symmetric(1))


class HeadSection(Section):
    """The keys at the top of a file that are not mappings."""

    name: Annotated[
        str,
        Field(
            pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
            max_length=80,
            description="name of the problem, also of its run folder: letters, digits, dot, dash and underscore",
        ),
    ]
    about: Annotated[str, Field(description="what the gait is, in a sentence")] = ""
    friction: Annotated[NonNegative, Field(le=1000, description="coefficient of friction mu"), FRICTION]
    impact_law: Annotated[
        ImpactLaw, Field(description="tangential law of a slipping impact: Coulomb friction, or no tangential impulse")
    ] = ImpactLaw.COULOMB


class FrictionCoefficients(Section):
    """Friction of a foot that sticks, and of one that slips: |f_t| <= mu_s f_n,  f_t = -s mu_k f_n - c dx."""

    static: Annotated[
        NonNegative, Field(le=1000, description="coefficient mu_s that bounds the force of a sticking foot"), FRICTION
    ]
    kinetic: Annotated[
        NonNegative, Field(le=1000, description="coefficient mu_k of a slipping foot, at most the static one"), FRICTION
    ]
    viscous: Annotated[NonNegative, Field(le=1e6, description="drag c of a slip besides that [N s/m]"), DRAG] = 0.0

    @model_validator(mode="after")
    def _static_is_larger(self) -> Self:
        if self.static < self.kinetic:
            raise ValueError(
                f"static = {self.static:g} is below kinetic = {self.kinetic:g}: "
                "a foot that sticks would then need less force to slip than it meets once it slips"
            )
        return self


class StepSection(Section):
    """The mode sequence of one step."""

    phases: Annotated[tuple[Mode, ...], Field(max_length=MAX_PHASES, description="modes of the stance foot in order")]
    impact: Annotated[Mode, Field(description="what the colliding foot does just after the impact that ends the step")]


class GaitSection(StepSection):
    """A gait that repeats itself after one step, and a first guess."""

    guess: Annotated[dict[str, Any], Field(description="first guess of state and durations")]


class CycleSection(Section):
    """A gait that repeats itself after several steps, and a first guess."""

    steps: Annotated[
        tuple[StepSection, ...], Field(min_length=1, max_length=MAX_STEPS, description="the steps in order")
    ]
    guess: Annotated[dict[str, Any], Field(description="first guess of state and durations of all phases")]


class OpenGaitSection(Section):
    """A gait whose mode sequence is to be found."""

    phases: Annotated[Literal["auto"], Field(description="the modes are to be found")]
    impact: Annotated[
        Mode | None, Field(description="what the colliding foot does just after the impact; any mode if left out")
    ] = None
    steps: Annotated[int, Field(ge=1, le=MAX_STEPS, strict=True, description="steps of a cycle, at most")] = 1
    guess: Annotated[dict[str, Any] | None, Field(description="state near which a gait is preferred")] = None


class GuessSection(Section):
    """First guess: state after impact, and phase durations."""

    state: Annotated[
        dict[str, Any], Field(description="state just after impact; what is left out follows from the section")
    ]
    durations: Annotated[
        tuple[Duration, ...] | None, Field(description="of the phases [s], one each; optional"), DURATION
    ] = None


class FreeSection(Section):
    """An unknown in place of a number."""

    free: Annotated[list[Any], Field(min_length=2, max_length=2, description="bounds [lo, hi] of the unknown")]
    guess: Annotated[Any, Field(description="first guess, within the bounds")]


class RangeSection(Section):
    """Bounds of a scalar, in SI."""

    min: Annotated[Number | None, Field(description="lower bound, none if left out")] = None
    max: Annotated[Number | None, Field(description="upper bound, none if left out")] = None


class AngleRangeSection(RangeSection):
    """Bounds of an angle."""

    min: Annotated[Angle | None, Field(description="lower bound [rad], none if left out")] = None
    max: Annotated[Angle | None, Field(description="upper bound [rad], none if left out")] = None


SECTION_KEYS = ("walker", "control", "gait", "objective", "constraints")
"""Keys of a file besides those of its head."""


@lru_cache
def state_section(walker: type[Walker]) -> type[Section]:
    """State of a walker: one optional key per name."""

    def entry(name: str) -> Any:
        if name in {*walker.shape} - {*walker.lengths}:
            largest = walker.largest_angle
            return Annotated[Angle, Field(ge=-largest, le=largest, description="[rad]")]
        known = {"x": ("[m]", POSITION), "dx": ("slip velocity [m/s]", SLIP)}
        known |= dict.fromkeys((*walker.lengths, "y"), ("[m]", LENGTH))
        known |= dict.fromkeys((*(f"d{length}" for length in walker.lengths), "dy"), ("[m/s]", SLIP))
        words, within = known.get(name, ("[rad/s]", RATE))
        return Annotated[Finite, Field(description=words), within]

    return section_model("StateSection", {name: entry(name) for name in walker.state_names()}, required=False)
