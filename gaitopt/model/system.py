"""The hybrid system: a walker, its control and the ground as compiled CasADi functions.

    dz/dt = flow_mode(t, z, p, r)         t time since the last impact, z state, p parameters, r segment data
    margins_mode(t, z, p, r) > 0          while the mode holds; it ends when a margin falls to zero
    z_plus = impact_mode(z, p)            reset at touchdown

Every number of walker, friction and control is an entry of ``p``, named by its dotted key. Any of them can therefore be
varied, freed or continued without building a function again. ``Expressions`` combines the symbols of a walker, its
control and the ground; ``HybridSystem`` compiles them. The NLP and the simulator share these functions.
"""

import pickle
import re
from collections.abc import Callable, Mapping
from functools import wraps
from inspect import signature
from typing import Any, Concatenate, ParamSpec, TypeAlias, TypeVar, cast

import numpy as np
from casadi import SX, Function, cse, densify, horzcat, jacobian, jtimes, vec, vertcat

from gaitopt.arrays import Array
from gaitopt.building import building, built_once
from gaitopt.model.control import Control
from gaitopt.model.cycle import Cycle
from gaitopt.model.declaration import has_links, joint_limits, named_arguments
from gaitopt.model.expressions import Expressions
from gaitopt.model.friction import COULOMB, ContactFriction, Friction, ImpactLaw
from gaitopt.model.lagrangian import ground_names
from gaitopt.model.links import state_tree
from gaitopt.model.modes import SWING_FOOT, Mode
from gaitopt.model.section import TOUCHDOWN, Section, section_of, stated_state
from gaitopt.model.step_feedback import Correction
from gaitopt.model.walker import Walker
from gaitopt.threads import Uncompared, cached_property

FLOOR = "floor"
"""Beginning of the keys of the ground under the contacts, which are not parameters of a problem."""
MOST_UNPICKLED = 16
"""Largest number of unpickled systems that are kept with their compiled functions, some megabytes each."""
Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")
Method: TypeAlias = Callable[Concatenate["HybridSystem", Arguments], Value]


def compiled(
    inputs: str, before: Callable[["HybridSystem", Mode], Mode] | None = None
) -> Callable[[Method[Arguments, dict[str, SX]]], Method[Arguments, Function]]:
    """Decorator of a method that returns expressions by name: the method then returns their function, built once.

    Parameters
    ----------
    inputs : letters of the arguments; the method also returns the symbols of arguments other than t, z, p and r.
    before : maps the method's argument ``before`` to the mode that stands for all modes with the same expressions.
    """

    def decorated(expressions: Method[Arguments, dict[str, SX]]) -> Method[Arguments, Function]:
        position = [*signature(expressions).parameters].index("before") - 1 if before is not None else None
        defaults = expressions.__kwdefaults__ or {}

        @wraps(expressions)
        def function(system: "HybridSystem", /, *args: Arguments.args, **kwargs: Arguments.kwargs) -> Function:
            positional: list[Any] = [*args]
            named = cast(dict[str, Any], {**defaults, **kwargs})
            if before is not None and position is not None:
                positional[position] = before(system, positional[position])
            key = (expressions.__name__, *positional, *named.values())
            if key not in system._functions:
                system._compile(key, inputs, lambda: expressions(system, *positional, **named))
            return system._functions[key]

        return function

    return decorated


def _touching_and_locked(system: "HybridSystem", before: Mode) -> Mode:
    """The mode before an impact without what does not matter: contacts that touch, and locked stops, but no slip."""
    contact = before.contact.with_states(dict.fromkeys(before.touching, Mode.STICK))
    return Mode.of(contact, dict.fromkeys(before.locked, "locked"))


def _before_reset(system: "HybridSystem", before: Mode) -> Mode:
    """The mode before a reset without what does not matter. A section at the end of a cycle may depend on all."""
    return _touching_and_locked(system, before) if system.cycle_end == TOUCHDOWN else before


