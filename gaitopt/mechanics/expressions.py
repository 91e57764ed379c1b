"""The expressions that the functions of a hybrid system compile: motions, impacts and margins of its modes."""

from functools import cached_property

from casadi import SX, jacobian, jtimes, vertcat

from gaitopt.mechanics.contact import Motion, flight, motion
from gaitopt.mechanics.control.law import Control
from gaitopt.mechanics.friction import Friction
from gaitopt.mechanics.impact import Impact, Push, impact, landing, push_off
from gaitopt.mechanics.lagrangian import equations_of_motion
from gaitopt.mechanics.margins import margin_names
from gaitopt.mechanics.modes import ImpactLaw, Mode
from gaitopt.mechanics.strike import strike, take_off
from gaitopt.mechanics.walker import Walker


class Expressions:
    """A walker, its control and the ground in CasADi symbols; parameters as for ``HybridSystem``.

    Attributes
    ----------
    t, z, p, r : time since the last impact, state, parameters and segment data, the arguments of all expressions.
    eom : equations of motion of the walker.
    """

    def __init__(self, walker: type[Walker], control: Control, law: ImpactLaw, friction: Friction) -> None:
        self.walker, self._control, self._law, self._friction = walker, control, law, friction
        self.eom = equations_of_motion(walker)
        self._coefficients = SX.sym("c", len(friction.parameters))
        self._scalars = SX.sym("k", len(control.parameters))
        self.t, self.z, self.r = SX.sym("t"), self.eom.z, SX.sym("r", control.data(0).size)
        self.p = vertcat(self.eom.p, self._coefficients, self._scalars)
        self._motions: dict[Mode, Motion] = {}
        self._impacts: dict[Mode, Impact] = {}

        self._kinetic = friction.kinetic(self._coefficients)
        self._static = friction.static(self._coefficients)

    @cached_property
    def torque(self) -> SX:
        """Actuator torques, shape (n_u,)."""
        indices = [self.walker.shape.index(name) for name in self.walker.tracked]
        angles, rates = self.eom.q[indices], self.eom.dq[indices]
        return self._control.torque(self.t, angles, rates, self._scalars, self.r)

    def motion(self, mode: Mode) -> Motion:
        """Accelerations and contact force in a mode."""
        if mode not in self._motions:
            flies = mode.flies
            self._motions[mode] = flight(self.eom, **self._acting(mode)) if flies else self.slipping(_slip(mode), mode)
        return self._motions[mode]

    def slipping(self, slip: SX | None, mode: Mode) -> Motion:
        """Motion with a given sign of the slip, which may be an unknown between -1 and 1; None holds the foot."""
        drag = SX(self._friction.drag(self._coefficients, self.eom.z[-1]))
        return motion(self.eom, slip, kinetic=self._kinetic, drag=drag, **self._acting(mode))

    def _acting(self, mode: Mode) -> dict[str, SX]:
        """What acts in a mode besides contact forces and gravity."""
        springs = self.eom.force_of(self.potential_of(mode))
        return {"springs": springs, "torque": self.torque, "locked": self._locked(mode.locked)}

    def potential_of(self, mode: Mode) -> SX:
        """Potential energy that acts in this mode and not in all."""
        energies = self.eom.mechanism.potential_while.items()
        return sum((energy for state, energy in energies if mode.has(state)), SX(0))

    def _locked(self, stops: tuple[str, ...]) -> SX:
        """Derivative of the gaps of some stops by the shape coordinates."""
        gaps = vertcat(SX(0, 1), *(self.eom.mechanism.stops[name] for name in stops))
        return jacobian(gaps, self.eom.q[: len(self.walker.shape)])

    def impact(self, mode: Mode) -> Impact:
        """The impact after which the walker is in a mode: of the foot, or of the stops that are locked in it."""
        if mode not in self._impacts:
            self._impacts[mode] = self._new_impact(mode)
        return self._impacts[mode]

    def _new_impact(self, mode: Mode) -> Impact:
        if mode.flies:
            return take_off(self.eom, self._locked(mode.locked))
        if mode.locked:
            return strike(self.eom, _slip(mode), self._kinetic, self._locked(mode.locked))
        if self.walker.massless_feet:
            return landing(self.eom)
        held = tuple(stop for stop in self.walker.stops if stop not in self.walker.open_in_impact)
        return impact(self.eom, _slip(mode), self._law, self._kinetic, self._locked(held))

    def open_impact(self, slip: SX) -> Impact:
        """The impact of the foot with a sign of the slip that is an unknown between -1 and 1."""
        return impact(self.eom, slip, ImpactLaw.COULOMB, self._kinetic, self._locked(()))

    def margins(self, mode: Mode) -> SX:
        """What a mode assumes, in the order of ``margin_names(mode)``."""
        state, mu = self.motion(mode), self._static
        f_t, f_n = state.force[0], state.force[1]
        lands = mode.flies or not self.walker.flies  # a walker that flies lands out of flight alone
        margins = {
            "touchdown": -self.eom.mechanism.touchdown if lands else SX(1),
            "upright": self.eom.mechanism.upright,
            "normal_force": f_n,
            "cone_forward": mu * f_n + f_t,
            "cone_backward": mu * f_n - f_t,
            "slip_velocity": mode.direction * self.eom.z[-1],
            "painleve": state.painleve,
            "clearance": self.eom.mechanism.swing_foot[1] if lands else SX(1),
            **self.eom.mechanism.stops,
            **self.eom.switches,
        }
        return vertcat(*(margins[name] for name in margin_names(mode)))

    @cached_property
    def push(self) -> Push:
        """The push of the stance foot just before the swing foot lands."""
        return push_off(self.eom, self._locked(self.walker.stops))

    @property
    def approach(self) -> SX:
        """Normal velocity with which the swing foot lands."""
        return (self.eom.W_swing @ self.push.rates)[1]

    def impact_margins(self, mode: Mode) -> dict[str, SX]:
        """What an impact assumes, by name."""
        result, stick = self.impact(mode), self.impact(mode.with_contact(Mode.STICK))
        mu = self._static
        f_t, f_n = result.impulse[0], result.impulse[1]
        z, n, push = self.eom.z, len(self.walker.coordinates()), self.push.impulse
        return {
            "impulse": f_n,
            "lift_velocity": result.lift_velocity,
            "touchdown_rate": jtimes(SX(self.eom.mechanism.touchdown), z[:n], z[n:]),
            "push_cone_forward": mu * push[1] + push[0],
            "push_cone_backward": mu * push[1] - push[0],
            "push_landing": -self.approach,
            "impulse_cone_forward": mu * f_n + f_t,
            "impulse_cone_backward": mu * f_n - f_t,
            "impact_slip_velocity": mode.direction * result.slip_velocity,
            "impact_painleve": result.painleve,
            "impact_onset": -mu * stick.impulse[1] - mode.direction * stick.impulse[0],
        }


def _slip(mode: Mode) -> SX | None:
    """Sign of the slip in a mode, None where the foot sticks."""
    return None if mode.sticks else SX(mode.direction)
