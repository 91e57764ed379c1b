"""A gait: a periodic cycle of steps with its multipliers and scalars, or the reason why there is none.

    P(xi) = xi,        multipliers: eigenvalues of DP at xi

``Gait`` is the result of the solver, ``Attractor`` a gait that simulated walks converge to. The table of a motion has a
row per sample: time, mode, state, contact force and torques.
"""

import warnings
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.display import Moving
from gaitopt.errors import GaitoptWarning, ProblemError, SolveError
from gaitopt.gait.frames import data_frame, sample_set
from gaitopt.gait.measures import angles_of, contact_record, control_record, observe
from gaitopt.gait.ranges import DesignRange
from gaitopt.gait.records import AttemptRecord, GaitRecord, StepRecord, VerificationRecord, phase_records
from gaitopt.gait.shares import undetermined_forces
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.gait.zero_dynamics import ConstraintMeasures, constraint_measures
from gaitopt.model.cycle import Cycle
from gaitopt.model.declaration import actuator_units
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import MEASURES, phase_of, state_unit, unit_of

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """A violated condition, which is a reason why there is no gait.

    Attributes
    ----------
    what : the quantity: ``friction``, ``normal_force``, ``duration``, ``touchdown``, the name of a constraint, ...
    description : what is violated, as a sentence.
    phase : index of the phase, counted through all steps; None for an impact, or if the cause concerns no phase.
    step : index of the step.
    time : time since the last impact [s]; None if there is no single time.
    needed, available : the required and the actual value, in SI; None if there are no such numbers.
    severity : the violation relative to the usual size of the quantity.
    """

    what: str
    description: str
    phase: int | None = None
    step: int = 0
    time: float | None = None
    needed: float | None = None
    available: float | None = None
    severity: float = 0.0

    @property
    def words(self) -> str:
        """The former name of ``description``, which warns."""
        warnings.warn("Cause.words is now called Cause.description", GaitoptWarning, stacklevel=2)
        return self.description

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of the command line; phases are counted from 1."""
        numbers = {"time": self.time, "needed": self.needed, "available": self.available}
        phase = None if self.phase is None else self.phase + 1
        return {"what": self.what, "phase": phase, **numbers, "words": self.description}


def describe_causes(causes: tuple[Cause, ...] | list[Cause]) -> str:
    """The sentences of all causes in one line."""
    return "; ".join(cause.description for cause in causes)


TIE_DIGITS = 10
"""Moduli that agree to this number of digits count as equal, so that rounding does not decide their order."""


def floquet_multipliers(return_map: Array) -> NDArray[np.complex128]:
    """Eigenvalues of a return map's derivative, largest modulus first; shape (n_xi,)."""
    values = np.linalg.eigvals(return_map).astype(complex)
    return values[np.lexsort((-values.imag, -values.real, -np.round(np.abs(values), TIE_DIGITS)))]