class HybridSystem:
    """Functions of one walker under one control law, which are built on first use and kept.

    A system never changes, so that a copy is the system itself. A pickle holds walker, control and laws; equal systems
    that are unpickled are one object, whose functions are compiled once.

    Parameters
    ----------
    walker : the walker's class.
    control : the control law, of which the structure and the segment data matter here, but not the scalars.
    law : tangential law of slipping impacts.
    friction : friction law of the feet; its numbers are entries of ``p``.
    cycle_end : event that ends a cycle: ``touchdown``, ``clock`` or the name of a margin.
    uneven : whether the ground under each contact has a height and a slope, see ``lagrangian.ground_names``.

    Attributes
    ----------
    parameters : dotted keys of ``p`` in order: walker, friction, control, ground.
    walker, control, law, friction, cycle_end, uneven : see the parameters.
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
        uneven: bool = False,
    ) -> None:
        self.walker, self.control, self.law, self.friction = walker, control, law, friction
        self.cycle_end, self.uneven = cycle_end, uneven
        self.parameters = (
            *(f"walker.{name}" for name in walker.model_fields),
            *friction.parameters,
            *(f"control.{name}" for name in control.parameters),
            *(f"{FLOOR}.{name}" for name in ground_names(walker) if uneven),
            *(f"control.{name}" for name in control.feedback_parameters),
        )
        self.state_names = walker.state_names()
        self.n_z = len(self.state_names)
        self.n_shape = len(walker.coordinates()) - 1
        self.n_r = control.data(0).size
        n_walker = len(walker.model_fields)
        self._friction_entries = slice(n_walker, n_walker + len(friction.parameters))
        self._symbols = Expressions(walker, control, law, friction, cycle_end, uneven)
        self.transitions, self._eom = self._symbols.transitions, self._symbols.eom
        self._functions: dict[tuple[Any, ...], Function] = {}
        self._data: dict[int, Array] = {}
        self._origin: HybridSystem | None = None

    def retimed(self, control: Control) -> "HybridSystem":
        """The same functions under a law that differs only in breakpoints, segment data and values of parameters."""
        twin = object.__new__(HybridSystem)
        vars(twin).update(vars(self), control=control, _data={}, _origin=self.shared)
        return twin

    @property
    def shared(self) -> "HybridSystem":
        """The system whose functions this one uses: the key of everything that depends on the functions only."""
        return self._origin or self

    @property
    def expressions(self) -> Expressions:
        """The expressions of which its functions are made."""
        return self._symbols

    def __copy__(self) -> "HybridSystem":
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "HybridSystem":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self.walker, self.control, self.law, self.friction, self.cycle_end, self.uneven)

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
        """(t, z, p, r) -> dz/dt, Jacobian of the margins by z, and rates of the margins along the flow."""
        dz, margins = self._symbols.rate(mode), self._symbols.margins(mode)
        by_z = jacobian(margins, self._eom.z)
        return {"dz": dz, "margins_by_z": by_z, "rates": by_z @ dz + jacobian(margins, self._symbols.t)}

    @compiled("typr")
    def variational(self, mode: Mode, columns: int) -> dict[str, SX]:
        """(t, y, p, r) -> dy/dt of y = (z, columns of deviations one after the other).

        Under feedback from step to step the columns of deviations of the corrected parameters, which are constant
        during a cycle, follow.
        """
        z, dz, deviations = self._eom.z, self._symbols.rate(mode), SX.sym("deviations", self.n_z, columns)
        rates, corrected = jacobian(dz, z) @ deviations, self._corrected
        changes = SX.sym("changes", corrected.numel(), columns)
        if changes.numel():
            rates += jacobian(dz, corrected) @ changes
        zeros = SX.zeros(changes.numel())
        return {"y": vertcat(z, vec(deviations), vec(changes)), "dy": vertcat(dz, vec(rates), zeros)}

    @property
    def _corrected(self) -> SX:
        """The parameters that feedback from step to step corrects in any step of a cycle."""
        return SX(0, 1) if self.correction is None else self._symbols.p[self.correction.entries]

    @compiled("tzpr")
    def margins_by_corrected(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> Jacobian of the margins by the parameters that feedback from step to step corrects."""
        return {"margins_by_corrected": densify(jacobian(self._symbols.margins(mode), self._corrected))}

    @compiled("typr")
    def varied(self, mode: Mode, places: tuple[int, ...]) -> dict[str, SX]:
        """(t, y, p, r) -> dy/dt of y = (z, deviations), in columns by the start state, then by parameters."""
        z, dz, columns = self._eom.z, self._symbols.rate(mode), self.n_z + len(places)
        deviations = SX.sym("deviations", self.n_z, columns)
        forcing = horzcat(SX.zeros(self.n_z, self.n_z), jacobian(dz, self._symbols.p)[:, [*places]])
        rates = jacobian(dz, z) @ deviations + forcing
        return {"y": vertcat(z, vec(deviations)), "dy": densify(vertcat(dz, vec(rates)))}

    @compiled("tzpr")
    def margins_by_parameters(self, mode: Mode, places: tuple[int, ...]) -> dict[str, SX]:
        """(t, z, p, r) -> Jacobian of the margins in some parameters."""
        return {"margins_by_p": densify(jacobian(self._symbols.margins(mode), self._symbols.p)[:, [*places]])}

    @compiled("zp")
    def landing_by_parameters(
        self, mode: Mode, before: Mode, ends_step: bool, places: tuple[int, ...]
    ) -> dict[str, SX]:
        """(z, p) -> Jacobians of ``reset`` in some parameters, and of the step length in the state and in these."""
        z, p, x = self._symbols.z, self._symbols.p, self.n_shape
        z_plus = self._symbols.reset(mode, before, ends_step=ends_step)
        length = self._symbols.after(mode, before, ends_step=ends_step)[x]
        by_p = jacobian(length, p)[:, [*places]]
        return {
            "z_plus_by_p": densify(jacobian(z_plus, p)[:, [*places]]),
            "length_by_z": densify(jacobian(length, z)),
            "length_by_p": densify(by_p),
        }

    @compiled("tzpr")
    def observation(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> contact forces, torques (n_u), motor power (n_u), swing foot (2), energy, E' dq, loss, slip.

        The contact forces are (f_t, f_n) of one contact after the other. The loss is the power that the dampers
        dissipate, the slip the tangential velocity of every contact.
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
            "slip": vertcat(*(eom.contacts[name].velocity[0] for name in self.walker.contact_names())),
        }

    @cached_property
    def angle_names(self) -> tuple[str, ...]:
        """Names of ``angles``: shape coordinates, motors, phase variables, and all other joints of the links."""
        names = (*self.walker.shape, *self.walker.actuators, *self.walker.phases)
        return (*names, *(name for name in joint_limits(self.walker) if name not in names))

    @property
    @compiled("zp")
    def angles(self) -> dict[str, SX]:
        """(z, p) -> angles of the links and joints of ``angle_names`` and their rates, shape (n,) each [rad, or m]."""
        eom, walker, n = self._eom, self.walker, len(self.walker.shape)
        named, motors = named_arguments(walker, eom.q, eom.p), zip(walker.actuators, eom.mechanism.motors, strict=True)
        joints = state_tree(walker, *named).joints if has_links(walker) else {}
        known = {**joints, **eom.mechanism.phases, **dict(motors), **vars(named[0])}
        angles = vertcat(*(known[name] for name in self.angle_names))
        return {"angles": angles, "rates": jtimes(angles, eom.q[:n], eom.dq[:n])}

    @compiled("tzpr")
    def quantities(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> ``Control.quantities`` of the law, which must have some."""
        return self._symbols.quantities(mode)

    @compiled("zp")
    def phase_rate(self) -> dict[str, SX]:
        """(z, p) -> rate of the phase variable of a law that has one [rad/s, or m/s]."""
        return {"phase_rate": self._symbols.phase_rate}

    @compiled("tzpr")
    def momentum(self, mode: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> terms of d(M dq)/dt = E u - weight - rest for the shape, while the foot sticks.

        M dq, weight and rest have the shape (n_shape,), E has (n_shape, n_u). The rest is the force of springs and
        dampers, less the derivative of the kinetic energy by the shape.
        """
        return self._symbols.momentum(mode)

    @compiled("zp", before=_touching_and_locked)
    def impact(self, mode: Mode, before: Mode, *, ends_step: bool = True) -> dict[str, SX]:
        """(z, p) -> z_plus, impulse. z_plus is that of ``reset``, but x is the position of the base point.

        The impulse is (F_t, F_n) of all contacts, in the order that they have before the impact; for a foot that stands
        alone, its own impulse.
        """
        z_plus = self._symbols.after(mode, before, ends_step=ends_step)
        return {"z_plus": z_plus, "impulse": self._symbols.impulse(mode, before)}

    @compiled("zp", before=_touching_and_locked)
    def impacts(self, before: Mode, *modes: Mode) -> dict[str, SX]:
        """(z, p) -> z_plus, impulse and ``foot_velocities`` in a column for each mode; velocity of the landing [m/s].

        The walker stands on one foot; see ``Expressions``. The velocity is the normal velocity of the swing foot before
        the landing.
        """
        columns, symbols = list[SX](), self._symbols
        for mode in modes:
            ends_step = any(name not in before.touching for name in mode.touching)
            z_plus = symbols.after(mode, before, ends_step=ends_step)
            columns.append(vertcat(z_plus, symbols.impulse(mode, before), *symbols.foot_velocities(mode, before)))
        return {"impacts": horzcat(*columns), "approach": symbols.approach(before)}

    @compiled("zp")
    def approach(self, before: Mode, contact: str) -> dict[str, SX]:
        """(z, p) -> normal velocity with which a contact lands in a mode [m/s]."""
        return {"approach": self._symbols.approach(before, contact)}

    @compiled("zp", before=_touching_and_locked)
    def impact_margins(self, mode: Mode, before: Mode) -> dict[str, SX]:
        """(z, p) -> margins of an impact in the order of ``transitions.impact_margin_names(mode, before)``."""
        return {"margins": vertcat(SX(0, 1), *self._symbols.impact_margins(mode, before).values())}

    @compiled("zp", before=_before_reset)
    def reset(self, mode: Mode, before: Mode, *, ends_step: bool = True) -> dict[str, SX]:
        """(z, p) -> z_plus: the state after the event that ends a phase; x is counted from the new base point.

        Parameters
        ----------
        mode : mode just after the impact, with the names that the contacts have before it; see ``Transitions.struck``.
        before : mode just before it.
        ends_step : whether the step ends.
        """
        return {"z_plus": self._symbols.reset(mode, before, ends_step=ends_step)}

    @compiled("zp", before=_before_reset)
    def reset_jacobian(self, mode: Mode, before: Mode, *, ends_step: bool = True) -> dict[str, SX]:
        """(z, p) -> d z_plus / dz of ``reset``, shape (n_z, n_z)."""
        (z_plus,) = self.reset(mode, before, ends_step=ends_step).call([self._symbols.z, self._symbols.p])
        return {"z_plus_by_z": jacobian(z_plus, self._eom.z)}

    @compiled("tzpr")
    def stopped_together(self, mode: Mode, after: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> z_plus: the state in ``after`` when slips of several contacts have ended at one instant."""
        return {"z_plus": self._symbols.stopped_together(mode, after)}

    @compiled("tzpr")
    def stopped_together_jacobian(self, mode: Mode, after: Mode) -> dict[str, SX]:
        """(t, z, p, r) -> d z_plus / dz of ``stopped_together``, shape (n_z, n_z)."""
        return {"z_plus_by_z": jacobian(self._symbols.stopped_together(mode, after), self._eom.z)}

    @property
    def mechanics_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the parts of ``mechanics``; see ``Expressions``."""
        return self._symbols.mechanics_shapes

    @property
    def springs_while(self) -> tuple[str, ...]:
        """States in which further springs act, in the order of their columns in ``mechanics``."""
        return tuple(self._eom.mechanism.potential_while)

    @property
    @compiled("zp")
    def mechanics(self) -> dict[str, SX]:
        """(z, p) -> M, forces and J of all contacts, from which forces in any mode follow; see ``mechanics_shapes``."""
        return {"mechanics": self._symbols.mechanics}

    @property
    @compiled("zdp")
    def mechanics_rate(self) -> dict[str, SX]:
        """(z, dz/dt, p) -> rate of ``mechanics`` along a motion."""
        dz, mechanics = SX.sym("dz", self.n_z), self._symbols.mechanics
        return {"d": dz, "rate": jtimes(mechanics, self._symbols.z, dz)}

    @property
    @building
    def law_uses(self) -> tuple[bool, bool]:
        """Whether the torques depend on the accelerations with the contacts sticking, and on the actual ones."""
        return self._symbols.law_uses

    @property
    @compiled("tzhapr")
    def law_torques(self) -> dict[str, SX]:
        """(t, z, sticking, actual, p, r) -> torques from accelerations that the law may use; see ``Expressions``."""
        torque, sticking, actual = self._symbols.law
        return {"h": sticking, "a": actual, "torque": torque}

    @property
    @compiled("tzhadpr")
    def law_torques_rate(self) -> dict[str, SX]:
        """(t, z, sticking, actual, rates of z, sticking and actual, p, r) -> rate of ``law_torques``."""
        torque, sticking, actual = self._symbols.law
        arguments = vertcat(self._symbols.z, sticking, actual)
        rates = SX.sym("rates", arguments.numel())
        rate = jtimes(torque, arguments, rates) + jacobian(torque, self._symbols.t)
        return {"h": sticking, "a": actual, "d": rates, "rate": rate}

    @property
    @compiled("zp")
    def descent(self) -> dict[str, SX]:
        """(z, p) -> rates of the guard of touchdown on level ground, and of the swing foot's height; of one foot."""
        z, n = self._symbols.z, self.n_shape + 1
        falling = vertcat(-SX(self._eom.mechanism.touchdown), self._eom.contacts[SWING_FOOT].position[1])
        return {"rates": jtimes(falling, z[:n], z[n:])}

    @property
    @compiled("zp")
    def trailing_foot(self) -> dict[str, SX]:
        """(z, p) -> height of the foot that has just left the ground, if the walker may fall back on it [m]."""
        foot = self._eom.mechanism.trailing_foot
        return {"height": SX(0, 1) if foot is None else foot[1]}

    @compiled("zp")
    def swing_height_gradient(self, places: tuple[int, ...]) -> dict[str, SX]:
        """(z, p) -> gradient of the height of the swing foot in the state and in some parameters, shape (n_z + m,)."""
        height, symbols = self._eom.mechanism.swing_foot[1], self._symbols
        by_p = jacobian(height, symbols.p)[:, [*places]]
        return {"gradient": densify(horzcat(jacobian(height, symbols.z), by_p).T)}

    @property
    @compiled("zp")
    def contact_points(self) -> dict[str, SX]:
        """(z, p) -> height of every contact, its velocity (v_t, v_n), and a number that is positive if it may land."""
        return self._symbols.points()

    @compiled("zp", before=_touching_and_locked)
    def push(self, before: Mode) -> dict[str, SX]:
        """(z, p) -> impulses (2, n) of the contacts that push off before another one lands, work [J], rates.

        The rates are those of (shape, x, y) just after the push.
        """
        impulses, rates, work = self._symbols.push(before)
        return {"impulse": horzcat(SX(2, 0), *impulses.values()), "work": work, "rates": rates}

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
        xi = SX.sym("xi", len(self.walker.section_names(slipping=True)))
        return {"x": xi, "z_plus": stated_state(self.walker, xi, self._eom.p)}

    @property
    @compiled("xp")
    def lift_jacobian(self) -> dict[str, SX]:
        """(xi, p) -> d z / d xi of ``lift``; the column of dx is the last."""
        xi = SX.sym("xi", self.lift.size1_in(0))
        return {"x": xi, "z_plus_by_xi": jacobian(self.lift(xi, self._symbols.p), xi)}

    @building
    def _compile(self, key: tuple[Any, ...], inputs: str, expressions: Callable[[], dict[str, SX]]) -> None:
        if key not in self._functions:  # another thread may just have built it
            common = {"t": self._symbols.t, "z": self._symbols.z, "p": self._symbols.p, "r": self._symbols.r}
            results = expressions()
            symbols = [results.pop(letter) if letter in results else common[letter] for letter in inputs]
            name = re.sub(r"[\W_]+", "_", "_".join(map(str, key))).strip("_")
            self._functions[key] = Function(name, symbols, cse([*results.values()]), [*inputs], [*results])

    def section(self, of: Cycle | Mode) -> Section:
        """The section of a cycle, or of contacts ``of`` that touch the ground before the event and after it."""
        before, after = (of.phases[-1], of.impact) if isinstance(of, Cycle) else (self.walker.swapped(of), of)
        return section_of(self.walker, before, after, self.cycle_end)

    def values(self, parameters: Mapping[str, float]) -> Array:
        """The vector ``p``, shape (n_p,), from values by dotted key; the control law's own values are the default."""
        of_law = self.control.parameters | self.control.feedback_parameters
        values = {**{f"control.{name}": value for name, value in of_law.items()}, **parameters}
        return np.array([float(values[name]) for name in self.parameters])

    @cached_property
    def _swapped_parameters(self) -> list[int] | None:
        """Indices of the parameters after those of contacts and control have been swapped; None if nothing changes."""
        friction, indices = self._friction_entries, [*range(len(self.parameters))]
        order = [friction.start + k for k in self.friction.exchanged(self.walker.partners())]
        swapped = [*indices[: friction.start], *order, *indices[friction.stop :]]
        for pair in self.control.exchanged.items():
            one, other = (self.parameters.index(f"control.{key}") for key in pair)
            swapped[one], swapped[other] = other, one
        return None if swapped == indices else swapped

    @property
    def legs(self) -> int:
        """Number of parameter sets of ``step_parameters`` for any values of the parameters."""
        return len(self.step_parameters(self._symbols.p))

    def step_parameters(self, p: Any) -> tuple[Any, ...]:
        """Parameters in each of the first steps, after which they repeat: one set if the legs are alike, otherwise two.

        At every landing that ends a step, legs that differ swap their parameters and their friction, and a control
        law swaps those that it exchanges.

        Parameters
        ----------
        p : ndarray or CasADi symbols, shape (n_p,) - those of the first step.
        """
        if self.cycle_end != TOUCHDOWN:
            return (p,)
        of_walker, order = self.walker.step_parameters(p), self._swapped_parameters
        if order is None:
            return of_walker
        other = of_walker[-1][order]
        if len(of_walker) == 1 and isinstance(p, np.ndarray) and np.array_equal(p, other):
            return (p,)
        return p, other

    @cached_property
    def correction(self) -> Correction | None:
        """The feedback from step to step; None if the law has none."""
        feedback = self.control.step_feedback
        if feedback is None:
            return None
        exchanged = {f"control.{one}": f"control.{other}" for one, other in self.control.exchanged.items()}
        return Correction(feedback, self.parameters, self.state_names, exchanged)

    def data(self, segment: int) -> Array:
        """Segment data of the control, shape (n_r,); read-only by convention."""
        if segment not in self._data:
            self._data[segment] = self.control.data(segment)
        return self._data[segment]

    def contact_coefficients(self, p: Any) -> dict[str, tuple[Any, Any, Any]]:
        """Static, kinetic and viscous coefficient of every contact by name."""
        return self.friction.of(p[self._friction_entries])


def _unpickled(
    walker: type[Walker],
    control: Control,
    law: ImpactLaw,
    friction: Friction | ContactFriction,
    cycle_end: str,
    uneven: bool,
) -> HybridSystem:
    key = (walker, law, friction, cycle_end, uneven, pickle.dumps(control))  # laws are equal if their pickles are
    return _system(key, Uncompared((walker, control, law, friction, cycle_end, uneven)))


@built_once(maxsize=MOST_UNPICKLED)
def _system(key: tuple[object, ...], stated: Uncompared[tuple[Any, ...]]) -> HybridSystem:
    return HybridSystem(*stated.value)
