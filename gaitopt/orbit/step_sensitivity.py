"""Derivative of the return map along simulated steps: variational equations and saltation.

    d/dt Z = f_z Z  along every arc,     Z -> S Z  at every switch,     Z -> R_z (I - f grad g' / g_dot) Z  at impact

S is the saltation matrix of ``mechanics.saltation``. A breakpoint of the control lies at a fixed time since the
impact, the same for every neighbouring motion, so that it leaves deviations as they are.
"""

from collections.abc import Sequence

import numpy as np
from casadi import Function

from gaitopt.arrays import Array
from gaitopt.gait import Arc, Step
from gaitopt.mechanics import Dynamics, Mode, ending_margin, margin_names, margin_unit
from gaitopt.mechanics.buffered import buffered
from gaitopt.mechanics.saltation import projection, saltation
from gaitopt.simulation import Stepper

AT_EVENT = 1e-9
"""A margin this close to zero, in natural units, has fallen; where a torque jumps at a breakpoint it is far from it."""


class StepSensitivity:
    """How small deviations on the section pass one step of a system at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    section_mode : mode of the impact whose section coordinates are used.
    stepper : what integrates the variational equations.

    References
    ----------
    Gamus & Or (2013), section II.C.
    """

    def __init__(self, dynamics: Dynamics, section_mode: Mode, stepper: Stepper) -> None:
        self._system = system = dynamics.system
        self._sides = [(dynamics, stepper)]
        for side in range(1, system.walker.n_sides()):
            own = dynamics.standing(side)
            self._sides.append((own, stepper.at(own)))
        self._indices, self._lifted = system.section(section_mode), system.section(Mode.SLIP_FORWARD)

    @np.errstate(divide="ignore", invalid="ignore")  # an event that is grazed has no rate, and its map no derivative
    def jacobian(self, steps: Sequence[Step]) -> Array:
        """Derivative of the return map along complete steps that start and end on the section, shape (n_xi, n_xi).

        It is not finite if a step grazes an event.
        """
        start = steps[0].arcs[0].states[0]
        lift = _matrix(self._system.lift_jacobian, start[self._lifted], self._sides[0][0].p)
        deviations = lift[:, : self._indices.size]
        for step in steps:
            deviations = self._through(step, deviations)
        return deviations[self._indices]

    def _through(self, step: Step, deviations: Array) -> Array:
        """Deviations just after the impact of a step from those at its start, shape (n_z, n_xi)."""
        system = self._system
        for arc, after in zip(step.arcs, (*step.arcs[1:], None), strict=True):
            data, ends = system.data(arc.segment), arc.times[[0, -1]]
            dynamics, stepper = self._sides[arc.side]
            deviations = stepper.propagate_variations(arc.mode, data, arc.states[0], deviations, ends)
            if after is None or after.segment == arc.segment or _ends_at_breakpoint(dynamics, arc, after):
                deviations = _event(dynamics, arc, after) @ deviations
        reset = _matrix(system.impact_jacobian(step.final_impact.mode), step.arcs[-1].states[-1], dynamics.p)
        after_impact = reset @ deviations
        after_impact[system.n_shape] = 0.0  # x is counted from the new stance foot
        return np.asarray(after_impact)


def _ends_at_breakpoint(dynamics: Dynamics, arc: Arc, after: Arc) -> bool:
    """Whether the event of a mode falls on a breakpoint of the control, so that no arc lies between the two."""
    if after.mode is arc.mode:
        return False
    name = ending_margin(arc.mode, after.mode)
    margins = dynamics.margins(arc.mode, arc.segment, arc.times[-1:], arc.states[-1:])[0]
    unit = margin_unit(name, dynamics.scales)
    return bool(abs(margins[margin_names(arc.mode).index(name)]) <= AT_EVENT * unit)


def _event(dynamics: Dynamics, arc: Arc, after: Arc | None) -> Array:
    """What the event at the end of an arc does to deviations; shape (n_z, n_z)."""
    system, z, p, data = dynamics.system, arc.states[-1], dynamics.p, dynamics.system.data(arc.segment)
    row = margin_names(arc.mode).index(ending_margin(arc.mode, None if after is None else after.mode))
    flow, gradients, rates = buffered(system.linearized(arc.mode))(arc.end, z, p, data)
    gradient, rate = gradients.reshape(z.size, -1)[:, row], rates[row].item()
    if after is None:
        return projection(flow, gradient, rate)
    (flow_after,) = buffered(system.flow(after.mode))(after.start, after.states[0], p, data)
    return saltation(flow, flow_after, gradient, rate, _reset(dynamics, arc, after))


def _reset(dynamics: Dynamics, arc: Arc, after: Arc) -> Array | None:
    """Derivative of the reset from one arc to the next; None where no stop locks."""
    if arc.mode.locked == after.mode.locked:
        return None
    slides = after.states[0][-1] or after.mode.flies
    struck = after.mode if slides else after.mode.with_contact(Mode.STICK)
    return _matrix(dynamics.system.impact_jacobian(struck), arc.states[-1], dynamics.p).copy()


def _matrix(function: Function, *values: Array | float) -> Array:
    """The one output of a function as a matrix, valid until it is called again."""
    return buffered(function)(*values)[0].reshape(function.size_out(0), order="F")
