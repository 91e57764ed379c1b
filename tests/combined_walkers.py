"""Walkers with named contacts that combine stops, switches, push-offs, massless, rolling and unequal feet."""

from dataclasses import replace
from types import SimpleNamespace

from casadi import SX, norm_2, sqrt, sumsqr, vertcat

from gaitopt.model.mechanism import Body, Contact, Mechanism, polar
from gaitopt.model.walker import Walker
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.crawler import Crawler
from gaitopt.model.walkers.heel_toe import HeelToe
from gaitopt.model.walkers.hopper import Hopper
from gaitopt.model.walkers.kneed import KneedWalker
from gaitopt.model.walkers.push_off import PushOffCompass
from gaitopt.model.walkers.round_feet import RoundFeetCompass
from gaitopt.model.walkers.slip_walker import SlipWalker
from gaitopt.model.walkers.unequal_compass import UnequalCompass

FEET = ("foot_1", "foot_2")


def with_feet(stated: Mechanism, q: SimpleNamespace, counts: SX) -> Mechanism:
    """A mechanism whose feet are contacts; the swing foot passes through the ground while ``counts`` is negative."""
    points = Contact(position=vertcat(q.x, q.y)), Contact(position=stated.swing_foot, counts=counts)
    return replace(stated, contacts=dict(zip(FEET, points, strict=True)))


class TwoFeet(Walker):
    """What walkers have in common that swap two named feet; a class that restates a walker inherits from it first."""

    contacts = FEET
    landing_contacts = FEET[1:]
    exchanged_contacts = dict([FEET])  # noqa: RUF012

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return with_feet(super().mechanism(q, p), q, q.theta1 - 0.04)


class NamedCompass(TwoFeet, CompassBiped):
    """The compass with its feet as named contacts."""

    model = "named_compass"


class NamedUnequal(TwoFeet, UnequalCompass):
    """The compass with unequal legs."""

    model = "named_unequal"


class NamedRound(TwoFeet, RoundFeetCompass):
    """The compass on round feet: the coordinate x of a foot is the distance that it has slid."""

    model = "named_round"


class NamedPush(TwoFeet, PushOffCompass):
    """The compass that pushes off."""

    model = "named_push"
    pushes = FEET[:1]

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        stated = super().mechanism(q, p)
        return replace(stated, push={FEET[0]: stated.push})


class NamedKneed(KneedWalker):
    """The kneed walker with its feet as named contacts."""

    model = "named_kneed"
    contacts = FEET
    landing_contacts = FEET[1:]
    exchanged_contacts = dict([FEET])  # noqa: RUF012
    closing_stops = ("knee",)

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return with_feet(super().mechanism(q, p), q, q.theta1 + q.theta2 - 0.02)


class NamedHopper(Hopper):
    """The hopper with its foot as a named contact."""

    model = "named_hopper"
    flies = False
    contacts = ("toe",)
    landing_contacts = ("toe",)

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        """The foot."""
        return replace(super().mechanism(q, p), contacts={"toe": Contact(position=vertcat(q.x, q.y))})


class Pogo(Walker):
    """A body on a massless springy leg with a thrust, in which a mass on a spring slides from a stop and back."""

    model = "pogo"
    shape = ("leg_x", "leg_y", "slide")
    lengths = shape
    contacts = ("toe",)
    massless_contacts = contacts
    landing_contacts = contacts
    stops = ("slider",)
    switches = ("thrust",)

    leg_length: float
    body_mass: float
    slider_mass: float
    leg_stiffness: float
    slider_stiffness: float
    thrust: float
    gravity: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        body, leg, speed = vertcat(q.x, q.y), vertcat(q.leg_x, q.leg_y), sqrt(p.gravity * p.leg_length)
        shortening = p.leg_length - norm_2(leg)
        toe = Contact(position=body + leg, gap=q.y - p.leg_length, places={"leg_x": SX(0), "leg_y": -p.leg_length})
        return Mechanism(
            bodies=(
                Body(mass=p.body_mass, position=body),
                Body(mass=p.slider_mass, position=body - vertcat(0, q.slide)),
            ),
            gravity=vertcat(0, -p.gravity),
            upright=q.y / p.leg_length,
            swing_foot=body,
            relabel=vertcat(q.leg_x, q.leg_y, q.slide),
            stops={"slider": q.slide / p.leg_length},
            switches={"thrust": lambda dq: -dq.y / speed},
            potential=p.slider_stiffness / 2 * q.slide**2,
            potential_while={"toe": p.leg_stiffness / 2 * shortening**2, "thrust on": p.thrust * shortening},
            contacts={"toe": toe},
            length=SX(p.leg_length),
        )


