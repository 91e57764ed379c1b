"""Exact derivatives of one step by its start state and by the tiles under its feet.

Along an arc the deviations Z of the state by start state and parameters follow

    dZ/dt = f_z Z + f_p

An event at the margin g = 0 is shifted by the time tau; the state just after it, at the time without the shift, is

    tau = -(g_z Z + g_p) / (dg/dt)           Z -> R_z (Z + f_minus tau) + R_p - f_plus tau

At the impact that ends the step the last term is absent, because states are compared just after the impact; tau is then
the change of the period. An extremum inside an arc, such as the clearance, changes by its partial derivatives alone; at
the end of an arc its rate times tau is added.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.gait import curves
from gaitopt.gait.measures import observe
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.integration import CompiledStep, Integration
from gaitopt.model.buffered import Buffers, buffered
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import FOOT, SWING_FOOT
from gaitopt.model.transitions import CONE
from gaitopt.simulation.ground import OnTiles
from gaitopt.verification.return_map import event_at_end

RTOL, ATOL = 1e-12, 1e-13
"""Relative and absolute tolerance of the deviations, whose entries are of the order of one in SI."""
OUTPUTS = ("period", "step_length", "foot_clearance", "cone_distance")
"""Quantities of a step that a tile changes [s, m, m, N]; ``cone_distance`` is min(mu f_n - |f_t|) while sticking."""
AT_END = 1e-6
"""An extremum counts as that at the end of an arc if it is this close to the end, relative to the duration."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepDerivatives(ReadOnlyArrays):
    """Derivatives of one step by its start state and by parameters.

    Attributes
    ----------
    state_by_state, state_by_tiles : ndarrays, shapes (n_z, n_z) and (n_z, m) - of the state after the impact.
    outputs_by_state, outputs_by_tiles : ndarrays, shapes (4, n_z) and (4, m) - derivatives of
        ``OUTPUTS``; NaN where there is none, such as that of the distance to the cone of a step that slips.
    """

    state_by_state: Array
    state_by_tiles: Array
    outputs_by_state: Array
    outputs_by_tiles: Array


def tile_parameters(on_tiles: OnTiles, quantity: str) -> dict[str, tuple[tuple[int, float], ...]]:
    """The parameters through which a quantity of a tile acts on a step: their indices and weights.

    The key ``landed`` is for the step that ends on the tile, ``stands`` for the next one, which begins on it.
    """
    if quantity == "friction":
        return {
            step: tuple(
                dict.fromkeys((on_tiles.parameter_index(f"{foot}.{kind}"), 1.0) for kind in ("static", "kinetic"))
            )
            for step, foot in (("landed", SWING_FOOT), ("stands", FOOT))
        }
    swing = on_tiles.parameter_index(f"{SWING_FOOT}.{quantity}")
    if quantity == "height":  # the next tile is measured from the one under the foot
        return {"landed": ((swing, 1.0),), "stands": ((swing, -1.0),)}
    return {"landed": ((swing, 1.0),), "stands": ((on_tiles.parameter_index(f"{FOOT}.{quantity}"), 1.0),)}


def step_derivatives(step: Step, dynamics: Dynamics, indices: Sequence[int]) -> StepDerivatives:
    """Derivatives of a step of a walker on one foot, which ends with a landing.

    Parameters
    ----------
    step : a step whose arcs are given at Chebyshev points.
    dynamics : the system on tiles, at parameters at which it takes this step.
    indices : indices of the m parameters by which the step is differentiated.

    Raises
    ------
    FloatingPointError
        If the step grazes an event, where it has no derivative.
    """
    system, at = dynamics.system, tuple(indices)
    n, m = system.n_z, len(at)
    Z = np.hstack([np.eye(n), np.zeros((n, m))])
    outputs = np.full((len(OUTPUTS), n + m), np.nan)
    height, cone = _highest(step.arcs), _nearest_to_cone(step, dynamics)
    sticks = all(mode.sticks for mode, _ in step.phases) and step.final_impact.mode.sticks
    for arc, after in zip(step.arcs, (*step.arcs[1:], None), strict=True):
        if height is not None and height[0] is arc:
            at_top = _flowed(dynamics, arc, Z, height[1], at)
            gradient = buffered(system.swing_height_gradient(at))(_state_at(arc, height[1]), dynamics.p)[0]
            outputs[2] = gradient[:n] @ at_top
            outputs[2, n:] += gradient[n:]
        first = Z
        Z = _flowed(dynamics, arc, Z, arc.end, at)
        if after is not None and after.segment != arc.segment:  # a breakpoint of the control has a fixed time
            continue
        row, struck = event_at_end(arc, after, step.final_impact.mode)
        z, p, data = arc.states[-1], dynamics.p, system.data(arc.segment)
        f, by_z, rates = (value.copy() for value in buffered(system.linearized(arc.mode))(arc.end, z, p, data))
        names = system.transitions.margin_names(arc.mode)
        (by_p,) = (value.copy() for value in buffered(system.margins_by_parameters(arc.mode, at))(arc.end, z, p, data))
        by_z, by_p = by_z.reshape((len(names), n), order="F"), by_p.reshape((len(names), m), order="F")
        g = names.index(row.guard)
        tau = -(by_z[g] @ Z + np.concatenate([np.zeros(n), by_p[g]])) / rates[g]
        if cone is not None and sticks and cone[0] is arc:
            outputs[3] = _change_of_cone(dynamics, arc, first, cone, tau, at)
        Z = Z + np.outer(f, tau)
        if struck is not None:
            jacobian = buffered(system.reset_jacobian(struck, arc.mode, ends_step=after is None))(z, p)[0]
            of_landing = buffered(system.landing_by_parameters(struck, arc.mode, after is None, at))(z, p)
            R_p, length_z, length_p = (value.copy() for value in of_landing)
            if after is None:
                outputs[1] = length_z @ Z
                outputs[1, n:] += length_p
            Z = jacobian.reshape((n, n), order="F") @ Z
            Z[:, n:] += R_p.reshape((n, m), order="F")
        if after is None:
            outputs[0] = tau
            Z[system.n_shape] = 0.0  # x is counted from the new stance foot
        else:
            (f_plus,) = buffered(system.flow(after.mode))(after.start, after.states[0], p, system.data(after.segment))
            Z = Z - np.outer(f_plus, tau)
    if not (np.isfinite(Z).all() and np.isfinite(outputs[:2]).all()):
        raise FloatingPointError("the step grazes an event, where it has no derivative")
    return StepDerivatives(
        state_by_state=Z[:, :n],
        state_by_tiles=Z[:, n:],
        outputs_by_state=outputs[:, :n],
        outputs_by_tiles=outputs[:, n:],
    )


