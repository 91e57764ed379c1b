"""The scalars of a motion as numbers: the formulas of ``problem.scalars`` evaluated along arcs.

Solver and simulator both provide arcs at Chebyshev points, so the same functions measure both.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.shares import share_bounds
from gaitopt.gait.trajectory import Arc, Step, along, push_work, swap_indices
from gaitopt.model.buffered import buffered
from gaitopt.model.contacts import sharing_contacts
from gaitopt.model.control import ConstantTorque, NoControl
from gaitopt.model.declaration import joint_limits
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.model.units import Scales
from gaitopt.model.virtual_constraints import VirtualConstraints
from gaitopt.problem.scalars import MEASURES, SCALARS

Along = TypeVar("Along")
ENDS = np.array([-1.0, 1.0])
ON_THE_SPOT = 1e-9
"""A walker whose cycle is shorter than this has not moved, in leg lengths."""
AT_LIMIT = 1e-6
"""An optimum may exceed the limit of an angle by this [rad], and that of a torque by this fraction of the limit."""
WITHOUT_FORCE = 1e-9
"""A contact force below this fraction of the largest one counts as zero. The spring force of a massless leg is zero at
touchdown and lift-off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """Quantities along one arc, at the m times of its points.

    Attributes
    ----------
    force : ndarray, shape (m, 2 n) - contact forces (f_t, f_n) of the n contacts, one after the other [N].
    slip : ndarray, shape (m, n) - tangential velocities of the contacts [m/s].
    torque : ndarray, shape (m, n_u) - torques of the motors [N m].
    power : ndarray, shape (m, n_u) - power of each motor [W].
    swing_foot : ndarray, shape (m, 2) - position of the swing foot [m].
    energy : ndarray, shape (m,) - kinetic plus potential energy [J].
    loss : ndarray, shape (m,) - power that the dampers dissipate [W].
    """

    force: Array
    slip: Array
    torque: Array
    power: Array
    swing_foot: Array
    energy: Array
    loss: Array


