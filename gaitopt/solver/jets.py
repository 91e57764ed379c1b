"""Taylor coefficients of the shooting equations F along a polynomial curve of their unknowns w.

    w(e) = w_0 + w_1 e + w_2 e^2 + ...,      F(w(e)) = F_0 + F_1 e + F_2 e^2 + ...
    F_1 = F' w_1,      F_2 = F' w_2 + F'' (w_1, w_1) / 2,      F_3 = F' w_3 + F'' (w_1, w_2) + F''' (w_1, w_1, w_1) / 6

A Runge-Kutta step is linear in its stages, so that only the flow, the events and the resets are differentiated
symbolically. Mixed derivatives follow by polarisation,

    F'' (a, b) = F_2(a + b) / 2 - F_2(a - b) / 2

The coefficients are exact up to rounding. A. Griewank, A. Walther (2008), Evaluating Derivatives, ch. 13.
"""

import numpy as np
from casadi import SX, Function, cse, densify, horzcat, jtimes, reshape, substitute, vec

from gaitopt.arrays import Array
from gaitopt.building import built_once
from gaitopt.errors import ProblemError
from gaitopt.integration import A, B, C
from gaitopt.model.buffered import buffered_map
from gaitopt.solver.shooting import MultipleShooting, conditions


@built_once(maxsize=256)
def jet_of(function: Function, order: int, plain: tuple[int, ...], moved: tuple[int, ...] | None = None) -> Function:
    """A function that maps Taylor coefficients of the inputs to those of the output; each order is one column.

    Parameters
    ----------
    function : a function of vectors and matrices, with one output.
    plain : indices of the inputs that are constant.
    moved : entries of the first constant input that vary nevertheless. Their coefficients from the first order on are
        an additional input, the last one.
    """
    e = SX.sym("e")
    inputs, values = list[SX](), list[SX]()
    for k in range(function.n_in()):
        size = function.numel_in(k)
        inputs.append(SX.sym(f"x{k}", size, 1 if k in plain else order + 1))
        values.append(reshape(_series(inputs[-1], e), *function.size_in(k)))
    if moved is not None:
        inputs.append(SX.sym("v", len(moved), order))
        change = e * _series(inputs[-1], e)
        for i, entry in enumerate(moved):
            values[plain[0]][entry] += change[i]
    columns = [vec(function(*values))]
    for j in range(1, order + 1):
        columns.append(jtimes(columns[-1], e, SX(1)) / j)
    coefficients = cse(densify(substitute(horzcat(*columns), e, SX(0))))
    return Function(f"jet_{function.name()}", inputs, [coefficients])


def _series(columns: SX, e: SX) -> SX:
    value = SX.zeros(columns.size1())
    for j in reversed(range(columns.size2())):
        value = columns[:, j] + e * value
    return value