def _flowed(dynamics: Dynamics, arc: Arc, Z: Array, end: float, indices: tuple[int, ...]) -> Array:
    """Deviations at the time ``end`` of an arc, from the deviations ``Z`` at its start."""
    system = dynamics.system
    if end <= arc.start:
        return Z
    function, data = system.varied(arc.mode, indices), system.data(arc.segment)
    step = CompiledStep(function, function, rtol=RTOL, atol=ATOL)
    step.load(dynamics.p, data)
    y = np.concatenate([arc.states[0], Z.ravel(order="F")])
    (f,) = Buffers(function)(arc.start, y, dynamics.p, data)
    integration = Integration(step, arc.start, y, f.copy(), end, (end - arc.start) / 25)
    while not integration.finished:
        integration.advance()
    return np.asarray(integration.y[system.n_z :].reshape(Z.shape, order="F"))


def _highest(arcs: Sequence[Arc]) -> tuple[Arc, float] | None:
    """The arc and the time at which the swing foot is highest after mid-swing, see ``measures.foot_clearance``."""
    found: list[tuple[float, Arc, float]] = []
    for arc in (arc for arc in arcs if len(arc.times) > 2):
        foot = observe(arc).swing_foot
        ahead, start = foot[:, 0] - arc.states[:, arc.states.shape[1] // 2 - 1], -1.0
        if arc.mode.touching:
            if ahead[-1] <= 0:
                continue
            passing = curves.roots(ahead)
            start = float(passing[-1]) if passing.size else -1.0
        s, height = curves.maximum(foot[:, 1], start=start)
        found.append((height, arc, arc.start + arc.duration * (s + 1) / 2))
    best = max(found, key=lambda each: each[0], default=None)
    return None if best is None else best[1:]


def _state_at(arc: Arc, time: float) -> Array:
    s = np.array([2 * (time - arc.start) / arc.duration - 1])
    return np.asarray(curves.evaluate(curves.coefficients(arc.states), s)[0])


def _nearest_to_cone(step: Step, dynamics: Dynamics) -> tuple[Arc, float, str] | None:
    """The arc, the time and the margin at which a sticking foot is nearest to the edge of its cone."""
    found: list[tuple[float, Arc, float, str]] = []
    for arc in (arc for arc in step.arcs if arc.mode.sticks and len(arc.times) > 2):
        names = arc.dynamics.system.transitions.margin_names(arc.mode)
        margins = arc.dynamics.margins(arc.mode, arc.segment, arc.times, arc.states)
        for name in CONE.values():
            s, negative = curves.maximum(-margins[:, names.index(name)])
            found.append((-negative, arc, arc.start + arc.duration * (s + 1) / 2, name))
    best = min(found, key=lambda each: each[0], default=None)
    return None if best is None else best[1:]


def _change_of_cone(
    dynamics: Dynamics, arc: Arc, first: Array, cone: tuple[Arc, float, str], tau: Array, indices: tuple[int, ...]
) -> Array:
    """Derivatives of the smallest distance to the cone, shape (n_z + m,)."""
    _, time, name = cone
    system, n = dynamics.system, dynamics.system.n_z
    at_end = arc.end - time < AT_END * arc.duration
    z, data = (arc.states[-1] if at_end else _state_at(arc, time)), system.data(arc.segment)
    Z = _flowed(dynamics, arc, first, arc.end if at_end else time, indices)
    _, by_z, rates = buffered(system.linearized(arc.mode))(time, z, dynamics.p, data)
    names = system.transitions.margin_names(arc.mode)
    g = names.index(name)
    change = by_z.reshape((len(names), n), order="F")[g] @ Z + (rates[g] * tau if at_end else 0.0)
    (by_p,) = buffered(system.margins_by_parameters(arc.mode, indices))(time, z, dynamics.p, data)
    change[n:] += by_p.reshape((len(names), len(indices)), order="F")[g]
    return np.asarray(change)