def observe(arc: Arc) -> Observation:
    """Evaluate contact forces, torques, power, swing foot and energy along ``arc``."""
    outputs = along(arc, arc.dynamics.system.observation(arc.mode))
    force, torque, power, foot, energy, _, loss, slip = (value.copy() for value in outputs)
    return Observation(
        force=force, slip=slip, torque=torque, power=power, swing_foot=foot, energy=energy[:, 0], loss=loss[:, 0]
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactObservation:
    """A contact that touches the ground along an arc, or a group of contacts whose shares of a force are undetermined.

    Attributes
    ----------
    names : names of the contacts.
    direction : sign of the slip velocity, 0 if they stick.
    force : ndarray, shape (m, 2) - sum of their forces (f_t, f_n) [N].
    slip : ndarray, shape (m,) - tangential velocity [m/s].
    """

    names: tuple[str, ...]
    direction: int
    force: Array
    slip: Array


def touching_contacts(arc: Arc, observed: Observation) -> Iterator[ContactObservation]:
    """The contacts on the ground; those with undetermined forces are combined to one observation."""
    walker, mode = arc.dynamics.system.walker, arc.mode
    index = {name: k for k, name in enumerate(walker.contact_names())}
    for names in sharing_contacts(walker, mode):
        columns = [2 * index[name] for name in names]
        yield ContactObservation(
            names=names,
            direction=mode.directions[names[0]],
            force=np.stack([observed.force[:, [k + row for k in columns]].sum(axis=1) for row in (0, 1)], axis=1),
            slip=observed.slip[:, index[names[0]]],
        )


def measure(steps: Sequence[Step]) -> dict[str, float | None]:
    """All scalars of complete steps, by the names in ``MEASURES``.

    A scalar that is not defined is None: a cost if the walker stays on the spot, the required friction without a
    sticking phase, the impulse ratio without an impulse. Units are those of ``problem.scalars.SCALARS``.

    ``foot_clearance`` is the largest height of the swing foot after mid-swing, when the legs have passed each other. If
    there are several steps, it is the smallest of these heights.
    """
    cycle = _Measured(steps)
    contacts = [contact for arc, o in cycle.arcs for contact in touching_contacts(arc, o)]
    friction_ratios = (friction_ratio(contact.force) for contact in contacts if not contact.direction)
    impulse_ratios = (step.final_impact.impulse_ratio for step in steps)
    extrema: dict[str, float | None] = {
        "peak_torque": max((_peak(column) for _, o in cycle.driven for column in o.torque.T), default=0.0),
        "foot_clearance": min(max(_clearances(pairs), default=0.0) for pairs in swings(cycle.steps)),
        "required_friction": max(map(_peak, friction_ratios), default=None),
        "impulse_ratio": max((ratio for ratio in impulse_ratios if ratio is not None), default=None),
        "min_normal_force": min((-curves.maximum(-contact.force[:, 1])[1] for contact in contacts), default=None),
        "apex_height": max((curves.maximum(heights)[1] for heights in cycle.flights), default=None),
    }
    values: dict[str, float | None] = {}
    for name in MEASURES:
        formula = SCALARS[name].formula
        value = extrema[name] if formula is None else formula(cycle)
        values[name] = None if value is None or np.isnan(value) else value
    return values


def angles_of(arc: Arc) -> tuple[Array, Array]:
    """Angles of ``HybridSystem.angle_names`` along an arc and their rates, shape (m, n) each [rad, or m; per s]."""
    angles, rates = along(arc, arc.dynamics.system.angles)
    return angles.copy(), rates.copy()


def peak_torques(arcs: Sequence[Arc]) -> dict[str, float]:
    """The largest torque of each motor along arcs, by name [N m]."""
    torques, names = [observe(arc).torque for arc in arcs], arcs[0].dynamics.system.walker.actuators
    return {name: max(_peak(torque[:, k]) for torque in torques) for k, name in enumerate(names)}


def exceeded_limits(steps: Sequence[Step]) -> Iterator[str]:
    """Sentences about joints that leave the range of their links, and motors that exceed the effort of their joints."""
    system = steps[0].arcs[0].dynamics.system
    limits, arcs = joint_limits(system.walker), [arc for step in steps for arc in step.arcs]
    if not any(limit for pair in limits.values() for limit in pair):
        return
    turned = [angles_of(arc)[0] for arc in arcs]
    peaks = peak_torques(arcs)
    for name, (span, effort) in limits.items():
        if span is not None:
            columns = [angles[:, system.angle_names.index(name)] for angles in turned]
            low, high = min(-curves.maximum(-c)[1] for c in columns), max(curves.maximum(c)[1] for c in columns)
            if low < span[0] - AT_LIMIT or high > span[1] + AT_LIMIT:
                yield f"{name} turns from {low:.4g} to {high:.4g} rad, beyond its range from {span[0]:g} to {span[1]:g}"
        if effort is not None and peaks.get(name, 0.0) > effort * (1 + AT_LIMIT):
            yield f"{name} takes {peaks[name]:.4g} N m, more than the effort {effort:g} N m of its joint"


def control_record(steps: Sequence[Step]) -> dict[str, Any]:
    """Parameters of the control law by name; if it has a reference, also the tracking errors at both ends of the cycle.

    If the error at the end is small, the error just after the impact is the mismatch between both ends of the
    reference. If the reference is fitted to a table or a gait, the record also has the largest error of the fit. It is
    empty for passive walkers, constant torques and open-loop torques.
    """
    if not steps:
        return {}
    first, last = steps[0].arcs[0], steps[-1].arcs[-1]
    system = first.dynamics.system
    law = system.control
    if isinstance(law, NoControl | ConstantTorque | OpenLoop):
        return {}
    values = {key: value for key, value in first.dynamics.parameters.items() if key.startswith("control.")}
    record: dict[str, Any] = {"control": {key.removeprefix("control."): value for key, value in values.items()}}
    if isinstance(law, ProportionalDerivative):
        names: Sequence[str] = law.reference.motion().names
    elif isinstance(law, VirtualConstraints):
        names = law.outputs
    else:
        return record

    def errors(arc: Arc, k: int) -> Array:
        at = {"t": arc.times[k], "z": arc.states[k], "p": arc.dynamics.p, "r": system.data(arc.segment)}
        return np.asarray(system.quantities(arc.mode)(**at)["outputs"], dtype=float).ravel()

    pairs = zip(names, errors(first, 0).tolist(), errors(last, -1).tolist(), strict=True)
    record["tracking_errors"] = {name: {"start": start, "end": end} for name, start, end in pairs}
    fits = {joint: error for each in law.targets.values() for joint, error in each.motion().fit_errors.items()}
    return record | ({"fit_errors": fits} if fits else {})


def contact_record(steps: Sequence[Step]) -> dict[str, Any]:
    """Scalars of every named contact along complete steps, and the contacts whose forces are undetermined somewhere.

    For a contact with an undetermined force, the record has bounds of the force [N] instead of the scalars that depend
    on it. It is empty if contacts have no labels.
    """
    walker = steps[0].arcs[0].dynamics.system.walker if steps else None
    if walker is None or not walker.labels():
        return {}
    values: dict[str, dict[str, Any]] = {
        name: {"required_friction": None, "min_normal_force": None, "slip_distance": 0.0} for name in walker.labels()
    }
    shared = dict[str, None]()
    for arc in (arc for step in steps for arc in step.arcs):
        for contact in touching_contacts(arc, observe(arc)):
            if contact.direction:
                for name in contact.names:
                    values[name]["slip_distance"] += abs(curves.integral(contact.slip, arc.duration))
            if len(contact.names) > 1:
                shared |= dict.fromkeys(contact.names)
                continue
            row = values[contact.names[0]]
            lowest = -curves.maximum(-contact.force[:, 1])[1]
            row["min_normal_force"] = min(
                lowest, np.inf if row["min_normal_force"] is None else row["min_normal_force"]
            )
            if not contact.direction:
                row["required_friction"] = max(_peak(friction_ratio(contact.force)), row["required_friction"] or 0.0)
    for name in shared:
        values[name] |= {"required_friction": None, "min_normal_force": None}
    if not shared:
        return {"contacts": values}
    bounds = share_bounds(arc for step in steps for arc in step.arcs)
    return {"contacts": values, "undetermined": [*shared], "undetermined_bounds": bounds}


def measure_scales(scales: Scales) -> dict[str, float]:
    """Natural unit of every measure by its name; one for a ratio."""
    return {name: SCALARS[name].within.size(scales) for name in MEASURES}


def friction_ratio(force: Array) -> Array:
    """f_t / f_n along an arc from its contact force (m, 2).

    If the force vanishes at an end, like that of a spring, the ratio there is its limit. Without any force, as in an
    arc without duration, it is zero.
    """
    nothing, full = WITHOUT_FORCE * np.abs(force).max(), force.copy()
    for end in (0, -1):
        if abs(force[end, 1]) <= nothing:
            full[end] = [curves.slopes(column, ENDS)[end] for column in force.T]
    return np.divide(full[:, 0], full[:, 1], out=np.zeros(len(full)), where=full.any(axis=1))


class _Measured:
    """``Quantities`` of complete steps as numbers."""

    def __init__(self, steps: Sequence[Step]) -> None:
        self._dynamics = steps[0].arcs[0].dynamics
        self.steps = [[(arc, observe(arc)) for arc in step.arcs] for step in steps]
        self.arcs = [pair for pairs in self.steps for pair in pairs]
        self.driven = [(arc, o) for arc, o in self.arcs if o.torque.any()]
        self.duration = sum(step.period for step in steps)
        self.distance = sum(step.final_impact.step_length for step in steps)
        self.push_work = sum(step.final_impact.push_work for step in steps)
        for last, arc in (pair for step in steps for pair in pairwise(step.arcs)):
            if arc.struck is not None and (arc.struck.swaps or {*arc.struck.touching} - {*last.mode.touching}):
                self.push_work += push_work(last.dynamics, last.mode, last.states[-1])
        self.slip = sum(
            abs(curves.integral(contact.slip, arc.duration))
            for arc, o in self.arcs
            if arc.mode.slips
            for contact in touching_contacts(arc, o)
            if contact.direction
        )

    @property
    def flights(self) -> Iterator[Array]:
        """Heights of the centre of mass along every arc without contact [m]."""
        for arc, _ in self.arcs:
            if not arc.mode.touching:
                yield along(arc, self._dynamics.system.centre_height)[0][:, 0].copy()

    @property
    def incline(self) -> float:
        """sin(slope) of the ground."""
        return float(buffered(self._dynamics.system.incline)(self._dynamics.p)[0][0])

    @property
    def weight(self) -> float:
        """Weight of the walker, m g [N]."""
        return float(buffered(self._dynamics.system.weight)(self._dynamics.p)[0][0])

    @property
    def transport(self) -> float:
        """Weight times distance [J]; NaN on the spot, so that costs are not defined there."""
        if abs(self.distance) <= ON_THE_SPOT * self._dynamics.scales.length:
            return float("nan")
        return self.weight * self.distance

    def integral(self, rate: str) -> float:
        """Integral of ``power``, ``absolute_power``, ``loss`` or ``squared_torque`` over all arcs."""
        if rate == "loss":
            return sum(curves.integral(o.loss, arc.duration) for arc, o in self.arcs)
        if rate == "power":
            return sum(curves.integral(o.power.sum(axis=1), arc.duration) for arc, o in self.driven)
        if rate == "squared_torque":
            return sum(curves.integral((o.torque**2).sum(axis=1), arc.duration) for arc, o in self.driven)
        columns = ((column, arc.duration) for arc, o in self.driven for column in o.power.T)
        return sum(curves.absolute_integral(column, duration) for column, duration in columns)


def _peak(values: Array) -> float:
    return max(curves.maximum(values)[1], curves.maximum(-values)[1])


def swings(steps: Sequence[list[tuple[Arc, Along]]]) -> list[list[tuple[Arc, Along]]]:
    """The arcs between two swaps of the feet. If they swap within the steps, the last swing continues in the first.

    Parameters
    ----------
    steps : the arcs of each step, each in a pair with quantities along it.
    """
    pairs = [pair for step in steps for pair in step]
    starts = swap_indices(arc for arc, _ in pairs)
    if not starts:
        return [*steps]
    groups = [pairs[i:k] for i, k in pairwise([0, *starts, len(pairs)])]
    return [groups[-1] + groups[0], *groups[1:-1]]


def _clearances(observed: list[tuple[Arc, Observation]]) -> Iterator[float]:
    """Largest height of the swing foot in each arc: in flight, or while it is ahead of the stance foot."""
    for arc, o in observed:
        if not arc.mode.touching:
            yield curves.maximum(o.swing_foot[:, 1])[1]
            continue
        ahead = o.swing_foot[:, 0] - arc.states[:, arc.states.shape[1] // 2 - 1]
        if ahead[-1] > 0:
            passing = curves.roots(ahead)
            yield curves.maximum(o.swing_foot[:, 1], start=passing[-1] if passing.size else -1.0)[1]
