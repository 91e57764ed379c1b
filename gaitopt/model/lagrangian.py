"""Equations of motion of a walker, from the positions of its masses.

    M(q) ddq + B(q, dq) + G(q) = E u + W' f                                Gamus & Or (2013), eq. (2)

W is the Jacobian of the stance foot. With the Jacobians J = dr/dq of the positions and angles r of the bodies,

    M = sum m J' J        B = sum m J' (dJ/dt dq)

These sums take half as many operations as derivatives of the kinetic energy. Because (x, y) are coordinates, W' f only
adds (f_t, f_n) to the rows of x and y. Walkers that do not fly have y = dy = 0 in all expressions.

**Uneven ground.** Under every contact is a tile of height h; its slope exceeds that of the nominal ground by d. Its
tangent and normal are the rows of

    R = [ cos d   -sin d ]
        [ sin d    cos d ]

in the frame of the nominal ground, in which the state is stated. A foot that stands alone has h = 0, and slides along
y = -x tan d; h of the swing foot is the height of the next tile above that of the stance foot.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace

from casadi import (
    SX,
    cos,
    dot,
    gradient,
    horzcat,
    jacobian,
    jtimes,
    mmax,
    norm_2,
    sin,
    sqrt,
    substitute,
    sum1,
    tan,
    triu,
    triu2symm,
    vertcat,
    vertsplit,
)

from gaitopt.building import built_once
from gaitopt.model.declaration import check_class, parameter_namespace, symbolic_mechanism
from gaitopt.model.mechanism import Body, Contact, Mechanism
from gaitopt.model.modes import FOOT, SWING_FOOT
from gaitopt.model.walker import Walker

TRAILING = "trailing_foot.height"
"""Name of the height of ``Mechanism.trailing_foot`` on uneven ground."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactPoint:
    """A point of the walker that can touch the ground.

    Attributes
    ----------
    position : SX, shape (2,) - along the ground and normal to it [m].
    J : SX, shape (2, n_q) - its Jacobian, with rows tangent and normal.
    velocity : SX, shape (2,) - J dq [m/s].
    convective : SX, shape (2,) - dJ/dt dq [m/s^2].
    gap : SX - margin that falls to zero when the point lands.
    R : SX, shape (2, 2) - tangent and normal of the ground under it, as rows; the identity on even ground.
    """

    position: SX
    J: SX
    velocity: SX
    convective: SX
    gap: SX
    R: SX

    @property
    def is_tilted(self) -> bool:
        """Whether the ground under it may have a slope of its own."""
        return not self.R.is_constant()

    @property
    def nominal_J(self) -> SX:
        """Jacobian of the position in the frame of the nominal ground."""
        return self.R.T @ self.J if self.is_tilted else self.J


@dataclass(frozen=True, slots=True, kw_only=True)
class EquationsOfMotion:
    """Symbolic mechanics of one walker.

    Attributes
    ----------
    walker : the walker's class.
    p : SX, shape (n_p,) - the walker's parameters, in the order of its fields.
    z : SX, shape (n_z,) - integrated state: coordinates, then rates, in the order of ``Walker.coordinates``.
    q, dq : SX, shape (n_shape + 2,) - coordinates (shape, x, y) and rates; y = dy = 0 if they are not states.
    M : SX, shape (n_q, n_q) - mass matrix.
    B : SX, shape (n_q,) - velocity terms, with dampers.
    G : SX, shape (n_q,) - gravity, with the springs that act in all modes.
    switches, sections : SX by name - margins of the switches, and of the sections that may end a cycle.
    E : SX, shape (n_q, n_u) - generalised forces of the actuators, Q = E u.
    moment : SX, shape (2, n_q) - Jacobian of the first moment of mass, sum m r.
    W_swing : SX, shape (2, n_q) - Jacobian of the swing foot, with rows tangent and normal.
    contacts : contacts by name; those of a walker that stands on one foot at a time are ``foot`` and ``swing_foot``.
    gaps : SX by name, shape (1, n_q) - derivatives of the gaps of the stops, which are affine.
    energy : SX - kinetic plus potential energy [J].
    dissipation : SX - power that the dampers dissipate [W].
    mass : SX - total mass [kg].
    centre_height : SX - height of the centre of mass over the ground, along its normal [m].
    gravity : SX - acceleration of gravity [m/s^2].
    length : SX - natural unit of length, by default that of a straight leg; see ``Mechanism`` [m].
    mechanism : the walker's mechanism, with y = dy = 0 if it does not fly.
    ground : SX, shape (n_g,) - height and slope of the ground under each contact, in the order of ``ground_names``.
    """

    walker: type[Walker]
    p: SX
    z: SX
    q: SX
    dq: SX
    M: SX
    B: SX
    G: SX
    E: SX
    moment: SX
    W_swing: SX
    contacts: Mapping[str, ContactPoint]
    gaps: Mapping[str, SX]
    switches: Mapping[str, SX]
    sections: Mapping[str, SX]
    energy: SX
    dissipation: SX
    mass: SX
    centre_height: SX
    gravity: SX
    length: SX
    mechanism: Mechanism
    ground: SX

    def state(self, shape: SX, x: SX, y: SX | float = 0.0) -> SX:
        """Coordinates, or their rates, in the order of the state."""
        return vertcat(shape, y, x) if "y" in self.walker.coordinates() else vertcat(shape, x)

    @property
    def parameters(self) -> SimpleNamespace:
        """The walker's parameters by name."""
        return parameter_namespace(self.walker, self.p)

    def gravity_force(self, gravity: SX) -> SX:
        """Gradient of the potential energy of the weight under an acceleration of gravity, shape (n_q,).

        Parameters
        ----------
        gravity : SX, shape (2,) - along x and y [m/s^2]; ``mechanism.gravity`` is the walker's own.
        """
        return -self.moment.T @ gravity

    def force_of(self, potential: SX) -> SX:
        """Gradient of a potential energy, shape (n_q,)."""
        n = len(self.walker.shape)
        gradients = jacobian(potential, self.q[:n]).T
        return vertcat(gradients, SX.zeros(2))  # springs do not act on the ground


