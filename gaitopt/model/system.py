"""The hybrid system: a walker, its control and the ground as compiled CasADi functions.

    dz/dt = flow_mode(t, z, p, r)         t time since the last impact, z state, p parameters, r segment data
    margins_mode(t, z, p, r) > 0          while the mode holds; it ends where a margin falls to zero
    z_plus = impact_mode(z, p)            reset at touchdown

Every number of walker, friction and control is an entry of ``p``, named by its dotted key. Any of them can therefore be
varied, freed or continued without building a function again. ``Expressions`` puts the symbols of a walker, its control
and the ground together; ``HybridSystem`` compiles them. The NLP and the simulator share these functions.
"""

import pickle
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import wraps
from types import SimpleNamespace
from typing import Any, Concatenate, ParamSpec, TypeAlias, TypeVar

import numpy as np
from casadi import SX, Function, cse, horzcat, jacobian, jtimes, substitute, symvar, vec, vertcat

from gaitopt.arrays import Array
from gaitopt.building import BUILT, building, built_once
from gaitopt.model.buffered import buffered
from gaitopt.model.contact import Impact, Motion, Push, flight, impact, landing, motion, push_off, strike, take_off
from gaitopt.model.contract import quantities, torques
from gaitopt.model.control import Control, parameter_names
from gaitopt.model.cycle import Cycle
from gaitopt.model.declaration import FOOT_COORDINATES, has_links, joint_limits, state_after_impact, state_tree
from gaitopt.model.friction import COULOMB, ContactFriction, Friction, ImpactLaw
from gaitopt.model.instant import Instant
from gaitopt.model.lagrangian import equations_of_motion, parameter_namespace
from gaitopt.model.modes import FOOT, Mode
from gaitopt.model.section import TOUCHDOWN, Section, contact_section
from gaitopt.model.transitions import transitions
from gaitopt.model.walker import Walker
from gaitopt.threads import cached_property