class Crutch(Crawler):
    """The crawler with a massless springy crutch, which it places ahead of its front mass where that has moved on."""

    model = "crutch"
    shape = (*Crawler.shape, "crutch_x", "crutch_y")
    lengths = shape
    contacts = (*Crawler.contacts, "tip")
    massless_contacts = ("tip",)

    crutch_stiffness: float
    height: float
    ahead: float
    placed: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        stated, crutch = super().mechanism(q, p), vertcat(q.crutch_x, q.crutch_y)
        length, pivot = sqrt(p.height**2 + p.ahead**2), stated.contacts["front"].position + vertcat(0, p.height)
        tip = Contact(
            position=pivot + crutch, gap=p.placed - q.gap, places={"crutch_x": p.ahead, "crutch_y": -p.height}
        )
        return replace(
            stated,
            contacts={**stated.contacts, "tip": tip},
            potential_while={"tip": p.crutch_stiffness / 2 * (length - norm_2(crutch)) ** 2},
        )


class Limper(SlipWalker):
    """Spring-mass walking on two legs of different stiffness."""

    model = "limper"
    exchanged = {"stiffness": "other_stiffness"}  # noqa: RUF012

    other_stiffness: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        legs = {"front": (p.stiffness, q.front_x, q.front_y), "back": (p.other_stiffness, q.back_x, q.back_y)}
        springs = {name: k / 2 * (p.leg_length - sqrt(sumsqr(vertcat(x, y)))) ** 2 for name, (k, x, y) in legs.items()}
        return replace(super().mechanism(q, p), potential_while=springs)


class ToePush(HeelToe):
    """The walker on flat feet, whose toe pushes off along the leg just before the other heel lands."""

    model = "toe_push"
    pushes = ("toe",)

    push: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return replace(super().mechanism(q, p), push={"toe": polar(p.push, q.theta1)})


class KneedPush(NamedKneed):
    """The kneed walker, which pushes off with its stance foot while the knee of the other leg is locked."""

    model = "kneed_push"
    pushes = FEET[:1]

    push: float

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return replace(super().mechanism(q, p), push={FEET[0]: polar(p.push, q.theta1)})


def renumbered(walker: type[Walker]) -> type[Walker]:
    """The walker with its contacts in the opposite order."""

    class Renumbered(walker):
        contacts = walker.contacts[::-1]
        massless_contacts = walker.massless_contacts[::-1]

        @classmethod
        def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
            stated = super().mechanism(q, p)
            return replace(stated, contacts={name: stated.contacts[name] for name in cls.contacts})

    return Renumbered


def with_spare(walker: type[Walker]) -> type[Walker]:
    """The walker with another contact, 3 m above its last body."""

    class Spared(walker):
        contacts = ("spare", *walker.contacts)

        @classmethod
        def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
            stated = super().mechanism(q, p)
            spare = Contact(position=stated.bodies[-1].position + vertcat(0, 3))
            return replace(stated, contacts={"spare": spare, **stated.contacts})

    return Spared


def mirrored(walker: type[Walker]) -> type[Walker]:
    """The walker seen from the other side, which walks towards negative x."""
    flip = vertcat(-1, 1)

    class Mirrored(walker):
        @classmethod
        def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
            stated = super().mechanism(SimpleNamespace(**{**vars(q), "x": -q.x}), p)
            return replace(
                stated,
                bodies=tuple(replace(b, position=flip * b.position, angle=-b.angle) for b in stated.bodies),
                gravity=flip * stated.gravity,
                swing_foot=flip * stated.swing_foot,
                contacts={name: replace(c, position=flip * c.position) for name, c in stated.contacts.items()},
                push={name: flip * impulse for name, impulse in stated.pushes.items()} or None,
            )

    return Mirrored
