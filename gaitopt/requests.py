"""What each verb takes besides a problem: one frozen request per verb, each field with its type, default and bounds.

A field is stated here once. From it come

- the check of its value where a request is made: an ``ArgumentError`` names argument, value and what it must be;
- help, bounds and choices of the command's option, see ``cli.options.option``;
- its share in the identity of work that a run folder keeps, see ``Request.identity``.

The plans of ``runs`` and the request of a continuation are such requests with a problem and a folder. The signatures of
library and commands repeat names, types and defaults, because that is where an editor looks for them; a test compares
them. Problem, grid, workers, run folder and progress are in no request.

Every command reads its options from here, so that only the standard library is imported.
"""

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from enum import StrEnum
from numbers import Integral, Real
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin

from gaitopt.errors import ArgumentError, UnknownNameError

Choice = TypeVar("Choice", bound=StrEnum)


class Method(StrEnum):
    """What searches for a gait: Newton's method, IPOPT, or ``auto``: IPOPT where Newton's method finds none."""

    AUTO = "auto"
    NEWTON = "newton"
    IPOPT = "ipopt"


class Engine(StrEnum):
    """An integrator of arcs; ``auto`` is heyoka where it is installed and worth its compilation, else scipy."""

    AUTO = "auto"
    SCIPY = "scipy"
    HEYOKA = "heyoka"


NOUNS: Mapping[type[StrEnum], str] = {Method: "method of solution", Engine: "engine"}
"""What the members of a choice are, for messages."""
MOST_STARTS = 1_000_000
"""Maximum number of start states; more would take days, and fill the memory with candidates."""
MOST_WORKERS = 1024
"""Processes of one machine; each takes some 100 MB."""
LARGEST_SPREAD = 0.99
"""Below one, no coordinate of a sample changes its sign."""
NARROWEST, WIDEST = 1e-14, 1.0
"""Bounds of a bracket: doubles resolve no narrower one, and no special point needs a wider one."""
SHORTEST_STEP, LONGEST_STEP = 1e-6, 0.1
"""Bounds of the time step of another physics engine [s]."""


LONGEST_SHOWN = 60
"""Characters of a wrong value in a message."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """What a field of a request says about its values.

    Attributes
    ----------
    kind : ``int``, ``float``, ``bool``, a choice, a tuple of one of them, or a type that is not checked here.
    default : the value if none is given; ``MISSING`` if one must be given.
    optional : whether None is a value too.
    help : one sentence for the command line; empty where the command has no such option.
    least, most : bounds, both included; None without, and no upper bound comes without a lower one.
    unit : of a number.
    keyed : enters the identity of stored work at its default too, as it has from the first version on.
    effort : limits the work of one call, and does not change what is stored.
    """

    name: str
    kind: Any
    default: Any
    optional: bool
    help: str
    least: float | None
    most: float | None
    unit: str
    keyed: bool
    effort: bool

    @property
    def is_number(self) -> bool:
        """Whether the value is a number, or some numbers."""
        return self._of in (int, float)

    @property
    def _of(self) -> Any:
        """The type of the value, or of each of its parts."""
        return get_args(self.kind)[0] if get_origin(self.kind) is tuple else self.kind

    def read(self, text: Any) -> Any:
        """The number that a text has in decimal digits, for ``checked``; another text as it is."""
        try:
            return self._of(text) if isinstance(text, str) and text.isascii() and "_" not in text else text
        except ValueError:
            return text

    @property
    def span(self) -> str:
        """The bounds in words; empty without."""
        if self.least is None:
            return ""
        unit = f" {self.unit}" if self.unit else ""
        lower = f"{self.least:,}"
        return f"at least {lower}{unit}" if self.most is None else f"from {lower} to {self.most:,}{unit}"

    @property
    def choices(self) -> tuple[str, ...]:
        """The words of a choice; empty for other types."""
        return tuple(self.kind) if isinstance(self.kind, type) and issubclass(self.kind, StrEnum) else ()

    def checked(self, value: Any) -> Any:
        """The value, a number of NumPy as one of Python and a word as its choice.

        Raises
        ------
        ArgumentError
            If it has another type, is not finite, or lies outside the bounds.
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
        return self._number(value) if self.kind in WORDS else value

    def _number(self, value: Any) -> Any:
        """A finite number within the bounds, or a truth value."""
        kind, least, most = self._of, self.least, self.most
        abstract: Any = {int: Integral, float: Real, bool: bool}[kind]
        right = isinstance(value, abstract) and isinstance(value, bool) == (kind is bool)
        inside = (
            right and math.isfinite(value) and (least is None or value >= least) and (most is None or value <= most)
        )
        if not inside:
            words = f"{WORDS[kind]}, {self.span}" if self.span else WORDS[kind]
            shown = repr(value)
            shown = shown if len(shown) <= LONGEST_SHOWN else f"{shown[: LONGEST_SHOWN - 3]}..."
            raise ArgumentError(self.name, f"is {shown}, but must be {words}")
        return kind(value)


