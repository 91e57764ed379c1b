"""Derivatives of a gait's return map by the state on its section and by parameters, by implicit differentiation.

    xi_(n+1) - xi* = A (xi_n - xi*) + B (u_n - u*) + ...        A = dPi/dxi,  B = dPi/du

The parameters u, of control, walker or friction, act during one whole cycle: also in the lift of the section
coordinates to a state and in the last impact.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.errors import ProblemError, SolveError, UnknownNameError
from gaitopt.gait.gait import Gait, require_gait
from gaitopt.problem.faults import nearest_keys
from gaitopt.solver.assembly import solution_of
from gaitopt.solver.newton import parameter_sensitivity, section_sensitivity


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReturnMapDerivatives(ReadOnlyArrays):
    """The linearised return map of a gait, in SI.

    Attributes
    ----------
    A : ndarray, shape (n, n) - derivative by the section coordinates.
    B : ndarray, shape (n, m) - derivative by the parameters, at fixed section coordinates.
    names : names of the n section coordinates.
    keys : dotted keys of the m parameters.
    """

    A: Array
    B: Array
    names: tuple[str, ...]
    keys: tuple[str, ...]


def return_map_derivatives(gait: Gait, keys: Sequence[str] = ()) -> ReturnMapDerivatives:
    """Exact derivatives of a gait's return map by the state just after the impact and by parameters.

    Parameters
    ----------
    gait : a gait; the return map is that of its whole cycle.
    keys : dotted keys of continuous parameters of control, walker or friction. They act during the whole cycle.

    Returns
    -------
    derivatives : ``A`` (n, n) and ``B`` (n, m) in SI, ``names`` of the section coordinates and ``keys``.

    Raises
    ------
    ProblemError
        If the name of a problem is given in place of its gait, or a key twice.
    SolveError
        If the gait is a failed solve, or comes from a file, where its nodes are not kept.
    UnknownNameError
        If a key is not that of a continuous parameter.
    """
    require_gait(gait, "return_map_derivatives")
    name, keys = gait.problem.name, (keys,) if isinstance(keys, str) else tuple(keys)
    if not gait.converged:
        raise SolveError(f"{name} is {gait.status}: {gait.message}")
    if gait.shooting is None:
        raise SolveError(f"{name}: a gait from a file has no shooting nodes; solve its problem again")
    for k, key in enumerate(keys):
        if key not in gait.system.parameters:
            raise UnknownNameError(f"{key} is not a parameter of {name}{nearest_keys(key, gait.system.parameters)}")
        if isinstance(gait.problem.parameters.get(key), int):
            raise UnknownNameError(f"{key} is a whole number, by which the return map has no derivative")
        if key in keys[:k]:
            raise ProblemError(f"{key} is given twice")
    at = solution_of(gait, keys)
    section = gait.system.section(gait.cycle)
    return ReturnMapDerivatives(
        A=section_sensitivity(at)[1], B=parameter_sensitivity(at), names=section.names, keys=keys
    )
