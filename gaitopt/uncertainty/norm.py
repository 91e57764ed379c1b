"""The gait sensitivity norm: how much one tile changes what a walker does in all the steps that follow.

With the deviation z_k of the state in which step k begins, and the change d of tile n,

    z_n = F_landed d                    z_(n+1) = A z_n + F_stands d            z_(k+1) = A z_k
    y_(n-1) = C_landed d                y_n = C z_n + C_stands d                y_k = C z_k

the norm of an output is the root of the sum of all y_k^2 at d = 1. With independent tiles of small standard deviation s
the output of a step has the standard deviation s times the norm. A gait of several steps has the root mean square of
the norms of tiles under each of its steps. Hobbelen & Wisse (2007), IEEE Trans. Robotics 23, 1213-1224.

Feedback from step to step changes parameters u of the control with the state at the start of a cycle, u_k = K z_k, so
that B u_k is added to the next state and D u_k to the output.
"""

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait.gait import Gait
from gaitopt.gait.trajectory import Step
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.lagrangian import TRAILING
from gaitopt.model.modes import SWING_FOOT
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.system import FLOOR
from gaitopt.problem.floor import QUANTITIES
from gaitopt.simulation.ground import OnTiles
from gaitopt.simulation.simulator import Simulator
from gaitopt.uncertainty.derivatives import OUTPUTS, StepDerivatives, step_derivatives, tile_parameters

NEGLIGIBLE = 1e-30
"""The sum of squares has converged once a term, relative to the sum, is below this number."""
MOST_STEPS = 1_000_000
"""Largest number of steps that are summed."""
Norms = dict[str, dict[str, float | None]]


def sensitivity_norm(gait: Gait) -> Norms:
    """The norm from a unit change of friction, height [m] and slope [rad] of a tile to each of ``OUTPUTS``, in SI.

    An entry is None where there is no derivative: if the step grazes an event, for the distance to the cone of a gait
    that slips, and for quantities that the floor of this walker cannot have.
    """
    none: Norms = {quantity: dict.fromkeys(OUTPUTS) for quantity in QUANTITIES}
    system = gait.system
    if not system.walker.stands_on_one() or system.cycle_end != TOUCHDOWN:
        return none
    known = [name for name in QUANTITIES if _has(gait, name)]
    on_tiles = OnTiles(gait.dynamics, drops=False, uneven=known != ["friction"])
    steps = Simulator(gait.dynamics).run(gait.state, steps=len(gait.steps), dense=True).steps
    uses = {quantity: tile_parameters(on_tiles, quantity) for quantity in known}
    correction = on_tiles.system.correction
    corrected = [] if correction is None else correction.of_u
    places = sorted({place for use in uses.values() for parts in use.values() for place, _ in parts} | {*corrected})
    try:
        linear = [step_derivatives(step, _dynamics(on_tiles, n, step), places) for n, step in enumerate(steps)]
    except FloatingPointError:
        return none
    feedback = np.zeros((len(places), system.n_z))  # derivative of the parameters by the state at the start of a cycle
    if correction is not None:
        p = _dynamics(on_tiles, 0, steps[0]).p
        feedback[[places.index(place) for place in corrected]] = correction.slopes(p, steps[0].arcs[0].states[0])[0]
    for quantity, use in uses.items():
        weights = {key: np.zeros(len(places)) for key in use}
        for key, parts in use.items():
            for place, weight in parts:
                weights[key][places.index(place)] = weight
        squares = np.mean([_squares(linear, weights, n, feedback) for n in range(len(linear))], axis=0)
        none[quantity] = {
            name: float(np.sqrt(square)) if np.isfinite(square) else None
            for name, square in zip(OUTPUTS, squares, strict=True)
        }
    return none


def _squares(linear: list[StepDerivatives], weights: dict[str, Array], n: int, feedback: Array) -> Array:
    """Sums of the squares of the changes of each output where the tile under step ``n`` of the cycle changes.

    Parameters
    ----------
    weights : changes of the parameters in the step that ends on the tile and in that which begins on it.
    feedback : derivative of the parameters in a cycle by the state at its start.
    """
    landing = linear[(n - 1) % len(linear)]
    total = (landing.outputs_by_tiles @ weights["landed"]) ** 2
    z, u = landing.state_by_tiles @ weights["landed"], np.zeros(len(feedback))
    for k in range(n, n + MOST_STEPS):
        step = linear[k % len(linear)]
        u = u if k % len(linear) else feedback @ z
        changed = u + weights["stands"] if k == n else u
        squares = (step.outputs_by_state @ z + step.outputs_by_tiles @ changed) ** 2
        total, z = total + squares, step.state_by_state @ z + step.state_by_tiles @ changed
        if k > n + len(linear) and not (squares > NEGLIGIBLE * total).any():
            break
    return np.asarray(total)


def _dynamics(on_tiles: OnTiles, n: int, step: Step) -> Dynamics:
    """The walker on nominal tiles, whose foot lands at a height rather than by the walker's own guard."""
    p = on_tiles.parameters(n, {}, step.arcs[0].states[:1])[0]
    keys = on_tiles.system.parameters
    if on_tiles.system.uneven:
        p[keys.index(f"{FLOOR}.{SWING_FOOT}.is_higher")] = 1.0
        p[keys.index(f"{FLOOR}.{TRAILING}")] = 0.0
    return Dynamics(on_tiles.system, p)


def _has(gait: Gait, quantity: str) -> bool:
    """Whether the walker may walk on tiles that differ in a quantity."""
    fields = gait.system.walker.model_fields
    rolls, keeps_energy = "foot_radius" in fields, "energy" in fields
    return quantity == "friction" or not (keeps_energy or (rolls and quantity == "slope"))
