"""A walker with several contacts, its control and the ground in CasADi symbols; see ``gaitopt.model.system``."""

from casadi import SX, jacobian, jtimes, sqrt, vertcat

from gaitopt.building import BUILT
from gaitopt.model.contact_set import ContactImpact, ContactMotion, contact_impact, contact_motion
from gaitopt.model.contact_transitions import ContactTransitions, share_name
from gaitopt.model.control import Control
from gaitopt.model.friction import ContactFriction, ImpactLaw
from gaitopt.model.lagrangian import equations_of_motion
from gaitopt.model.modes import Mode
from gaitopt.model.system import Expressions
from gaitopt.model.walker import Walker


class ContactExpressions(Expressions):
    """Expressions of a walker with named contacts; parameters and attributes as of ``Expressions``."""

    def __init__(self, walker: type[Walker], control: Control, law: ImpactLaw, friction: ContactFriction) -> None:
        self.walker, self._control, self._law = walker, control, law
        self.eom = equations_of_motion(walker)
        coefficients = SX.sym("c", len(friction.parameters))
        self._scalars = SX.sym("k", len(control.parameters))
        self.t, self.z, self.r = SX.sym("t"), self.eom.z, SX.sym("r", control.data(0).size)
        self.p = vertcat(self.eom.p, coefficients, self._scalars)
        self._torques: dict[tuple[str, Mode | None], SX] = {}
        self._states: dict[Mode, ContactMotion] = {}
        self._collisions: dict[tuple[Mode, tuple[str, ...]], ContactImpact] = {}
        self.transitions = ContactTransitions(walker)
        of = friction.of(coefficients)
        self._static, self._kinetic, self._viscous = ({name: SX(c[k]) for name, c in of.items()} for k in range(3))
        BUILT.watch(vars(self))

    def rate(self, mode: Mode) -> SX:
        """dz/dt in a mode, shape (n_z,)."""
        return self.state(mode).dz

    def forces(self, mode: Mode) -> SX:
        """(f_t, f_n) of all contacts, one after the other [N]."""
        return vertcat(*self.state(mode).forces.values())

    def state(self, mode: Mode) -> ContactMotion:
        """Accelerations and contact forces in a mode."""
        if mode not in self._states:
            self._states[mode] = BUILT.watch(self._driven(mode, self.torque(mode)))
        return self._states[mode]

    def _driven(self, mode: Mode, torque: SX) -> ContactMotion:
        """Accelerations and contact forces in a mode under given torques."""
        return contact_motion(
            self.eom,
            mode,
            static=self._static,
            kinetic=self._kinetic,
            viscous=self._viscous,
            springs=self.eom.force_of(self.potential_of(mode)),
            torque=torque,
        )

    def _held(self, mode: Mode) -> Mode:
        """The mode in which all contacts on the ground stick."""
        return mode.with_states(dict.fromkeys(mode.touching, str(Mode.STICK)))

    def _rate(self, mode: Mode, torque: SX, slip: SX | None = None) -> SX:
        """dz/dt in a mode under given torques."""
        return self._driven(mode, torque).dz

    def collision(self, mode: Mode, landing: tuple[str, ...]) -> ContactImpact:
        """The impact after which the contacts are in a mode; ``landing`` are the massless contacts that land."""
        if (mode, landing) not in self._collisions:
            result = contact_impact(self.eom, mode, static=self._static, kinetic=self._kinetic, landing=landing)
            self._collisions[mode, landing] = BUILT.watch(result)
        return self._collisions[mode, landing]

    def margins(self, mode: Mode) -> SX:
        """Margins of a mode, in the order of ``Transitions.margin_names``."""
        state, contacts, q, dq = self.state(mode), self.eom.mechanism.contacts, self.eom.q, self.eom.dq
        margins: dict[str, SX] = {"upright": self.eom.mechanism.upright, "regularity": state.regularity}
        for name, contact in contacts.items():
            gap = contact.position[1] if contact.gap is None else contact.gap
            margins[f"gap.{name}"] = (
                gap if contact.counts.is_constant() else _either(gap, -contact.counts * self.eom.length)
            )
            f_t, f_n = state.forces[name][0], state.forces[name][1]
            margins[f"normal_force.{name}"] = f_n
            margins[f"cone_forward.{name}"] = self._static[name] * f_n + f_t
            margins[f"cone_backward.{name}"] = self._static[name] * f_n - f_t
            velocity = jacobian(contact.position[0], q) @ dq
            margins[f"slip_velocity.{name}"] = mode.directions[name] * velocity
        margins |= {share_name(share.parts): share.value for share in state.shares}
        return vertcat(*(margins[name] for name in self.transitions.margin_names(mode)))

    def decision(self, mode: Mode) -> dict[str, SX]:
        """What decides whether a mode is consistent: dz, margins, their rates, and normal accelerations of contacts."""
        margins, state = self.margins(mode), self.state(mode)
        rates = jtimes(margins, self.eom.z, state.dz) + jacobian(margins, self.t)
        return {
            "dz": state.dz,
            "margins": margins,
            "rates": rates,
            "separations": vertcat(SX(0, 1), *(state.separations.values())),
        }

    def points(self) -> dict[str, SX]:
        """Height, and velocity (v_t, v_n), of every contact."""
        positions = [contact.position for contact in self.eom.mechanism.contacts.values()]
        velocities = [jacobian(position, self.eom.q) @ self.eom.dq for position in positions]
        return {"heights": vertcat(*(position[1] for position in positions)), "velocities": vertcat(*velocities)}


def _either(a: SX, b: SX) -> SX:
    """Positive where one of two numbers is; where b is negative it falls through zero with a, at the same rate.

    Rvachev's disjunction: a maximum without a kink, of which engines can take Taylor series.
    """
    return a + b + sqrt(a**2 + b**2)
