"""A walker, its control law and the ground in CasADi symbols; ``gaitopt.model.system`` compiles them."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace

from casadi import (
    SX,
    densify,
    depends_on,
    horzcat,
    jacobian,
    jtimes,
    reshape,
    substitute,
    vec,
    vertcat,
    vertsplit,
)

from gaitopt.building import BUILT
from gaitopt.model.contacts import Friction as Coefficients
from gaitopt.model.contacts import Impact, Motion, impact, massless_landing, motion, ordered, push_off
from gaitopt.model.contract import quantities, torques
from gaitopt.model.control import Control, parameter_names
from gaitopt.model.foreign import FOOT_COORDINATES
from gaitopt.model.friction import ContactFriction, Friction, ImpactLaw
from gaitopt.model.instant import Instant
from gaitopt.model.lagrangian import equations_of_motion, equations_on_tiles
from gaitopt.model.modes import FOOT, OFF, SWING_FOOT, Mode
from gaitopt.model.section import TOUCHDOWN, section_of
from gaitopt.model.transitions import PUSH, impulse_name, share_name, transitions
from gaitopt.model.walker import Walker
from gaitopt.threads import cached_method, cached_property


class Expressions:
    """All expressions of one walker under one control law; for the parameters see ``HybridSystem``.

    Attributes
    ----------
    t, z, p, r : time since the last impact, state, parameters and segment data, the arguments of all expressions.
    eom : equations of motion of the walker.
    transitions : the table of the walker.
    """

    def __init__(
        self,
        walker: type[Walker],
        control: Control,
        law: ImpactLaw,
        friction: Friction | ContactFriction,
        cycle_end: str = TOUCHDOWN,
        uneven: bool = False,
    ) -> None:
        self.walker, self._control, self._law = walker, control, law
        self.eom = equations_on_tiles(walker) if uneven else equations_of_motion(walker)
        coefficients = SX.sym("c", len(friction.parameters))
        self._scalars = SX.sym("k", len(control.parameters))
        self.t, self.z, self.r = SX.sym("t"), self.eom.z, SX.sym("r", control.data(0).size)
        feedback = SX.sym("f", len(control.feedback_parameters))  # which acts between the steps, not in expressions
        self.p = vertcat(self.eom.p, coefficients, self._scalars, self.eom.ground, feedback)
        self._impacts: dict[tuple[Mode, tuple[str, ...], tuple[str, ...]], Impact] = {}
        self._pushes: dict[tuple[tuple[str, ...], Mode], tuple[Mapping[str, SX], SX, SX]] = {}
        self._torques: dict[tuple[str, Mode | None], SX] = {}

        self.transitions = transitions(walker, friction, law, cycle_end)
        of = friction.of(coefficients)
        if FOOT in of and FOOT not in walker.contacts:
            of.setdefault(SWING_FOOT, of[FOOT])
        static, kinetic, viscous = ({name: SX(c[k]) for name, c in of.items()} for k in range(3))
        self._friction = Coefficients(static=static, kinetic=kinetic, viscous=viscous)
        BUILT.watch(vars(self))

    # ---- the control law

    def torque(self, mode: Mode) -> SX:
        """Actuator torques in a mode, shape (n_u,); most laws do not depend on it."""
        sticking = mode.held
        for key in (("any", None), ("sticking", sticking), ("actual", mode)):
            if key in self._torques:
                return self._torques[key]
        uses = "any"

        def accelerations(actual: bool) -> tuple[SX, SX]:
            nonlocal uses
            uses = "actual" if actual or uses == "actual" else "sticking"
            return self._accelerations(mode, actual)

        torque = BUILT.watch(torques(self._control, self._instant(accelerations), self.p))
        self._torques[uses, {"any": None, "sticking": sticking, "actual": mode}[uses]] = torque
        return torque

    def quantities(self, mode: Mode) -> dict[str, SX]:
        """Further expressions of the control law in a mode."""
        now = self._instant(lambda actual: self._accelerations(mode, actual))
        return quantities(self._control, now, self.p)

    @property
    def phase_rate(self) -> SX:
        """Rate of the phase variable of the control law."""
        return vars(self._instant(lambda actual: (SX(0), SX(0))).ds)[self._control.phase_variable]

    @cached_property
    def law(self) -> tuple[SX, SX, SX]:
        """Torques as a function of accelerations, and their symbols: those with the contacts sticking, and the actual.

        Each is a column: the shape accelerations without torques, then their derivative by each torque.
        """
        n, u = len(self.walker.shape), len(self.walker.actuators)
        sticking, actual = SX.sym("sticking", n * (1 + u)), SX.sym("actual", n * (1 + u))

        def accelerations(is_actual: bool) -> tuple[SX, SX]:
            values = reshape(actual if is_actual else sticking, n, 1 + u)
            return values[:, 0], values[:, 1:]

        torque = torques(self._control, self._instant(accelerations), vertcat(self.p, sticking, actual))
        return BUILT.watch((torque, sticking, actual))

    @property
    def law_uses(self) -> tuple[bool, bool]:
        """Whether the torques depend on the accelerations with the contacts sticking, and on the actual ones."""
        torque, sticking, actual = self.law
        return depends_on(torque, sticking), depends_on(torque, actual)

    def _accelerations(self, mode: Mode, actual: bool) -> tuple[SX, SX]:
        """Shape accelerations without torques, and derivatives by torques, in a mode or with all contacts sticking."""
        u, first = SX.sym("u", len(self.walker.actuators)), len(self.walker.coordinates())
        dz = self._driven(mode if actual else mode.held, u).dz
        ddq = dz[first : first + len(self.walker.shape)]
        return substitute(ddq, u, SX.zeros(u.numel())), jacobian(ddq, u)

    def _instant(self, accelerations: Callable[[bool], tuple[SX, SX]]) -> Instant:
        """The input of the control law, in symbols."""
        names, n = (*self.walker.shape, *FOOT_COORDINATES), len(self.walker.shape)
        q, dq = ({name: values[k] for k, name in enumerate(names)} for values in (self.eom.q, self.eom.dq))
        phases = self.eom.mechanism.phases
        rates = {name: jtimes(phase, self.eom.q[:n], self.eom.dq[:n]) for name, phase in phases.items()}
        shape, shape_rates = ({name: values[name] for name in self.walker.shape} for values in (q, dq))
        return Instant(
            t=self.t,
            q=SimpleNamespace(**q),
            dq=SimpleNamespace(**dq),
            s=SimpleNamespace(**shape, **phases),
            ds=SimpleNamespace(**shape_rates, **rates),
            p=parameter_names(self._control, self._scalars),
            r=self.r,
            robot=self.eom,
            _accelerations=accelerations,
        )

    # ---- motions

    @cached_method
    def motion(self, mode: Mode) -> Motion:
        """Accelerations and contact forces in a mode."""
        return BUILT.watch(self._driven(mode, self.torque(mode)))

    def _driven(self, mode: Mode, torque: SX) -> Motion:
        """Accelerations and contact forces in a mode under given torques."""
        springs = self.eom.force_of(self.potential_of(mode))
        return motion(self.eom, mode, self._friction, springs=springs, torque=torque)

    def rate(self, mode: Mode) -> SX:
        """dz/dt in a mode, shape (n_z,)."""
        return self.motion(mode).dz

    def forces(self, mode: Mode) -> SX:
        """(f_t, f_n) of all contacts, one after the other [N]."""
        forces = self.motion(mode).forces
        return vertcat(*(forces[name] for name in self.walker.contact_names()))

    def potential_of(self, mode: Mode) -> SX:
        """The potential energies that act in this mode, but not in all modes."""
        energies = self.eom.mechanism.potential_while.items()
        return sum((energy for state, energy in energies if mode.has(state)), SX(0))

    def momentum(self, mode: Mode) -> dict[str, SX]:
        """Terms of d(M dq)/dt = E u - weight - rest for the shape, while the foot sticks."""
        n, eom = len(self.walker.shape), self.eom
        weight, momentum = eom.gravity_force(eom.mechanism.gravity)[:n], eom.M[:n, :n] @ eom.dq[:n]
        forces = (eom.B + eom.G + eom.force_of(self.potential_of(mode)))[:n]
        rest = forces - weight - jtimes(momentum, eom.q[:n], eom.dq[:n])
        return {"momentum": momentum, "E": eom.E[:n, :], "weight": weight, "rest": rest}

    def margins(self, mode: Mode) -> SX:
        """Margins of a mode, in the order of ``Transitions.margin_names``."""
        found, eom = self.motion(mode), self.eom
        margins: dict[str, SX] = {
            "upright": eom.mechanism.upright,
            **eom.sections,
            **eom.mechanism.stops,
            **eom.switches,
        }
        margins |= {"regularity": found.regularity, "painleve": found.apparent_mass}
        for name, contact in eom.contacts.items():
            f_t, f_n = found.forces[name][0], found.forces[name][1]
            height = contact.position[1] if self.walker.stands_on_one() else contact.gap
            of_contact = {"gap": contact.gap, "clearance": height}
            if not self.transitions.may_land(mode):
                of_contact = dict.fromkeys(of_contact, SX(1))
            if name in mode.touching:
                of_contact = {
                    "normal_force": f_n,
                    "cone_forward": self._friction.static[name] * f_n + f_t,
                    "cone_backward": self._friction.static[name] * f_n - f_t,
                    "slip_velocity": mode.directions[name] * contact.velocity[0],
                }
            margins |= {self.transitions.name(what, name): value for what, value in of_contact.items()}
        margins |= {share_name(share.parts): share.value for share in found.shares}
        return vertcat(*(margins[name] for name in self.transitions.margin_names(mode)))

    # ---- impacts

    def impact(self, mode: Mode, before: Mode) -> Impact:
        """The impact after which the walker is in a mode, with the names that the contacts have before it.

        The coordinates of a massless contact that lands take their values; a massless foot lands without an impulse.
        Under the frictionless law, contacts that land and slip have no tangential impulse.

        Parameters
        ----------
        mode : mode just after it, with the stops that are locked then; without stops at the end of a step.
        before : mode just before it.
        """
        walker, landing = self.walker, tuple(name for name in mode.touching if name not in before.touching)
        mode = walker.held_in_impact(mode, before)
        pushing = tuple(name for name in walker.pushing() if landing and name in before.touching)
        pushed, key = self.push(before)[1] if pushing else None, (mode, landing, pushing)
        if key not in self._impacts:
            self._impacts[key] = BUILT.watch(self._impact(mode, landing, pushed))
        return self._impacts[key]

    def _impact(self, mode: Mode, landing: tuple[str, ...], pushed: SX | None) -> Impact:
        eom, friction = self.eom, self._friction
        if landing and self.walker.massless_feet:
            none = dict.fromkeys(eom.contacts, SX.zeros(2))
            return Impact(q=eom.q, dq=eom.dq, impulses=none, velocities=none, regularity=SX(1), apparent_mass=SX(1),
                          shares=())  # fmt: skip
        if self._law is ImpactLaw.FRICTIONLESS:
            friction = replace(friction, kinetic=dict(friction.kinetic) | dict.fromkeys(landing, SX(0)))
        places = [name for name in landing if name in self.walker.placed_contacts()]
        return impact(eom, mode, friction, before=pushed, places=places)

    def impulse(self, mode: Mode, before: Mode) -> SX:
        """(F_t, F_n) of all contacts [N s], in the order that they have before an impact; for a lone foot, its own.

        For the arguments see ``impact``.
        """
        impulses = self.impact(mode, before).impulses
        return vertcat(*(impulses[name] for name in self.walker.struck_contacts(mode)))

    def foot_velocities(self, mode: Mode, before: Mode) -> tuple[SX, SX]:
        """v_t of the foot on the ground and v_n of the former stance foot just after an impact of a walker on one foot.

        For the arguments see ``impact``.
        """
        velocities, (foot, *_) = self.impact(mode, before).velocities, (*mode.touching, FOOT)
        return velocities[foot][0], velocities[FOOT][1]

    def push(self, before: Mode) -> tuple[Mapping[str, SX], SX, SX]:
        """The push of the contacts that are on the ground in the mode before another one lands.

        Returns
        -------
        impulses : (P_t, P_n) [N s] by contact, shape (2,).
        rates : rates just after the push, shape (n_q,).
        work : its work [J].
        """
        pushing = tuple(name for name in self.walker.pushing() if name in before.touching)
        off = before.with_states(dict.fromkeys(before.contacts, OFF))
        if (pushing, off) not in self._pushes:
            pushes, contacts = self.eom.mechanism.pushes, self.eom.contacts
            impulses = {name: contacts[name].R @ pushes[name] for name in pushing}
            self._pushes[pushing, off] = BUILT.watch((impulses, *push_off(self.eom, off, pushing)))
        return self._pushes[pushing, off]

    def approach(self, before: Mode, contact: str = SWING_FOOT) -> SX:
        """Normal velocity with which a contact lands."""
        return (self.eom.contacts[contact].J @ self.push(before)[1])[1]

    def impact_margins(self, mode: Mode, before: Mode) -> dict[str, SX]:
        """Margins of an impact by name.

        Parameters
        ----------
        mode : mode just after it, with the names that the contacts have before it.
        before : mode just before it.
        """
        table, static, (pushes, pushed, _) = self.transitions, self._friction.static, self.push(before)
        names = table.impact_margin_names(mode, before)
        if not names:
            return {}
        result, n = self.impact(mode, before), len(self.walker.coordinates())
        margins: dict[str, SX] = {
            "impact_regularity": result.regularity,
            "impact_painleve": result.apparent_mass,
        }
        for name, (p_t, p_n) in ((name, vertsplit(impulse)) for name, impulse in pushes.items()):
            edges = static[name] * p_n + p_t, static[name] * p_n - p_t
            margins |= zip((table.name(cone, name) for cone in PUSH[:2]), edges, strict=True)
        for name, contact in self.eom.contacts.items():
            impulse_t, impulse_n = result.impulses[name][0], result.impulses[name][1]
            of_contact = {"lift_velocity": result.velocities[name][1]}
            if name in mode.touching:
                of_contact = {
                    "impulse": impulse_n,
                    "impulse_cone_forward": static[name] * impulse_n + impulse_t,
                    "impulse_cone_backward": static[name] * impulse_n - impulse_t,
                    "impact_slip_velocity": mode.directions[name] * result.velocities[name][0],
                    "touchdown_rate": -jtimes(SX(contact.gap), self.z[:n], self.z[n:]),
                    PUSH[2]: -(contact.J @ pushed)[1],
                }
            if name in mode.touching and table.name("impact_onset", name) in names:
                stick = self.impact(mode.with_states({name: Mode.STICK}), before).impulses[name]
                of_contact["impact_onset"] = -static[name] * stick[1] - mode.directions[name] * stick[0]
            margins |= {table.name(what, name): value for what, value in of_contact.items()}
        margins |= {impulse_name(share_name(share.parts)): share.value for share in result.shares}
        return {name: margins[name] for name in names}

    def reset(self, mode: Mode, before: Mode, *, ends_step: bool) -> SX:
        """The state after a reset has ended a phase, as a function of the state before it, shape (n_z,).

        Parameters
        ----------
        mode, before : modes just after and just before it, with the names that the contacts have before it.
        ends_step : whether the step ends. The shape is then relabelled, and x is counted from the new base point.
            Deviations from the section that the motion would keep are removed: those of the energy, and of the heights
            of contacts that never leave the ground.
        """
        z, end = self.after(mode, before, ends_step=ends_step), self.transitions.cycle_end
        if not ends_step:
            return z
        z[len(self.walker.coordinates()) - 1] = 0
        if end != TOUCHDOWN or "energy" in self.walker.model_fields:
            after = self.walker.swapped(mode) if end == TOUCHDOWN else mode
            section = section_of(self.walker, before, after, end)
            p = self.eom.p if end != TOUCHDOWN else self.walker.step_parameters(self.eom.p)[-1]
            z = section.projected(z=z, p=p)["z_plus"]
        return z

    def stopped_together(self, mode: Mode, after: Mode) -> SX:
        """The state after slips of several contacts have ended at one instant, from the state before it, shape (n_z,).

        Both states are the same if all velocities are zero. If a slip still has the velocity v at the end of the first
        slip, it ends t = -v / v' later in the mode in between. This changes the state by t (f - f'), with the rates f
        and v' in that mode and f' in the next one. The derivative is that of the events one after the other.
        """
        z = SX(self.z)
        for name, before, following in self.transitions.stops_in_turn(mode, after):
            velocity, rate = self.eom.contacts[name].velocity[0], self.rate(before)
            time = -velocity / jtimes(velocity, self.z, rate)
            z = substitute(self.z + time * (rate - self.rate(following)), self.z, z)
        return z

    def after(self, mode: Mode, before: Mode, *, ends_step: bool) -> SX:
        """The state of ``reset`` without its projection; x is the position of the base point. See also ``impact``."""
        landing = {name for name in mode.touching if name not in before.touching}
        if landing and self.walker.stands_on_one():
            return self._on_other_foot(mode, before)
        strikes = landing or (not ends_step and mode.locked != before.locked)
        z = self.state_after(mode, before) if strikes else SX(self.z)
        ends = self.transitions.cycle_end == TOUCHDOWN
        swaps = ends_step if ends else bool(landing & {*self.walker.step_ends()})
        return substitute(self.relabelled, self.z, z) if swaps else z

    def _on_other_foot(self, mode: Mode, before: Mode) -> SX:
        """The state after the impact of a walker on one foot: the base point is the foot that has landed."""
        eom, n = self.eom, len(self.walker.shape)
        base, shape, result = eom.mechanism.swing_foot[0], eom.mechanism.relabel, self.impact(mode, before)
        rates = jtimes(shape, eom.q[:n], result.dq[:n])
        if self.walker.massless_feet:
            shape, rates = massless_landing(eom)
        along = result.velocities[SWING_FOOT][0] * eom.contacts[SWING_FOOT].R[0, :]
        return vertcat(eom.state(shape, base), eom.state(rates, along[0], along[1]))

    def state_after(self, mode: Mode, before: Mode) -> SX:
        """The state just after an impact, before any relabelling, shape (n_z,); for the arguments see ``impact``."""
        result = self.impact(mode, before)
        return vertcat(ordered(self.eom, result.q), ordered(self.eom, result.dq))

    @property
    def relabelled(self) -> SX:
        """The state after the feet have swapped roles; x is the position of the new base point."""
        eom, n = self.eom, len(self.walker.shape)
        shape, base, velocity = eom.mechanism.relabel, eom.mechanism.swing_foot, eom.W_swing @ eom.dq
        rates = jtimes(shape, eom.q[:n], eom.dq[:n])
        return vertcat(eom.state(shape, base[0], base[1]), eom.state(rates, velocity[0], velocity[1]))

    # ---- what decides about the contacts

    def points(self) -> dict[str, SX]:
        """Height, velocity (v_t, v_n), and ``Contact.counts`` of every contact."""
        contacts, named = self.eom.contacts.values(), self.eom.mechanism.contacts
        counts = (named[name].counts if name in named else SX(1) for name in self.eom.contacts)
        return {
            "heights": vertcat(*(contact.position[1] for contact in contacts)),
            "velocities": vertcat(*(contact.velocity for contact in contacts)),
            "counts": vertcat(*counts),
        }

    @cached_property
    def mechanics(self) -> SX:
        """M, forces and J of all contacts and stops, in the order and with the shapes of ``mechanics_shapes``."""
        eom, contacts = self.eom, self.eom.contacts.values()
        J = vertcat(*(contact.J for contact in contacts), *eom.gaps.values())
        convective = vertcat(*(contact.convective for contact in contacts), SX.zeros(len(eom.gaps)))
        springs = [-eom.force_of(energy) for energy in eom.mechanism.potential_while.values()]
        matrices = (eom.M, -eom.B - eom.G, eom.E, horzcat(SX(eom.q.numel(), 0), *springs), J, convective)
        return BUILT.watch(vertcat(*(vec(densify(matrix.T)) for matrix in matrices)))  # rows one after the other

    @property
    def mechanics_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the matrices of ``mechanics``.

        They are M; the generalised forces without those of motors and contacts; E; the forces of the springs that
        act in some modes, with a column for each entry of ``Mechanism.potential_while``; J with the rows t and n of
        each contact and one row of each stop; and dJ dq.
        """
        n, k = self.eom.q.numel(), 2 * len(self.walker.landing_points()) + len(self.walker.stops)
        springs = len(self.eom.mechanism.potential_while)
        shapes = ((n, n), (n,), (n, len(self.walker.actuators)), (n, springs), (k, n), (k,))
        return dict(zip(("M", "force", "E", "springs", "J", "convective"), shapes, strict=True))