WORDS = {int: "a whole number", float: "a finite number", bool: "True or False"}
"""What a value must be, by type."""


def choice(kind: type[Choice], word: str) -> Choice:
    """The member of a choice with a name.

    Raises
    ------
    UnknownNameError
        If there is none.
    """
    if word not in tuple(kind):
        raise UnknownNameError(f"no {NOUNS[kind]} is called {word!r}; use {', '.join(kind)}")
    return kind(word)


def about(
    words: str,
    *,
    least: float | None = None,
    most: float | None = None,
    unit: str = "",
    keyed: bool = False,
    effort: bool = False,
) -> dict[str, Any]:
    """What a field says about its values, see ``Entry``; ``words`` are its help."""
    return {"help": words, "least": least, "most": most, "unit": unit, "keyed": keyed, "effort": effort}


METHOD = about("Newton's method from the guess, or IPOPT; auto uses IPOPT if Newton's method fails.")
ENGINE = about("Integrator of the simulation.")
SEED = about("Random seed.", least=0)
SECONDS = about(
    "Stop after this time, with what is known by then; the result then depends on the machine.",
    least=0.0,
    unit="s",
    effort=True,
)
STARTS = about("Number of start states of the search by simulation.", least=1, most=MOST_STARTS)


def entries(request: "type[Request]") -> dict[str, Entry]:
    """What the fields of a request say, by name."""
    stated = dict[str, Entry]()
    for one in (one for one in fields(request) if one.metadata):
        optional = isinstance(one.type, UnionType)
        stated[one.name] = Entry(
            name=one.name,
            kind=get_args(one.type)[0] if optional else one.type,
            default=one.default if one.default_factory is MISSING else one.default_factory(),
            optional=optional,
            **one.metadata,
        )
    return stated


@dataclass(frozen=True, kw_only=True)
class Request:
    """What a verb takes; its values are checked when it is made.

    Raises
    ------
    ArgumentError
        If a value has another type or is out of its bounds.
    UnknownNameError
        If there is no such choice.
    """

    def __post_init__(self) -> None:
        for name, stated in entries(type(self)).items():
            object.__setattr__(self, name, stated.checked(getattr(self, name)))

    @property
    def identity(self) -> list[Any]:
        """What distinguishes stored work from that of other requests, in the order of the fields.

        A field whose default came with a later version is stated where its value is another: what was stored before
        keeps its name.
        """
        stated = list[Any]()
        for name, one in entries(type(self)).items():
            value = getattr(self, name)
            word = value.value if isinstance(value, StrEnum) else value
            if one.keyed:
                stated.append(word)
            elif value != one.default and not one.effort:
                stated.append(name if value is True else word if one.choices else [name, word])
        return stated


@dataclass(frozen=True, kw_only=True)
class SolveRequest(Request):
    """See ``gaitopt.solve``."""

    method: Method = field(default=Method.AUTO, metadata=METHOD)


@dataclass(frozen=True, kw_only=True)
class StartsRequest(Request):
    """See ``gaitopt.multistart``."""

    starts: int = field(default=1, metadata=about("Number of sampled guesses; the best gait is stored.", least=1))
    seed: int = field(default=0, metadata=SEED)
    spread: float = field(
        default=0.3, metadata=about("Spread of the samples, relative to the guess.", least=0.0, most=LARGEST_SPREAD)
    )


@dataclass(frozen=True, kw_only=True)
class SimulateRequest(Request):
    """See ``gaitopt.simulate``."""

    steps: int | None = field(default=None, metadata=about("Number of steps. Default: 1.", least=1))
    dense: bool = field(default=True, metadata=about(""))
    engine: Engine = field(default=Engine.AUTO, metadata=ENGINE)


@dataclass(frozen=True, kw_only=True)
class UntilRequest(Request):
    """See ``gaitopt.Until``."""

    time: float | None = field(default=None, metadata=about("End at this time [s]."))
    events: int | None = field(
        default=None, metadata=about("End after this number of mode changes and impacts.", least=1)
    )


