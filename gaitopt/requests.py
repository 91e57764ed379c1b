"""The arguments of every verb besides its problem: one frozen request per verb, with types, defaults and bounds.

A field is declared here once. Its declaration determines

- the check of its value when a request is made: an ``ArgumentError`` names argument, value and allowed values;
- help, bounds and choices of the command's option, see ``cli.options.option``;
- how it enters the identity of stored work, see ``Request.identity``.

The plans of ``runs`` and the request of a continuation are such requests with a problem and a folder. The signatures of
library and commands repeat names, types and defaults, because editors look for them there; a test compares them.
Problem, grid, workers, run folder and progress are not part of any request.

Every command reads its options from here. Therefore only the standard library is imported.
"""

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import StrEnum
from numbers import Integral, Real
from types import UnionType
from typing import Annotated, Any, TypeVar, get_args, get_origin

from gaitopt.errors import ArgumentError, UnknownNameError

Choice = TypeVar("Choice", bound=StrEnum)


class Method(StrEnum):
    """The method that searches for a gait; ``auto`` uses IPOPT if Newton's method finds no gait."""

    AUTO = "auto"
    NEWTON = "newton"
    IPOPT = "ipopt"


class Engine(StrEnum):
    """An integrator of arcs; ``auto`` uses heyoka if it is installed and its compilation pays off, otherwise scipy."""

    AUTO = "auto"
    SCIPY = "scipy"
    HEYOKA = "heyoka"


class FeedbackLaw(StrEnum):
    """A law that walks a known gait: curves over a phase, tracking by PD control, or a correction per step."""

    CONSTRAINTS = "virtual_constraints"
    PD = "pd"
    STEP = "step_feedback"


NOUNS: Mapping[type[StrEnum], str] = {Method: "method of solution", Engine: "engine", FeedbackLaw: "feedback law"}
"""Nouns for the members of a choice in messages."""
MOST_STARTS = 1_000_000
"""Largest number of start states; more would take days, and fill the memory with candidates."""
MOST_WORKERS = 1024
"""Largest number of processes on one machine; each takes some 100 MB."""
LARGEST_SPREAD = 0.99
"""Largest spread of samples; below one, no coordinate changes its sign."""
NARROWEST, WIDEST = 1e-14, 1.0
"""Bounds of the width of a bracket: doubles cannot resolve a narrower one, and no special point needs a wider one."""
FINEST_TIME_STEP, COARSEST_TIME_STEP = 1e-6, 0.1
"""Bounds of the time step of another physics engine [s]."""
SHORTEST_STEP_TIME, LONGEST_STEP_TIME = 1e-6, 1e6
"""Bounds of the longest time from impact to impact [s]."""


AGREEMENT = 1e-9
"""Default tolerance with which a verification compares period, switching times and states, in natural units."""
FINEST_AGREEMENT, COARSEST_AGREEMENT = 1e-13, 1e-4
"""Bounds of the tolerance of a verification. A smaller one is below rounding; with a larger one another gait could
pass."""
NEWTON_STEPS = 9
"""Default of the largest number of Newton steps. Each step is at most half as long as the one before, and the search
converges quadratically well before this number."""
IPOPT_ITERATIONS = 300
"""Default of the largest number of iterations of IPOPT in a search for a motion; a successful one takes about ten."""
INTERVALS = 14
"""Default number of intervals of a step in a first mesh; they give about ten digits on the gaits of the paper."""
FEWEST_INTERVALS, MOST_INTERVALS = 2, 2000
"""Bounds of the number of intervals. IPOPT takes half a second for an iteration on the finest mesh, and does not search
on a finer one; Newton's method may refine it."""


FIGURE_GROUPS = ("range", "patch", "push", "sensitivity", "falls")
"""The groups of figures of robustness."""

LONGEST_SHOWN = 60
"""Largest number of characters of a wrong value in a message."""
TYPE_NAMES = {int: "a whole number", float: "a finite number", bool: "True or False"}
"""The text with which messages describe the values of a type."""