class Jets:
    """Taylor coefficients of the equations of a gait along m curves of unknowns at once.

    Parameters
    ----------
    equations : the equations of the gait.
    p : ndarray, shape (n_p,) - all parameters.
    curves : ndarray, shape (order + 1, m, n_w) - coefficients of each curve, from w_0 on.
    """

    def __init__(self, equations: MultipleShooting, p: Array, curves: Array) -> None:
        self._equations, self._p, self._w = equations, p, curves[0, 0]
        gains = [key for key in equations.free if ".step_feedback." in key]
        if gains:
            raise ProblemError(f"{gains[0]}: the equations are not linear in the gains of feedback from step to step")
        self.order, self.count = curves.shape[0] - 1, curves.shape[1]
        n, mesh = equations.system.n_z * equations.n_nodes, equations.mesh
        # the coefficients of one curve side by side: shape (m, order + 1, ...)
        self.nodes = np.moveaxis(curves[..., :n], 0, 1).reshape(self.count, self.order + 1, equations.n_nodes, -1)
        self.durations = np.moveaxis(curves[..., n : n + equations.n_phases], 0, 1)
        self.freed = np.moveaxis(curves[..., n + equations.n_phases :], 0, 1)
        times_by, lengths_by = equations.duration_derivatives
        self._times, self._lengths = self.durations @ times_by.T, self.durations @ lengths_by.T
        self._times[:, 0], self._lengths[:, 0] = mesh.interval_times(self.durations[0, 0])

    def equalities(self) -> Array:
        """Coefficients of the residuals of all equalities, shape (order + 1, m, n)."""
        equations, mesh = self._equations, self._equations.mesh
        ends = np.empty((self.count, self.order + 1, mesh.intervals, equations.system.n_z))
        for index, at in enumerate(mesh.arc_intervals):
            ends[:, :, at] = self._steps(index, np.arange(at.stop - at.start), np.ones(at.stop - at.start))
        defects = self.nodes[:, :, mesh.start_nodes + 1] - ends
        phase_ends, phase_starts = (self.nodes[:, :, at] for at in mesh.joints)
        joined = buffered_map(jet_of(conditions(*equations.cycle_key), self.order, (4,)), self.count)
        inputs = (each.reshape(self.count, -1) for each in (phase_ends, phase_starts, self.durations, self.freed))
        (values,) = joined(*inputs, self._p)
        both = [defects.reshape(self.count, self.order + 1, -1), values.reshape(self.count, self.order + 1, -1)]
        return np.moveaxis(np.concatenate(both, axis=2), 1, 0)

    def samples(self, index: int, fractions: Array) -> tuple[Array, Array]:
        """Coefficients of times (m, order + 1, k) and states (m, order + 1, k, n_z) at fractions (k,) of an arc."""
        at = self._equations.mesh.arc_intervals[index]
        intervals = fractions * (at.stop - at.start)
        k = np.minimum(intervals.astype(int), at.stop - at.start - 1)
        times = self._times[:, :, at.start + k] + (intervals - k) * self._lengths[:, :, at.start + k]
        return times, self._steps(index, k, intervals - k)

    def at_phase(self, function: Function, phase: int, times: Array, states: Array, segment: int = 0) -> Array:
        """Coefficients (m, order + 1, k, ...) of a function of (t, z, p, r) or (z, p) at times and states of a phase.

        Parameters
        ----------
        times, states : coefficients from ``samples``.
        segment : segment of the control.
        """
        system, k = self._equations.system, states.shape[2]
        p, moved, v = self._parameters(phase)
        named = function.n_in() == 4
        jet = buffered_map(jet_of(function, self.order, (2, 3) if named else (1,), moved), self.count * k)
        t, z = _by_point(times[..., None], states)
        v = np.repeat(v, k, axis=0)
        (values,) = jet(t, z, p, system.data(segment), v) if named else jet(z, p, v)
        return np.swapaxes(values.reshape(self.count, k, self.order + 1, -1), 1, 2)

    def _steps(self, index: int, k: Array, fractions: Array) -> Array:
        """States after fractions of the steps on intervals k of an arc; shape (m, order + 1, size of k, n_z)."""
        equations = self._equations
        arc, first = equations.mesh.arcs[index], equations.mesh.arc_nodes[index].start
        at, n_z, size = equations.mesh.arc_intervals[index].start + k, equations.system.n_z, k.size
        starts, times, lengths = _by_point(
            self.nodes[:, :, first + k], self._times[:, :, at, None], (fractions * self._lengths[:, :, at])[..., None]
        )
        p, moved_entries, v = self._parameters(arc.phase)
        jet = jet_of(equations.system.shared.flow(arc.mode), self.order, (2, 3), moved_entries)
        flow, data = buffered_map(jet, self.count * size), equations.system.data(arc.segment)
        v = np.repeat(v, size, axis=0)
        starts, lengths = (each.reshape(len(each), self.order + 1, -1) for each in (starts, lengths))
        moved = np.empty((len(A), *starts.shape))  # h k_i
        for i, (a, c) in enumerate(zip(A, C, strict=True)):
            inner = starts + np.tensordot(a[:i], moved[:i], 1)
            rates = flow(times + c * lengths[:, :, 0], inner.reshape(len(inner), -1), p, data, v)[0]
            _multiply(lengths, rates.reshape(inner.shape), out=moved[i])
        ends = starts + np.tensordot(B, moved, 1)
        if arc.mode.fixes_x:
            ends[..., -1] = 0.0
        return np.swapaxes(ends.reshape(self.count, size, self.order + 1, n_z), 1, 2)

    def _parameters(self, phase: int) -> tuple[Array, tuple[int, ...], Array]:
        """Parameters of a phase, the indices of those that vary, and their coefficients from the first order on.

        If the legs differ, their parameters swap from step to step.
        """
        equations = self._equations
        p = equations.per_phase(equations.acting_values(self._w, self._p))[phase]
        entries = tuple(map(equations.system.parameters.index, equations.varied_in_phases[phase]))
        of_free, of_first = equations.varied_slopes(self._w, self._p)
        moved = self.freed[:, 1:] @ of_free.T + self.nodes[:, 1:, 0] @ of_first.T
        return p, entries, moved.reshape(self.count, -1)


def second_derivatives(equations: MultipleShooting, w: Array, p: Array, first: Array, second: Array) -> Array:
    """F'' (a, b) for pairs of directions; shape (m, n).

    Parameters
    ----------
    first, second : ndarray, shape (m, n_w) - directions a and b, of any length.
    """
    units = equations.units(p).unknowns
    sizes = [np.abs(each / units).max(axis=1, keepdims=True) for each in (first, second)]
    a, b = (each / np.where(size > 0, size, 1.0) for each, size in zip((first, second), sizes, strict=True))
    along = np.concatenate([a + b, a - b])
    curves = np.stack([np.broadcast_to(w, along.shape), along, np.zeros_like(along)])
    bent = Jets(equations, p, curves).equalities()[2]
    return np.asarray((bent[: len(a)] - bent[len(a) :]) / 2 * sizes[0] * sizes[1])


def _by_point(*arrays: Array) -> tuple[Array, ...]:
    """Coefficients (m, order + 1, k, ...) at k points, rearranged as m k rows of inputs for a mapped function."""
    return tuple(np.swapaxes(each, 1, 2).reshape(each.shape[0] * each.shape[2], -1) for each in arrays)


def _multiply(lengths: Array, rates: Array, out: Array) -> None:
    """Product of two truncated series; the second axis of each array counts the order."""
    out[...] = lengths[:, :1] * rates
    for k in range(1, rates.shape[1]):
        out[:, k:] += lengths[:, k, None] * rates[:, :-k]
