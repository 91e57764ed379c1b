"""A walker with several contacts, its control and the ground in CasADi symbols; see ``gaitopt.model.system``."""

from casadi import (
    SX,
    densify,
    depends_on,
    horzcat,
    jacobian,
    jtimes,
    reshape,
    sqrt,
    substitute,
    vec,
    vertcat,
)

from gaitopt.building import BUILT
from gaitopt.model.contact_set import (
    ContactImpact,
    ContactMotion,
    contact_impact,
    contact_motion,
)
from gaitopt.model.contact_transitions import contact_transitions, impulse_name, share_name
from gaitopt.model.contract import torques
from gaitopt.model.control import Control
from gaitopt.model.friction import ContactFriction, ImpactLaw
from gaitopt.model.lagrangian import equations_of_motion
from gaitopt.model.modes import Mode
from gaitopt.model.section import TOUCHDOWN, contact_section
from gaitopt.model.system import Expressions
from gaitopt.model.walker import Walker
from gaitopt.threads import cached_property


class ContactExpressions(Expressions):
    """Expressions of a walker with named contacts; for parameters and attributes see ``Expressions``.

    Parameters
    ----------
    cycle_end : see ``ContactTransitions``.
    """

    def __init__(
        self, walker: type[Walker], control: Control, law: ImpactLaw, friction: ContactFriction, cycle_end: str
    ) -> None:
        self.walker, self._control, self._law = walker, control, law
        self.eom = equations_of_motion(walker)
        coefficients = SX.sym("c", len(friction.parameters))
        self._scalars = SX.sym("k", len(control.parameters))
        self.t, self.z, self.r = SX.sym("t"), self.eom.z, SX.sym("r", control.data(0).size)
        self.p = vertcat(self.eom.p, coefficients, self._scalars)
        self._torques: dict[tuple[str, Mode | None], SX] = {}
        self._states: dict[Mode, ContactMotion] = {}
        self._collisions: dict[tuple[Mode, tuple[str, ...]], ContactImpact] = {}
        self.transitions = contact_transitions(walker, cycle_end)
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
        margins |= self.eom.sections
        for name, contact in contacts.items():
            margins[f"gap.{name}"] = self._gap(name)
            f_t, f_n = state.forces[name][0], state.forces[name][1]
            margins[f"normal_force.{name}"] = f_n
            margins[f"cone_forward.{name}"] = self._static[name] * f_n + f_t
            margins[f"cone_backward.{name}"] = self._static[name] * f_n - f_t
            velocity = jacobian(contact.position[0], q) @ dq
            margins[f"slip_velocity.{name}"] = mode.directions[name] * velocity
        margins |= {share_name(share.parts): share.value for share in state.shares}
        return vertcat(*(margins[name] for name in self.transitions.margin_names(mode)))

    def impact_margins(self, mode: Mode, before: Mode | None = None) -> dict[str, SX]:
        """Margins of an impact by name, in the order of ``Transitions.impact_margin_names``."""
        assert before is not None
        names = self.transitions.impact_margin_names(mode, before)
        if not names:
            return {}
        result, contacts, eom = self.collision(mode, self.landing(mode, before)), self.eom.mechanism.contacts, self.eom
        n = len(self.walker.coordinates())
        margins: dict[str, SX] = {"impact_regularity": result.regularity}
        for name in contacts:
            impulse_t, impulse_n = result.impulses[name][0], result.impulses[name][1]
            margins[f"impulse.{name}"] = impulse_n
            margins[f"impulse_cone_forward.{name}"] = self._static[name] * impulse_n + impulse_t
            margins[f"impulse_cone_backward.{name}"] = self._static[name] * impulse_n - impulse_t
            margins[f"impact_slip_velocity.{name}"] = mode.directions[name] * result.velocities[name][0]
            margins[f"lift_velocity.{name}"] = result.velocities[name][1]
            margins[f"touchdown_rate.{name}"] = -jtimes(SX(self._gap(name)), eom.z[:n], eom.z[n:])
        margins |= {impulse_name(share_name(share.parts)): share.value for share in result.shares}
        return {name: margins[name] for name in names}

    def landing(self, mode: Mode, before: Mode) -> tuple[str, ...]:
        """The massless contacts that land in an impact."""
        massless = self.walker.massless_contacts
        return tuple(name for name in massless if name in mode.touching and name not in before.touching)

    def reset(self, mode: Mode, before: Mode, *, ends_step: bool) -> SX:
        """The state after a step or an impact has ended a phase, as a function of that before it, shape (n_z,).

        Parameters
        ----------
        mode, before : of the impact, with the contacts as they are called before it; it has none if none lands.
        ends_step : relabels the shape, and counts x from the new base point. Deviations from the section are removed
            where the motion would keep them: of heights of contacts that never leave the ground, and of the energy.
        """
        lands = any(name not in before.touching for name in mode.touching)
        z = SX(self.collision(mode, self.landing(mode, before)).z_plus if lands else self.eom.z)
        if not ends_step:
            return z
        end = self.transitions.cycle_end
        if end == TOUCHDOWN:
            z = substitute(self.relabelled, self.eom.z, z)
        z[len(self.walker.coordinates()) - 1] = 0
        if end != TOUCHDOWN or "energy" in self.walker.model_fields:
            impact = self.walker.swapped(mode) if end == TOUCHDOWN else mode
            n = self.eom.p.numel()
            z = contact_section(self.walker, before, impact, end).projected(z=z, p=self.p[:n])["z_plus"]
        return z

    @property
    def relabelled(self) -> SX:
        """The state after the feet have swapped roles, x being the position of the new base point."""
        eom, n = self.eom, len(self.walker.shape)
        shape, base = eom.mechanism.relabel, eom.mechanism.swing_foot
        rates, velocity = (jtimes(SX(value), eom.q, eom.dq) for value in (shape, base))
        return vertcat(eom.state(shape, base[0], base[1]), eom.state(rates[:n], velocity[0], velocity[1]))

    def _gap(self, name: str) -> SX:
        """The margin that falls to zero where a contact lands."""
        contact = self.eom.mechanism.contacts[name]
        gap = contact.position[1] if contact.gap is None else contact.gap
        return gap if contact.counts.is_constant() else _either(gap, -contact.counts * self.eom.length)

    @cached_property
    def mechanics(self) -> SX:
        """What decides about the contacts, in the order and the shapes of ``mechanics_shapes``."""
        eom, q = self.eom, self.eom.q
        J = vertcat(*(jacobian(contact.position, q) for contact in eom.mechanism.contacts.values()))
        springs = [-eom.force_of(energy) for energy in eom.mechanism.potential_while.values()]
        parts = (eom.M, -eom.B - eom.G, eom.E, horzcat(SX(q.numel(), 0), *springs), J, jtimes(J @ eom.dq, q, eom.dq))
        return BUILT.watch(vertcat(*(vec(densify(part.T)) for part in parts)))  # rows one after the other

    @property
    def mechanics_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the parts of ``mechanics``.

        M, generalised forces besides those of motors and contacts, E, forces of the springs that act in some modes
        (a column for each entry of ``Mechanism.potential_while``), J with the rows t and n of each contact, and dJ dq.
        """
        n, k = self.eom.q.numel(), 2 * len(self.walker.contacts)
        springs = len(self.eom.mechanism.potential_while)
        shapes = ((n, n), (n,), (n, len(self.walker.actuators)), (n, springs), (k, n), (k,))
        return dict(zip(("M", "force", "E", "springs", "J", "convective"), shapes, strict=True))

    @cached_property
    def law(self) -> tuple[SX, SX, SX]:
        """Torques as a function of the accelerations that the law uses, and these: with the contacts held, and actual.

        Each is a column: the shape accelerations without torques, then their derivative by each torque.
        """
        n, u = len(self.walker.shape), len(self.walker.actuators)
        held, actual = SX.sym("held", n * (1 + u)), SX.sym("actual", n * (1 + u))

        def accelerations(is_actual: bool) -> tuple[SX, SX]:
            values = reshape(actual if is_actual else held, n, 1 + u)
            return values[:, 0], values[:, 1:]

        torque = torques(self._control, self._instant(accelerations), vertcat(self.p, held, actual))
        return BUILT.watch((torque, held, actual))

    @property
    def law_uses(self) -> tuple[bool, bool]:
        """Whether the torques depend on the accelerations with the contacts held, and on the actual ones."""
        torque, held, actual = self.law
        return depends_on(torque, held), depends_on(torque, actual)

    def points(self) -> dict[str, SX]:
        """Height, velocity (v_t, v_n), and ``Contact.counts`` of every contact."""
        contacts = self.eom.mechanism.contacts.values()
        velocities = [jacobian(contact.position, self.eom.q) @ self.eom.dq for contact in contacts]
        return {
            "heights": vertcat(*(contact.position[1] for contact in contacts)),
            "velocities": vertcat(*velocities),
            "counts": vertcat(*(contact.counts for contact in contacts)),
        }


def _either(a: SX, b: SX) -> SX:
    """Positive where one of two numbers is; where b is negative it falls through zero with a, at the same rate.

    Rvachev's disjunction: a maximum without a kink, of which engines can take Taylor series.
    """
    return a + b + sqrt(a**2 + b**2)