@dataclass(frozen=True, slots=True)
class About:
    """Properties of a field of a request besides its type and default.

    Attributes
    ----------
    help : one sentence for the command line; empty if the command has no such option.
    lower, upper : smallest and largest value; None if there is no bound. A field with ``upper`` also needs ``lower``.
    unit : unit of a number.
    keyed : whether the field enters the identity of stored work even at its default, as in the first version.
    effort : whether the field limits the work of one call without changing the stored results.
    items : the names that a text may list, with commas between; empty if it may be any text.
    """

    help: str = ""
    lower: float | None = None
    upper: float | None = None
    unit: str = ""
    keyed: bool = False
    effort: bool = False
    items: tuple[str, ...] = ()

    @property
    def span(self) -> str:
        """The bounds as a text; empty if there are none."""
        if self.lower is None:
            return ""
        unit = f" {self.unit}" if self.unit else ""
        if self.upper is None:
            return f"at least {self.lower:,}{unit}"
        return f"from {self.lower:,} to {self.upper:,}{unit}"


@dataclass(frozen=True, slots=True)
class Entry:
    """A field of a request.

    Attributes
    ----------
    kind : ``int``, ``float``, ``bool``, a choice, a tuple of one of them, or a type that is not checked here.
    optional : whether the value may be None.
    default : the default value; ``MISSING`` if there is none.
    about : its other properties.
    """

    name: str
    kind: Any
    optional: bool
    default: Any
    about: About

    @property
    def choices(self) -> tuple[str, ...]:
        """The members of a choice; empty for other types."""
        return tuple(self.kind) if isinstance(self.kind, type) and issubclass(self.kind, StrEnum) else ()

    @property
    def is_number(self) -> bool:
        """Whether the value is a number or a tuple of numbers."""
        return self._of in (int, float)

    @property
    def _of(self) -> Any:
        """The type of the value, or of the elements of a tuple."""
        return get_args(self.kind)[0] if get_origin(self.kind) is tuple else self.kind

    def read(self, text: Any) -> Any:
        """The number in a text of decimal digits, to be passed to ``checked``; any other text is returned unchanged."""
        try:
            return self._of(text) if isinstance(text, str) and text.isascii() and "_" not in text else text
        except ValueError:
            return text

    def checked(self, value: Any) -> Any:
        """The value; numbers of NumPy become those of Python, and texts become members of the choice.

        Raises
        ------
        ArgumentError
            If the value has another type, is not finite, or lies outside the bounds.
        UnknownNameError
            If there is no such choice.
        """
        if value is None and self.optional:
            return None
        if self.choices:
            return choice(self.kind, value)
        if get_origin(self.kind) is tuple:
            if not value:
                raise ArgumentError(self.name, "is empty, but must have at least one value")
            return tuple(map(self._number, value))
        if self.kind is str and not isinstance(value, str):
            raise ArgumentError(self.name, f"is {_shown(value)}, but must be a text")
        if self.about.items and (not _items_of(value) or {*_items_of(value)} - {*self.about.items}):
            allowed = f"some of {', '.join(self.about.items)}, with commas between"
            raise ArgumentError(self.name, f"is {_shown(value)}, but must be {allowed}")
        return self._number(value) if self.kind in TYPE_NAMES else value

    def _number(self, value: Any) -> Any:
        """A finite number within the bounds, or a truth value."""
        kind, lower, upper, span = self._of, self.about.lower, self.about.upper, self.about.span
        abstract: Any = {int: Integral, float: Real, bool: bool}[kind]
        right = isinstance(value, abstract) and isinstance(value, bool) == (kind is bool) and math.isfinite(value)
        if not right or (lower is not None and value < lower) or (upper is not None and value > upper):
            allowed = f"{TYPE_NAMES[kind]}, {span}" if span else TYPE_NAMES[kind]
            raise ArgumentError(self.name, f"is {_shown(value)}, but must be {allowed}")
        return kind(value)


def _items_of(text: str) -> list[str]:
    return [item for item in map(str.strip, text.split(",")) if item]


def _shown(value: Any) -> str:
    shown = repr(value)
    return shown if len(shown) <= LONGEST_SHOWN else f"{shown[: LONGEST_SHOWN - 3]}..."


def choice(kind: type[Choice], word: str) -> Choice:
    """The member of a choice with this name.

    Raises
    ------
    UnknownNameError
        If there is no such member.
    """
    if word not in tuple(kind):
        raise UnknownNameError(f"no {NOUNS[kind]} is called {word!r}; use {', '.join(kind)}")
    return kind(word)