@dataclass(frozen=True, kw_only=True)
class ExplainRequest(Request):
    """See ``gaitopt.explain``."""

    starts: int = field(default=1000, metadata=STARTS)
    seed: int = field(default=0, metadata=SEED)
    seconds: float | None = field(default=None, metadata=SECONDS)


@dataclass(frozen=True, kw_only=True)
class SearchRequest(Request):
    """A search for gaits of any mode sequence."""

    starts: int = field(default=1000, metadata=STARTS)
    seed: int = field(default=0, metadata=SEED)
    within: Mapping[str, tuple[float, float]] = field(
        default_factory=dict, metadata=about("Range of a start coordinate, such as dtheta1=0:1; may be repeated.")
    )
    method: Method = field(default=Method.AUTO, metadata=METHOD)


@dataclass(frozen=True, kw_only=True)
class FindRequest(SearchRequest):
    """See ``gaitopt.find``."""

    steps: int | None = field(default=None, metadata=about("Maximum number of steps of a cycle.", least=1))
    seconds: float | None = field(default=None, metadata=SECONDS)


@dataclass(frozen=True, kw_only=True)
class ContinueRequest(Request):
    """See ``gaitopt.continuation``."""

    parameter: str = field(metadata=about("Parameter: friction, walker.slope, ..."))
    to: tuple[float, ...] = field(metadata=about("Target value; give two targets to continue in both directions."))
    lower: float | None = field(default=None, metadata=about("Lower bound of the parameter."))
    upper: float | None = field(default=None, metadata=about("Upper bound of the parameter."))
    max_points: int = field(default=2000, metadata=about("Maximum number of points per target.", least=1, effort=True))
    max_seconds: float | None = field(
        default=None, metadata=about("Time limit per target [s].", least=0.0, unit="s", effort=True)
    )
    verify_every: int = field(default=10, metadata=about("Verify every N-th point by simulation; 0: none.", least=0))


@dataclass(frozen=True, kw_only=True)
class SweepRequest(Request):
    """See ``gaitopt.sweep``."""

    warm: bool = field(
        default=False,
        metadata=about(
            "Start each point from the gait of its neighbour; the result may then depend on the grid.", keyed=True
        ),
    )
    from_guess: bool = field(
        default=False,
        metadata=about(
            "Solve from the guess of the file; by default the file's gait is followed to the changed values."
        ),
    )
    method: Method = field(default=Method.AUTO, metadata=METHOD)


@dataclass(frozen=True, kw_only=True)
class AttractorsRequest(Request):
    """See ``gaitopt.attractors``."""

    starts: int = field(
        default=20, metadata=about("Number of walks at each value.", least=1, most=MOST_STARTS, keyed=True)
    )
    transient: int = field(
        default=200,
        metadata=about("Number of cycles to discard first; take more near bifurcations.", least=1, keyed=True),
    )
    keep: int = field(default=64, metadata=about("Number of cycles to record afterwards.", least=2, keyed=True))
    seed: int = field(default=0, metadata=SEED | {"keyed": True})
    engine: Engine = field(default=Engine.AUTO, metadata=ENGINE | {"keyed": True})


@dataclass(frozen=True, kw_only=True)
class BasinRequest(Request):
    """See ``gaitopt.basin``."""

    steps: int = field(default=100, metadata=about("Maximum number of steps of each walk.", least=1))
    engine: Engine = field(default=Engine.AUTO, metadata=ENGINE)


@dataclass(frozen=True, kw_only=True)
class ProveRequest(Request):
    """See ``gaitopt.prove``."""

    width: float | None = field(
        default=None,
        metadata=about(
            "Width of the bracket of a special point. Default: the narrowest provable one.",
            least=NARROWEST,
            most=WIDEST,
        ),
    )


@dataclass(frozen=True, kw_only=True)
class ReplayRequest(Request):
    """See ``gaitopt.replay``."""

    time_steps: tuple[float, ...] | None = field(
        default=None,
        metadata=about(
            "Time step [s]; may be repeated. Default: 0.004, 0.002, ..., 0.00025.",
            least=SHORTEST_STEP,
            most=LONGEST_STEP,
            unit="s",
        ),
    )


@dataclass(frozen=True, kw_only=True)
class WorkersRequest(Request):
    """Where jobs run; the result does not depend on it."""

    workers: int | None = field(
        default=None, metadata=about("Number of processes. Default: one per core.", least=1, most=MOST_WORKERS)
    )
    scheduler: str | None = field(
        default=None, metadata=about("Use an existing Dask scheduler, such as tls://host:8786.")
    )