def ground_names(walker: type[Walker]) -> tuple[str, ...]:
    """Names of the numbers that describe uneven ground: height [m] and slope [rad] under every contact.

    If one foot stands alone, two more follow. ``swing_foot.is_higher`` is 0 if the next tile is level with this one, so
    that the walker's own guard determines touchdown, and 1 otherwise. ``trailing_foot.height`` is the height of
    ``Mechanism.trailing_foot`` at the start of the step.
    """
    names = [f"{name}.{what}" for name in walker.landing_points() for what in ("height", "slope")]
    return (*names, *((f"{SWING_FOOT}.is_higher", TRAILING) if walker.stands_on_one() else ()))


@built_once(maxsize=8)
def equations_of_motion(walker: type[Walker]) -> EquationsOfMotion:
    """Derive the equations of motion of ``walker``.

    Raises
    ------
    ProblemError
        If the class is not well formed; the message says where.
    """
    return _equations(walker, uneven=False)


@built_once(maxsize=4)
def equations_on_tiles(walker: type[Walker]) -> EquationsOfMotion:
    """The equations of motion on uneven ground, with the heights and slopes ``ground`` under the contacts."""
    return _equations(walker, uneven=True)


def _equations(walker: type[Walker], *, uneven: bool) -> EquationsOfMotion:
    check_class(walker)
    q, p, mechanism, _ = symbolic_mechanism(walker)
    names = (*walker.shape, "x", "y")
    dq = vertcat(*(SX.sym(f"d{name}") for name in names))

    M, velocity_terms, kinetic = inertia(mechanism.bodies, q, dq)
    weights = (body.mass * dot(mechanism.gravity, body.position) for body in mechanism.bodies)
    potential = SX(mechanism.potential) - sum(weights, SX(0))
    dissipation = sum((SX(d.coefficient) * jtimes(SX(d.across), q, dq) ** 2 for d in mechanism.dampers), SX(0))
    B = velocity_terms + gradient(dissipation, dq) / 2  # Rayleigh's function
    angles = vertcat(*mechanism.motors) if mechanism.motors else SX(0, 1)
    feet = [contact.position for contact in mechanism.contacts.values()] or [SX.zeros(2)]
    distances = (norm_2(body.position - foot) for body in mechanism.bodies for foot in feet)
    straight = substitute(vertcat(*distances), q, SX.zeros(q.numel()))
    length = mmax(straight) if mechanism.length is None else mechanism.length

    on_ground = "y" not in walker.coordinates()
    points = {name: (contact.position, _gap(contact, length)) for name, contact in mechanism.contacts.items()} or {
        FOOT: (q[-2:], q[-1]),
        SWING_FOOT: (mechanism.swing_foot, -SX(mechanism.touchdown)),
    }
    ground, tilts, y_on_ground = SX(0, 1), dict[str, SX](), SX.zeros(2)
    if uneven:
        keys = ground_names(walker)
        ground = vertcat(*(SX.sym(key) for key in keys))
        of = dict(zip(keys, vertsplit(ground), strict=True))
        points = {
            name: (position - vertcat(0, of[f"{name}.height"]), substitute(gap, q[-1], q[-1] - of[f"{name}.height"]))
            for name, (position, gap) in points.items()
        }
        if not mechanism.contacts:
            over = points[SWING_FOOT][0][1] / length
            is_higher, guard = of[f"{SWING_FOOT}.is_higher"], -SX(mechanism.touchdown)
            points[SWING_FOOT] = (points[SWING_FOOT][0], (1 - is_higher) * guard + is_higher * over)
            if mechanism.trailing_foot is not None:
                mechanism = replace(mechanism, upright=(mechanism.trailing_foot[1] - of[TRAILING]) / length)
            y_on_ground = -tan(of[f"{FOOT}.slope"]) * vertcat(q[-2], dq[-2])
        slopes = {name: of[f"{name}.slope"] for name in points}
        tilts = {name: vertcat(horzcat(cos(d), -sin(d)), horzcat(sin(d), cos(d))) for name, d in slopes.items()}

    def grounded(expression: SX) -> SX:
        return substitute(expression, vertcat(q[-1], dq[-1]), y_on_ground) if on_ground else expression

    order = [names.index(name) for name in walker.coordinates()]
    rates = SimpleNamespace(**{name: dq[i] for i, name in enumerate(names)})

    mass = sum1(vertcat(*(SX(body.mass) for body in mechanism.bodies)))
    heights = sum((body.mass * body.position[1] for body in mechanism.bodies), SX(0))
    return EquationsOfMotion(
        walker=walker,
        p=p,
        z=vertcat(q[order], dq[order]),
        q=grounded(q),
        dq=grounded(dq),
        M=triu2symm(triu(grounded(M))),  # entries that are equal are one expression
        B=grounded(B),
        G=grounded(gradient(potential, q)),
        E=grounded(jacobian(angles, q).T),
        moment=grounded(
            sum((body.mass * jacobian(body.position, q) for body in mechanism.bodies), SX.zeros(2, q.numel()))
        ),
        W_swing=grounded(jacobian(mechanism.swing_foot, q)),
        contacts={
            name: _point(position, gap, q, dq, tilts.get(name, SX.eye(2)), grounded)
            for name, (position, gap) in points.items()
        },
        gaps={name: grounded(jacobian(SX(gap), q)) for name, gap in mechanism.stops.items()},
        switches={name: grounded(SX(margin(rates))) for name, margin in mechanism.switches.items()},
        sections={name: grounded(SX(margin(rates))) for name, margin in mechanism.sections.items()},
        energy=grounded(kinetic + potential),
        dissipation=grounded(dissipation),
        mass=mass,
        centre_height=grounded(heights / mass),
        gravity=norm_2(mechanism.gravity),
        length=length,
        mechanism=_mapped(mechanism, grounded),
        ground=ground,
    )


