"""The gait sensitivity norm: how much one tile changes what a walker does in all the steps that follow.

With the deviation z_k of the state in which step k begins, and the change d of tile n,

    z_n = F_landed d                    z_(n+1) = A z_n + F_stands d            z_(k+1) = A z_k
    y_(n-1) = C_landed d                y_n = C z_n + C_stands d                y_k = C z_k

the norm of an output is the root of the sum of all y_k^2 at d = 1. With independent tiles of small standard deviation s
the output of a step has the standard deviation s times the norm. A gait of many steps has the root mean square of
the norms of tiles under each of its steps. Hobbelen & Wisse (2007), IEEE Trans. Robotics 23, 1213-1224.

Feedback from step to step changes parameters u of the control with the state at the start of a cycle, u_k = K z_k, so
that B u_k is added to the next state and D u_k to the output.
"""

from math import ceil

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait
from gaitopt.gait.measures import measure, observe, touching_contacts
from gaitopt.gait.trajectory import Step
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.lagrangian import TRAILING
from gaitopt.model.modes import SWING_FOOT
from gaitopt.model.system import FLOOR
from gaitopt.problem.floor import QUANTITIES, Floor
from gaitopt.simulation.ground import OnTiles, may_vary
from gaitopt.simulation.simulator import Simulator
from gaitopt.uncertainty.derivatives import OUTPUTS, StepDerivatives, step_derivatives, tile_parameters
from gaitopt.verification.return_map import extrapolated

NEGLIGIBLE = 1e-30
"""The sum of squares has converged once a term, relative to the sum, is below this number."""
FORGOTTEN, SMALLEST_RADIUS, MOST_WALKED = 1e-8, 0.1, 400
"""A walk over a changed tile ends where this fraction of its deviation is left; smallest radius that counts, and
largest number of steps."""
ENOUGH = 1e-7
"""Estimated error of a difference of walks, in SI, at which no smaller change is tried."""
MOST_STEPS = 1_000_000
"""Largest number of steps that are summed."""
Norms = dict[str, dict[str, float | None]]


def sensitivity_norm(gait: Gait) -> Norms:
    """The norm from a unit change of friction, height [m] and slope [rad] of a tile to each of ``OUTPUTS``, in SI.

    An entry is None where there is no derivative: if the step grazes an event, for the distance to the cone of a gait
    that slips, and for quantities that the floor of this walker cannot have. The derivatives are exact for a walker on
    one foot. For named contacts they are extrapolated from differences of walks.
    """
    none: Norms = {quantity: dict.fromkeys(OUTPUTS) for quantity in QUANTITIES}
    system = gait.system
    known = [name for name in QUANTITIES if may_vary(system, name)]
    if not system.walker.stands_on_one():
        return none | {quantity: norm_of_walks(gait, quantity) for quantity in known}
    if not known:
        return none
    on_tiles = OnTiles(gait.dynamics, drops=False, uneven=known != ["friction"])
    steps = Simulator(gait.dynamics).run(gait.state, steps=len(gait.steps), dense=True).steps
    uses = {quantity: tile_parameters(on_tiles, quantity) for quantity in known}
    correction = on_tiles.system.correction
    corrected = [] if correction is None else correction.entries
    of_uses = (index for use in uses.values() for weighted in use.values() for index, _ in weighted)
    varied = sorted({*of_uses, *corrected})
    try:
        linear = [step_derivatives(step, _dynamics(on_tiles, n, step), varied) for n, step in enumerate(steps)]
    except FloatingPointError:
        return none
    feedback = [np.zeros((len(varied), system.n_z)) for _ in steps]
    if correction is not None:
        p = _dynamics(on_tiles, 0, steps[0]).p
        slopes = correction.slopes(p, steps[0].arcs[0].states[0])[0]
        for n, of_step in enumerate(feedback):
            of_step[[varied.index(entry) for entry in corrected]] = correction.by_entry(slopes, n)
    for quantity, use in uses.items():
        weights = {key: np.zeros(len(varied)) for key in use}
        for key, weighted in use.items():
            for index, weight in weighted:
                weights[key][varied.index(index)] = weight
        squares = np.mean([_squares(linear, weights, n, feedback) for n in range(len(linear))], axis=0)
        none[quantity] = {
            name: float(np.sqrt(square)) if np.isfinite(square) else None
            for name, square in zip(OUTPUTS, squares, strict=True)
        }
    return none


