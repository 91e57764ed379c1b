"""Curves that make a feedback law repeat the motion of a gait: a quadratic program for their control points.

The joints of a gait follow h(t); its phase x(t) is the time itself or a variable of the posture. Bezier curves h_d(x)
of degree n are sought for one of two laws.

**Virtual constraints** apply the torques that keep h = h_d(x). With x'' = a0 + a u and h'' = b0 + b u along the gait,

    u = D^-1 (h_d'' x'^2 + h_d' a0 - b0),      D = b - h_d' a      the decoupling matrix

so that curves beside the gait, h_d = h + e, need torques that differ by du = D^-1 (e'' x'^2 + e' x''). The first two
and the last two control points make the outputs invariant under the impact (Westervelt et al. 2003): the curves pass
through the postures just after and just before it, with the rates there,

    h_d = h,      h_d' = h' / x'      at both ends

**PD control** applies u = -kp (h - h_d) - kd (h' - h_d'), which differs from the torques of the gait by du. Its curves
need not coincide with h, because their distance from h produces the torques of the gait.

In both cases du is linear in the control points c, and so are the contact forces f = f_gait + F du. The program is

    minimise    mean |du|^2 / mean |u|^2  +  mean |h_d - h|^2        in natural units
    subject to  mu f_n - |f_t| >= margin where a contact sticks,   f_n >= margin,   |u| <= largest torque

It is always feasible, because a slack with a large weight relaxes the constraints. The slack is part of the result.

References
----------
Westervelt, Grizzle & Koditschek (2003), Hybrid zero dynamics of planar biped walkers, IEEE TAC 48(1), section IV.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from casadi import Sparsity, conic
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.building import building, built_once
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait
from gaitopt.gait.measures import observe
from gaitopt.gait.trajectory import Arc
from gaitopt.model.buffered import buffered_map
from gaitopt.model.contacts import sharing_contacts
from gaitopt.model.control import ConstantTorque
from gaitopt.model.curve import bernstein_matrix
from gaitopt.model.declaration import joint_limits
from gaitopt.model.system import HybridSystem

CLOCK = "clock"
"""The phase of curves over the time since the impact."""
FORCE_MARGIN = 0.02
"""Smallest distance of the contact force from its cone, and of the normal force from zero, relative to the weight. It
is positive because the motion under the law differs a little from that of the gait."""
SLACK_WEIGHT = 1e4
"""Weight of the violation of the constraints; the objective is of order one."""
RANGE_MARGIN = 1e-3
"""Smallest distance of a curve from the end of a joint's range [rad, or m], unless the gait itself is closer."""
ANGLE_WEIGHTS = {"constraints": 1.0, "pd": 1e-2}
"""Weight of the distance between curves and joints. Under PD control it only keeps the program well-posed."""
INVARIANT_POINTS = (0, 1, -2, -1)
"""Control points that the invariance under the impact determines."""
SINGULAR = 1e-9
"""A matrix is singular if its smallest singular value, relative to the largest one, is below this number."""
SMALLEST_DEGREE = 4
"""Smallest degree of an invariant curve that has a free control point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Joints:
    """Joints and their motors along a gait, at N samples of time with quadrature weights.

    Attributes
    ----------
    names, motors : the m joints, and the motor of each.
    t, weights : ndarray, shape (N,) - time since the impact [s], and weights that integrate over it.
    phase : ndarray, shape (N, 3) - the phase x, x' and x''.
    angles : ndarray, shape (3, N, m) - h, h' and h'' [rad, or m].
    torques : ndarray, shape (N, m) - torques of the gait [N m].
    response : ndarray, shape (N, m, m) - b, the change of h'' per torque.
    phase_response : ndarray, shape (N, m) - a, the change of x'' per torque.
    at : ndarray of integers, shape (R,) - the sample of each of the R contact forces: those of every contact on the
        ground, or of contacts that share undetermined forces, at every sample; none in flight.
    force, force_response : ndarrays, shape (R, 2), (R, 2, m) - (f_t, f_n) of the gait [N], and their change per torque.
    sticks : boolean ndarray, shape (R,) - whether the contact sticks.
    friction : ndarray, shape (R,) - static coefficient of the contact.
    weight : a typical normal force [N].
    ranges : ndarray, shape (2, m) - smallest and largest angle of each joint; infinite if its links state none.
    """

    names: tuple[str, ...]
    motors: tuple[str, ...]
    t: Array
    weights: Array
    phase: Array
    angles: Array
    torques: Array
    response: Array
    phase_response: Array
    at: NDArray[np.intp]
    force: Array
    force_response: Array
    sticks: Array
    friction: Array
    weight: float
    ranges: Array

    @classmethod
    def of(cls, gait: Gait, names: Sequence[str], motors: Sequence[str], phase: str, step: int = 0) -> "Joints":
        """The joints along a step of a gait.

        Parameters
        ----------
        names, motors : the joints, and the motor of each; see ``HybridSystem.angle_names``.
        phase : ``CLOCK`` or the name of an angle.
        step : number of the step, from 0.
        """
        arcs = gait.steps[step].arcs
        dynamics = arcs[0].dynamics
        system, walker = dynamics.system, dynamics.system.walker
        driven = _idle(system.shared)
        known = {key: value for key, value in dynamics.parameters.items() if not key.startswith("control.")}
        columns = [system.angle_names.index(name) for name in names]
        used = [walker.actuators.index(name) for name in motors]
        n_q, samples, contacts = len(walker.coordinates()), list[tuple[Array, ...]](), list[tuple[Any, ...]]()
        index, count = {name: k for k, name in enumerate(walker.contact_names())}, 0

        def under(arc: Arc, torques: Mapping[str, float]) -> tuple[Array, Array]:
            """Accelerations (N, n_q) and the contact forces, (N, contacts, 2), along an arc under constant torques."""
            p = driven.values({**known, **{f"control.{name}": value for name, value in torques.items()}})
            inputs = (arc.times[:, None], arc.states, p, driven.data(0))
            rate = buffered_map(driven.flow(arc.mode), arc.times.size)(*inputs)[0][:, n_q:].copy()
            forces = buffered_map(driven.observation(arc.mode), arc.times.size)(*inputs)[0].copy()
            return rate, forces.reshape(arc.times.size, -1, 2)

        for arc in arcs:
            n = arc.times.size
            evaluated = buffered_map(system.angles, n)
            angles, rates = (values.copy() for values in evaluated(arc.states, dynamics.p))
            by_rate = list[Array]()  # rates of the angles are linear in those of the coordinates
            for one in np.eye(n_q):
                states = np.concatenate([arc.states[:, :n_q], np.tile(one, (n, 1))], axis=1)
                by_rate.append(evaluated(states, dynamics.p)[1].copy())
            passive, force = under(arc, {})
            unit = [under(arc, {name: 1.0}) for name in motors]
            response = np.einsum("knj,nkm->njm", by_rate, np.stack([u[0] - passive for u in unit], axis=2))
            observed = observe(arc)
            accelerations = curves.slopes(rates, curves.points(n)) * 2 / arc.duration
            clock = np.stack([arc.times, np.ones(n), np.zeros(n)], axis=1)
            k = None if phase == CLOCK else system.angle_names.index(phase)
            samples.append(
                (
                    arc.times,
                    curves.weights(n) * arc.duration / 2,
                    clock if k is None else np.stack([angles[:, k], rates[:, k], accelerations[:, k]], axis=1),
                    np.stack([angles[:, columns], rates[:, columns], accelerations[:, columns]], axis=1),
                    observed.torque[:, used],
                    response[:, columns],
                    np.zeros((n, len(used))) if k is None else response[:, k],
                )
            )
            by_torque = np.stack([u[1] - force for u in unit], axis=3)
            for names_on in sharing_contacts(walker, arc.mode):
                of = [index[name] for name in names_on]
                contacts.append(
                    (
                        count + np.arange(n),
                        observed.force.reshape(n, -1, 2)[:, of].sum(axis=1),
                        by_torque[:, of].sum(axis=1),
                        np.full(n, not arc.mode.directions[names_on[0]]),
                        np.full(n, min(dynamics.contact_friction[name] for name in names_on)),
                    )
                )
            count += n
        t, w, x, h, u, b, a = (np.concatenate(columns) for columns in zip(*samples, strict=True))
        at, f, F, sticks, friction = (np.concatenate(columns) for columns in zip(*contacts, strict=True))
        scales, limits = dynamics.scales, joint_limits(walker)
        spans = ((limits[name][0] if name in limits else None) or (-np.inf, np.inf) for name in names)
        return cls(
            names=tuple(names), motors=tuple(motors), t=t, weights=w / w.sum(), phase=x, angles=h.transpose(1, 0, 2),
            torques=u, response=b, phase_response=a, at=at, force=f, force_response=F, sticks=sticks,
            friction=friction, weight=scales.energy / scales.length,
            ranges=np.array([*spans]).T,
        )  # fmt: skip

    @property
    def span(self) -> tuple[float, float]:
        """The phase just after and just before the impact."""
        return float(self.phase[0, 0]), float(self.phase[-1, 0])

    @property
    def smallest_rate(self) -> float:
        """Smallest rate of the phase relative to its mean; positive if the phase is monotone."""
        start, end = self.span
        mean = (end - start) / float(self.t[-1] - self.t[0])
        return float((self.phase[:, 1] / mean).min()) if mean else 0.0

    @property
    def slopes(self) -> Array:
        """dh/dx along the gait, shape (N, m)."""
        return np.asarray(self.angles[1] / self.phase[:, 1:2])

    @property
    def decoupling(self) -> Array:
        """The decoupling matrix D along the gait, shape (N, m, m)."""
        return np.asarray(self.response - self.slopes[:, :, None] * self.phase_response[:, None, :])

    @property
    def singular_at(self) -> float | None:
        """Time at which the motors cannot move the joints apart from the phase, because D is singular [s]; or None."""
        D = self.decoupling
        sizes, signs = np.linalg.svd(D, compute_uv=False), np.sign(np.linalg.det(D))
        singular = (sizes[:, -1] <= SINGULAR * sizes[:, 0].max()) | (signs != signs[0])
        return float(self.t[singular][0]) if singular.any() else None

    @property
    def inertia(self) -> float:
        """A typical torque per acceleration of a joint [kg m^2, or kg], where motors can accelerate the joints."""
        inverse = np.linalg.pinv(self.response, rcond=SINGULAR)
        largest = np.linalg.eigvalsh(inverse).max(axis=1)
        return float(np.median(largest[largest > 0]))

    def basis(self, degree: int, span: tuple[float, float] | None = None) -> tuple[Array, Array, Array]:
        """The Bernstein polynomials B and their derivatives B' and B'' in the phase, shape (N, degree + 1) each.

        Parameters
        ----------
        span : values of the phase between which they are defined; by default those at the ends of the step.
        """
        start, end = self.span if span is None else span
        s = (self.phase[:, 0] - start) / (end - start)
        values, first, second = (bernstein_matrix(degree, s, k) / (end - start) ** k for k in range(3))
        return values, first, second


@built_once(maxsize=8)
def _idle(system: HybridSystem) -> HybridSystem:
    """The walker and the ground of a system, with motors that apply given torques."""
    law = ConstantTorque.model_validate(dict.fromkeys(system.walker.actuators, 0.0))
    return HybridSystem(system.walker, law, system.law, system.friction, system.cycle_end)


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedCurves:
    """Control points with which a law repeats a gait.

    Attributes
    ----------
    points : ndarray, shape (m, degree + 1) - control points [rad, or m].
    deviation : root mean square of the additional torques, relative to those of the gait.
    violation : excess over the cone, relative to the weight, or over the largest torques, relative to these; 0 if none.
    """

    points: Array
    deviation: float
    violation: float

    @property
    def degree(self) -> int:
        """Degree of the curves."""
        return self.points.shape[1] - 1

    def over(self, span: tuple[float, float], other: tuple[float, float]) -> "FittedCurves":
        """The same polynomials, whose control points belong to another span; the polar form yields the points.

        References
        ----------
        Ramshaw (1989), Blossoms are polar forms, Computer Aided Geometric Design 6, 323-358.
        """
        if span == other:
            return self
        ends, rows = [(x - span[0]) / (span[1] - span[0]) for x in other], list[Array]()
        for k in range(self.degree + 1):
            points = self.points
            for s in [ends[0]] * (self.degree - k) + [ends[1]] * k:
                points = (1 - s) * points[:, :-1] + s * points[:, 1:]
            rows.append(points[:, 0])
        return replace(self, points=np.stack(rows, axis=1))

    def rows(self, names: Sequence[str]) -> dict[str, list[float]]:
        """The control points by joint, in the form of a problem file."""
        return {name: row.tolist() for name, row in zip(names, self.points, strict=True)}


def invariant_curves(joints: Joints, degree: int, largest: Mapping[str, float]) -> FittedCurves:
    """Curves over the phase for virtual constraints, invariant under the impact.

    Parameters
    ----------
    largest : largest torque of each motor that has one [N m].
    """
    h, _, h2 = joints.angles
    x1, x2 = joints.phase[:, 1:2], joints.phase[:, 2:]
    values, first, second = joints.basis(degree)
    m, (start, end) = len(joints.names), joints.span
    points = np.zeros((m, degree + 1))
    step = joints.slopes[[0, -1]] * (end - start) / degree
    points[:, INVARIANT_POINTS] = np.stack([h[0], h[0] + step[0], h[-1] - step[1], h[-1]], axis=1)
    acceleration = second * x1**2 + first * x2  # acceleration of a joint per control point
    inverse = np.linalg.inv(joints.decoupling)
    du = np.einsum("nij,nk->nijk", inverse, acceleration)
    gait = -np.einsum("nij,nj->ni", inverse, h2)
    return _fitted(
        joints,
        points,
        [*range(2, degree - 1)],
        du,
        gait,
        values,
        largest,
        meets_angles=True,
    )


def tracked_curves(
    joints: Joints,
    degree: int,
    gains: tuple[float, float],
    largest: Mapping[str, float],
    span: tuple[float, float] | None = None,
) -> FittedCurves:
    """Curves over the phase, or the clock, that joints track by PD control with gains (kp, kd).

    Parameters
    ----------
    span : see ``Joints.basis``.
    """
    kp, kd = gains
    h, h1, _ = joints.angles
    values, first, _ = joints.basis(degree, span)
    m = len(joints.names)
    du = np.einsum("ij,nk->nijk", np.eye(m), kp * values + kd * first * joints.phase[:, 1:2])
    gait = -(kp * h + kd * h1) - joints.torques
    points = np.zeros((m, degree + 1))
    return _fitted(joints, points, [*range(degree + 1)], du, gait, values, largest, meets_angles=False)


def _fitted(
    joints: Joints, points: Array, free: list[int], by_point: Array, constant: Array, values: Array,
    largest: Mapping[str, float], *, meets_angles: bool,
) -> FittedCurves:  # fmt: skip
    """Solve the program with du = by_point points + constant for the control points whose numbers are in ``free``.

    Parameters
    ----------
    by_point : ndarray, shape (N, m, m, degree + 1) - du of each motor per control point of each joint.
    constant : ndarray, shape (N, m) - du without control points.
    values : ndarray, shape (N, degree + 1) - value of the curve per control point.
    meets_angles : whether the joints follow the curves exactly, which then stay within the ranges of the joints.
    """
    N, m = constant.shape
    w, n_x, weight = joints.weights, m * len(free), ANGLE_WEIGHTS["constraints" if meets_angles else "pd"]
    U = by_point[:, :, :, free].reshape(N, m, n_x)
    u0 = constant + np.einsum("nijk,jk->ni", by_point, points)
    scale = float(np.sqrt(w @ (joints.torques**2).sum(axis=1)))
    scale = scale or float(np.sqrt(w @ (u0**2).sum(axis=1))) or 1.0  # the gait may have no torques
    H = np.einsum("n,nix,niy->xy", w, U, U) / scale**2
    g = np.einsum("n,nix,ni->x", w, U, u0) / scale**2
    away, E = values @ points.T - joints.angles[0], values[:, free]
    H += weight * np.kron(np.eye(m), (E.T * w) @ E)
    g += weight * ((E.T * w) @ away).T.ravel()
    rows, bounds = _constraints(joints, U, u0, largest)
    if meets_angles:
        more, ends = _range_constraints(joints, E, values @ points.T)
        rows, bounds = np.vstack([rows, more]), np.append(bounds, ends)
    H = np.block(
        [[H + 1e-12 * np.eye(n_x), np.zeros((n_x, 1))], [np.zeros((1, n_x)), np.eye(1)]]
    )  # DAQP measures rows in H^-1/2
    A = np.hstack([rows, np.ones((len(bounds), 1))])
    shapes = {"h": Sparsity.dense(*H.shape), "a": Sparsity.dense(*A.shape)}
    program = building(conic)("curves", "daqp", shapes, {"error_on_fail": False})
    unbounded = np.full(n_x, -np.inf)
    solution = program(
        h=H, g=np.append(g, SLACK_WEIGHT), a=A, lba=bounds, uba=np.inf, lbx=np.append(unbounded, 0), ubx=np.inf
    )
    x = np.asarray(solution["x"]).ravel()
    points = points.copy()
    points[:, free] = x[:-1].reshape(m, len(free))
    du = U @ x[:-1] + u0
    return FittedCurves(
        points=points, deviation=float(np.sqrt(w @ (du**2).sum(axis=1)) / scale), violation=max(float(x[-1]), 0.0)
    )


def _range_constraints(joints: Joints, E: Array, known: Array) -> tuple[Array, Array]:
    """Rows A and bounds b of A x >= b, by which every joint keeps its distance from the ends of its range.

    If the gait itself comes closer to an end, the joint may come as close.

    Parameters
    ----------
    E : ndarray, shape (N, n_free) - value of a curve per free control point.
    known : ndarray, shape (N, m) - the curves of the given control points.
    """
    rows, bounds, m = [np.zeros((0, len(joints.names) * E.shape[1]))], [np.zeros(0)], len(joints.names)
    for j, (low, high) in enumerate(joints.ranges.T):
        one = np.kron(np.eye(m)[j], E)
        for sign, end in ((1, low), (-1, -high)):
            if np.isfinite(end):
                rows.append(sign * one)
                bounds.append(np.minimum(end + RANGE_MARGIN, sign * joints.angles[0, :, j]) - sign * known[:, j])
    return np.vstack(rows), np.concatenate(bounds)


def _constraints(joints: Joints, U: Array, u0: Array, largest: Mapping[str, float]) -> tuple[Array, Array]:
    """Rows A and bounds b of A x >= b: the cone where a contact sticks, the normal forces, and the largest torques."""
    f = joints.force + np.einsum("nij,nj->ni", joints.force_response, u0[joints.at])
    F = np.einsum("nij,njx->nix", joints.force_response, U[joints.at])
    rows, bounds, sticks = list[Array](), list[Array](), joints.sticks
    mu = joints.friction[sticks]
    for sign in (1, -1):
        rows.append((sign * F[sticks, 0] + mu[:, None] * F[sticks, 1]) / joints.weight)
        bounds.append(FORCE_MARGIN * mu - (sign * f[sticks, 0] + mu * f[sticks, 1]) / joints.weight)
    rows.append(F[:, 1] / joints.weight)
    bounds.append(FORCE_MARGIN - f[:, 1] / joints.weight)
    for k, motor in enumerate(joints.motors):
        if motor in largest:
            for sign in (1, -1):
                rows.append(sign * U[:, k] / largest[motor])
                bounds.append(-1 - sign * (joints.torques[:, k] + u0[:, k]) / largest[motor])
    return np.concatenate(rows), np.concatenate(bounds)