def entries(request: "type[Request]") -> dict[str, Entry]:
    """The fields of a request by name: those of its type ``Annotated[..., About(...)]``."""
    stated = dict[str, Entry]()
    for one in fields(request):
        kind, *about = get_args(one.type) if get_origin(one.type) is Annotated else (one.type,)
        if about:
            optional = isinstance(kind, UnionType)
            default = one.default if one.default_factory is MISSING else one.default_factory()
            stated[one.name] = Entry(one.name, get_args(kind)[0] if optional else kind, optional, default, about[0])
    return stated


@dataclass(frozen=True, kw_only=True)
class Request:
    """The arguments of a verb; their values are checked when the request is made.

    Raises
    ------
    ArgumentError
        If a value has another type or is out of its bounds.
    UnknownNameError
        If there is no such choice.
    """

    def __post_init__(self) -> None:
        for name, entry in entries(type(self)).items():
            object.__setattr__(self, name, entry.checked(getattr(self, name)))

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments by name, without the problem, the folder and what else a plan adds to a request."""
        return {name: getattr(self, name) for name in entries(type(self))}

    @property
    def identity(self) -> list[Any]:
        """The values that distinguish stored work from that of other requests, in the order of the fields.

        A field that a later version added only appears if its value is not the default, so that work that was stored
        before keeps its name.
        """
        stated = list[Any]()
        for name, entry in entries(type(self)).items():
            value = getattr(self, name)
            word = value.value if isinstance(value, StrEnum) else value
            if entry.about.keyed:
                stated.append(word)
            elif value != entry.default and not entry.about.effort:
                stated.append(name if value is True else word if entry.choices else [name, word])
        return stated


METHOD = About("Newton's method from the guess, or IPOPT; auto uses IPOPT if Newton's method fails.")
ENGINE = About("Integrator of the simulation.")
SEED = About("Random seed.", lower=0)
STARTS = About("Number of start states of the search by simulation.", lower=1, upper=MOST_STARTS)
MAX_POINTS = About("Maximum number of points per target.", lower=1, effort=True)
MAX_SECONDS = About("Time limit per target [s].", lower=0.0, unit="s", effort=True)
VERIFY_EVERY = About("Verify every N-th point by simulation; 0: none.", lower=0)
SECONDS = About(
    "Stop after this time, with what is known by then; the result then depends on the machine.",
    lower=0.0,
    unit="s",
    effort=True,
)


@dataclass(frozen=True, kw_only=True)
class SearchLimits(Request):
    """Limits of the search for one gait from its guess."""

    newton_steps: Annotated[int, About("Maximum number of Newton steps from the guess.", lower=1, upper=1000)] = (
        NEWTON_STEPS
    )
    ipopt_iterations: Annotated[int, About("Maximum number of iterations of IPOPT.", lower=1, upper=100_000)] = (
        IPOPT_ITERATIONS
    )
    intervals: Annotated[
        int,
        About(
            "Shooting intervals of a step in the first mesh; a stiff or inaccurate motion gets more.",
            lower=FEWEST_INTERVALS,
            upper=MOST_INTERVALS,
        ),
    ] = INTERVALS

    @property
    def stated(self) -> dict[str, int]:
        """The limits that differ from the defaults; results record these."""
        return dict(self.identity)


DEFAULT_LIMITS = SearchLimits()


@dataclass(frozen=True, kw_only=True)
class SolveRequest(SearchLimits):
    """See ``gaitopt.solve``."""

    method: Annotated[Method, METHOD] = Method.AUTO


@dataclass(frozen=True, kw_only=True)
class VerifyRequest(Request):
    """See ``gaitopt.verify``."""

    engine: Annotated[Engine, ENGINE] = Engine.AUTO
    tolerance: Annotated[
        float,
        About(
            "Largest difference of the two methods in natural units; the tolerances of all claims are in proportion.",
            lower=FINEST_AGREEMENT,
            upper=COARSEST_AGREEMENT,
        ),
    ] = AGREEMENT


@dataclass(frozen=True, kw_only=True)
class StartsRequest(Request):
    """See ``gaitopt.multistart``."""

    starts: Annotated[int, About("Number of sampled guesses; the best gait is stored.", lower=1)] = 1
    seed: Annotated[int, SEED] = 0
    spread: Annotated[
        float, About("Spread of the samples, relative to the guess.", lower=0.0, upper=LARGEST_SPREAD)
    ] = 0.3


@dataclass(frozen=True, kw_only=True)
class SimulateRequest(Request):
    """See ``gaitopt.simulate``."""

    steps: Annotated[int | None, About("Number of steps. Default: 1.", lower=1)] = None
    dense: Annotated[bool, About()] = True
    engine: Annotated[Engine, ENGINE] = Engine.AUTO
    longest_step: Annotated[
        float | None,
        About("Longest time of a step [s]. Default: 50 sqrt(l/g).", lower=SHORTEST_STEP_TIME, upper=LONGEST_STEP_TIME),
    ] = None


@dataclass(frozen=True, kw_only=True)
class UntilRequest(Request):
    """See ``gaitopt.Until``."""

    time: Annotated[float | None, About("End at this time [s].")] = None
    events: Annotated[int | None, About("End after this number of mode changes and impacts.", lower=1)] = None


@dataclass(frozen=True, kw_only=True)
class FloorRequest(Request):
    """See ``gaitopt.Floor``."""

    floor: Annotated[
        str | None,
        About(
            "Tiles under the feet, one per step: 'friction=0.2, 0.13x2, 0.2; height=0, 0.01', or a CSV file with the "
            "columns friction, height and slope. The last tile repeats."
        ),
    ] = None
    random: Annotated[
        str | None,
        About("Random tiles: friction=0.12:0.2 (uniform), or 'height=normal(0, 0.002)'; beyond 3 sigma drawn again."),
    ] = None
    seed: Annotated[int, SEED] = 0


@dataclass(frozen=True, kw_only=True)
class ExplainRequest(Request):
    """See ``gaitopt.explain``."""

    starts: Annotated[int, STARTS] = 1000
    seed: Annotated[int, SEED] = 0
    seconds: Annotated[float | None, SECONDS] = None


@dataclass(frozen=True, kw_only=True)
class SearchRequest(Request):
    """The arguments that all searches for gaits of any mode sequence have in common."""

    starts: Annotated[int, STARTS] = 1000
    seed: Annotated[int, SEED] = 0
    within: Annotated[
        Mapping[str, tuple[float, float]],
        About("Range of a start coordinate, such as dtheta1=0:1; may be repeated."),
    ] = field(default_factory=dict)
    method: Annotated[Method, METHOD] = Method.AUTO


@dataclass(frozen=True, kw_only=True)
class FindRequest(SearchRequest):
    """See ``gaitopt.find``."""

    steps: Annotated[int | None, About("Maximum number of steps of a cycle.", lower=1)] = None
    seconds: Annotated[float | None, SECONDS] = None


@dataclass(frozen=True, kw_only=True)
class ContinueRequest(Request):
    """See ``gaitopt.continuation``."""

    parameter: Annotated[str, About("Parameter: friction, walker.slope, ...")]
    to: Annotated[tuple[float, ...], About("Target value; give two targets to continue in both directions.")]
    lower: Annotated[float | None, About("Lower bound of the parameter.")] = None
    upper: Annotated[float | None, About("Upper bound of the parameter.")] = None
    max_points: Annotated[int, MAX_POINTS] = 2000
    max_seconds: Annotated[float | None, MAX_SECONDS] = None
    verify_every: Annotated[int, VERIFY_EVERY] = 10


@dataclass(frozen=True, kw_only=True)
class TraceRequest(Request):
    """See ``gaitopt.trace``."""

    key: Annotated[str, About("Second parameter: walker.slope, walker.hip_mass, ...")]
    to: Annotated[tuple[float, ...], About("Target of the second parameter; give two to trace in both directions.")]
    lower: Annotated[float | None, About("Lower bound of the parameter of the branch.")] = None
    upper: Annotated[float | None, About("Upper bound of the parameter of the branch.")] = None
    max_points: Annotated[int, MAX_POINTS] = 2000
    max_seconds: Annotated[float | None, MAX_SECONDS] = None
    verify_every: Annotated[int, VERIFY_EVERY] = 10


@dataclass(frozen=True, kw_only=True)
class SweepRequest(Request):
    """See ``gaitopt.sweep``."""

    warm: Annotated[
        bool,
        About("Start each point from the gait of its neighbour; the result may then depend on the grid.", keyed=True),
    ] = False
    from_guess: Annotated[
        bool, About("Solve from the guess of the file; by default the file's gait is followed to the changed values.")
    ] = False
    method: Annotated[Method, METHOD] = Method.AUTO


@dataclass(frozen=True, kw_only=True)
class AttractorsRequest(Request):
    """See ``gaitopt.attractors``."""

    starts: Annotated[int, About("Number of walks at each value.", lower=1, upper=MOST_STARTS, keyed=True)] = 20
    transient: Annotated[
        int, About("Number of cycles to discard first; take more near bifurcations.", lower=1, keyed=True)
    ] = 200
    keep: Annotated[int, About("Number of cycles to record afterwards.", lower=2, keyed=True)] = 64
    seed: Annotated[int, replace(SEED, keyed=True)] = 0
    engine: Annotated[Engine, replace(ENGINE, keyed=True)] = Engine.AUTO


@dataclass(frozen=True, kw_only=True)
class AtlasRequest(Request):
    """See ``gaitopt.atlas``."""

    slices: Annotated[
        int, About("Number of branches to begin with, at values of the second parameter.", lower=3, upper=1000)
    ] = 9
    refinements: Annotated[
        int, About("How many times the distance of branches that differ is halved.", lower=0, upper=20)
    ] = 3
    max_points: Annotated[int, About("Maximum number of points of a branch on each side of its start.", lower=10)] = 400
    steps: Annotated[
        int | None,
        About("Largest number of steps of a cycle, for doubled gaits. Default: that of PROBLEM.", lower=1),
    ] = None


@dataclass(frozen=True, kw_only=True)
class BasinRequest(Request):
    """See ``gaitopt.basin``."""

    steps: Annotated[int, About("Maximum number of steps of each walk.", lower=1)] = 100
    engine: Annotated[Engine, ENGINE] = Engine.AUTO


@dataclass(frozen=True, kw_only=True)
class RobustnessRequest(Request):
    """See ``gaitopt.robustness``."""

    what: Annotated[
        str | None,
        About(f"Figures: some of {','.join(FIGURE_GROUPS)}, with commas. Default: all.", items=FIGURE_GROUPS),
    ] = None
    over: Annotated[str | None, About("Parameter of the range. Default: friction.")] = None
    random: Annotated[
        str | None,
        About(
            "Random tiles on which falls are counted: friction=0.12:0.2 or 'friction=normal(0.15, 0.02)', also height "
            "and slope. Default: friction within 20 % of that of the problem."
        ),
    ] = None
    walks: Annotated[int, About("Number of walks on random tiles.", lower=2, upper=MOST_STARTS)] = 400
    steps: Annotated[int, About("Maximum number of steps of such a walk.", lower=1, upper=MOST_STARTS)] = 1000
    seed: Annotated[int, SEED] = 0
    engine: Annotated[Engine, ENGINE] = Engine.AUTO

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of figures, each once."""
        asked = FIGURE_GROUPS if self.what is None else _items_of(self.what)
        return tuple(name for name in FIGURE_GROUPS if name in asked)


