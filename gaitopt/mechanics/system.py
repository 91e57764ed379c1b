"""The hybrid system: a walker, its control and the ground as compiled CasADi functions.

    dz/dt = flow_mode(t, z, p, r)         t time since the last impact, z state, p parameters, r segment data
    margins_mode(t, z, p, r) > 0          what the mode assumes; it ends where a margin falls to zero
    z_plus = impact_mode(z, p)            reset at touchdown

Every number of walker, friction and control is an entry of ``p``, named by its dotted key, so that any of them
can be varied, freed or continued without rebuilding anything. The NLP and the simulator both use these functions.
"""

import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from casadi import SX, Function, cse, horzcat, jacobian, jtimes, vec, vertcat
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.mechanics.control.law import Control
from gaitopt.mechanics.declaration import state_after_impact
from gaitopt.mechanics.expressions import Expressions
from gaitopt.mechanics.friction import CoulombFriction, Friction
from gaitopt.mechanics.lagrangian import parameter_namespace
from gaitopt.mechanics.margins import PUSH, impact_margin_names
from gaitopt.mechanics.modes import ImpactLaw, Mode
from gaitopt.mechanics.walker import Walker

COULOMB = CoulombFriction()
KEPT = 16
"""Unpickled systems that are kept with their compiled functions, some megabytes each."""


