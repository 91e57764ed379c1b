"""A hybrid system at fixed parameters: flow, margins, friction and natural units as numbers.

A ``Dynamics`` applies to one step, because legs that differ swap their parameters at touchdown. The steps of a motion
take the entries of ``Dynamics.steps`` in turn, and every arc refers to the one of its step. No other object knows which
leg is the stance leg.

``saltation`` maps a small deviation across an event with reset R and guard g,

    S = R_z + (f_plus - R_z f_minus) grad g' / (dg/dt)

At the last event of a step a deviation is projected along the flow onto the guard and then reset, because the return
map compares states on the section and not at equal times.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitopt.arrays import Array, ReadOnlyArrays, read_only
from gaitopt.model.buffered import buffered, buffered_map
from gaitopt.model.friction import ImpactLaw
from gaitopt.model.modes import Mode
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import margin_unit
from gaitopt.model.units import Scales
from gaitopt.threads import cached_method, cached_property


@dataclass(frozen=True, eq=False)
class Dynamics(ReadOnlyArrays):
    """A hybrid system at parameters ``p``.

    Attributes
    ----------
    system : walker, control and ground.
    p : ndarray, shape (n_p,) - parameters in the order of ``system.parameters``; read-only.
    """

    system: HybridSystem
    p: Array

    @classmethod
    def of(cls, system: HybridSystem, parameters: Mapping[str, float]) -> "Dynamics":
        """A system at the values of its parameters by dotted key; the control law's own values are the default."""
        return cls(system, system.values(parameters))

    @property
    def parameters(self) -> dict[str, float]:
        """Values of all parameters by dotted key."""
        return dict(zip(self.system.parameters, map(float, self.p), strict=True))

    def parameter(self, key: str) -> float:
        """Value of the parameter with this dotted key."""
        return float(self.p[self.system.parameters.index(key)])

    def at(self, parameters: Mapping[str, float]) -> "Dynamics":
        """The same system with other values of the parameters with these dotted keys."""
        return Dynamics.of(self.system, {**self.parameters, **parameters})

    @cached_property
    def steps(self) -> tuple["Dynamics", ...]:
        """The dynamics of the steps of a motion, this one first: one if the legs are alike, otherwise one per leg.

        They repeat: step k of a motion has ``steps[k % len(steps)]``, a phase ``cycle.per_phase(steps)[phase]``.
        """
        _, *others = self.system.step_parameters(self.p)
        return (self, *(Dynamics(self.system, p) for p in others))

    @property
    def steps_per_cycle(self) -> int:
        """Number of steps of the shortest cycle: one per leg if the legs differ, all between two corrections."""
        correction = self.system.correction
        return len(self.steps) if correction is None else max(len(self.steps), correction.every)

    def acting(self, z: Array, n: int = 0) -> "Dynamics":
        """The dynamics in the cycle that begins with a state: feedback from step to step corrects some parameters.

        Parameters
        ----------
        n : number of the step whose dynamics these are.
        """
        correction = self.system.correction
        return self if correction is None else Dynamics(self.system, correction(self.p, z, n))

    @cached_property
    def static_friction(self) -> float:
        """Coefficient that bounds |f_t| / f_n of a sticking foot; for several contacts the largest one."""
        return max(self.contact_friction.values())

    @cached_property
    def contact_friction(self) -> dict[str, float]:
        """Static coefficient of every contact by name."""
        return {name: float(static) for name, (static, _, _) in self.system.contact_coefficients(self.p).items()}

    @property
    def friction_drops(self) -> bool:
        """Whether friction drops when a contact begins to slip: static above kinetic."""
        coefficients = self.system.contact_coefficients(self.p).values()
        return any(bool(static > kinetic) for static, kinetic, _ in coefficients)

    @property
    def stick_comes_first(self) -> bool:
        """Whether sticking and slipping can both be consistent in an impact, which then sticks.

        This is possible with two coefficients of friction, and if a slipping impact has no friction. The return map
        jumps at the edge of such states.
        """
        return self.system.law is ImpactLaw.FRICTIONLESS or self.friction_drops

    @cached_property
    def scales(self) -> Scales:
        """Natural units of the walker."""
        return Scales.of(*(float(value[0]) for value in buffered(self.system.size)(self.p)))

    @cached_property
    def state_units(self) -> Array:
        """Natural unit of every entry of ``z``, shape (n_z,): 1 for angles, leg length for lengths; rates per time."""
        lengths = {*self.system.walker.lengths, "x", "y"}
        units = np.array([self.scales.length if name in lengths else 1.0 for name in self.system.walker.coordinates()])
        return np.concatenate([units, units / self.scales.time])

    @cached_method
    def margin_units(self, mode: Mode) -> Array:
        """Natural unit of every margin of a mode, shape (n,); read-only."""
        names, scales = self.system.transitions.margin_names(mode), self.scales
        return read_only(np.array([margin_unit(name, scales) for name in names]))

    def lift(self, xi: Array) -> Array:
        """State just after an impact of a foot, shape (n_z,), from section coordinates with or without dx."""
        return self.system.section(Mode.SLIP_FORWARD).lift(xi, self.p)

    def after_impact(self, mode: Mode, z: Array, before: Mode, *, ends_step: bool = True) -> Array:
        """State just after an impact, shape (n_z,); if a step ends, x starts from zero at the new base point.

        Parameters
        ----------
        mode, before, ends_step : see ``HybridSystem.reset``.
        """
        return buffered(self.system.reset(mode, before, ends_step=ends_step))(z, self.p)[0].copy()

    def margins(self, mode: Mode, segment: int, times: Array, states: Array) -> Array:
        """Margins of a mode at times (m,) and states (m, n_z), in the order of its transitions; shape (m, n)."""
        margins = buffered_map(self.system.margins(mode), times.size)
        return margins(times[:, None], states, self.p, self.system.data(segment))[0].copy()

    def impact_margins(self, mode: Mode, z: Array, before: Mode) -> dict[str, float]:
        """Margins by name of the impact that follows the state ``z``, shape (n_z,); see ``HybridSystem.reset``."""
        (values,) = buffered(self.system.impact_margins(mode, before))(z, self.p)
        return dict(zip(self.system.transitions.impact_margin_names(mode, before), values.tolist(), strict=True))


def saltation(
    f_minus: Array, f_plus: Array, guard_gradient: Array, guard_rate: float, reset: Array | None = None
) -> Array:
    """Saltation matrix of a transition within a step; shape (n_z, n_z).

    Parameters
    ----------
    f_minus, f_plus : ndarray, shape (n_z,) - flow just before and just after the switch.
    guard_gradient : ndarray, shape (n_z,) - gradient of the guard by the state.
    guard_rate : total time derivative of the guard along ``f_minus``.
    reset : ndarray, shape (n_z, n_z) - derivative of the reset; the identity by default.
    """
    R_z = np.eye(f_minus.size) if reset is None else reset
    return np.asarray(R_z + np.outer(f_plus - R_z @ f_minus, guard_gradient) / guard_rate)


def projection(f_minus: Array, guard_gradient: Array, guard_rate: float) -> Array:
    """Projection of a deviation along the flow onto the guard; shape (n_z, n_z)."""
    return np.eye(f_minus.size) - np.outer(f_minus, guard_gradient) / guard_rate