def multiplier_distance(
    first: NDArray[np.complex128], second: NDArray[np.complex128], *, relative: bool = False
) -> float:
    """Largest distance between two sets of multipliers, paired so that the sum of the distances is smallest.

    Parameters
    ----------
    first, second : complex ndarrays, shape (n,).
    relative : whether each distance is divided by the modulus of the second multiplier if that exceeds one.
    """
    distances = np.abs(first[:, None] - second[None, :])
    distances /= np.maximum(1.0, np.abs(second)) if relative else 1.0
    closest = distances.argmin(axis=1) if distances.size else np.arange(0)
    if len({*closest.tolist()}) == closest.size:  # all closest partners differ
        return float(distances.min(axis=1, initial=np.inf).max(initial=0.0))
    from scipy.optimize import linear_sum_assignment  # takes a quarter of a second to import and is rarely needed

    rows, columns = linear_sum_assignment(distances)
    return float(distances[rows, columns].max(initial=0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkerMotion(Moving, ReadOnlyArrays):
    """Base of a gait and of a simulated walk.

    Attributes
    ----------
    problem : the problem whose walker, control and friction were used.
    dynamics : the hybrid system at its parameters.
    """

    problem: Problem
    dynamics: Dynamics

    @property
    def system(self) -> HybridSystem:
        """The hybrid system of the motion."""
        return self.dynamics.system

    @property
    def p(self) -> Array:
        """Parameter vector, shape (n_p,); see ``Dynamics``."""
        return self.dynamics.p

    def to_frame(self) -> "DataFrame":
        """All steps as a pandas data frame, with units in ``attrs["units"]``.

        It has the columns of the table in a run folder. If the control law depends on a phase variable that is not a
        coordinate, it also has this variable and its rate.
        """
        header, rows, attributes = self._table()
        return data_frame(header, rows, _units(self.system), **attributes)

    def to_xarray(self) -> "Dataset":
        """All steps as an xarray dataset over ``sample``, with the time as a coordinate and units as attributes."""
        header, rows, attributes = self._table()
        return sample_set(header, rows, _units(self.system), **attributes)

    def _table(self) -> tuple[tuple[str, ...], Iterator[tuple[float | str, ...]], dict[str, str]]:
        """Header, rows and attributes of all steps."""
        (steps, attributes), phase = self._tabulated(), phase_columns(self.system)
        return (*trajectory_header(self.system), *phase), trajectory_rows(steps, phase), attributes

    @abstractmethod
    def _tabulated(self) -> tuple[tuple[Step, ...], dict[str, str]]:
        """The steps and the attributes of the table."""

    def _state_record(self, state: Array) -> dict[str, float]:
        return dict(zip(self.system.state_names, map(float, state), strict=True))


def trajectory_header(system: HybridSystem) -> tuple[str, ...]:
    """Names of the columns: t [s], mode, the state in SI, f_t and f_n [N], and the torque of every actuator [N m].

    If the walker has several contacts, each has its own columns, such as ``f_t.left`` and ``f_n.left``.
    """
    walker = system.walker
    forces = (walker.quantity(force, name) for name in walker.contact_names() for force in ("f_t", "f_n"))
    return ("t", "mode", *system.state_names, *forces, *walker.actuators)


def phase_columns(system: HybridSystem) -> tuple[str, ...]:
    """Names of the control law's phase variable and of its rate; empty if there is none, or it is a coordinate."""
    name = system.control.phase_variable
    return (name, f"d{name}") if name and name not in system.state_names else ()


def trajectory_rows(steps: Iterable[Step], phase: tuple[str, ...] = ()) -> Iterator[tuple[float | str, ...]]:
    """Rows under ``trajectory_header``, and under ``phase_columns`` if they are given.

    The time continues over the steps; x is measured from the stance foot of each step. Both ends of an arc have a row,
    so that two arcs are separated by a time that occurs twice. Undetermined forces are NaN.
    """
    began = 0.0
    for step in steps:
        for arc in step.arcs:
            system, observed = arc.dynamics.system, observe(arc)
            header, columns = trajectory_header(system), [arc.states, observed.force, observed.torque]
            if phase:
                index = system.angle_names.index(phase[0])
                columns += [values[:, [index]] for values in angles_of(arc)]
            numbers = np.hstack(columns)
            numbers[:, [header.index(name) - 2 for name in undetermined_forces(arc)]] = np.nan
            for t, row in zip(arc.times, numbers, strict=True):
                yield (began + float(t), str(arc.mode), *map(float, row))
        began += step.period


def _units(system: HybridSystem) -> dict[str, str]:
    states = {name: state_unit(name, system) for name in system.state_names}
    columns = {name: unit_of(name, system) for name in trajectory_header(system)}
    return {**columns, **states, **actuator_units(system.walker)}


SAME_STATE = 1e-6
"""Largest difference between the states of two steps that count as equal, relative to the largest coordinate; both in
natural units."""


class Status(StrEnum):
    """Status of a solve; only ``converged`` is a gait."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not_converged"
    INFEASIBLE = "infeasible"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True, slots=True, kw_only=True)
class Shooting(ReadOnlyArrays):
    """The shooting nodes behind a gait.

    Attributes
    ----------
    times : ndarray, shape (n_nodes,) - time since the last impact of every node [s].
    states : ndarray, shape (n_nodes, n_z) - state at every node.
    intervals : number of intervals of every arc.
    residual : largest violation of the equalities, in natural units.
    errors : ndarray, shape (n_phases,) - estimated integration error of states and duration of every phase, in natural
        units.
    """

    times: Array
    states: Array
    intervals: tuple[int, ...]
    residual: float
    errors: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Gait(WalkerMotion):
    """A periodic cycle of steps; or a failed solve, whose ``status`` is not ``converged``.

    A gait has a motion (``state``, ``period``, ``phases``, ``steps``), its stability (``multipliers``,
    ``spectral_radius``) and scalars (``measures``, ``scalar(name)``). ``gaitopt.verify`` checks it by an independent
    simulation, ``gaitopt.continuation`` follows it along a parameter. A failed solve has ``message`` and ``causes``
    instead.

    Attributes
    ----------
    problem : the problem that was solved.
    dynamics : the hybrid system at its parameters, including the solution for free parameters.
    status, message : result of the solver, and its explanation.
    steps : the steps of the cycle with arcs at Chebyshev points; empty after a failure.
    shooting : the nodes, or None after a failure.
    multipliers : complex ndarray - Floquet multipliers by implicit differentiation, largest modulus first.
    measures : scalars of the cycle by name, see ``measure``.
    freed : solution for free parameters, by dotted key.
    solver : ``method``, ``iterations``, ``seconds``, and further numbers.
    verification : record of the last verification, if any.
    causes : why there is no gait, most important cause first; empty for a gait.
    timed : indices of the phases that end at a breakpoint of the control, because the torques jump there.
    best : the point where a failed design ended, see ``best_point``; None for all other solves.
    over : objective, stability and constraints along the range of a design over a range; None for all other gaits.
    """

    status: Status
    message: str
    steps: tuple[Step, ...] = ()
    shooting: Shooting | None = None
    multipliers: NDArray[np.complex128] = field(default_factory=lambda: np.zeros(0, dtype=complex))
    measures: Mapping[str, float | None] = field(default_factory=dict)
    freed: Mapping[str, float] = field(default_factory=dict)
    solver: Mapping[str, float | str] = field(default_factory=dict)
    verification: VerificationRecord | None = None
    causes: tuple[Cause, ...] = ()
    timed: tuple[int, ...] = ()
    best: Mapping[str, Any] | None = None
    over: DesignRange | None = None

    def __repr__(self) -> str:
        if not self.steps:
            return f"<Gait {self.problem.name}: {self.status}{self.message and f': {self.message}'}>"
        radius = self.spectral_radius
        stable = "" if radius is None else f", radius {radius:.4g} ({'stable' if self.stable else 'unstable'})"
        return f"<Gait {self.problem.name}: {self.cycle}, period {self.period:.6g} s{stable}, {self.status}>"

    def __post_init__(self) -> None:
        ReadOnlyArrays.__post_init__(self)
        # ``replace(gait, dynamics=...)`` replaces the dynamics of all arcs too
        if not self.steps:
            return
        first = self.steps[0].arcs[0]
        corrected = self.system.correction is not None and first.dynamics.system is self.system
        if first.dynamics is not self.dynamics and not corrected:
            steps = (
                replace(step, arcs=tuple(replace(arc, dynamics=of_step) for arc in step.arcs))
                for step, of_step in zip(self.steps, cycle(self.dynamics.acting(first.states[0]).steps), strict=False)
            )
            object.__setattr__(self, "steps", tuple(steps))

    @property
    def converged(self) -> bool:
        """Whether this is a gait."""
        return self.status is Status.CONVERGED

    @property
    def cycle(self) -> Cycle:
        """The mode sequences of its steps, including which phases are timed; the problem does not state the latter."""
        return self.problem.cycle.with_timed(self.timed)

    @property
    def motion(self) -> tuple[Step, ...]:
        """The steps of the cycle.

        Raises
        ------
        SolveError
            If the attempt failed and there is no gait.
        """
        if not self.steps:
            raise SolveError(f"{self.problem.name} is {self.status}, so there is no motion: {self.message}")
        return self.steps

    @property
    def state(self) -> Array:
        """State just after the impact; shape (n_z,). Raises the error of ``motion``."""
        return self.motion[0].arcs[0].states[0]

    @property
    def arcs(self) -> tuple[Arc, ...]:
        """The arcs of all steps in order; times are counted from the impact before each step."""
        return tuple(arc for step in self.steps for arc in step.arcs)

    @property
    def arcs_by_phase(self) -> tuple[tuple[Arc, int], ...]:
        """The arcs of all steps, each with the index of its phase in the cycle."""
        firsts = zip(self.cycle.first_phases, self.steps, strict=True)
        return tuple(
            (arc, first + phase)
            for first, step in firsts
            for arc, phase in zip(step.arcs, step.arc_phases, strict=True)
        )

    @property
    def phases(self) -> tuple[tuple[Mode, float], ...]:
        """Modes and durations [s] of the phases of all steps."""
        return tuple(phase for step in self.steps for phase in step.phases)

    @property
    def period(self) -> float | None:
        """Duration of the cycle [s]; None if the attempt failed."""
        return float(sum(step.period for step in self.steps)) if self.steps else None

    @property
    def spectral_radius(self) -> float | None:
        """Largest modulus of the multipliers; the gait is stable if it is below one."""
        return float(np.abs(self.multipliers[0])) if self.multipliers.size else None

    @property
    def stable(self) -> bool | None:
        """Whether all multipliers lie within the unit circle; None if the attempt failed."""
        return None if self.spectral_radius is None else self.spectral_radius < 1

    @property
    def constraints(self) -> ConstraintMeasures | None:
        """Decoupling matrix and zero dynamics of a gait under virtual constraints; None under another law."""
        return constraint_measures(self.steps)

    @property
    def repeats_after(self) -> int:
        """Number of steps of the shortest cycle that repeats itself within the gait; usually all of its steps."""
        n, shortest = len(self.steps), len(self.dynamics.steps)
        if n <= shortest:
            return n
        steps = self.cycle.steps
        unit = self.dynamics.state_units
        states = np.array([step.arcs[0].states[0] for step in self.steps]) / unit

        def repeats(k: int) -> bool:
            same = (
                steps[k:] == steps[:-k] and np.abs(states[k:] - states[:-k]).max() < SAME_STATE * np.abs(states).max()
            )
            return n % k == 0 and bool(same)

        return next((k for k in range(shortest, n, shortest) if repeats(k)), n)

    def scalar(self, name: str) -> float:
        """A measure, ``spectral_radius``, ``state.NAME`` or a parameter by its key; NaN where it is not defined.

        ``phases.K.duration`` is the duration of a phase, counted from 0 [s].

        Raises
        ------
        KeyError
            If the result has no such scalar.
        """
        if name.startswith("state."):
            return float(self.state[self.system.state_names.index(name.removeprefix("state."))])
        if name in self.system.parameters:
            return self.dynamics.parameter(name)
        phase = phase_of(name)
        if phase is not None:
            return self.phases[phase][1]
        value = self.spectral_radius if name == "spectral_radius" else self.measures[name]
        return float("nan") if value is None else value

    def verified(self, verification: VerificationRecord) -> "Gait":
        """The same gait with the record of a verification."""
        return replace(self, verification=verification)

    def to_record(self) -> GaitRecord | AttemptRecord:
        """The result as one JSON object, with the keys of the command line; the inverse is ``store.gaits``."""
        values, constraints = self.dynamics.parameters, self.constraints
        coefficients = {key.removeprefix("friction."): values[key] for key in self.system.friction.parameters}
        record = {
            "problem": self.problem.name,
            "status": str(self.status),
            "message": self.message,
            "friction": coefficients.get("friction", coefficients),
            **self._motion_record(),
            **{name: self.measures.get(name) for name in MEASURES},
            **contact_record(self.steps),
            **control_record(self.steps),
            "multipliers": [{"re": float(m.real), "im": float(m.imag)} for m in self.multipliers],
            "spectral_radius": self.spectral_radius,
            **({} if constraints is None else constraints.to_record()),
            "parameters": dict(self.freed),
            "solver": dict(self.solver),
            "verification": self.verification,
            **({} if self.over is None else {"over": self.over.to_record()}),
            **({} if self.over is None or self.over.widest is None else {"widest": [*self.over.widest]}),
        }
        return cast("GaitRecord | AttemptRecord", record)

    def _tabulated(self) -> tuple[tuple[Step, ...], dict[str, str]]:
        return self.steps, {"problem": self.problem.name}

    def _motion_record(self) -> dict[str, Any]:
        if self.problem.is_open:  # no gait was found
            return {"n_steps": None, "phases": [], "impact": None, "state": None}
        cycle = self.problem.cycle
        record: dict[str, Any] = {"n_steps": len(cycle.steps), "impact": cycle.impact.words}
        if not self.steps:
            return record | {"phases": [{**mode.record, "duration": None} for mode in cycle.phases], "state": None}
        firsts = zip(cycle.first_phases, self.steps, strict=True)
        phases = [phase for first, step in firsts for phase in phase_records(step, self.timed, first)]
        record |= {"phases": phases, "state": self._state_record(self.state)}
        if len(self.steps) > 1:
            record["steps"] = [
                StepRecord(
                    phases=phases[first : first + len(step.phases)],
                    impact=step.final_impact.mode.words,
                    period=step.period,
                    step_length=step.final_impact.step_length,
                    state=self._state_record(step.arcs[0].states[0]),
                )
                for first, step in zip(cycle.first_phases, self.steps, strict=True)
            ]
        return record


def best_point(problem: Problem, state: Array, durations: Array, parameters: Mapping[str, float]) -> dict[str, Any]:
    """The point where a design ends, as ``Problem.with_guess`` takes it: a motion and the freed parameters.

    Parameters
    ----------
    state, durations : state just after the impact, and durations of the phases [s].
    parameters : values of the freed parameters by dotted key.
    """
    phases = zip(problem.cycle.phases, durations.tolist(), strict=True)
    return {
        "phases": [{**mode.record, "duration": duration} for mode, duration in phases],
        "impact": problem.cycle.impact.words,
        "state": dict(zip(problem.walker.state_names(), state.tolist(), strict=True)),
        "parameters": dict(parameters),
    }


def require_gait(start: object, call: str) -> None:
    """Raise a ProblemError if the argument ``start`` of a call is a problem, or its name, instead of a gait."""
    if isinstance(start, str | Path | Problem):
        remedy = f"solve({str(start)!r})" if isinstance(start, str | Path) else "solve(problem)"
        raise ProblemError(f"{call} takes a gait, not a problem; give {remedy}")


def require_converged(gait: "Gait") -> None:
    """Raise a SolveError that carries the gait if it is a failed solve."""
    if not gait.converged:
        error = SolveError(f"{gait.problem.name} is {gait.status}: {gait.message}")
        error.result = gait
        raise error


@dataclass(frozen=True, slots=True, kw_only=True)
class Attractor(ReadOnlyArrays):
    """A gait to which simulated walks converge: a state, and the number of steps after which it repeats.

    Attributes
    ----------
    problem : the problem of its walker.
    state : ndarray, shape (k,) - section coordinates; with several contacts, the whole state.
    period : number of steps per cycle.
    phases, impact : modes of the step that ends in this state.
    count : number of grid points of the basin that converge to it.
    """

    problem: Problem
    state: Array
    period: int
    phases: tuple[Mode, ...]
    impact: Mode
    count: int

    def __str__(self) -> str:
        sticks = [mode.sticks for mode in self.phases]
        kind = "sticking" if all(sticks) and self.impact.sticks else "stick-slip" if any(sticks) else "slipping"
        return f"{kind}{'' if self.period == 1 else f', period {self.period}'}"

    @property
    def named_state(self) -> dict[str, float]:
        """The values of ``state`` by name."""
        names = self.problem.map_section.defining_names
        return dict(zip(names, self.state.tolist(), strict=True))
