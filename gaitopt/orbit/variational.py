"""Derivative of the return map along a simulated step: variational equations and saltation.

    d/dt Z = f_z Z  along every arc,     Z -> S Z  at every switch,     Z -> R_z (I - f grad g' / g_dot) Z  at impact

S is the saltation matrix of ``mechanics.saltation``. A breakpoint of the control lies at a fixed time since the
impact, the same for every neighbouring motion, so that it leaves deviations as they are.
"""

import numpy as np
from numpy.typing import NDArray

from gaitopt.gait import Arc, Step
from gaitopt.mechanics import HybridSystem, Mode, ending_margin, margin_names
from gaitopt.mechanics.saltation import projection, saltation
from gaitopt.simulation import Stepper

Array = NDArray[np.float64]


@np.errstate(divide="ignore", invalid="ignore")  # an event that is grazed has no rate, and its map no derivative
def return_map_jacobian(system: HybridSystem, p: Array, step: Step, section_mode: Mode, stepper: Stepper) -> Array:
    """Derivative of the return map along one complete step, shape (n_xi, n_xi); not finite if it grazes an event.

    Parameters
    ----------
    step : a complete step that starts and ends on the section of ``section_mode``.
    section_mode : mode of the impact whose section coordinates are used.
    stepper : what integrates the variational equations.

    References
    ----------
    Gamus & Or (2013), section II.C.
    """
    indices = system.section(section_mode)
    xi = step.arcs[0].states[0][system.section(Mode.SLIP_FORWARD)]
    deviations = np.asarray(system.lift_jacobian(xi, p))[:, : indices.size]
    for arc, after in zip(step.arcs, (*step.arcs[1:], None), strict=True):
        data, ends = system.control.data(arc.segment), arc.times[[0, -1]]
        deviations = stepper.transport(arc.mode, data, arc.states[0], deviations, ends)
        deviations = _across(system, p, arc, after) @ deviations
    assert step.impact is not None, "only a complete step returns to the section"
    reset = np.asarray(system.impact_jacobian(step.impact.mode)(step.arcs[-1].states[-1], p))
    return (reset @ deviations)[indices]


def _across(system: HybridSystem, p: Array, arc: Arc, after: Arc | None) -> Array:
    """What the event at the end of an arc does to deviations."""
    if after is not None and after.segment != arc.segment:
        return np.eye(system.n_z)
    z, data = arc.states[-1], system.control.data(arc.segment)
    flow, _, gradients = (np.asarray(m) for m in system.linearisation(arc.mode)(arc.end, z, p, data))
    row = margin_names(arc.mode).index(ending_margin(arc.mode, None if after is None else after.mode))
    rate = float(system.events(arc.mode)(arc.end, z, p, data)[1][row])
    if after is None:
        return projection(flow.ravel(), gradients[row], rate)
    flow_after = np.asarray(system.flow(after.mode)(after.start, after.states[0], p, data)).ravel()
    return saltation(flow.ravel(), flow_after, gradients[row], rate)