class Expressions:
    """A walker, its control and the ground in CasADi symbols; parameters as for ``HybridSystem``.

    Attributes
    ----------
    t, z, p, r : time since the last impact, state, parameters and segment data, the arguments of all expressions.
    eom : equations of motion of the walker.
    transitions : the table of the walker.
    """

    def __init__(self, walker: type[Walker], control: Control, law: ImpactLaw, friction: Friction) -> None:
        self.walker, self._control, self._law = walker, control, law
        self.eom = equations_of_motion(walker)
        coefficients = SX.sym("c", len(friction.parameters))
        self._scalars = SX.sym("k", len(control.parameters))
        self.t, self.z, self.r = SX.sym("t"), self.eom.z, SX.sym("r", control.data(0).size)
        self.p = vertcat(self.eom.p, coefficients, self._scalars)
        self._motions: dict[Mode, Motion] = {}
        self._impacts: dict[Mode, Impact] = {}
        self._torques: dict[tuple[str, Mode | None], SX] = {}

        self.transitions = transitions(walker, friction, law)
        self._static, self._kinetic, self._viscous = friction.coefficients(coefficients)
        BUILT.watch(vars(self))

    def torque(self, mode: Mode, slip: SX | None = None) -> SX:
        """Actuator torques in a mode, shape (n_u,); most laws do not depend on it.

        Parameters
        ----------
        slip : an unknown sign of the slip in place of that of the mode.
        """
        held = self._held(mode)
        for key in (("any", None), ("held", held), *((("actual", mode),) if slip is None else ())):
            if key in self._torques:
                return self._torques[key]
        uses = "any"

        def accelerations(actual: bool) -> tuple[SX, SX]:
            nonlocal uses
            uses = "actual" if actual or uses == "actual" else "held"
            return self._accelerations(mode, slip, actual)

        known = self.p if slip is None else vertcat(self.p, *symvar(slip))
        torque = BUILT.watch(torques(self._control, self._instant(accelerations), known))
        if uses != "actual" or slip is None:
            self._torques[uses, {"any": None, "held": held, "actual": mode}[uses]] = torque
        return torque

    def quantities(self, mode: Mode) -> dict[str, SX]:
        """Further expressions of the control law in a mode."""
        now = self._instant(lambda actual: self._accelerations(mode, None, actual))
        return quantities(self._control, now, self.p)

    @property
    def phase_rate(self) -> SX:
        """Rate of the phase variable of the control law."""
        return vars(self._instant(lambda actual: (SX(0), SX(0))).ds)[self._control.phase_variable]

    def momentum(self, mode: Mode) -> dict[str, SX]:
        """Terms of d(M dq)/dt = E u - weight - rest for the shape, while the foot is held."""
        n, eom = len(self.walker.shape), self.eom
        weight, momentum = eom.gravity_force(eom.mechanism.gravity)[:n], eom.M[:n, :n] @ eom.dq[:n]
        forces = (eom.B + eom.G + eom.force_of(self.potential_of(mode)))[:n]
        rest = forces - weight - jtimes(momentum, eom.q[:n], eom.dq[:n])
        return {"momentum": momentum, "E": eom.E[:n, :], "weight": weight, "rest": rest}

    def _accelerations(self, mode: Mode, slip: SX | None, actual: bool) -> tuple[SX, SX]:
        """Shape accelerations without torques, and their derivative by the torques, in a mode or with the foot held."""
        u, first = SX.sym("u", len(self.walker.actuators)), len(self.walker.coordinates())
        dz = self._rate(mode, u, slip) if actual else self._rate(self._held(mode), u)
        ddq = dz[first : first + len(self.walker.shape)]
        return substitute(ddq, u, SX.zeros(u.numel())), jacobian(ddq, u)

    def _held(self, mode: Mode) -> Mode:
        """The mode in which the foot sticks instead."""
        return mode.with_contact(Mode.STICK)

    def _rate(self, mode: Mode, torque: SX, slip: SX | None = None) -> SX:
        """dz/dt in a mode under given torques, with an unknown sign of the slip if there is one."""
        return self._moving(_slip(mode) if slip is None else slip, mode, torque).dz

    def _instant(self, accelerations: Callable[[bool], tuple[SX, SX]]) -> Instant:
        """What the control law knows, in symbols."""
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

    def motion(self, mode: Mode) -> Motion:
        """Accelerations and contact force in a mode."""
        if mode not in self._motions:
            self._motions[mode] = BUILT.watch(self._moving(_slip(mode), mode, self.torque(mode)))
        return self._motions[mode]

    def rate(self, mode: Mode) -> SX:
        """dz/dt in a mode, shape (n_z,)."""
        return self.motion(mode).dz

    def forces(self, mode: Mode) -> SX:
        """(f_t, f_n) of all contacts, one after the other [N]."""
        return self.motion(mode).force

    def slipping(self, slip: SX, mode: Mode) -> Motion:
        """Motion with a sign of the slip that may be an unknown between -1 and 1."""
        return self._moving(slip, mode, self.torque(mode, slip))

    def _moving(self, slip: SX | None, mode: Mode, torque: SX) -> Motion:
        """Motion under given torques with the springs and locked stops of a mode; ``slip`` None holds the foot."""
        springs, locked = self.eom.force_of(self.potential_of(mode)), self._locked(mode.locked)
        if not mode.touching:
            return flight(self.eom, springs=springs, torque=torque, locked=locked)
        drag = SX(self._viscous) * self.eom.z[-1]
        return motion(self.eom, slip, kinetic=self._kinetic, drag=drag, springs=springs, torque=torque, locked=locked)

    def potential_of(self, mode: Mode) -> SX:
        """Potential energy that acts only in this mode and some others."""
        energies = self.eom.mechanism.potential_while.items()
        return sum((energy for state, energy in energies if mode.has(state)), SX(0))

    def _locked(self, stops: tuple[str, ...]) -> SX:
        """Derivative of the gaps of some stops by the shape coordinates."""
        gaps = vertcat(SX(0, 1), *(self.eom.mechanism.stops[name] for name in stops))
        return jacobian(gaps, self.eom.q[: len(self.walker.shape)])

    def impact(self, mode: Mode) -> Impact:
        """The impact after which the walker is in a mode: of the foot, or of the stops that are locked in it."""
        if mode not in self._impacts:
            walker, locked = self.walker, self._locked(mode.locked)
            if not mode.touching:
                result = take_off(self.eom, locked)
            elif mode.locked:
                result = strike(self.eom, _slip(mode), self._kinetic, locked)
            elif walker.massless_feet:
                result = landing(self.eom)
            else:
                held = self._locked(tuple(stop for stop in walker.stops if stop not in walker.open_in_impact))
                result = impact(self.eom, _slip(mode), self._law, self._kinetic, held)
            self._impacts[mode] = BUILT.watch(result)
        return self._impacts[mode]

    def open_impact(self, slip: SX) -> Impact:
        """The impact of the foot where the sign of the slip is an unknown between -1 and 1."""
        return impact(self.eom, slip, ImpactLaw.COULOMB, self._kinetic, self._locked(()))

    def margins(self, mode: Mode) -> SX:
        """Margins of a mode, in the order of ``Transitions.margin_names``."""
        state, mu = self.motion(mode), self._static
        f_t, f_n = state.force[0], state.force[1]
        lands = not (mode.touching and self.walker.flies)  # a walker that flies lands out of flight alone
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
        return vertcat(*(margins[name] for name in self.transitions.margin_names(mode)))

    @cached_property
    def push(self) -> Push:
        """The push of the stance foot just before the swing foot lands."""
        return BUILT.watch(push_off(self.eom, self._locked(self.walker.stops)))

    @property
    def approach(self) -> SX:
        """Normal velocity with which the swing foot lands."""
        return (self.eom.W_swing @ self.push.rates)[1]

    def impact_margins(self, mode: Mode, before: Mode | None = None) -> dict[str, SX]:
        """Margins of an impact by name."""
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
    """Sign of the slip in a mode; None if the foot sticks."""
    return None if mode.sticks else SX(mode.direction)


