"""Feedback from step to step: parameters of a control law that are corrected once per cycle.

    u_n = u* + K (xi_n - xi*),      lower <= u_n <= upper

xi_n are the section coordinates just after the impact with which cycle n begins, xi* those of the nominal gait, and u*
the parameters of the law. K is given, or a design from the linearised return map of the nominal gait,

    xi_(n+1) - xi* = A (xi_n - xi*) + B (u_n - u*),      so that the multipliers are the eigenvalues of A + B K

The nominal gait is that of the problem without the feedback, at the values of the problem. K and xi* stay the same when
a parameter is continued or changed later.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Self

import numpy as np
from casadi import MX, SX, fmax, fmin
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    PrivateAttr,
    TypeAdapter,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
    model_validator,
)

from gaitopt.arrays import Array
from gaitopt.model.units import Free, is_free, number_or_free

LARGEST_GAIN = 1e9
"""Largest size of an entry of K that is accepted: a larger one is a mistake."""


def _unchanged(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
    handler(value)
    return value


Gain = Annotated[
    float,
    Field(ge=-LARGEST_GAIN, le=LARGEST_GAIN, allow_inf_nan=False, strict=True),
    WrapValidator(_unchanged),  # an integer stays one, because the digest of a problem depends on it
]
"""An entry of K."""
Weight = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Numbers = Mapping[tuple[str, str], float]
"""Gains by key of the parameter and name of the section coordinate."""
PREFIX = "step_feedback."
"""Prefix of the keys of the gains and of xi* below ``control``."""


class Lqr(BaseModel):
    """The gains that minimise the sum of xi' Q xi + u' R u over all steps; Q and R are diagonal."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    Q: Annotated[dict[str, Weight], Field(description="weights of the section coordinates by name, 1 by default")] = {}
    R: Annotated[dict[str, Weight], Field(description="weights of the parameters by dotted key, 1 by default")] = {}


class Deadbeat(BaseModel):
    """Gains with which every deviation vanishes after at most n steps, where n is the number of section coordinates."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class MinimumRadius(BaseModel):
    """Bounded gains with a small spectral radius: the best result of some local searches."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    max_gain: Annotated[float, Field(gt=0, le=LARGEST_GAIN, description="largest size of an entry of K")] = 100.0


