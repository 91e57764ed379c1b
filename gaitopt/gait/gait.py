"""A gait: a periodic step found by the NLP, with everything that is known of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitopt.gait.measures import MEASURES
from gaitopt.gait.trajectory import Step
from gaitopt.mechanics import HybridSystem
from gaitopt.problem import Problem

Array = NDArray[np.float64]


class Status(StrEnum):
    """Whether a result may be trusted."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not_converged"
    INFEASIBLE = "infeasible"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True, slots=True, kw_only=True)
class Shooting:
    """The shooting nodes behind a gait.

    Attributes
    ----------
    times : ndarray, shape (K + 1,) - time since impact of every node [s].
    states : ndarray, shape (K + 1, n_z).
    intervals : number of intervals of every arc.
    residual : largest violation of the equalities.
    errors : ndarray, shape (n_phases,) - estimate of the integration error of the states in every phase.
    """

    times: Array
    states: Array
    intervals: tuple[int, ...]
    residual: float
    errors: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Gait:
    """A periodic step, or the remains of a failed attempt: only ``status == converged`` is a gait.

    Attributes
    ----------
    problem : what was asked.
    system : the hybrid system that was solved.
    p : ndarray, shape (n_p,) - parameter vector, freed ones as found.
    status, message : how the solver ended, in words.
    step : the step with arcs at Chebyshev points, or None after a failure.
    shooting : the nodes, or None after a failure.
    multipliers : complex ndarray - Floquet multipliers by implicit differentiation, largest modulus first.
    measures : scalars of the step by name, see ``measure``.
    freed : values of freed parameters by dotted key.
    solver : iterations and times [s] of the solver.
    verification : record of the last verification, if there was one.
    """

    problem: Problem
    system: HybridSystem
    p: Array
    status: Status
    message: str
    step: Step | None = None
    shooting: Shooting | None = None
    multipliers: NDArray[np.complex128] = field(default_factory=lambda: np.zeros(0, dtype=complex))
    measures: Mapping[str, float | None] = field(default_factory=dict)
    freed: Mapping[str, float] = field(default_factory=dict)
    solver: Mapping[str, float] = field(default_factory=dict)
    verification: Mapping[str, Any] | None = None

    @property
    def converged(self) -> bool:
        """Whether this is a gait."""
        return self.status is Status.CONVERGED

    @property
    def state(self) -> Array:
        """State just after the impact; shape (n_z,).

        Raises
        ------
        ValueError
            If the attempt failed and there is no gait.
        """
        if self.step is None:
            raise ValueError(f"{self.problem.name} is {self.status}: there is no gait to take a state from")
        return self.step.arcs[0].states[0]

    @property
    def spectral_radius(self) -> float | None:
        """Largest modulus of the multipliers; below one the gait is stable."""
        return float(np.abs(self.multipliers[0])) if self.multipliers.size else None

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

    def _friction_record(self) -> float | Mapping[str, float]:
        """The coefficient, or all numbers of the friction law by name where there are several."""
        values = dict(zip(self.system.parameters, map(float, self.p), strict=True))
        numbers = {key.removeprefix("friction."): values[key] for key in self.system.friction.parameters}
        return numbers.get("friction", numbers)

    def _motion_record(self) -> dict[str, Any]:
        if self.problem.is_open:  # and none was found
            return {"phases": [], "impact": None, "state": None}
        sequence = self.problem.sequence
        if self.step is None:
            modes = [{"mode": str(mode), "duration": None} for mode in sequence.phases]
            return {"phases": modes, "impact": str(sequence.impact), "state": None}
        return {
            "phases": [{"mode": str(mode), "duration": duration} for mode, duration in self.step.phases],
            "impact": str(sequence.impact),
            "state": dict(zip(self.system.state_names, map(float, self.state), strict=True)),
        }