def norm_of_walks(gait: Gait, quantity: str) -> dict[str, float | None]:
    """The norm from a quantity of a tile to each of ``OUTPUTS``, from differences of walks over one changed tile."""
    cycle, dynamics = len(gait.steps), gait.dynamics
    decay = max(gait.spectral_radius or 0.0, SMALLEST_RADIUS) ** (1 / cycle)
    count = 2 * cycle + min(MOST_WALKED, ceil(np.log(FORGOTTEN) / np.log(decay)))
    pairs = dynamics.system.contact_coefficients(dynamics.p).values()
    coefficients = {(float(static), float(kinetic)) for static, kinetic, _ in pairs}
    if quantity == "friction" and len(coefficients) != 1:
        return dict.fromkeys(OUTPUTS)
    nominal = [*next(iter(coefficients))] if quantity == "friction" else [0.0, 0.0]
    unit = {"friction": 1.0, "height": dynamics.scales.length, "slope": 1.0}[quantity]
    phases = [step.phases for step in gait.steps]
    defined = np.isfinite([_outputs(step) for step in gait.motion]).all(axis=0)

    def outputs(tile: int, change: float) -> Array | None:
        """Outputs of all steps in a walk with one changed tile, in one row; None if the walk has other modes."""
        values = [nominal] * tile + [[each + change for each in nominal], nominal]
        floor = Floor.from_record({quantity: values if quantity == "friction" else [value for value, _ in values]})
        walk = Simulator(dynamics, floor=floor).run(gait.state, steps=count, dense=True)
        modes = [[mode for mode, _ in step.phases] for step in walk.steps]
        if len(modes) < count or any(m != [mode for mode, _ in phases[k % cycle]] for k, m in enumerate(modes)):
            return None
        return np.array([_outputs(step) for step in walk.steps])[:, defined].ravel()

    squares = []
    for tile in range(cycle, 2 * cycle):

        def central(h: float, tile: int = tile) -> Array | None:
            ahead, behind = outputs(tile, h * unit), outputs(tile, -h * unit)
            return None if ahead is None or behind is None else (ahead - behind) / (2 * h * unit)

        changes, _ = extrapolated(central, power=2, goal=ENOUGH)
        if changes is None:
            return dict.fromkeys(OUTPUTS)
        squares.append((changes.reshape(count, -1) ** 2).sum(axis=0))
    norms = dict(zip(np.array(OUTPUTS)[defined].tolist(), np.sqrt(np.mean(squares, axis=0)).tolist(), strict=True))
    return {name: norms.get(name) for name in OUTPUTS}


def _outputs(step: Step) -> list[float]:
    """The ``OUTPUTS`` of a step; NaN for the distance to the cone where a contact slips."""
    measures, distance = measure([step]), np.inf
    for arc in step.arcs:
        friction = arc.dynamics.contact_friction
        for contact in touching_contacts(arc, observe(arc)):
            if contact.direction or len(contact.names) > 1:
                distance = np.nan
                continue
            f_t, f_n = contact.force.T
            margins = (friction[contact.names[0]] * f_n - sign * f_t for sign in (-1, 1))
            distance = min(distance, *(-curves.maximum(-margin)[1] for margin in margins))
    values = {**measures, "cone_distance": distance}
    return [np.nan if value is None else float(value) for value in (values[name] for name in OUTPUTS)]


def _squares(linear: list[StepDerivatives], weights: dict[str, Array], n: int, feedback: list[Array]) -> Array:
    """Sums of the squares of the changes of each output where the tile under step ``n`` of the cycle changes.

    Parameters
    ----------
    weights : changes of the parameters in the step that ends on the tile and in that which begins on it.
    feedback : derivatives of the parameters in each step of a cycle by the state at its start.
    """
    landing = linear[(n - 1) % len(linear)]
    total = (landing.outputs_by_tiles @ weights["landed"]) ** 2
    z, first = landing.state_by_tiles @ weights["landed"], np.zeros(feedback[0].shape[1])
    for k in range(n, n + MOST_STEPS):
        step = linear[k % len(linear)]
        first = first if k % len(linear) else z
        u = feedback[k % len(linear)] @ first
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