class FeedbackDesign(BaseModel):
    """The method that designs the gains; exactly one of the three is given."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    lqr: Annotated[Lqr | None, Field(description="discrete linear-quadratic regulator")] = None
    deadbeat: Annotated[Deadbeat | None, Field(description="(A + B K)^n = 0 with n section coordinates")] = None
    minimum_radius: Annotated[MinimumRadius | None, Field(description="least spectral radius with bounded gains")] = (
        None
    )

    @model_validator(mode="before")
    @classmethod
    def _named(cls, data: Any) -> Any:
        """A method without keys may be given by its name."""
        return {data: {}} if isinstance(data, str) else data

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        if sum(value is not None for _, value in self) != 1:
            raise ValueError("give one of lqr, deadbeat, minimum_radius")
        return self


def _nested(value: Any) -> Any:
    """Gains as nested mappings without dots in their keys, so that a dotted key names an entry."""
    if not isinstance(value, Mapping):
        return value
    nested: dict[str, Any] = {}
    for key, below in value.items():
        level, (*above, last) = nested, str(key).split(".")
        for name in above:
            level = level.setdefault(name, {})
        entry = below if is_free(below) else _nested(below)
        level[last] = (
            {**level[last], **entry} if isinstance(level.get(last), dict) and isinstance(entry, dict) else entry
        )
    return nested


def _entries(nested: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, str], Any]]:
    """Every entry of nested gains: the key of its parameter with the name of its coordinate, and its value."""
    for key, value in nested.items():
        if isinstance(value, Mapping):
            yield from _entries(value, (*path, key))
        else:
            yield (".".join(path), key), value


def _read_gains(value: Any) -> Any:
    """A number, an unknown, or a mapping to such values that is not empty."""
    return (_GAINS if isinstance(value, Mapping) and value and not is_free(value) else _GAIN).validate_python(value)


_GAIN: TypeAdapter[float | Free[float]] = TypeAdapter(
    Annotated[Gain | Free[Gain], number_or_free(TypeAdapter(Gain), TypeAdapter(Free[Gain]))]
)
_GAINS = TypeAdapter(dict[str, Annotated[Any, PlainValidator(_read_gains)]])


def _checked(nested: Any) -> Any:
    """The gains, in which every entry is a finite number or an unknown."""
    if not isinstance(nested, Mapping):
        raise ValueError("give the gains of each parameter by coordinate: {control.hip: {theta1: 0.1}}")
    gains = _GAINS.validate_python(nested)
    entries = [*_entries(gains)]
    if not entries:
        raise ValueError("has no entry; give those that are not zero: {control.hip: {theta1: 0.1}}")
    for name in (name for (key, name), _ in entries if not key):
        raise ValueError(f"{name}: give the gains of a parameter by coordinate: {{control.hip: {{theta1: 0.1}}}}")
    return gains


@dataclass(frozen=True, slots=True, kw_only=True)
class Resolved:
    """The numbers of the feedback.

    Attributes
    ----------
    keys, names : dotted keys of the m parameters, and names of the n section coordinates.
    gains : ndarray, shape (m, n) - K.
    state : ndarray, shape (n,) - xi*.
    every : number of steps of a cycle.
    """

    keys: tuple[str, ...]
    names: tuple[str, ...]
    gains: Array
    state: Array
    every: int


class StepFeedback(BaseModel):
    """Corrections of parameters of the law, once per cycle, in proportion to the deviation just after the impact."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    gains: Annotated[
        dict[str, Any] | None,
        BeforeValidator(lambda value: None if value is None else _checked(_nested(value))),
        WithJsonSchema({"type": "object"}),
        Field(
            description="entries of K: {control.hip: {theta1: 0.1}}; what is left out is zero, and an entry may be an "
            "unknown of a design, {free: [-1, 1], guess: 0}"
        ),
    ] = None
    design: Annotated[
        FeedbackDesign | None, Field(description="how K is designed: lqr, deadbeat or minimum_radius")
    ] = None
    corrects: Annotated[
        tuple[str, ...] | None,
        Field(description="dotted keys of the parameters that a design corrects; by default all of the law"),
    ] = None
    limits: Annotated[
        dict[str, tuple[float, float]] | None,
        Field(description="lower and upper bound of the corrected parameters by dotted key"),
    ] = None
    at: Annotated[
        dict[str, Any] | None,
        WithJsonSchema({"type": "object"}),
        Field(description="values by dotted key at which the nominal gait is taken; those of the problem by default"),
    ] = None
    _known: Resolved | None = PrivateAttr(default=None)

    @property
    def known(self) -> Resolved:
        """The gains, and the state of the nominal gait.

        Raises
        ------
        ValueError
            If the nominal gait is not known yet.
        """
        if self._known is None:
            raise ValueError("the gains and the state of step_feedback follow from the nominal gait")
        return self._known

    @property
    def is_known(self) -> bool:
        """Whether the gains and the nominal state are known."""
        return self._known is not None

    def resolved(self, known: Resolved) -> Self:
        """The same feedback with known gains and nominal state."""
        made = self.model_copy()
        made._known = known
        return made

    @property
    def stated(self) -> Numbers:
        """The gains stated in the file; for an unknown, its guess."""
        return {at: float(v.guess if isinstance(v, Free) else v) for at, v in _entries(self.gains or {})}

    @property
    def parameters(self) -> dict[str, float]:
        """Values of the gains and of xi* by their keys below ``control``; the stated gains alone until xi* is known."""
        if self._known is None:
            return {_gain_key(*at): value for at, value in self.stated.items()}
        known = self._known
        gains = zip(((key, name) for key in known.keys for name in known.names), known.gains.ravel(), strict=True)
        rows = {_gain_key(*at): float(value) for at, value in gains}
        return rows | {f"{PREFIX}state.{n}": float(v) for n, v in zip(known.names, known.state, strict=True)}

    @property
    def free(self) -> dict[str, Free[float]]:
        """The gains that a design finds, by key below ``control``."""
        stated = ((_gain_key(*at), value) for at, value in _entries(self.gains or {}) if isinstance(value, Free))
        return {key: Free[float](free=value.free, guess=value.guess) for key, value in stated}

    def faults(self, parameters: Mapping[str, float]) -> Iterator[tuple[tuple[str, ...], str]]:
        """Faults of the feedback of a law with these parameters: the path of each wrong entry and a sentence."""
        if (self.gains is None) == (self.design is None):
            yield (), "give either gains: {control.hip: {theta1: 0.1}} or a design: lqr, deadbeat or minimum_radius"
        for (key, name), value in _entries(self.gains or {}):
            if isinstance(value, Free):
                yield from ((("gains", *key.split("."), name, *keys), message) for keys, message in value.faults())
        if self.corrects is not None and self.design is None:
            yield ("corrects",), "names the parameters of a design; with gains leave it out"
        if self.corrects == ():
            yield ("corrects",), "names no parameter; leave it out, and all are corrected"
        known = [f"control.{name}" for name in parameters]
        used: dict[str, tuple[str, ...]] = {key: ("gains",) for key, _ in self.stated}
        used |= dict.fromkeys(self.corrects or (), ("corrects",)) | dict.fromkeys(self.limits or {}, ("limits",))
        if self.design is not None and self.design.lqr is not None:
            used |= dict.fromkeys(self.design.lqr.R, ("design", "lqr", "R"))
        used = {key: path for key, path in used.items() if key not in known}
        for key in [f"{key}.{name}" for key, name in self.stated if f"{key}.{name}" in known]:
            used.pop(key.rpartition(".")[0], None)
            yield ("gains", key), "give the gains of a parameter by coordinate: {theta1: 0.1}"
        for key, path in used.items():
            yield path, f"{key} is no parameter of the law; it has {', '.join(known) or 'none'}"
        corrected = self.corrects or [key for key, _ in self.stated] or known
        for key, (low, high) in (self.limits or {}).items():
            if not low < high:
                yield ("limits", key), f"[{low:g}, {high:g}] is empty: the lower limit comes first"
            elif key in known and key not in corrected:
                yield ("limits", key), f"{key} is not corrected; limits bound {', '.join(dict.fromkeys(corrected))}"


