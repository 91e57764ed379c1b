"""Zero dynamics of a gait under virtual constraints: the motion that remains while all outputs are zero.

Let d be the direction in which no motor acts, E' d = 0, and sigma = d' M dq the momentum along it. If there are n - 1
outputs for n shape coordinates, and if neither dampers and springs nor the derivative of the inertia M(q) act along d,
the surface of the constraints has one coordinate, the phase theta, and

    dtheta/dt = kappa1(theta) sigma      kappa1 = 1 / (d' M dq/dtheta)
    dsigma/dt = kappa2(theta)            kappa2 = -d' (weight)

so that zeta = sigma^2 / 2 is the kinetic energy that belongs to the potential V_zero(theta) = -int kappa2 / kappa1
dtheta, which is zero just after the impact. A sticking impact that leads back to the surface maps sigma_plus =
delta_zero sigma_minus.
Hence

    zeta -> delta_zero^2 zeta - V_zero(theta_minus)

is the return map on the surface: delta_zero^2 is a multiplier. A step is possible while delta_zero^2 zeta exceeds the
largest value of V_zero.

References
----------
Westervelt, Grizzle & Koditschek (2003), Hybrid zero dynamics of planar biped walkers, IEEE TAC 48(1), theorem 3.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from casadi import Function
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.records import ConstraintRecord, ZeroDynamicsRecord
from gaitopt.gait.trajectory import Arc, Step, along
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.model.virtual_constraints import Law, VirtualConstraints

ON_SURFACE = 1e-9
"""Largest output, and largest rate of an output in natural units, that errors of the states cause on the constraint
surface."""
NO_FORCE = 1e-9
"""A generalised force below this fraction of weight times length counts as zero; it is due to rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstraintMeasures:
    """Numbers of a gait under virtual constraints.

    Attributes
    ----------
    decoupling_min_singular_value : smallest singular value of the decoupling matrix along the gait [1/(kg m^2)].
    invariant : whether all outputs are zero all along the gait, including just after the impact.
    delta_squared, potential_max : delta_zero^2, and the largest V_zero [kg^2 m^4/s^2]. They are None unless the gait is
        on the constraint surface, sticks throughout, and has one degree of freedom on which no motor, damper or spring
        acts.
    """

    decoupling_min_singular_value: float
    invariant: bool
    delta_squared: float | None = None
    potential_max: float | None = None

    def to_record(self) -> ConstraintRecord:
        """The entries of a gait's record."""
        zero: ZeroDynamicsRecord = {
            "delta_squared": self.delta_squared,
            "potential_max": self.potential_max,
            "invariant": self.invariant,
        }
        return {"decoupling_min_singular_value": self.decoupling_min_singular_value, "zero_dynamics": zero}


def constraint_measures(steps: Sequence[Step]) -> ConstraintMeasures | None:
    """The numbers of a gait under virtual constraints; None under another control law.

    Parameters
    ----------
    steps : the steps of one cycle, with arcs at Chebyshev points.
    """
    arcs = [arc for step in steps for arc in step.arcs]
    if not (arcs and isinstance(arcs[0].dynamics.system.control, VirtualConstraints)):
        return None
    known = [_evaluated(arc, arc.dynamics.system.quantities(arc.mode)) for arc in arcs]
    time = arcs[0].dynamics.scales.time
    largest = max(float(np.abs(np.hstack([q["outputs"], time * q["rates"]])).max()) for q in known)
    singular, invariant = min(_smallest_singular_value(q["decoupling"]) for q in known), largest < ON_SURFACE
    zero = _zero_dynamics(steps) if invariant else None
    if zero is None:
        return ConstraintMeasures(decoupling_min_singular_value=singular, invariant=invariant)
    return ConstraintMeasures(
        decoupling_min_singular_value=singular, invariant=True, delta_squared=zero[0], potential_max=zero[1]
    )


def has_zero_dynamics(system: HybridSystem) -> bool:
    """Whether a law leaves one degree of freedom while its outputs are zero, which a sticking gait may follow."""
    law = system.control
    if not isinstance(law, VirtualConstraints) or law.law is not Law.LINEARISING:
        return False
    if law.limits or law.step_feedback is not None:
        return False
    return not system.walker.pushes and len(law.outputs) == len(system.walker.shape) - 1


def driven_columns(system: HybridSystem, E: Array) -> Array:
    """The rows of E' (..., n_u, n_shape) that belong to the motors of the outputs."""
    assert isinstance(system.control, VirtualConstraints)
    return E[..., [system.walker.actuators.index(name) for name in system.control.driven_by(system.walker)], :]


def unactuated_direction(system: HybridSystem, E: Array) -> Array:
    """The direction d of the shape in which no motor acts, E' d = 0, from all motors' E' (n_u, n_shape) at a state."""
    d = np.linalg.svd(driven_columns(system, E))[2][-1]
    return np.asarray(d / d[np.abs(d).argmax()])


def _evaluated(arc: Arc, function: Function) -> dict[str, Array]:
    """The outputs of a function (t, z, p, r) along an arc, by name; matrices are transposed, see ``BufferedMap``."""
    return {name: value.copy() for name, value in zip(function.name_out(), along(arc, function), strict=True)}


def _smallest_singular_value(matrices: Array) -> float:
    """Smallest singular value of the matrices (m, k, k), or (m, 1), along an arc; zero where one is singular."""
    size = matrices.shape[1]
    square = matrices.reshape(-1, size, size)
    if curves.roots(np.linalg.det(square)).size:
        return 0.0
    smallest = np.linalg.svd(square, compute_uv=False)[:, -1]
    return -curves.maximum(-np.asarray(smallest, dtype=float))[1]


def _zero_dynamics(steps: Sequence[Step]) -> tuple[float, float] | None:
    """delta_zero^2 and the largest V_zero of a gait on the constraint surface; None where they are not defined."""
    arc, last = steps[0].arcs[0], steps[-1].final_impact
    system, scales = arc.dynamics.system, arc.dynamics.scales
    sticks = len(steps) == len(steps[0].arcs) == 1 and arc.mode is last.mode is Mode.STICK
    if not sticks or not has_zero_dynamics(system):
        return None
    terms = _evaluated(arc, system.momentum(arc.mode))
    E = terms["E"].reshape(arc.times.size, len(system.walker.actuators), len(system.walker.shape))
    d, E = unactuated_direction(system, E[0]), driven_columns(system, E)
    if np.abs(E @ d).max() > NO_FORCE or np.abs(terms["rest"] @ d).max() > NO_FORCE * scales.energy:
        return None
    sigma, kappa2 = terms["momentum"] @ d, -terms["weight"] @ d
    after = replace(arc, times=arc.times[:1], states=last.state[None])
    delta = float((_evaluated(after, system.momentum(arc.mode))["momentum"] @ d)[0] / sigma[-1])
    series = chebyshev.chebint(curves.coefficients(-kappa2 * sigma), lbnd=-1) * arc.duration / 2
    # the integral runs over time, because kappa2 / kappa1 dtheta = kappa2 sigma dt
    potential = chebyshev.chebval(curves.points(arc.times.size), series)
    return delta**2, curves.maximum(np.asarray(potential, dtype=float))[1]