def _point(position: SX, gap: SX, q: SX, dq: SX, R: SX, grounded: Callable[[SX], SX]) -> ContactPoint:
    J = jacobian(position, q)
    J = J if R.is_constant() else R @ J
    velocity = J @ dq
    parts = position, J, velocity, jtimes(velocity, q, dq), gap, R
    return ContactPoint(**dict(zip(ContactPoint.__slots__, map(grounded, parts), strict=True)))


def _gap(contact: Contact, length: SX) -> SX:
    """The margin that falls to zero when a contact lands."""
    gap = contact.position[1] if contact.gap is None else contact.gap
    counts = SX(contact.counts)
    return gap if counts.is_constant() else _either(gap, -counts * length)


def _either(a: SX, b: SX) -> SX:
    """A number that is positive if one of two numbers is, and falls through zero with a if b is negative.

    It is Rvachev's disjunction: a maximum without a kink, which engines can expand in Taylor series.
    """
    return a + b + sqrt(a**2 + b**2)


def inertia(bodies: Iterable[Body], q: SX, dq: SX) -> tuple[SX, SX, SX]:
    """Mass matrix, velocity terms and kinetic energy: sums over the positions and angles of the bodies."""
    M, B, kinetic = SX.zeros(q.numel(), q.numel()), SX.zeros(q.numel()), SX(0)
    for body in bodies:
        for mass, coordinate in ((body.mass, body.position), (body.inertia, SX(body.angle))):
            J = jacobian(coordinate, q)
            rate = J @ dq
            M += mass * (J.T @ J)
            B += mass * (J.T @ jtimes(rate, q, dq))
            kinetic += mass * dot(rate, rate) / 2
    return M, B, kinetic


def _mapped(mechanism: Mechanism, function: Callable[[SX], SX]) -> Mechanism:
    """The mechanism with a function applied to the expressions that modes, guards and resets use."""
    return replace(
        mechanism,
        swing_foot=function(mechanism.swing_foot),
        touchdown=function(SX(mechanism.touchdown)),
        upright=function(SX(mechanism.upright)),
        trailing_foot=None if mechanism.trailing_foot is None else function(mechanism.trailing_foot),
        relabel=function(SX(mechanism.relabel)),
        stops={name: function(SX(gap)) for name, gap in mechanism.stops.items()},
        phases={name: function(SX(phase)) for name, phase in mechanism.phases.items()},
        potential_while={state: function(SX(energy)) for state, energy in mechanism.potential_while.items()},
        push={name: function(impulse) for name, impulse in mechanism.pushes.items()},
    )