def _gain_key(key: str, name: str) -> str:
    return f"{PREFIX}gains.{key}.{name}"


class Correction:
    """The correction u = u* + K (xi - xi*) within limits, applied to the parameter vector p of a system.

    Parameters
    ----------
    feedback : feedback whose gains and nominal state are known.
    parameters : names of the entries of p.
    states : names of the entries of z.
    exchanged : pairs of dotted keys of parameters that take each other's values after every step.

    Attributes
    ----------
    keys : dotted keys of the corrected parameters.
    every : number of steps of a cycle.
    entries : indices in p of the parameters that are corrected in any step of a cycle.
    """

    def __init__(
        self,
        feedback: StepFeedback,
        parameters: tuple[str, ...],
        states: tuple[str, ...],
        exchanged: Mapping[str, str],
    ) -> None:
        known, index = feedback.known, {name: k for k, name in enumerate(parameters)}
        self.keys, self.every = known.keys, known.every
        self._size = len(parameters)
        partner = {**exchanged, **{other: one for one, other in exchanged.items()}}
        self._of_u = [index[key] for key in known.keys], [index[partner.get(key, key)] for key in known.keys]
        self.entries = [*dict.fromkeys(entry for of_u in self._of_u for entry in of_u)]
        self.of_K = np.array([[index[f"control.{_gain_key(key, name)}"] for name in known.names] for key in known.keys])
        self.of_K = self.of_K.reshape(len(known.keys), len(known.names))
        self._of_xi = [index[f"control.{PREFIX}state.{name}"] for name in known.names]
        self.indices = [states.index(name) for name in known.names]
        limits = feedback.limits or {}
        self._lower = np.array([limits.get(key, (-np.inf, np.inf))[0] for key in known.keys])
        self._upper = np.array([limits.get(key, (-np.inf, np.inf))[1] for key in known.keys])

    def __call__(self, p: Array, z: Array, n: int = 0) -> Array:
        """The parameters in step n of the cycle that begins with the state z: p (..., n_p) and z (..., n_z).

        Those of every second step, the first of which is step 1, are exchanged, in ``p`` and in the result.
        """
        of_u = self._of_u[n % 2]
        deviation = z[..., self.indices] - p[..., self._of_xi]
        change = np.einsum("...ij,...j->...i", p[..., self.of_K], deviation)
        full = p.copy()
        full[..., of_u] = np.clip(p[..., of_u] + change, self._lower, self._upper)
        return full

    def symbolic(self, p: Any, z: Any) -> Any:
        """The corrected parameters as a CasADi column."""
        full = (MX if isinstance(p, MX) else SX)(p)
        deviation = z[self.indices] - p[self._of_xi]
        for k, (entry, row) in enumerate(zip(self._of_u[0], self.of_K.tolist(), strict=True)):
            u = p[entry]
            for j, gain in enumerate(row):
                u = u + p[gain] * deviation[j]
            u = u if self._lower[k] == -np.inf else fmax(u, self._lower[k])
            full[entry] = u if self._upper[k] == np.inf else fmin(u, self._upper[k])
        return full

    def slopes(self, p: Array, z: Array) -> tuple[Array, Array]:
        """Derivatives of the corrected parameters by the state, (m, n_z), and by p, (m, n_p); zero at a limit."""
        deviation = z[self.indices] - p[self._of_xi]
        K = p[self.of_K]
        of_u = self._of_u[0]
        u = p[of_u] + K @ deviation
        free = (u > self._lower) & (u < self._upper)
        by_state, by_p = np.zeros((len(of_u), z.size)), np.zeros((len(of_u), self._size))
        by_state[:, self.indices] = K
        rows = np.arange(len(of_u))
        by_p[rows, of_u] = 1.0
        by_p[:, self._of_xi] = -K
        by_p[rows[:, None], self.of_K] = deviation
        by_state[~free], by_p[~free] = 0.0, 0.0
        return by_state, by_p

    def by_entry(self, changes: Array, n: int) -> Array:
        """Changes of the ``entries`` in step n of a cycle, from those of the corrected parameters, (m, k)."""
        rows = np.zeros((len(self.entries), changes.shape[1]))
        rows[[self.entries.index(entry) for entry in self._of_u[n % 2]]] = changes
        return rows
