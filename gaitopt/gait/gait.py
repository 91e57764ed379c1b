"""A gait: a periodic cycle of steps solved by the NLP, with everything that is known of it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.errors import SolveError
from gaitopt.gait.cause import Cause
from gaitopt.gait.measures import MEASURES
from gaitopt.gait.motion import WalkerMotion
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.mechanics import Mode

REPEATED = 1e-6
"""Largest difference of the states of steps that are the same, relative to the largest coordinate in natural units."""


class Status(StrEnum):
    """Whether a result may be trusted."""

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
    states : ndarray, shape (n_nodes, n_z).
    intervals : number of intervals of every arc.
    residual : largest violation of the equalities, in natural units.
    errors : ndarray, shape (n_phases,) - estimated integration error of states and duration of every phase, likewise.
    """

    times: Array
    states: Array
    intervals: tuple[int, ...]
    residual: float
    errors: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Gait(WalkerMotion):
    """A periodic cycle of steps, or the remains of a failed attempt: only ``status == converged`` is a gait.

    Attributes
    ----------
    problem : the one that was solved.
    dynamics : the hybrid system that was solved at its parameters; freed ones have their solved values.
    status, message : how the solver ended, in words.
    steps : the steps of the cycle with arcs at Chebyshev points; empty after a failure.
    shooting : the nodes, or None after a failure.
    multipliers : complex ndarray - Floquet multipliers by implicit differentiation, largest modulus first.
    measures : scalars of the step by name, see ``measure``.
    freed : values of freed parameters by dotted key.
    solver : iterations and times [s] of the solver.
    verification : record of the last verification, if there was one.
    causes : why there is no gait, the first one being the worst; empty for a gait.
    """

    status: Status
    message: str
    steps: tuple[Step, ...] = ()
    shooting: Shooting | None = None
    multipliers: NDArray[np.complex128] = field(default_factory=lambda: np.zeros(0, dtype=complex))
    measures: Mapping[str, float | None] = field(default_factory=dict)
    freed: Mapping[str, float] = field(default_factory=dict)
    solver: Mapping[str, float] = field(default_factory=dict)
    verification: Mapping[str, Any] | None = None
    causes: tuple[Cause, ...] = ()

    def __repr__(self) -> str:
        if not self.steps:
            return f"<Gait {self.problem.name}: {self.status}>"
        radius = self.spectral_radius
        stable = "" if radius is None else f", radius {radius:.4g} ({'stable' if radius < 1 else 'unstable'})"
        return f"<Gait {self.problem.name}: {self.problem.cycle}, period {self.period:.6g} s{stable}, {self.status}>"

    @property
    def converged(self) -> bool:
        """Whether this is a gait."""
        return self.status is Status.CONVERGED

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
        """State just after the impact; shape (n_z,). Raises as ``motion``."""
        return self.motion[0].arcs[0].states[0]

    @property
    def arcs(self) -> tuple[Arc, ...]:
        """The arcs of all steps in order; times are counted from the impact before each step."""
        return tuple(arc for step in self.steps for arc in step.arcs)

    @property
    def phases(self) -> tuple[tuple[Mode, float], ...]:
        """Modes and durations [s] of the phases of all steps."""
        return tuple(phase for step in self.steps for phase in step.phases)

    @property
    def period(self) -> float:
        """Time of the whole cycle [s]."""
        return float(sum(step.period for step in self.steps))

    @property
    def spectral_radius(self) -> float | None:
        """Largest modulus of the multipliers; below one the gait is stable."""
        return float(np.abs(self.multipliers[0])) if self.multipliers.size else None

    @property
    def repeats_after(self) -> int:
        """Number of steps after which it repeats itself; fewer than it has where a shorter cycle is walked again."""
        n, sides = len(self.steps), self.system.walker.n_sides()
        if n <= sides:
            return n
        steps = self.problem.cycle.steps
        unit = self.dynamics.state_units
        states = np.array([step.arcs[0].states[0] for step in self.steps]) / unit

        def repeats(k: int) -> bool:
            same = steps[k:] == steps[:-k] and np.abs(states[k:] - states[:-k]).max() < REPEATED * np.abs(states).max()
            return n % k == 0 and bool(same)

        return next((k for k in range(sides, n, sides) if repeats(k)), n)

    def scalar(self, name: str) -> float:
        """A measure, ``spectral_radius``, ``state.NAME`` or a parameter by its key; NaN where it is not defined.

        Raises
        ------
        KeyError
            If the result has no such scalar.
        """
        if name.startswith("state."):
            return float(self.state[self.system.state_names.index(name.removeprefix("state."))])
        if name in self.system.parameters:
            return self.dynamics.parameter(name)
        value = self.spectral_radius if name == "spectral_radius" else self.measures[name]
        return float("nan") if value is None else value

    def verified(self, verification: Mapping[str, Any]) -> "Gait":
        """The same gait with the record of a verification."""
        return replace(self, verification=verification)

    def to_record(self) -> dict[str, Any]:
        """The result as one JSON object, with the keys of the command line."""
        return {
            "problem": self.problem.name,
            "status": str(self.status),
            "message": self.message,
            "friction": self._friction_record(),
            **self._motion_record(),
            **{name: self.measures.get(name) for name in MEASURES},
            "multipliers": [{"re": float(m.real), "im": float(m.imag)} for m in self.multipliers],
            "spectral_radius": self.spectral_radius,
            "parameters": dict(self.freed),
            "solver": dict(self.solver),
            "verification": self.verification,
        }

    def _tabulated(self) -> tuple[tuple[Step, ...], dict[str, str]]:
        return self.steps, {"problem": self.problem.name}

    def _friction_record(self) -> float | Mapping[str, float]:
        """The coefficient, or all numbers of the friction law by name where there are several."""
        values = self.dynamics.parameters
        numbers = {key.removeprefix("friction."): values[key] for key in self.system.friction.parameters}
        return numbers.get("friction", numbers)

    def _motion_record(self) -> dict[str, Any]:
        if self.problem.is_open:  # and none was found
            return {"n_steps": None, "phases": [], "impact": None, "state": None}
        cycle = self.problem.cycle
        counted = {"n_steps": len(cycle.steps), "impact": str(cycle.impact)}
        if not self.steps:
            return {
                **counted,
                "phases": [{**mode.record, "duration": None} for mode in cycle.phases],
                "state": None,
            }
        record = {**counted, "phases": _phase_records(self.phases), "state": self._state_record(self.state)}
        if len(self.steps) > 1:
            starts = [step.arcs[0].states[0] for step in self.steps]
            record["steps"] = [self._step_record(*pair) for pair in zip(self.steps, starts, strict=True)]
        return record

    def _step_record(self, step: Step, state: Array) -> dict[str, Any]:
        return {
            "phases": _phase_records(step.phases),
            "impact": str(step.final_impact.mode),
            "period": step.period,
            "step_length": step.final_impact.step_length,
            "state": self._state_record(state),
        }


def _phase_records(phases: Iterable[tuple[Mode, float]]) -> list[dict[str, Any]]:
    return [{**mode.record, "duration": duration} for mode, duration in phases]
