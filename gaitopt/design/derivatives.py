"""Derivatives of every quantity in the result of a gait by every continuous parameter.

    dw/dp = -F_w^-1 F_p,      d quantity / dp = quantity_w dw/dp + quantity_p      see ``design.sensitivity``

A derivative does not exist if the branch of the gait has a fold there, if multipliers coincide, if two multipliers have
the largest modulus, or if several values are an extremum. The table then contains null, with the reason.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.design.sensitivity import Multiplier, Sensitivity
from gaitopt.design.spectral_radius import RADIUS
from gaitopt.display import Tabulated, counted
from gaitopt.errors import SolveError, UnknownNameError
from gaitopt.gait.frames import data_frame
from gaitopt.gait.gait import Gait
from gaitopt.problem.faults import nearest_keys
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import SCALARS, relevant_scalars, unit_of
from gaitopt.solver.assembly import solution_of
from gaitopt.solver.newton import polish, refine
from gaitopt.solver.rollout import retraced

if TYPE_CHECKING:
    from pandas import DataFrame

SMALLEST_DISTANCE = 1e-6
"""Distance, relative to the largest multiplier or to one, below which two multipliers are a double one: rounding of the
return map moves it by the root of the rounding."""
LARGEST_DERIVATIVE = 1e9
"""Derivative of a state, in natural units and relative to the parameter, above which the gait is at a fold."""


@dataclass(frozen=True, kw_only=True)
class Derivatives(Tabulated, ReadOnlyArrays):
    """The derivatives of a gait's quantities by its parameters.

    Attributes
    ----------
    problem : problem of the gait.
    quantities : ``state.NAME``, ``phases.K.duration``, the scalars of the result, ``multipliers.K.re``, of complex ones
        also ``multipliers.K.im``, and ``spectral_radius``.
    parameters : dotted keys of the continuous parameters.
    at : ndarray, shape (n_parameters,) - values of the parameters.
    values : ndarray, shape (n_quantities,) - values of the quantities.
    table : ndarray, shape (n_quantities, n_parameters) - the derivatives; NaN where there is none.
    reasons : why a quantity has no derivatives, or not by all parameters.
    """

    problem: Problem
    quantities: tuple[str, ...]
    parameters: tuple[str, ...]
    at: Array
    values: Array
    table: Array
    reasons: Mapping[str, str]

    def __repr__(self) -> str:
        quantities = counted(len(self.quantities), "quantity", "quantities")
        return f"<Derivatives of {self.problem.name}: {quantities} by {counted(len(self.parameters), 'parameter')}>"

    def of(self, quantity: str, parameter: str) -> float:
        """One derivative, in SI units; NaN where there is none.

        Raises
        ------
        UnknownNameError
            If the gait has no such quantity or continuous parameter.
        """
        for name, known in ((quantity, self.quantities), (parameter, self.parameters)):
            if name not in known:
                raise UnknownNameError(f"{name} is not in the table of derivatives{nearest_keys(name, known)}")
        return float(self.table[self.quantities.index(quantity), self.parameters.index(parameter)])

    def unit(self, quantity: str, parameter: str) -> str:
        """Unit of a derivative; empty for a ratio."""
        above, below = (unit_of(key, self.problem) for key in (quantity, parameter))
        if above == below:
            return ""
        divisor = f"({below})" if " " in below or "/" in below else below
        return f"{above or '1'}/{divisor}" if below else above

    @property
    def levers(self) -> list[tuple[str, float]]:
        """Change of the spectral radius per relative increase of each parameter, the largest first."""
        row = self.table[self.quantities.index(RADIUS)] * self.at
        known = [(key, float(value)) for key, value in zip(self.parameters, row, strict=True) if value]
        return sorted((pair for pair in known if np.isfinite(pair[1])), key=lambda pair: -abs(pair[1]))

    def to_frame(self) -> "DataFrame":
        """A pandas data frame: one row per quantity and parameter, with the derivative and its unit."""
        header = ("quantity", "parameter", "derivative", "unit")
        return data_frame(header, self._rows(), {}, problem=self.problem.name)

    def _rows(self) -> Iterator[tuple[str, str, float, str]]:
        for quantity, row in zip(self.quantities, self.table.tolist(), strict=True):
            for parameter, value in zip(self.parameters, row, strict=True):
                yield quantity, parameter, value, self.unit(quantity, parameter)

    def to_record(self) -> dict[str, Any]:
        """One JSON object: ``derivatives`` by quantity and parameter, null where there is none; values and units."""
        by_quantity = {
            quantity: {
                parameter: None if np.isnan(value) else value
                for parameter, value in zip(self.parameters, row, strict=True)
            }
            for quantity, row in zip(self.quantities, self.table.tolist(), strict=True)
        }
        units = {key: unit_of(key, self.problem) for key in (*self.quantities, *self.parameters)}
        return {
            "problem": self.problem.name,
            "parameters": dict(zip(self.parameters, self.at.tolist(), strict=True)),
            "values": dict(zip(self.quantities, self.values.tolist(), strict=True)),
            "derivatives": by_quantity,
            "reasons": dict(self.reasons),
            "units": {key: unit for key, unit in units.items() if unit},
        }


def continuous_parameters(gait: Gait) -> tuple[str, ...]:
    """Dotted keys of the parameters of a gait that are not whole numbers."""
    stated = gait.problem.parameters
    return tuple(key for key in gait.system.parameters if not isinstance(stated.get(key), int))


def derivatives(gait: Gait) -> Derivatives:
    """The derivatives of a gait.

    Raises
    ------
    SolveError
        If there is no gait, or if it is not a function of its parameters, as at a fold.
    """
    name, keys = gait.problem.name, continuous_parameters(gait)
    if not gait.converged:
        raise SolveError(f"{name} is {gait.status}, so there is nothing to differentiate: {gait.message}")
    at = np.array([gait.dynamics.parameter(key) for key in keys])
    try:
        known = retraced(gait).on_mesh(keys) if gait.shooting is None else solution_of(gait, keys)
        sensitivity = Sensitivity(refine(polish(known)))  # with the parameters as unknowns
    except RuntimeError:  # singular
        raise _not_a_function(name) from None
    sizes = np.abs(sensitivity.slopes[: gait.state.size] * at / gait.dynamics.state_units[:, None])
    if not sizes.max(initial=0.0) < LARGEST_DERIVATIVE:
        raise _not_a_function(name)
    rows, reasons = dict[str, tuple[float, Array]](), dict[str, str]()
    for state in gait.system.state_names:
        rows[f"state.{state}"] = sensitivity.smooth(f"state.{state}")
    for phase in range(len(gait.phases)):
        rows[f"phases.{phase}.duration"] = sensitivity.smooth(f"phases.{phase}.duration")
    for key in relevant_scalars([gait.to_record()]):
        if key not in SCALARS or key == RADIUS or gait.measures[key] is None:
            continue
        found = sensitivity.smooth(key) if SCALARS[key].formula else sensitivity.extremum(key)
        if found is None:
            continue
        value, gradient = found[-2:]
        rows[key] = value, gradient
        if np.isnan(gradient).any():
            reasons[key] = "several values are the extremum, and some parameters change them differently"
    rows |= dict(_stability(sensitivity.multipliers(), len(keys), reasons))
    return Derivatives(
        problem=gait.problem,
        quantities=tuple(rows),
        parameters=keys,
        at=at,
        values=np.array([value for value, _ in rows.values()]),
        table=np.array([gradient for _, gradient in rows.values()]).reshape(len(rows), len(keys)),
        reasons=reasons,
    )


def _not_a_function(name: str) -> SolveError:
    return SolveError(
        f"{name}: the gait is not a function of its parameters here, as at a fold; take another point of its branch"
    )


def _stability(
    multipliers: Sequence[Multiplier], n: int, reasons: dict[str, str]
) -> Iterator[tuple[str, tuple[float, Array]]]:
    """Multipliers and spectral radius with their derivatives by n parameters; the reason if they have none."""
    values, none = np.array([m.value for m in multipliers]), np.full(n, np.nan)
    near = SMALLEST_DISTANCE * max(1.0, float(np.abs(values).max(initial=0.0)))
    pairs = (pair for pair in combinations(range(values.size), 2) if abs(values[pair[0]] - values[pair[1]]) < near)
    multiple = {k for pair in pairs for k in pair}
    for k, (value, gradient) in enumerate(multipliers):
        for axis, number, slope in (("re", value.real, gradient.real), ("im", value.imag, gradient.imag)):
            key = f"multipliers.{k}.{axis}"
            if axis == "im" and not value.imag:
                continue
            if k in multiple:
                reasons[key] = "the multiplier is multiple"
            yield key, (number, none if k in multiple else slope)
    if not values.size:
        return
    value, gradient = multipliers[0]
    tied = [k for k in range(1, values.size) if abs(abs(values[k]) - abs(value)) < near]
    gradient_of_radius = none
    if 0 in multiple:
        reasons[RADIUS] = "the largest multiplier is multiple"
    elif any(abs(values[k] - np.conj(value)) > near for k in tied):
        reasons[RADIUS] = "two multipliers have the largest modulus"
    elif abs(value) < near:
        reasons[RADIUS] = "the largest multiplier is zero, where its modulus has a kink"
    else:
        gradient_of_radius = np.real(np.conj(value) * gradient) / abs(value)
    yield RADIUS, (float(abs(value)), gradient_of_radius)