class HybridSystem:
    """Functions of one walker under one control law; all are built on first use and kept.

    A copy is the system itself, as nothing changes it. A pickle holds what it is made of; where it is read, equal
    systems are one object, whose functions are compiled once.

    Parameters
    ----------
    walker : the walker's class.
    control : the control law; its current scalars do not matter here, only its structure and segment data.
    law : tangential law of slipping impacts.
    friction : friction law of the feet; its numbers are entries of ``p``.

    Attributes
    ----------
    parameters : dotted keys of ``p`` in order: walker, friction, control.
    friction : as given.
    state_names : names of ``z`` in order.
    n_z, n_shape : number of states, and of the coordinates before x: the shape, and the height of a foot that can fly.
    """

    def __init__(
        self,
        walker: type[Walker],
        control: Control,
        law: ImpactLaw = ImpactLaw.COULOMB,
        friction: Friction = COULOMB,
    ) -> None:
        self.walker, self.control, self.law, self.friction = walker, control, law, friction
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
        self._symbols = Expressions(walker, control, law, friction)
        self._eom, self._t = self._symbols.eom, self._symbols.t
        self._p, self._r = self._symbols.p, self._symbols.r
        self._functions: dict[str, Function] = {}
        self._data: dict[int, Array] = {}

    def __copy__(self) -> "HybridSystem":
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "HybridSystem":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self.walker, self.control, self.law, self.friction)

    def flow(self, mode: Mode) -> Function:
        """(t, z, p, r) -> dz/dt."""
        return self._build(f"flow_{mode.key}", lambda: {"dz": self._symbols.motion(mode).dz})

    def margins(self, mode: Mode) -> Function:
        """(t, z, p, r) -> margins in the order of ``margin_names(mode)``."""
        return self._build(f"margins_{mode.key}", lambda: {"margins": self._symbols.margins(mode)})

    def events(self, mode: Mode) -> Function:
        """(t, z, p, r) -> margins and their rates along the flow."""

        def rates() -> SX:
            margins = self._symbols.margins(mode)
            return jtimes(margins, self._eom.z, self._symbols.motion(mode).dz) + jacobian(margins, self._t)

        return self._build(f"events_{mode.key}", lambda: {"margins": self._symbols.margins(mode), "rates": rates()})

    def linearized(self, mode: Mode) -> Function:
        """(t, z, p, r) -> dz/dt, Jacobian of the margins in z, and rates of the margins along the flow."""

        def outputs() -> dict[str, SX]:
            dz, margins = self._symbols.motion(mode).dz, self._symbols.margins(mode)
            by_z = jacobian(margins, self._eom.z)
            return {"dz": dz, "margins_by_z": by_z, "rates": by_z @ dz + jacobian(margins, self._t)}

        return self._build(f"linearized_{mode.key}", outputs)

    def variational(self, mode: Mode, columns: int) -> Function:
        """(t, y, p, r) -> dy/dt of y = (z, columns of deviations one after the other)."""

        def outputs() -> dict[str, SX]:
            dz = self._symbols.motion(mode).dz
            return {"dy": vertcat(dz, vec(jacobian(dz, self._eom.z) @ deviations))}

        deviations = SX.sym("deviations", self.n_z, columns)
        y = vertcat(self._eom.z, vec(deviations))
        name = f"variational_{mode.key}_{columns}"
        return self._build(name, outputs, "typr", y=y)

    def observation(self, mode: Mode) -> Function:
        """(t, z, p, r) -> contact force (2), torques (n_u), motor power (n_u), swing foot (2), energy, E' dq, loss.

        The loss is the power that the dampers take.
        """

        def outputs() -> dict[str, SX]:
            eom, torque = self._eom, self._symbols.torque
            motor_rates = eom.E.T @ eom.dq
            return {
                "force": self._symbols.motion(mode).force,
                "torque": torque,
                "power": torque * motor_rates,
                "swing_foot": eom.mechanism.swing_foot,
                "energy": eom.energy + self._symbols.potential_of(mode),
                "motor_rates": motor_rates,
                "loss": eom.dissipation,
            }

        return self._build(f"observation_{mode.key}", outputs)

    def impact(self, mode: Mode) -> Function:
        """(z, p) -> z_plus, impulse (2), slip velocity, lift velocity, painleve; see ``mechanics.impact``."""

        def outputs() -> dict[str, SX]:
            result = self._symbols.impact(mode)
            return {field.name: getattr(result, field.name) for field in fields(result)}

        return self._build(f"impact_{mode.key}", outputs, "zp")

    def impacts(self, modes: Sequence[Mode]) -> Function:
        """(z, p) -> what ``impact`` gives for each of several modes, one column per mode; and the approach.

        The approach is the normal velocity of the swing foot as it lands [m/s], negative where it comes down.
        """
        z, p = self._eom.z, self._p

        def outputs() -> dict[str, SX]:
            columns = [vertcat(*self.impact(mode).call([z, p])) for mode in modes]
            return {"impacts": horzcat(*columns), "approach": self._symbols.approach}

        return self._build("_".join(["impacts", *(mode.key for mode in modes)]), outputs, "zp")

    def impact_jacobian(self, mode: Mode) -> Function:
        """(z, p) -> d z_plus / dz, shape (n_z, n_z)."""

        def outputs() -> dict[str, SX]:
            return {"z_plus_by_z": jacobian(self._symbols.impact(mode).z_plus, self._eom.z)}

        return self._build(f"impact_jacobian_{mode.key}", outputs, "zp")

    def impact_margin_names(self, mode: Mode) -> tuple[str, ...]:
        """Names of the margins of an impact, in the order of ``impact_margins``."""
        names = impact_margin_names(mode, self.walker, two_coefficients=self.friction.two_coefficients)
        return (*names, *PUSH) if self.walker.pushes and not mode.locked else names

    def impact_margins(self, mode: Mode) -> Function:
        """(z, p) -> margins of an impact in the order of ``impact_margin_names(mode)``."""

        def outputs() -> dict[str, SX]:
            margins = self._symbols.impact_margins(mode)
            return {"margins": vertcat(*(margins[name] for name in self.impact_margin_names(mode)))}

        return self._build(f"impact_margins_{mode.key}", outputs, "zp")

    @cached_property
    def open_flow(self) -> Function:
        """(t, z, s, p, r) -> dz/dt, contact force (2), touchdown guard and its rate, the mode being open.

        Friction is -mu s f_n with s in [-1, 1], and kinetic friction bounds a foot at rest too.
        """

        def outputs() -> dict[str, SX]:
            state = self._symbols.slipping(s, self.walker.released(Mode.STICK))
            guard = SX(self._eom.mechanism.touchdown)
            rate = jtimes(guard, self._eom.z, state.dz)
            return {"dz": state.dz, "force": state.force, "guard": guard, "guard_rate": rate}

        s = SX.sym("s")
        return self._build("open_flow", outputs, "tzspr", s=s)

    @cached_property
    def open_impact(self) -> Function:
        """(z, s, p) -> z_plus, impulse (2), slip velocity, lift velocity, by Coulomb's law with s in [-1, 1]."""

        def outputs() -> dict[str, SX]:
            result = self._symbols.open_impact(s)
            names = ("z_plus", "impulse", "slip_velocity", "lift_velocity")
            return {name: getattr(result, name) for name in names}

        s = SX.sym("s")
        return self._build("open_impact", outputs, "zsp", s=s)

    @cached_property
    def push(self) -> Function:
        """(z, p) -> impulse (2) of the push of the stance foot just before the swing foot lands, and its work [J]."""
        push = self._symbols.push
        return Function("push", [self._eom.z, self._p], [push.impulse, push.work], ["z", "p"], ["impulse", "work"])

    @cached_property
    def weight(self) -> Function:
        """p -> total weight [N]."""
        return Function("weight", [self._p], [self._eom.mass * self._eom.gravity])

    @cached_property
    def size(self) -> Function:
        """p -> length of a leg [m], gravity [m/s^2] and total mass [kg]."""
        eom = self._eom
        return Function("size", [self._p], [eom.length, eom.gravity, eom.mass])

    @cached_property
    def lift(self) -> Function:
        """(xi, p) -> z: the state just after an impact from its section coordinates (always with dx), x = 0."""
        names = self.walker.section_names(slipping=True)
        xi = SX.sym("xi", len(names))
        free = SimpleNamespace(**{name: xi[i] for i, name in enumerate(names)})
        p = parameter_namespace(self.walker, self._eom.p)
        shape, rates = state_after_impact(self.walker, free, p)
        z = vertcat(self._eom.state(shape, SX(0)), self._eom.state(rates, xi[-1]))
        return Function("lift", [xi, self._p], [z])

    @cached_property
    def lift_jacobian(self) -> Function:
        """(xi, p) -> d z / d xi of ``lift``; the column of dx is the last."""
        xi = SX.sym("xi", self.lift.size1_in(0))
        return Function("lift_jacobian", [xi, self._p], [jacobian(self.lift(xi, self._p), xi)])

    def section(self, impact_mode: Mode) -> NDArray[np.intp]:
        """Indices in ``z`` of the section coordinates after an impact of the given mode."""
        names = self.walker.section_names(slipping=impact_mode.slips)
        return np.array([self.state_names.index(name) for name in names])

    def values(self, parameters: Mapping[str, float]) -> Array:
        """The vector ``p`` from values by dotted key, those of the control law itself where none is given; (n_p,)."""
        known = {**{f"control.{name}": value for name, value in self.control.parameters.items()}, **parameters}
        return np.array([float(known[name]) for name in self.parameters])

    def data(self, segment: int) -> Array:
        """Segment data of the control, shape (n_r,); not to be written to."""
        if segment not in self._data:
            self._data[segment] = self.control.data(segment)
        return self._data[segment]

    def static_friction(self, p: Any) -> Any:
        """Coefficient that bounds |f_t| / f_n of a sticking foot, from parameters as numbers or symbols."""
        return self.friction.static(p[self._friction_entries])

    def kinetic_friction(self, p: Any) -> Any:
        """|f_t| / f_n of a slipping foot without drag, from parameters as numbers or symbols."""
        return self.friction.kinetic(p[self._friction_entries])

    def _build(self, name: str, outputs: Callable[[], dict[str, SX]], inputs: str = "tzpr", **symbols: SX) -> Function:
        """The function of these inputs, letters of the module's equations or ``symbols``, built on first use."""
        if name not in self._functions:
            symbols |= {"t": self._t, "z": self._eom.z, "p": self._p, "r": self._r}
            results = outputs()
            shared = cse([*results.values()])
            self._functions[name] = Function(name, [symbols[key] for key in inputs], shared, [*inputs], [*results])
        return self._functions[name]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Parts:
    """What a system is made of; control laws are equal where their pickles are."""

    walker: type[Walker]
    law: ImpactLaw
    friction: Friction
    control_pickle: bytes
    control: Control = field(compare=False)


def _unpickled(walker: type[Walker], control: Control, law: ImpactLaw, friction: Friction) -> HybridSystem:
    parts = _Parts(walker=walker, law=law, friction=friction, control_pickle=pickle.dumps(control), control=control)
    return _system(parts)


@lru_cache(maxsize=KEPT)
def _system(parts: _Parts) -> HybridSystem:
    return HybridSystem(parts.walker, parts.control, parts.law, parts.friction)
