"""Scalars of the result as expressions of the NLP's unknowns, with exact derivatives.

Integrals are sums over the Lobatto points of every shooting interval; extrema are bounded by the values at those
points. |power| has kinks and is smoothed, sqrt(power^2 + width^2). What points and width miss is small; ``scalars``
has the same scalars without it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from casadi import DM, MX, Function, horzcat, repmat, reshape, sqrt, sum1, vec, vertcat

from gaitopt.arrays import Array
from gaitopt.mechanics import Mode
from gaitopt.nlp.integrator import LOBATTO_POINTS, LOBATTO_WEIGHTS, sampled_step
from gaitopt.nlp.multiple_shooting import MultipleShooting

RADIUS = "spectral_radius"
EXTREMA = {
    RADIUS: 1,
    "peak_torque": 1,
    "required_friction": 1,
    "impulse_ratio": 1,
    "foot_clearance": 1,
    "min_normal_force": -1,
}
"""Scalars that are the largest (1) or smallest (-1) of some values: of a curve, or of a number and its negative."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Samples:
    """Quantities of one arc at its N Lobatto points; ``ahead`` is the swing foot's lead over the stance foot."""

    mode: Mode
    weights: MX
    force: MX
    torque: MX
    power: MX
    height: MX
    ahead: MX


class Outcome:
    """Scalars of one step.

    Parameters
    ----------
    transcription : of the step.
    width : MX - of the smoothing of |power| [W].
    """

    def __init__(self, transcription: MultipleShooting, width: MX) -> None:
        self._t, self._width = transcription, width
        self._plain = {
            "period": self._period,
            "step_length": self._step_length,
            "speed": lambda: self._step_length() / self._period(),
            "work": self._work,
            "cost_of_transport": lambda: self._work() / self._weighted_length(),
            "absolute_cost_of_transport": lambda: self._absolute_work() / self._weighted_length(),
            "torque_squared": lambda: self._integral(lambda s: sum1(s.torque**2)),
            "slip_distance": self._slip_distance,
        }

    def value(self, name: str) -> MX:
        """A scalar that is no extremum: a name of the result, ``state.NAME``, or a dotted key."""
        if name in self._t.system.parameters:
            return self._t.p[self._t.system.parameters.index(name)]
        if name.startswith("state."):
            return self._t.Z[self._t.system.state_names.index(name.removeprefix("state.")), 0]
        return self._plain[name]()

    def bounded(self, name: str, extremum: MX) -> MX:
        """Rows that are not negative where ``extremum`` bounds the curve; the least is zero where it is its value."""
        if name == "peak_torque":
            return vertcat(*(vec(extremum - sign * s.torque) for s in self._samples for sign in (1, -1)))
        if name == "min_normal_force":
            return vertcat(*(vec(s.force[1, :] - extremum) for s in self._samples))
        if name == "foot_clearance":
            return vertcat(*(vec(extremum - s.height) for s in self._samples))
        if name == "impulse_ratio":  # of a sticking impact, also where the impact slips
            impulse = self._t.system.impact(Mode.STICK)(z=self._t.Z[:, -1], p=self._t.p)["impulse"]
            return vertcat(*(extremum * impulse[1] - sign * impulse[0] for sign in (1, -1)))
        sticking = [s.force for s in self._samples if s.mode.sticks]
        return vertcat(*(vec(extremum * f[1, :] - sign * f[0, :]) for f in sticking for sign in (1, -1)))

    def active_rows(self, name: str, w: Array, p: Array) -> list[int]:
        """Which rows of ``bounded`` count: of the clearance only those after the legs have passed each other."""
        if name != "foot_clearance":
            return list(range(self.bounded(name, MX(0)).numel()))
        leads = Function("leads", [self._t.w, self._t.parameters], [horzcat(*(s.ahead for s in self._samples))])
        behind = np.flatnonzero(np.asarray(leads(w, p)).ravel() <= 0)
        return list(range(int(behind[-1]) + 1 if behind.size else 0, leads.size2_out(0)))

    @cached_property
    def _samples(self) -> list[_Samples]:
        """Quantities at the Lobatto points, arc by arc."""
        system, arcs = self._t.system, self._t.layout.arcs

        def columns(i: int) -> list[MX]:
            arc, Z, start, h = self._t.arc(i)
            times = start + h * MX(np.arange(arc.intervals)).T
            return [Z[:, :-1], times, repmat(h, 1, arc.intervals), *self._t.constants(arc, arc.intervals)]

        samples = []
        n = LOBATTO_POINTS.size
        for i, wide in enumerate(self._t.map_arcs(lambda mode: sampled_step(system, mode), columns)):
            arc, _, start, h = self._t.arc(i)
            states = reshape(wide, system.n_z, n * arc.intervals)
            fractions = (np.arange(arc.intervals)[:, None] + LOBATTO_POINTS).ravel()
            observe = system.observation(arc.mode).map(fractions.size)
            times = start + h * MX(DM(fractions)).T
            force, torque, power, foot, *_ = observe(times, states, *self._t.constants(arc, fractions.size))
            weights = h * MX(DM(np.tile(LOBATTO_WEIGHTS, arc.intervals))).T
            ahead = foot[0, :] - states[system.n_shape, :]
            samples.append(
                _Samples(
                    mode=arcs[i].mode,
                    weights=weights,
                    force=force,
                    torque=torque,
                    power=power,
                    height=foot[1, :],
                    ahead=ahead,
                )
            )
        return samples

    def _integral(self, integrand: Callable[[_Samples], MX]) -> MX:
        return sum((integrand(s) @ s.weights.T for s in self._samples), MX(0))

    def _period(self) -> MX:
        return sum1(self._t.durations)

    def _step_length(self) -> MX:
        t = self._t
        impact = t.system.impact(t.layout.cycle.impact)
        return impact(z=t.Z[:, -1], p=t.p)["z_plus"][t.system.n_shape]

    def _weighted_length(self) -> MX:
        return self._t.system.weight(self._t.p) * self._step_length()

    def _work(self) -> MX:
        return self._push_work() + self._integral(lambda s: sum1(s.power))

    def _absolute_work(self) -> MX:
        return self._push_work() + self._integral(lambda s: sum1(sqrt(s.power**2 + self._width**2)))

    def _push_work(self) -> MX:
        """Work of the push before the impact; that of a foot at rest is positive."""
        return self._t.system.push(z=self._t.Z[:, -1], p=self._t.p)["work"]

    def _slip_distance(self) -> MX:
        x = self._t.system.n_shape
        distance = MX(0)
        for i in range(len(self._t.layout.arcs)):
            arc, Z, _, _ = self._t.arc(i)
            distance += arc.mode.direction * (Z[x, -1] - Z[x, 0])
        return distance