@dataclass(frozen=True, kw_only=True)
class StabiliseRequest(Request):
    """See ``gaitopt.stabilise``."""

    law: Annotated[
        FeedbackLaw | None,
        About(
            "Kind of law. Default: virtual_constraints where there is one motor less than shape coordinates, else pd."
        ),
    ] = None
    phase: Annotated[
        str | None,
        About("Phase of the curves: clock, or a phase variable. Default: one that is monotone; clock for pd."),
    ] = None
    degree: Annotated[
        int | None, About("Degree of the curves. Default: the least one that fits.", lower=4, upper=20)
    ] = None
    radius: Annotated[float, About("Upper bound of the spectral radius.", lower=0.0, upper=1.0)] = 1.0


@dataclass(frozen=True, kw_only=True)
class ProveRequest(Request):
    """See ``gaitopt.prove``."""

    width: Annotated[
        float | None,
        About(
            "Width of the bracket of a special point. Default: the narrowest provable one.",
            lower=NARROWEST,
            upper=WIDEST,
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class ReplayRequest(Request):
    """See ``gaitopt.replay``."""

    time_steps: Annotated[
        tuple[float, ...] | None,
        About(
            "Time step [s]; may be repeated. Default: 0.004, 0.002, ..., 0.00025.",
            lower=FINEST_TIME_STEP,
            upper=COARSEST_TIME_STEP,
            unit="s",
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class WorkersRequest(Request):
    """The processes that run the jobs of a verb; the result does not depend on them."""

    workers: Annotated[
        int | None, About("Number of processes. Default: one per core.", lower=1, upper=MOST_WORKERS)
    ] = None
    scheduler: Annotated[str | None, About("Use an existing Dask scheduler, such as tls://host:8786.")] = None