KEPT = 16
"""Number of unpickled systems that are kept with their compiled functions, some megabytes each."""
Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")
Method: TypeAlias = Callable[Concatenate["HybridSystem", Arguments], Value]


def compiled(inputs: str) -> Callable[[Method[Arguments, dict[str, SX]]], Method[Arguments, Function]]:
    """Decorator of a method that returns expressions by name: it returns the function of them, built once.

    Parameters
    ----------
    inputs : letters of the arguments; the method also returns the symbols of those that are not t, z, p or r.
    """

    def decorated(expressions: Method[Arguments, dict[str, SX]]) -> Method[Arguments, Function]:
        @wraps(expressions)
        def function(system: "HybridSystem", /, *args: Arguments.args, **kwargs: Arguments.kwargs) -> Function:
            key = (expressions.__name__, *args)
            if key not in system._functions:
                system._compile(key, inputs, lambda: expressions(system, *args, **kwargs))
            return system._functions[key]

        return function

    return decorated


class HybridSystem:
    """Functions of one walker under one control law; all are built on first use and kept.

    A system never changes, so that a copy is the system itself. A pickle holds walker, control and laws; equal systems
    that are unpickled are one object, whose functions are compiled once.

    Parameters
    ----------
    walker : the walker's class.
    control : the control law, of which the structure and the segment data matter here, but not the scalars.
    law : tangential law of slipping impacts.
    friction : friction law of the feet; its numbers are entries of ``p``.
    cycle_end : what ends a cycle of a walker with named contacts: ``touchdown``, ``clock`` or the name of a margin.

    Attributes
    ----------
    parameters : dotted keys of ``p`` in order: walker, friction, control.
    walker, control, law, friction, cycle_end : as given.
    transitions : the table of modes, margins and events.
    state_names : names of ``z`` in order.
    n_z, n_shape : number of states, and of the coordinates before x: the shape, and the height of a foot that can fly.
    """

    @building
    def __init__(
        self,
        walker: type[Walker],
        control: Control,
        law: ImpactLaw = ImpactLaw.COULOMB,
        friction: Friction | ContactFriction = COULOMB,
        cycle_end: str = TOUCHDOWN,
    ) -> None:
        self.walker, self.control, self.law, self.friction = walker, control, law, friction
        self.cycle_end = cycle_end
        self.parameters = (
            *(f"walker.{name}" for name in walker.model_fields),
            *friction.parameters,
            *(f"control.{name}" for name in control.parameters),
        )
        self.state_names = walker.state_names()
        self.n_z = len(self.state_names)
        self.n_shape = len(walker.coordinates()) - 1
        self.n_r = control.data(0).size
        n_walker = len(walker.model_fields)
        self._friction_entries = slice(n_walker, n_walker + len(friction.parameters))
        if isinstance(friction, ContactFriction):
            from gaitopt.model.contact_system import ContactExpressions  # it derives from ``Expressions``

            self._contacts = ContactExpressions(walker, control, law, friction, cycle_end)
            self._symbols: Expressions = self._contacts
        else:
            self._symbols = Expressions(walker, control, law, friction)
        self.transitions, self._eom = self._symbols.transitions, self._symbols.eom
        self._functions: dict[tuple[Any, ...], Function] = {}
        self._data: dict[int, Array] = {}
        self._sections: dict[bool, TouchdownSection] = {}

    @property
    def expressions(self) -> Expressions:
        """The expressions of which its functions are made."""
        return self._symbols

    def __copy__(self) -> "HybridSystem":
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "HybridSystem":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self.walker, self.control, self.law, self.friction, self.cycle_end)

    @compiled("tzpr")
    def flow(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> dz/dt."""
        return {"dz": self._symbols.rate(mode)}

    @compiled("tzpr")
    def torques(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> actuator torques (n_u)."""
        return {"torque": self._symbols.torque(mode)}

    @compiled("tzpr")
    def margins(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> margins in the order of ``transitions.margin_names(mode)``."""
        return {"margins": self._symbols.margins(mode)}

    @compiled("tzpr")
    def events(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> margins and their rates along the flow."""
        margins, dz = self._symbols.margins(mode), self._symbols.rate(mode)
        return {"margins": margins, "rates": jtimes(margins, self._eom.z, dz) + jacobian(margins, self._symbols.t)}

    @compiled("tzpr")
    def linearized(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> dz/dt, Jacobian of the margins in z, and rates of the margins along the flow."""
        dz, margins = self._symbols.rate(mode), self._symbols.margins(mode)
        by_z = jacobian(margins, self._eom.z)
        return {"dz": dz, "margins_by_z": by_z, "rates": by_z @ dz + jacobian(margins, self._symbols.t)}

    @compiled("typr")
    def variational(self, mode: Mode, columns: int) -> dict[str, SX]:
        """(t, y, p, r) -> dy/dt of y = (z, columns of deviations one after the other)."""
        z, dz, deviations = self._eom.z, self._symbols.rate(mode), SX.sym("deviations", self.n_z, columns)
        return {"y": vertcat(z, vec(deviations)), "dy": vertcat(dz, vec(jacobian(dz, z) @ deviations))}

    @compiled("tzpr")
    def observation(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> contact forces, torques (n_u), motor power (n_u), swing foot (2), energy, E' dq, loss.

        The forces (f_t, f_n) of all contacts follow each other. The loss is the power that the dampers dissipate.
        """
        eom, torque = self._eom, self._symbols.torque(mode)
        motor_rates = eom.E.T @ eom.dq
        return {
            "force": self._symbols.forces(mode),
            "torque": torque,
            "power": torque * motor_rates,
            "swing_foot": eom.mechanism.swing_foot,
            "energy": eom.energy + self._symbols.potential_of(mode),
            "motor_rates": motor_rates,
            "loss": eom.dissipation,
        }

    @cached_property
    def angle_names(self) -> tuple[str, ...]:
        """Names of ``angles``: shape coordinates, motors, phase variables, and the joints of the links without one."""
        names = (*self.walker.shape, *self.walker.actuators, *self.walker.phases)
        return (*names, *(name for name in joint_limits(self.walker) if name not in names))

    @property
    @compiled("zp")
    def angles(self) -> dict[str, SX]:
        """(z, p) -> angles of the links and joints of ``angle_names`` and their rates, shape (n,) each [rad, or m]."""
        eom, walker, names = self._eom, self.walker, (*self.walker.shape, "x", "y")
        q = SimpleNamespace(**{name: eom.q[k] for k, name in enumerate(names)})
        joints = state_tree(walker, q, parameter_namespace(walker, eom.p)).joints if has_links(walker) else {}
        motors, phases, n = (
            zip(walker.actuators, eom.mechanism.motors, strict=True),
            eom.mechanism.phases,
            len(names) - 2,
        )
        known = {**joints, **phases, **dict(motors), **vars(q)}
        angles = vertcat(*(known[name] for name in self.angle_names))
        return {"angles": angles, "rates": jtimes(angles, eom.q[:n], eom.dq[:n])}

    @compiled("tzpr")
    def quantities(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> ``Control.quantities`` of the law; no function without any."""
        return self._symbols.quantities(mode)

    @compiled("zp")
    def phase_rate(self) -> dict[str, SX]:
        """(z, p) -> rate of the phase variable of a law that has one [rad/s, or m/s]."""
        return {"phase_rate": self._symbols.phase_rate}

    @compiled("tzpr")
    def momentum(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> terms of d(M dq)/dt = E u - weight - rest for the shape, while the foot is held.

        M dq, weight and rest have the shape (n_shape,), E has (n_shape, n_u). The rest is the force of springs and
        dampers, less the derivative of the kinetic energy by the shape.
        """
        return self._symbols.momentum(mode)

    @compiled("zp")
    def impact(self, mode: Mode) -> dict[str, SX]:
        """(z, p) -> z_plus, impulse (2), slip velocity, lift velocity, painleve; see ``contact.Impact``."""
        result = self._symbols.impact(mode)
        return {field.name: getattr(result, field.name) for field in fields(result)}

    @compiled("zp")
    def impacts(self, *modes: Mode) -> dict[str, SX]:
        """(z, p) -> outputs of ``impact`` in one column per mode; normal velocity of the swing foot before it [m/s]."""
        columns = [vertcat(*self.impact(mode).call([self._symbols.z, self._symbols.p])) for mode in modes]
        return {"impacts": horzcat(*columns), "approach": self._symbols.approach}

    @compiled("zp")
    def approach(self) -> dict[str, SX]:
        """(z, p) -> normal velocity with which the swing foot lands [m/s]."""
        return {"approach": self._symbols.approach}

    @compiled("zp")
    def impact_jacobian(self, mode: Mode) -> dict[str, SX]:
        """(z, p) -> d z_plus / dz, shape (n_z, n_z)."""
        return {"z_plus_by_z": jacobian(self._symbols.impact(mode).z_plus, self._eom.z)}

    @compiled("zp")
    def impact_margins(self, mode: Mode, before: Mode | None = None) -> dict[str, SX]:
        """(z, p) -> margins of an impact in the order of ``transitions.impact_margin_names(mode, before)``."""
        margins, names = self._symbols.impact_margins(mode, before), self.transitions.impact_margin_names(mode, before)
        return {"margins": vertcat(SX(0, 1), *(margins[name] for name in names))}

    def reset(self, mode: Mode, before: Mode | None = None, *, ends_step: bool = True) -> Function:
        """(z, p) -> z_plus: the state after the event that ends a phase; x is counted from the new base point.

        Parameters
        ----------
        mode : just after the impact, with the contacts as they are called before it; see ``Transitions.struck``.
        before, ends_step : mode just before it, and whether the step ends; needed where the contacts have names.
        """
        return self._reset(mode, before, ends_step) if mode.is_named else self._reset(mode, None, not mode.locked)

    def reset_jacobian(self, mode: Mode, before: Mode | None = None, *, ends_step: bool = True) -> Function:
        """(z, p) -> d z_plus / dz of ``reset``, shape (n_z, n_z)."""
        if mode.is_named:
            return self._reset_jacobian(mode, before, ends_step)
        return self._reset_jacobian(mode, None, not mode.locked)

    @compiled("zp")
    def _reset(self, mode: Mode, before: Mode | None, ends_step: bool) -> dict[str, SX]:
        if before is not None:
            return {"z_plus": self._contacts.reset(mode, before, ends_step=ends_step)}
        z_plus = SX(self._symbols.impact(mode).z_plus)
        if ends_step:
            z_plus[self.n_shape] = 0
        return {"z_plus": z_plus}

    @compiled("zp")
    def _reset_jacobian(self, mode: Mode, before: Mode | None, ends_step: bool) -> dict[str, SX]:
        (z_plus,) = self._reset(mode, before, ends_step).call([self._symbols.z, self._symbols.p])
        return {"z_plus_by_z": jacobian(z_plus, self._eom.z)}

    @property
    def mechanics_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the parts of ``mechanics``; see ``ContactExpressions``."""
        return self._contacts.mechanics_shapes

    @property
    def springs_while(self) -> tuple[str, ...]:
        """States in which further springs act, in the order of their columns in ``mechanics``."""
        return tuple(self._eom.mechanism.potential_while)

    @property
    @compiled("zp")
    def mechanics(self) -> dict[str, SX]:
        """(z, p) -> M, forces and J of all contacts, from which forces in any mode follow; see ``mechanics_shapes``."""
        return {"mechanics": self._contacts.mechanics}

    @property
    @compiled("zdp")
    def mechanics_rate(self) -> dict[str, SX]:
        """(z, dz/dt, p) -> rate of ``mechanics`` along a motion."""
        dz, mechanics = SX.sym("dz", self.n_z), self._contacts.mechanics
        return {"d": dz, "rate": jtimes(mechanics, self._symbols.z, dz)}

    @property
    @building
    def law_uses(self) -> tuple[bool, bool]:
        """Whether the torques depend on the accelerations with the contacts held, and on the actual ones."""
        return self._contacts.law_uses

    @property
    @compiled("tzhapr")
    def law_torques(self) -> dict[str, SX]:
        """(t, z, held, actual, p, r) -> torques from accelerations that the law may use; see ``ContactExpressions``."""
        torque, held, actual = self._contacts.law
        return {"h": held, "a": actual, "torque": torque}

    @property
    @compiled("tzhadpr")
    def law_torques_rate(self) -> dict[str, SX]:
        """(t, z, held, actual, rates of z, held and actual, p, r) -> rate of ``law_torques``."""
        torque, held, actual = self._contacts.law
        arguments = vertcat(self._symbols.z, held, actual)
        rates = SX.sym("rates", arguments.numel())
        rate = jtimes(torque, arguments, rates) + jacobian(torque, self._symbols.t)
        return {"h": held, "a": actual, "d": rates, "rate": rate}

    @compiled("zp")
    def contact_impact(self, mode: Mode, landing: tuple[str, ...]) -> dict[str, SX]:
        """(z, p) -> z_plus and impulses; see ``ContactImpact``."""
        result = self._contacts.collision(mode, landing)
        return {"z_plus": result.z_plus, "impulses": vertcat(*result.impulses.values())}

    @property
    @compiled("zp")
    def relabelled(self) -> dict[str, SX]:
        """(z, p) -> z_plus: the state after the feet have swapped roles, x being the position of the new base point."""
        return {"z_plus": self._contacts.relabelled}

    @property
    @compiled("zp")
    def contact_points(self) -> dict[str, SX]:
        """(z, p) -> height of every contact, its velocity (v_t, v_n), and a number above zero where it may land."""
        return self._contacts.points()

    @property
    @compiled("tzspr")
    def open_flow(self) -> dict[str, SX]:
        """(t, z, s, p, r) -> dz/dt, contact force (2), touchdown guard and its rate, of a foot whose mode is unknown.

        Friction is -mu s f_n with s in [-1, 1]; kinetic friction bounds a foot at rest too.
        """
        s, guard = SX.sym("s"), SX(self._eom.mechanism.touchdown)
        state = self._symbols.slipping(s, self.walker.released(Mode.STICK))
        rate = jtimes(guard, self._eom.z, state.dz)
        return {"s": s, "dz": state.dz, "force": state.force, "guard": guard, "guard_rate": rate}

    @property
    @compiled("zsp")
    def open_impact(self) -> dict[str, SX]:
        """(z, s, p) -> z_plus, impulse (2), slip velocity, lift velocity, by Coulomb's law with s in [-1, 1]."""
        s = SX.sym("s")
        result = self._symbols.open_impact(s)
        names = ("z_plus", "impulse", "slip_velocity", "lift_velocity")
        return {"s": s} | {name: getattr(result, name) for name in names}

    @property
    @compiled("zp")
    def push(self) -> dict[str, SX]:
        """(z, p) -> impulse (2) of the push of the stance foot just before the swing foot lands, and its work [J]."""
        return {"impulse": self._symbols.push.impulse, "work": self._symbols.push.work}

    @property
    @compiled("p")
    def weight(self) -> dict[str, SX]:
        """p -> total weight [N]."""
        return {"weight": self._eom.mass * self._eom.gravity}

    @property
    @compiled("p")
    def incline(self) -> dict[str, SX]:
        """p -> sin(slope): gravity along the ground divided by gravity."""
        return {"incline": self._eom.mechanism.gravity[0] / self._eom.gravity}

    @property
    @compiled("zp")
    def centre_height(self) -> dict[str, SX]:
        """(z, p) -> height of the centre of mass, normal to the ground [m]."""
        return {"height": self._eom.centre_height}

    @property
    @compiled("p")
    def size(self) -> dict[str, SX]:
        """p -> length of a leg [m], gravity [m/s^2] and total mass [kg]."""
        return {"length": self._eom.length, "gravity": self._eom.gravity, "mass": self._eom.mass}

    @property
    @compiled("xp")
    def lift(self) -> dict[str, SX]:
        """(xi, p) -> z: the state just after an impact from its section coordinates (always with dx), x = 0."""
        names = self.walker.section_names(slipping=True)
        xi = SX.sym("xi", len(names))
        free = SimpleNamespace(**{name: xi[i] for i, name in enumerate(names)})
        shape, rates = state_after_impact(self.walker, free, parameter_namespace(self.walker, self._eom.p))
        return {"x": xi, "z_plus": vertcat(self._eom.state(shape, SX(0)), self._eom.state(rates, xi[-1]))}

    @property
    @compiled("xp")
    def lift_jacobian(self) -> dict[str, SX]:
        """(xi, p) -> d z / d xi of ``lift``; the column of dx is the last."""
        xi = SX.sym("xi", self.lift.size1_in(0))
        return {"x": xi, "z_plus_by_xi": jacobian(self.lift(xi, self._symbols.p), xi)}

    @building
    def _compile(self, key: tuple[Any, ...], inputs: str, expressions: Callable[[], dict[str, SX]]) -> None:
        if key not in self._functions:  # unless another thread has just built it
            common = {"t": self._symbols.t, "z": self._symbols.z, "p": self._symbols.p, "r": self._symbols.r}
            results = expressions()
            symbols = [results.pop(letter) if letter in results else common[letter] for letter in inputs]
            name = re.sub(r"[\W_]+", "_", "_".join(map(str, key))).strip("_")
            self._functions[key] = Function(name, symbols, cse([*results.values()]), [*inputs], [*results])

    def section(self, of: Cycle | Mode) -> Section:
        """The section just after the event that ends a cycle, or just after an impact of a foot."""
        if isinstance(of, Cycle) and self.walker.contacts:
            return contact_section(self.walker, of.phases[-1], of.impact, self.cycle_end)
        slipping = of.impact.slips if isinstance(of, Cycle) else of.slips
        if slipping not in self._sections:
            self._sections[slipping] = TouchdownSection(self, slipping=slipping)
        return self._sections[slipping]

    def values(self, parameters: Mapping[str, float]) -> Array:
        """The vector ``p`` from values by dotted key, shape (n_p,); those of the control law are its own by default."""
        values = {**{f"control.{name}": value for name, value in self.control.parameters.items()}, **parameters}
        return np.array([float(values[name]) for name in self.parameters])

    def data(self, segment: int) -> Array:
        """Segment data of the control, shape (n_r,); not to be written to."""
        if segment not in self._data:
            self._data[segment] = self.control.data(segment)
        return self._data[segment]

    def friction_coefficients(self, p: Any) -> tuple[Any, Any, Any]:
        """Static, kinetic and viscous coefficient from parameters as numbers or symbols; see ``Friction``."""
        return self.contact_coefficients(p)[FOOT]

    def contact_coefficients(self, p: Any) -> dict[str, tuple[Any, Any, Any]]:
        """The three coefficients of every contact by name."""
        return self.friction.of(p[self._friction_entries])


class TouchdownSection(Section):
    """The section of a walker that stands on one foot at a time; its class says which coordinates are free.

    Parameters
    ----------
    slipping : whether the foot slips just after the impact; dx is then the last coordinate.
    """

    def __init__(self, system: HybridSystem, *, slipping: bool) -> None:
        self._system, self._slipping, self.words = system, slipping, "slip" if slipping else "stick"
        self.names = system.walker.section_names(slipping=slipping)
        self.indices = np.array([system.state_names.index(name) for name in self.names])

    def lift(self, xi: Array, p: Array, near: Array | None = None) -> Array:
        """See ``Section``, for coordinates with or without dx, whatever the state ``near``."""
        full = np.zeros(len(self._system.walker.section_names(slipping=True)))
        full[: xi.size] = xi
        return buffered(self._system.lift)(full, p)[0].copy()

    def tangent(self, z: Array, p: Array) -> Array:
        """See ``Section``."""
        xi = z[self._system.section(Mode.SLIP_FORWARD).indices]
        (flat,) = buffered(self._system.lift_jacobian)(xi, p)
        return flat.reshape(z.size, -1, order="F")[:, : self.indices.size]

    def holds(self, before: Mode, impact: Mode) -> bool:
        """See ``Section``."""
        return impact.slips is self._slipping


@dataclass(frozen=True, slots=True, kw_only=True)
class _Definition:
    """What defines a system; control laws are equal if their pickles are."""

    walker: type[Walker]
    law: ImpactLaw
    friction: Friction | ContactFriction
    cycle_end: str
    control_pickle: bytes
    control: Control = field(compare=False)


def _unpickled(
    walker: type[Walker], control: Control, law: ImpactLaw, friction: Friction | ContactFriction, cycle_end: str
) -> HybridSystem:
    definition = _Definition(
        walker=walker,
        law=law,
        friction=friction,
        cycle_end=cycle_end,
        control_pickle=pickle.dumps(control),
        control=control,
    )
    return _system(definition)


@built_once(maxsize=KEPT)
def _system(definition: _Definition) -> HybridSystem:
    d = definition
    return HybridSystem(d.walker, d.control, d.law, d.friction, d.cycle_end)
